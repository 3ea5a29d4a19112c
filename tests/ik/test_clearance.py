"""Distance between the legs, against MuJoCo's."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo and Pinocchio are compiled modules without type stubs

import mujoco
import numpy as np
import pytest

from aslip.ik import Kinematics, LegClearance
from aslip.library import GaitLibrary
from aslip.robot import CASSIE

PARTS = ("thigh", "shin", "tarsus", "foot")
FAR = 1.0  # beyond the length of a leg [m]


@pytest.fixture(scope="module")
def clearance(kinematics: Kinematics) -> LegClearance:
    return LegClearance(kinematics)


def test_distance_is_that_of_mujocos_geoms(
    clearance: LegClearance, mujoco_model: mujoco.MjModel
) -> None:
    """Standing poses whose hips roll and turn the legs apart, and into each other."""
    rng, data = np.random.default_rng(0), mujoco.MjData(mujoco_model)
    hips = [j for j, name in enumerate(CASSIE.motor_names) if "hip" in name]
    qpos = np.tile(CASSIE.standing, (40, 1))
    qpos[:, CASSIE.indices.motor_qpos[hips]] += rng.uniform(-0.35, 0.35, (40, len(hips)))
    expected = []
    for data.qpos in qpos:
        mujoco.mj_kinematics(mujoco_model, data)
        pairs = [
            [mujoco_model.geom(f"left_{one}").id, mujoco_model.geom(f"right_{other}").id]
            for one in PARTS
            for other in PARTS
        ]
        distances = [mujoco.mj_geomDistance(mujoco_model, data, *p, FAR, None) for p in pairs]
        expected.append(min(distances))
    found = clearance(qpos)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found.min() < 0 < found.max()


def test_legs_of_the_shipped_gaits_keep_clear(clearance: LegClearance) -> None:
    """Samples of gaits in all directions, of stop and of start."""
    library = GaitLibrary.load("directions")
    assert library.transitions is not None
    for table, least in ((library.table, 0.036), (library.transitions, 0.123)):
        qpos = table.qpos.reshape(-1, table.qpos.shape[-1])
        # a number of samples that is no divisor of a stride's
        assert least <= clearance(qpos[:: max(1, len(qpos) // 1001)]).min() < 0.2
