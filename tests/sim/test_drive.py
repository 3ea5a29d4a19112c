"""PD control and the motor's limits, against torques computed by hand."""

import numpy as np
import pytest

from aslip.robot import CASSIE
from aslip.sim import PD, Drive, Torque
from tests.helpers import motor_torque

ZERO = np.zeros(10)
NO_LOAD = CASSIE.no_load_speed / CASSIE.gear  # at the joint [rad/s]


@pytest.mark.parametrize(
    ("speed", "share"), [(0.0, 1.0), (0.5, 1.0), (0.6, 0.8), (0.9, 0.2), (1.0, 0.0), (1.3, 0)]
)
@pytest.mark.parametrize("turning", [1, -1])
@pytest.mark.parametrize("pushing", [1, -1])
def test_torque_limit_falls_from_half_the_no_load_speed(
    speed: float, share: float, turning: int, pushing: int
) -> None:
    """Full torque up to half the no-load speed, none from it on, linear between; braking, too."""
    torque = motor_torque(np.full(10, pushing * 50.0), ZERO, turning * speed * NO_LOAD)
    np.testing.assert_allclose(torque, pushing * share * CASSIE.torque_limit, atol=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_infinite_targets_give_the_torque_limit(sign: int) -> None:
    torque = motor_torque(np.full(10, sign * np.inf), ZERO, ZERO)
    np.testing.assert_array_equal(torque, sign * CASSIE.torque_limit)


def test_nan_is_not_limited_and_affects_one_robot_only() -> None:
    """Divergence must be detected, and other robots must not change."""
    position, velocity = np.zeros((2, 10)), np.zeros((2, 10))
    for broken in (position, velocity):
        broken[0, 3] = np.nan
        torque = motor_torque(np.ones((2, 10)), position, velocity)
        assert np.isnan(torque[0, 3])
        assert np.isfinite(torque[1]).all()
        broken[:] = 0


def test_torques_are_written_to_out() -> None:
    drive, out = PD(3), np.zeros((3, 20))
    angles = [np.random.default_rng(i).normal(size=(3, 10)) for i in range(3)]
    assert drive.torque(*angles, out=out[:, ::2]).base is out
    np.testing.assert_array_equal(out[:, ::2], motor_torque(*angles))
    assert not out[:, 1::2].any()


class _PlainPD(Drive):
    """PD control in NumPy, as a user may write it."""

    def joint_torque(
        self, command: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> np.ndarray:
        return (command - position) * CASSIE.stiffness - velocity * CASSIE.damping


def test_drive_in_numpy_equals_the_compiled_one() -> None:
    rng = np.random.default_rng(2)
    target, position = rng.uniform(-2, 2, (2, 50, 10))
    velocity = rng.uniform(-1.2, 1.2, (50, 10)) * NO_LOAD
    expected = PD(50).torque(target, position, velocity)
    plain = _PlainPD(50)
    np.testing.assert_array_equal(plain.torque(target, position, velocity), expected)
    np.testing.assert_array_equal(plain.initial_command(position), np.zeros((50, 10)))
    np.testing.assert_array_equal(PD(50).initial_command(position), position)


def test_feedforward_torque_is_divided_by_the_gear_and_limited() -> None:
    joint = np.stack([np.full(10, 20.0), np.full(10, -1e3)])
    torque = Torque(2).torque(joint, np.ones((2, 10)), np.zeros((2, 10)))
    np.testing.assert_allclose(torque[0], 20.0 / CASSIE.gear)
    np.testing.assert_array_equal(torque[1], -CASSIE.torque_limit)
