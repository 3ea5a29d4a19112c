"""Solutions of the inverse kinematics, checked with Pinocchio and MuJoCo."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

import dataclasses
import sys

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aslip.ik import BodyTarget, IkSolution, solve
from aslip.ik.solve import newton
from aslip.ik.target import FootMotion
from aslip.robot import CASSIE


@pytest.fixture(scope="module")
def walking(kinematics, walking_library) -> IkSolution:
    return solve(kinematics, *walking_library)


def _take(target: BodyTarget, rows: slice | list[int]) -> BodyTarget:
    return dataclasses.replace(
        target, **{name: v[rows] for name, v in vars(target).items() if v is not None}
    )


def _slots(model: mujoco.MjModel, names) -> tuple[list[int], list[int]]:
    joints = [model.joint(name) for name in names]
    return [joint.qposadr[0] for joint in joints], [joint.dofadr[0] for joint in joints]


def _balls(model: mujoco.MjModel) -> np.ndarray:
    """(2, 4) positions of the rods' quaternions in `qpos`, left first."""
    first = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_BALL]
    return first[:, None] + np.arange(4)


def test_walking_poses_are_solved_to_rounding(kinematics, walking, walking_library):
    assert walking.residual.foot_position < 1e-12
    assert walking.residual.toe_direction < 1e-12
    assert walking.residual.loop < 1e-12
    rows = slice(None, None, 17)
    legs = kinematics.legs(kinematics.to_pinocchio(walking.qpos[rows]))
    for side, target in enumerate(walking_library[1:]):
        error = legs.position[:, side] - target.position[rows]
        assert np.linalg.norm(error, axis=-1).max() < 1e-12
        # level and forward: the x axis of the sole is the world's
        toes = legs.rotation[:, side, :, 0]
        np.testing.assert_allclose(toes, np.tile([1.0, 0, 0], (len(toes), 1)), atol=1e-12)
    np.testing.assert_allclose(legs.closure, 0, atol=1e-12)
    np.testing.assert_array_equal(walking.qpos[:, :3], walking_library[0].position)


def test_newton_needs_few_steps_anywhere_in_the_workspace(kinematics, monkeypatch):
    """Without joint limits, level feet reach every position in the box."""
    x, y, z = np.meshgrid(
        np.linspace(-0.45, 0.45, 10), np.linspace(0.05, 0.2, 4), np.linspace(-0.92, -0.6, 5)
    )
    left = np.stack((x.ravel(), y.ravel(), z.ravel()), axis=1)
    position = np.stack((left, left * (1, -1, 1)), axis=1)
    rotation = np.broadcast_to(np.eye(3), (*position.shape, 3))
    still = np.zeros_like(position)
    feet = FootMotion(position, rotation, still, still)
    monkeypatch.setattr(sys.modules["aslip.ik.solve"], "MAX_ITERATIONS", 10)
    _, solved = newton(kinematics, feet)
    assert solved.all()


def test_springs_are_at_rest(mujoco_model, kinematics, smooth_motion):
    solution = solve(kinematics, *smooth_motion(np.linspace(0, 3, 50)))
    position, velocity = _slots(mujoco_model, CASSIE.spring_names)
    assert not solution.qpos[:, position].any()
    assert not solution.qvel[:, velocity].any()


def test_joint_limits_are_respected(mujoco_model, walking):
    limited = mujoco_model.jnt_limited.astype(bool)
    low, high = mujoco_model.jnt_range[limited].T
    angle = walking.qpos[:, mujoco_model.jnt_qposadr[limited]]
    assert ((low <= angle) & (angle <= high)).all()


def test_orientation_error_is_a_roll_about_the_toes(kinematics, smooth_motion):
    targets = smooth_motion(np.linspace(0, 3, 20))
    solution = solve(kinematics, *targets)
    actual = kinematics.legs(kinematics.to_pinocchio(solution.qpos)).rotation
    for side, target in enumerate(targets[1:]):
        wanted = Rotation.from_quat(target.orientation, scalar_first=True)
        error = (wanted.inv() * Rotation.from_matrix(actual[:, side])).as_rotvec()
        np.testing.assert_allclose(error[:, 1:], 0, atol=1e-12)
        assert np.abs(error[:, 0]).max() > 0.01


