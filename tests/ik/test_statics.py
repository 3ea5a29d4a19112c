"""Static torques obey virtual work along motions of the library; feet share friction."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aslip.ik import Kinematics, share_friction, static_torque
from aslip.library import GaitLibrary
from aslip.robot import CASSIE, STANDARD_GRAVITY


@pytest.mark.parametrize("row", [0, 7, 20])
def test_motors_and_ground_do_the_same_work(library: GaitLibrary, row: int) -> None:
    """Virtual work: along a motion with rigid springs motors and ground forces balance."""
    table = library.table
    force = np.random.default_rng(row).normal(size=(table.qpos.shape[1], 2, 3))
    torque = static_torque(Kinematics(), table.qpos[row], force)
    # feet relative to a pelvis that does not turn
    velocity = table.foot_velocity[row]
    velocity = velocity - table.body_velocity[row][:, None]
    by_ground = (force * velocity).sum((1, 2))
    by_motors = (torque * table.motor_velocity[row]).sum(1)
    np.testing.assert_allclose(by_motors, -by_ground, atol=1e-9)


def test_both_legs_carry_a_standing_robot_equally() -> None:
    kinematics = Kinematics()
    qpos = CASSIE.standing[None]
    force = np.zeros((1, 2, 3))
    force[..., 2] = CASSIE.total_mass * STANDARD_GRAVITY / 2
    torque = static_torque(kinematics, qpos, force).reshape(2, 5)
    # roll and yaw of the right leg have the opposite sign
    np.testing.assert_allclose(torque[0], torque[1] * [-1, -1, 1, 1, 1], atol=1e-9)
    np.testing.assert_array_equal(static_torque(kinematics, qpos, 0 * force), np.zeros((1, 10)))


def test_torques_do_not_depend_on_the_heading_or_tilt() -> None:
    kinematics = Kinematics()
    qpos = CASSIE.standing[None]
    force = np.array([[[10.0, 20.0, 160.0], [-5.0, 8.0, 170.0]]])
    turn = Rotation.from_euler("xyz", [0.2, -0.3, 1.0])
    turned = qpos.copy()
    turned[:, 3:7] = (turn * Rotation.from_quat(qpos[0, 3:7], scalar_first=True)).as_quat(
        scalar_first=True
    )
    np.testing.assert_allclose(
        static_torque(kinematics, turned, turn.apply(force[0])[None]),
        static_torque(kinematics, qpos, force),
        atol=1e-9,
    )


def test_feet_that_share_friction_do_not_push_against_each_other() -> None:
    force = np.random.default_rng(3).normal(size=(4, 2, 3))
    force[..., 2] = [[160.0, 160.0], [300.0, 20.0], [0.0, 290.0], [0.0, 0.0]]
    force[2, 0] = force[3] = 0.0
    shared = share_friction(force)
    np.testing.assert_allclose(shared.sum(1), force.sum(1), atol=1e-12)
    np.testing.assert_array_equal(shared[..., 2], force[..., 2])
    # a foot in the air leaves that on the ground all the friction
    np.testing.assert_allclose(shared[2:], force[2:], atol=1e-12)
    ratio = shared[:2, :, :2] / shared[:2, :, 2:]
    np.testing.assert_allclose(ratio[:, 0], ratio[:, 1], atol=1e-12)
