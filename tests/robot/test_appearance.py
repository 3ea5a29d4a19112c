"""Visual geoms do not affect the physics, and both legs look alike."""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest

from aslip.files.assets import asset_path
from aslip.robot import mirror_name
from aslip.robot.model import geom_color, load_model

MIRROR = np.diag([1.0, -1.0, 1.0])
APPEARANCE_GROUP = 1
# of size (radius, half length), along their own z
ROUND = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
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


def test_motion_does_not_depend_on_appearance(model, bare):
    targets = np.random.default_rng(0).uniform(-0.5, 0.5, (1000, model.nu))
    data = [mujoco.MjData(m) for m in (model, bare)]
    for m, d in zip((model, bare), data, strict=True):
        mujoco.mj_resetDataKeyframe(m, d, 0)
        for target in targets:
            d.ctrl[:] = target * m.actuator_ctrlrange[:, 1]
            mujoco.mj_step(m, d)
    for name in ("qpos", "qvel", "qacc", "sensordata"):
        np.testing.assert_array_equal(getattr(data[0], name), getattr(data[1], name), name)


def test_visual_geoms_have_no_mass_and_no_contacts(model):
    seen = np.flatnonzero(model.geom_group == APPEARANCE_GROUP)
    assert len(seen) > 80
    assert not model.geom_contype[seen].any()
    assert not model.geom_conaffinity[seen].any()
    assert model.nmesh == 0


def look(model: mujoco.MjModel, data: mujoco.MjData, body: str, mirror: np.ndarray) -> list[tuple]:
    """Type, material, position and extent of each visible geom, mirrored."""
    found = []
    for i in np.flatnonzero(model.geom_bodyid == model.body(body).id):
        if model.geom_group[i] == APPEARANCE_GROUP:
            axes = mirror @ data.geom_xmat[i].reshape(3, 3)
            size = model.geom_size[i].copy()
            if model.geom_type[i] in ROUND:
                size = size[[0, 0, 1]]
            extent = axes @ np.diag(size**2) @ axes.T
            place = np.concatenate([mirror @ data.geom_xpos[i], extent.ravel()])
            found.append((model.geom_type[i], model.geom_matid[i], *model.geom_size[i], place))
    return found


def test_legs_look_like_mirror_images(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    bodies = [model.body(i).name for i in range(model.nbody)]
    for body in (name for name in bodies if name.startswith("left_")):
        left = look(model, data, body, np.eye(3))
        right = look(model, data, mirror_name(body), MIRROR)
        assert len(left) == len(right) > 0, body
        for (*a, place), (*b, mirrored) in zip(left, right, strict=True):
            assert a == b, body
            np.testing.assert_allclose(place, mirrored, atol=1e-12, err_msg=body)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("rod", "end", "length"),
    [("achilles_rod", "heel_spring", 0.5012), ("plantar_rod", "foot", 0.35012)],
)
def test_visible_rods_reach_their_ends(model, library, side, rod, end, length):
    data = mujoco.MjData(model)
    for qpos in library.table.qpos[::5, ::16].reshape(-1, model.nq):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        tip = data.body(f"{side}_{rod}").xpos + length * data.body(f"{side}_{rod}").xmat[::3]
        seen = np.flatnonzero(model.geom_bodyid == model.body(f"{side}_{end}").id)
        seen = seen[model.geom_group[seen] == APPEARANCE_GROUP]
        # in the geom's frame, the point is within its extent
        axes = data.geom_xmat[seen].reshape(-1, 3, 3)
        local = np.einsum("gji,gj->gi", axes, tip - data.geom_xpos[seen])
        extent = model.geom_aabb[seen, 3:] + 0.002
        assert (np.abs(local) <= extent).all(-1).any()


def test_colours_equal_those_of_mujoco(model):
    data, scene = mujoco.MjData(model), mujoco.MjvScene(model, model.ngeom)
    mujoco.mj_forward(model, data)
    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    option.geomgroup[:] = 1
    mujoco.mjv_updateScene(
        model, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene
    )
    drawn = {geom.objid: geom.rgba for geom in scene.geoms[: scene.ngeom]}
    assert sorted(drawn) == list(range(model.ngeom))
    for geom, rgba in drawn.items():
        np.testing.assert_array_equal(geom_color(model, geom), rgba, model.geom(geom).name)
