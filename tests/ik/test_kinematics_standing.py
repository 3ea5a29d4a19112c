"""Standing pose: the keyframe of the MJCF."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

import mujoco
import numpy as np
import pytest

from aslip.robot import CASSIE


@pytest.fixture
def standing(mujoco_model) -> mujoco.MjData:
    data = mujoco.MjData(mujoco_model)
    mujoco.mj_resetDataKeyframe(mujoco_model, data, mujoco_model.key("standing").id)
    mujoco.mj_forward(mujoco_model, data)
    return data


def test_loops_are_closed(standing):
    loops = standing.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    assert loops.sum() == 12
    np.testing.assert_allclose(standing.efc_pos[loops], 0, atol=1e-12)


def test_soles_are_flat_on_the_floor_below_the_centre_of_mass(mujoco_model, standing):
    for side in ("left", "right"):
        site = mujoco_model.site(f"{side}_foot").id
        x, _, z = standing.site_xpos[site]
        assert z == pytest.approx(0, abs=1e-12)
        assert x == pytest.approx(standing.subtree_com[0, 0], abs=1e-12)
        np.testing.assert_allclose(standing.site_xmat[site], np.eye(3).ravel(), atol=1e-12)
        # no part of the capsule is below the floor
        geom = mujoco_model.geom(f"{side}_foot")
        ends = standing.geom_xpos[geom.id, 2] - standing.geom_xmat[geom.id, 8] * geom.size[1] * (
            np.array([-1, 1])
        )
        np.testing.assert_allclose(ends - geom.size[0], 0, atol=1e-6)


def test_left_and_right_legs_mirror(mujoco_model):
    qpos = mujoco_model.key("standing").qpos
    left, right = qpos[CASSIE.indices.motor_qpos].reshape(2, 5)
    np.testing.assert_allclose(left * (-1, -1, 1, 1, 1), right, atol=1e-15)
    balls = mujoco_model.jnt_type == mujoco.mjtJoint.mjJNT_BALL
    left, right = qpos[mujoco_model.jnt_qposadr[balls][:, None] + np.arange(4)]
    np.testing.assert_allclose(left * (1, -1, -1, 1), right, atol=1e-15)
