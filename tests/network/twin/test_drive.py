"""PD control with the numbers of each command, against the PD loop and by hand."""

import numpy as np

from aslip.network.twin import CommandedPD
from aslip.network.wire import MotorCommand
from aslip.robot import CASSIE
from aslip.sim import PD

RNG = np.random.default_rng(0)


def _torque(q: np.ndarray, dq: np.ndarray, /, **numbers: np.ndarray) -> np.ndarray:
    """Shaft torques of robots with joint angles q and velocities dq."""
    zero = np.zeros((len(q), 10))
    command = MotorCommand(**{**dict.fromkeys(MotorCommand._fields, zero), **numbers})
    return CommandedPD(len(q)).torque(np.concatenate(command, axis=1), q, dq)


def test_torques_with_the_robot_s_gains_are_those_of_the_pd_loop() -> None:
    target, position, velocity = RNG.normal(size=(3, 50, 10))
    gains = [np.tile(gain, (50, 1)) for gain in (CASSIE.stiffness, CASSIE.damping)]
    ours = _torque(position, velocity, position=target, stiffness=gains[0], damping=gains[1])
    np.testing.assert_array_equal(ours, PD(50).torque(target, position, velocity))


def test_feedforward_and_target_velocity_add_to_the_torque() -> None:
    """4 N m + 2 N m s/rad (3 - 1) rad/s = 8 N m at the joint."""
    ones = np.ones((1, 10))
    torque = _torque(0 * ones, ones, torque=4 * ones, velocity=3 * ones, damping=2 * ones)
    np.testing.assert_allclose(torque * CASSIE.gear, 8 * ones)
