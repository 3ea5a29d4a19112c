"""Visual geoms do not affect the physics."""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest

from aslip.base.assets import asset_path
from aslip.robot.model import load_model

APPEARANCE_GROUP = 1
PHYSICS_ARRAYS = ("body_", "jnt_", "dof_", "actuator_", "eq_", "sensor_", "site_", "key_", "qpos")
# addresses among geoms; and a length from bounding boxes, read only by MuJoCo's sleeping, not used
ADDRESSES = {"body_geomadr", "body_geomnum", "sensor_refid", "dof_length"}


def bare_model() -> mujoco.MjModel:
    """Model without visual geoms."""
    root = ElementTree.parse(asset_path("cassie.xml")).getroot()
    for parent in list(root.iter()):
        for child in list(parent):
            look = child.tag in ("light", "camera", "texture", "material")
            if look or (child.tag == "geom" and child.get("class") == "visual"):
                parent.remove(child)
            elif child.tag == "visual":
                root.remove(child)
            child.attrib.pop("material", None)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return load_model()


@pytest.fixture(scope="module")
def bare() -> mujoco.MjModel:
    return bare_model()


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
