"""The true state against MuJoCo's own functions and finite differences."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import mujoco
import numpy as np
import pytest

from aslip.robot.rotation import quaternion_to_matrix, rotate_inverse, upper_hemisphere
from aslip.sim import Simulations, Snapshot, true_state


@pytest.fixture(scope="module")
def simulations() -> Simulations:
    return Simulations(2, num_threads=1)


def _random_states(simulations: Simulations, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Robot in the air that rotates and moves in all directions."""
    rng = np.random.default_rng(seed)
    qpos = np.stack([simulations.model.key("standing").qpos] * 2)
    qpos[:, 2] = 3.0
    qpos[:, 3:7] = rng.normal(size=(2, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos, rng.uniform(-1, 1, (2, 32))


def test_truth_names_the_parts_of_the_state(simulations: Simulations) -> None:
    qpos, qvel = _random_states(simulations, 0)
    simulations.reset(np.arange(2), qpos, qvel)
    truth = true_state(simulations.snapshot(), simulations.indices)
    model, data = simulations.model, mujoco.MjData(simulations.model)
    data.qpos, data.qvel = qpos[1], qvel[1]
    mujoco.mj_forward(model, data)
    pelvis = data.body("pelvis")
    np.testing.assert_array_equal(truth["pelvis_position"][1], pelvis.xpos)
    np.testing.assert_allclose(
        truth["pelvis_orientation"][1], upper_hemisphere(np.array(pelvis.xquat)), atol=1e-15
    )
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, pelvis.id, velocity, 0)
    np.testing.assert_allclose(truth["pelvis_velocity"][1], velocity[3:], atol=1e-12)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, pelvis.id, velocity, 1)
    np.testing.assert_allclose(truth["pelvis_angular_velocity"][1], velocity[:3], atol=1e-12)
    for side in ("left", "right"):
        site = data.site(f"{side}_foot")
        np.testing.assert_array_equal(truth[f"{side}_foot_position"][1], site.xpos)
        rotation = quaternion_to_matrix(truth[f"{side}_foot_orientation"][1]).ravel()
        np.testing.assert_allclose(rotation, site.xmat, atol=1e-14)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site.id, velocity, 0)
        np.testing.assert_allclose(truth[f"{side}_foot_velocity"][1], velocity[3:], atol=1e-12)
    for i, name in enumerate(("left_hip_roll", "left_hip_yaw", "left_hip_pitch", "left_knee")):
        assert truth["motor_position"][1, i] == data.joint(name).qpos[0]
        assert truth["motor_velocity"][1, i] == data.joint(name).qvel[0]
    for i, name in enumerate(("left_shin", "left_tarsus", "left_foot", "right_shin")):
        assert truth["joint_position"][1, i] == data.joint(name).qpos[0]
        assert truth["joint_velocity"][1, i] == data.joint(name).qvel[0]


def test_acceleration_in_free_fall_is_gravity(simulations: Simulations) -> None:
    """With joints at rest, in the pelvis frame."""
    qpos, _ = _random_states(simulations, 2)
    simulations.reset(np.arange(2), qpos)
    truth = true_state(simulations.snapshot(), simulations.indices)
    gravity = rotate_inverse(qpos[:, 3:7], np.array([0, 0, -9.81]))
    np.testing.assert_allclose(truth["pelvis_acceleration"], gravity, atol=1e-6)


def test_true_state_takes_any_leading_shape(simulations: Simulations) -> None:
    qpos, qvel = _random_states(simulations, 3)
    simulations.reset(np.arange(2), qpos, qvel)
    many = simulations.snapshot()
    one = Snapshot(*(np.array(value[1]) for value in vars(many).values()))
    stacked = Snapshot.stack([one, one])
    truth = true_state(many, simulations.indices)
    alone = true_state(one, simulations.indices)
    twice = true_state(stacked, simulations.indices)
    for name, value in truth.items():
        np.testing.assert_array_equal(alone[name], value[1], err_msg=name)
        np.testing.assert_array_equal(twice[name], [value[1]] * 2, err_msg=name)
