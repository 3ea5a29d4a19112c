"""Jacobians agree with finite differences and MuJoCo."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without type stubs

import mujoco
import numpy as np
import pytest

from aslip.ik.equations import Equations, least_squares
from aslip.ik.target import FootMotion
from aslip.robot import SIDES
from aslip.robot.rotation import quaternion_to_matrix

STEP = 1e-6


@pytest.fixture(scope="module")
def configuration(kinematics, random_qpos) -> np.ndarray:
    """(20, nq) with the pelvis at the origin, loops open."""
    return kinematics.at_origin(kinematics.to_pinocchio(random_qpos[:20]))


def test_jacobian_of_the_equations_is_their_derivative(kinematics, configuration):
    rng = np.random.default_rng(4)
    quaternion = rng.normal(size=(20, 2, 4))
    rotation = quaternion_to_matrix(quaternion / np.linalg.norm(quaternion, axis=-1)[..., None])
    still = np.zeros((20, 2, 3))
    feet = FootMotion(rng.normal(size=still.shape), rotation, still, still)
    jacobian = Equations.at(kinematics, configuration, feet).jacobian
    assert jacobian.shape[-2:] == (12, 11)
    for joint in range(jacobian.shape[-1]):
        step = np.zeros((20, *kinematics.leg_v.shape))
        step[..., joint] = STEP
        ahead, behind = (
            Equations.at(kinematics, kinematics.integrate(configuration, sign * step), feet)
            for sign in (1, -1)
        )
        numeric = (ahead.residual - behind.residual) / (2 * STEP)
        np.testing.assert_allclose(jacobian[..., joint], numeric, atol=1e-8)


def test_jacobian_of_the_feet_matches_mujoco(kinematics, mujoco_model, configuration):
    data = mujoco.MjData(mujoco_model)
    jacobian = kinematics.legs(configuration).jacobian
    expected = np.zeros((6, mujoco_model.nv))
    for i, qpos in enumerate(kinematics.to_mujoco(configuration)):
        data.qpos = qpos
        mujoco.mj_forward(mujoco_model, data)
        for side, name in enumerate(SIDES):
            site = mujoco_model.site(f"{name}_foot").id
            mujoco.mj_jacSite(mujoco_model, data, expected[:3], expected[3:], site)
            columns = kinematics.leg_v[side]
            np.testing.assert_allclose(jacobian[i, side], expected[:, columns], atol=1e-12)


def test_least_squares_is_as_exact_as_a_decomposition():
    rng = np.random.default_rng(6)
    matrix = rng.normal(size=(30, 2, 12, 11)) * np.logspace(0, -2, 11)
    vector = rng.normal(size=(30, 2, 12, 3))
    expected = np.linalg.pinv(matrix) @ vector
    error = least_squares(matrix, vector) - expected
    assert np.abs(error / np.abs(expected).max((-1, -2), keepdims=True)).max() < 1e-11


def test_least_squares_of_a_singular_matrix_is_finite():
    assert np.isfinite(least_squares(np.zeros((1, 12, 11)), np.ones((1, 12, 1)))).all()
