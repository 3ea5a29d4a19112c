"""Pinocchio and MuJoCo read the same robot from the same file."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.ik import CassieKinematics
from aslip.ik.mjcf import DRAWN, joint_references
from aslip.robot import SIDES
from aslip.robot.model import CassieIndices


def _mujoco_states(model: mujoco.MjModel, qpos: np.ndarray):
    data = mujoco.MjData(model)
    for configuration in qpos:
        data.qpos = configuration
        mujoco.mj_forward(model, data)
        yield data


def test_bodies_are_where_mujoco_has_them(kinematics, mujoco_model, random_qpos):
    import pinocchio as pin

    model = kinematics.model
    pin_data = model.createData()
    configurations = kinematics.to_pinocchio(random_qpos)
    for data, configuration in zip(
        _mujoco_states(mujoco_model, random_qpos), configurations, strict=True
    ):
        pin.framesForwardKinematics(model, pin_data, configuration)
        for body in range(1, mujoco_model.nbody):
            name = mujoco_model.body(body).name
            placement = pin_data.oMf[model.getFrameId(name, pin.FrameType.BODY)]
            np.testing.assert_allclose(placement.translation, data.xpos[body], atol=1e-12)
            np.testing.assert_allclose(placement.rotation.ravel(), data.xmat[body], atol=1e-12)


def test_soles_loops_and_centre_of_mass_are_where_mujoco_has_them(
    kinematics, mujoco_model, random_qpos
):
    forward = kinematics.forward(random_qpos)
    sites = [mujoco_model.site(f"{side}_foot").id for side in SIDES]
    for i, data in enumerate(_mujoco_states(mujoco_model, random_qpos)):
        np.testing.assert_allclose(forward.foot_position[i], data.site_xpos[sites], atol=1e-12)
        rotation = data.site_xmat[sites].reshape(2, 3, 3)
        np.testing.assert_allclose(forward.foot_rotation[i], rotation, atol=1e-12)
        np.testing.assert_allclose(forward.centre_of_mass[i], data.subtree_com[1], atol=1e-12)
        gaps = np.sort(np.linalg.norm(data.efc_pos[:12].reshape(4, 3), axis=1))
        own_gaps = np.sort(np.linalg.norm(forward.loop_gap[i], axis=1))
        np.testing.assert_allclose(own_gaps, gaps, atol=1e-12)


def test_mass_matrix_with_armature_equals_mujocos(kinematics, mujoco_model, random_qpos):
    full = np.zeros((mujoco_model.nv, mujoco_model.nv))
    matrices = kinematics.mass_matrix(random_qpos)
    for matrix, data in zip(matrices, _mujoco_states(mujoco_model, random_qpos), strict=True):
        mujoco.mj_fullM(mujoco_model, data, full)
        np.testing.assert_allclose(matrix, full, atol=1e-11)


def test_joint_limits_are_mujocos(kinematics, mujoco_model):
    for joint in range(mujoco_model.njnt):
        slot = mujoco_model.jnt_qposadr[joint]
        limited = mujoco_model.jnt_limited[joint]
        low, high = mujoco_model.jnt_range[joint] if limited else (-np.inf, np.inf)
        assert kinematics.lower_limit[slot] == pytest.approx(low, abs=1e-12)
        assert kinematics.upper_limit[slot] == pytest.approx(high, abs=1e-12)


def test_joint_references_and_drawn_pose_are_mujocos(kinematics, mujoco_model):
    from aslip.files.assets import asset_path

    for name, value in joint_references(asset_path("cassie.xml")).items():
        slot = mujoco_model.joint(name).qposadr[0]
        assert value == pytest.approx(mujoco_model.qpos0[slot], abs=1e-12)
    drawn = kinematics.to_mujoco(kinematics.model.referenceConfigurations[DRAWN])
    np.testing.assert_allclose(drawn[7:], mujoco_model.qpos0[7:], atol=1e-12)


def test_motor_indices_are_mujocos(kinematics, mujoco_model):
    indices = CassieIndices.from_model(mujoco_model)
    np.testing.assert_array_equal(kinematics.motor_q, indices.motor_qpos)
    np.testing.assert_array_equal(kinematics.motor_v, indices.motor_qvel)


def test_conversions_return_what_they_were_given(kinematics, random_qpos):
    rng = np.random.default_rng(1)
    qvel = rng.normal(size=(len(random_qpos), kinematics.model.nv))
    back = kinematics.to_mujoco(kinematics.to_pinocchio(random_qpos))
    np.testing.assert_array_equal(back, random_qpos)
    velocity = kinematics.velocity_to_pinocchio(random_qpos, qvel)
    back = kinematics.velocity_to_mujoco(random_qpos, velocity)
    np.testing.assert_allclose(back, qvel, atol=1e-14)


def test_velocities_move_the_feet_as_in_mujoco(kinematics, mujoco_model, random_qpos):
    import pinocchio as pin

    rng = np.random.default_rng(2)
    data, pin_data = mujoco.MjData(mujoco_model), kinematics.model.createData()
    frame = kinematics.model.getFrameId("left_foot", pin.FrameType.OP_FRAME)
    expected = np.zeros(6)
    for qpos in random_qpos:
        data.qpos, data.qvel = qpos, rng.normal(size=mujoco_model.nv)
        mujoco.mj_forward(mujoco_model, data)
        site = mujoco_model.site("left_foot").id
        mujoco.mj_objectVelocity(mujoco_model, data, mujoco.mjtObj.mjOBJ_SITE, site, expected, 0)
        pin.forwardKinematics(
            kinematics.model,
            pin_data,
            kinematics.to_pinocchio(qpos),
            kinematics.velocity_to_pinocchio(qpos, data.qvel),
        )
        actual = pin.getFrameVelocity(
            kinematics.model, pin_data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(actual.linear, expected[3:], atol=1e-11)
        np.testing.assert_allclose(actual.angular, expected[:3], atol=1e-11)


def test_wrong_shapes_are_named(kinematics: CassieKinematics):
    with pytest.raises(ShapeError, match=r"qpos must have shape \(n, 35\), got \(35,\)"):
        kinematics.forward(np.zeros(35))
    with pytest.raises(ShapeError, match=r"\(2, 34\)"):
        kinematics.mass_matrix(np.zeros((2, 34)))
