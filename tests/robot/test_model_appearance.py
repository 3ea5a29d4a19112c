"""Visual geoms do not affect the physics."""

import mujoco
import numpy as np
import pytest

from aslip.robot.model import load_model

APPEARANCE_GROUP = 1
PHYSICS_ARRAYS = ("body_", "jnt_", "dof_", "actuator_", "eq_", "sensor_", "site_", "key_", "qpos")
# addresses among geoms; and a length from bounding boxes, read only by MuJoCo's sleeping, not used
ADDRESSES = {"body_geomadr", "body_geomnum", "sensor_refid", "dof_length"}


@pytest.fixture(scope="module")
def bare() -> mujoco.MjModel:
    return load_model(visual=False)


def solid(model: mujoco.MjModel) -> np.ndarray:
    return np.flatnonzero(model.geom_group != APPEARANCE_GROUP)


def test_physics_arrays_do_not_depend_on_appearance(model, bare):
    assert bare.ngeom == len(solid(model)) < model.ngeom
    names = [n for n in dir(model) if n.startswith(PHYSICS_ARRAYS) and n not in ADDRESSES]
    assert len(names) > 100
    for name in names:
        if isinstance(getattr(model, name), np.ndarray):
            np.testing.assert_array_equal(getattr(model, name), getattr(bare, name), name)
    for name in (n for n in dir(model) if n.startswith("geom_")):
        if isinstance(getattr(model, name), np.ndarray) and name != "geom_matid":
            values = getattr(model, name)[solid(model)]
            np.testing.assert_array_equal(values, getattr(bare, name), name)


def test_visual_geoms_have_no_mass_and_no_contacts(model):
    seen = np.flatnonzero(model.geom_group == APPEARANCE_GROUP)
    assert len(seen) > 80
    assert not model.geom_contype[seen].any()
    assert not model.geom_conaffinity[seen].any()
    assert model.nmesh == 0
