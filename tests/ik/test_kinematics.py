"""Pinocchio and MuJoCo agree on the robot of an MJCF."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

import mujoco
import numpy as np

from aslip.robot import CASSIE, SIDES


def _mujoco_states(model: mujoco.MjModel, qpos: np.ndarray):
    data = mujoco.MjData(model)
    for configuration in qpos:
        data.qpos = configuration
        mujoco.mj_forward(model, data)
        yield data


def test_body_poses_match_mujoco(kinematics, mujoco_model, random_qpos):
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


def test_soles_and_loop_gaps_match_mujoco(kinematics, mujoco_model, random_qpos):
    legs = kinematics.legs(kinematics.to_pinocchio(random_qpos))
    sites = [mujoco_model.site(f"{side}_foot").id for side in SIDES]
    own_gaps = legs.closure[..., : kinematics.loop_rows].reshape(len(random_qpos), -1, 3)
    for i, data in enumerate(_mujoco_states(mujoco_model, random_qpos)):
        np.testing.assert_allclose(legs.position[i], data.site_xpos[sites], atol=1e-12)
        rotation = data.site_xmat[sites].reshape(2, 3, 3)
        np.testing.assert_allclose(legs.rotation[i], rotation, atol=1e-12)
        gaps = np.linalg.norm(data.efc_pos[:12].reshape(4, 3), axis=1)
        own = np.linalg.norm(own_gaps[i], axis=1)
        np.testing.assert_allclose(np.sort(own), np.sort(gaps), atol=1e-12)


def test_joint_limits_match_mujoco(kinematics, mujoco_model):
    limits = {}
    for joint in range(mujoco_model.njnt):
        limited = mujoco_model.jnt_limited[joint]
        low, high = mujoco_model.jnt_range[joint] if limited else (-np.inf, np.inf)
        limits[mujoco_model.joint(joint).name] = low, high
    for side in range(2):
        expected = np.transpose([limits[name] for name in kinematics.leg_joints[side]])
        np.testing.assert_allclose(kinematics.lower[side], expected[0], atol=1e-12)
        np.testing.assert_allclose(kinematics.upper[side], expected[1], atol=1e-12)


def test_indices_match_mujoco(kinematics, mujoco_model):
    motors = np.take_along_axis(kinematics.leg_v, kinematics.leg_motors, axis=1)
    np.testing.assert_array_equal(motors.ravel(), CASSIE.indices.motor_qvel)
    for side, names in enumerate(kinematics.leg_joints):
        for i, name in enumerate(names):
            joint, axis = mujoco_model.joint(name), i - names.index(name)
            assert kinematics.leg_q[side, i] == joint.qposadr[0] + axis
            assert kinematics.leg_v[side, i] == joint.dofadr[0] + axis