def test_velocities_are_the_rates_of_the_positions(kinematics, mujoco_model, smooth_motion):
    time, step = np.linspace(0, 3, 60), 1e-5
    solution = solve(kinematics, *smooth_motion(time))
    ahead, behind = (solve(kinematics, *smooth_motion(time + s)).qpos for s in (step, -step))
    forward, backward = np.zeros_like(solution.qvel), np.zeros_like(solution.qvel)
    for i, qpos in enumerate(solution.qpos):
        mujoco.mj_differentiatePos(mujoco_model, forward[i], step, qpos, ahead[i])
        mujoco.mj_differentiatePos(mujoco_model, backward[i], step, qpos, behind[i])
    np.testing.assert_allclose(solution.qvel, (forward - backward) / 2, atol=1e-7)


def test_bodies_move_with_their_targets_and_loops_stay_closed(
    kinematics, mujoco_model, smooth_motion
):
    targets = smooth_motion(np.linspace(0, 3, 60))
    solution = solve(kinematics, *targets)
    data, velocity = mujoco.MjData(mujoco_model), np.zeros(6)
    for i in range(len(solution.qpos)):
        data.qpos, data.qvel = solution.qpos[i], solution.qvel[i]
        mujoco.mj_forward(mujoco_model, data)
        loops = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert loops.sum() == 12
        np.testing.assert_allclose(data.efc_pos[loops], 0, atol=1e-12)
        np.testing.assert_allclose(data.efc_vel[loops], 0, atol=1e-12)
        kind, body = mujoco.mjtObj.mjOBJ_XBODY, mujoco_model.body("pelvis").id
        mujoco.mj_objectVelocity(mujoco_model, data, kind, body, velocity, 0)
        np.testing.assert_allclose(velocity[:3], targets[0].angular_velocity[i], atol=1e-12)
        np.testing.assert_allclose(velocity[3:], targets[0].velocity[i], atol=1e-12)
        np.testing.assert_allclose(data.xpos[body], targets[0].position[i], atol=1e-15)
        np.testing.assert_allclose(data.xquat[body], targets[0].orientation[i], atol=1e-15)
        for name, target in zip(("left_foot", "right_foot"), targets[1:], strict=True):
            site = mujoco_model.site(name)
            kind = mujoco.mjtObj.mjOBJ_SITE
            mujoco.mj_objectVelocity(mujoco_model, data, kind, site.id, velocity, 0)
            np.testing.assert_allclose(velocity[3:], target.velocity[i], atol=1e-11)
            toes = data.site_xmat[site.id].reshape(3, 3)[:, 0]
            turn = velocity[:3] - target.angular_velocity[i]
            # the sole turns relative to its target about the toe axis only
            np.testing.assert_allclose(np.cross(turn, toes), 0, atol=1e-11)


def _mirror_target(target: BodyTarget) -> BodyTarget:
    """Mirror a target in y: axial vectors change sign in x and z."""
    polar, axial = np.array([1.0, -1, 1]), np.array([-1.0, 1, -1])
    return BodyTarget(
        target.position * polar,
        target.orientation * np.array([1.0, -1, 1, -1]),
        target.velocity * polar,
        target.angular_velocity * axial,
    )


def test_mirrored_targets_give_mirrored_solutions(kinematics, mujoco_model, smooth_motion):
    pelvis, left, right = smooth_motion(np.linspace(0, 3, 50))
    solution = solve(kinematics, pelvis, left, right)
    mirrored = solve(kinematics, *(_mirror_target(body) for body in (pelvis, right, left)))
    roll_and_yaw_flip = np.array([-1, -1, 1, 1, 1])
    for name in ("motor_position", "motor_velocity"):
        legs = getattr(solution, name).reshape(-1, 2, 5)
        expected = legs[:, ::-1] * roll_and_yaw_flip
        np.testing.assert_allclose(getattr(mirrored, name).reshape(-1, 2, 5), expected, atol=1e-11)
    # the rods turn about axes of the leg, whose frame mirrors along its z
    ball = _balls(mujoco_model)
    rods = solution.qpos[:, ball][:, ::-1] * np.array([1, -1, -1, 1])
    np.testing.assert_allclose(mirrored.qpos[:, ball], rods, atol=1e-11)


def test_pose_does_not_depend_on_its_batch(kinematics, smooth_motion):
    targets = smooth_motion(np.linspace(0, 3, 37))
    together = solve(kinematics, *targets)
    again = solve(kinematics, *targets)
    backwards = solve(kinematics, *(_take(target, slice(None, None, -1)) for target in targets))
    for name in ("qpos", "qvel"):
        whole = getattr(together, name)
        np.testing.assert_array_equal(getattr(again, name), whole)
        np.testing.assert_array_equal(getattr(backwards, name)[::-1], whole)
        for i in (0, 18, 36):
            alone = solve(kinematics, *(_take(target, [i]) for target in targets))
            np.testing.assert_array_equal(getattr(alone, name)[0], whole[i])
