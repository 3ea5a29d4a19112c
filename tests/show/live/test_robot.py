"""Meshes have the bounds of their geoms, are closed and face outwards."""

import mujoco
import numpy as np
import pytest

from aslip.robot.model import load_model
from aslip.show.live.robot import body_meshes, geom_mesh, to_color, tube

# a body with one geom of each type, none of them at the origin or straight
XML = """
<mujoco><worldbody><body>
  <geom type="sphere" size=".2" {place}/>
  <geom type="capsule" size=".1 .3" {place}/>
  <geom type="ellipsoid" size=".1 .2 .3" {place}/>
  <geom type="cylinder" size=".2 .3" {place}/>
  <geom type="box" size=".1 .2 .3" {place}/>
</body></worldbody></mujoco>
"""
# half sizes of the boxes around them
BOUNDS = [(0.2, 0.2, 0.2), (0.1, 0.1, 0.4), (0.1, 0.2, 0.3), (0.2, 0.2, 0.3), (0.1, 0.2, 0.3)]


@pytest.mark.parametrize("geom", range(5))
def test_mesh_has_the_bounds_and_pose_of_its_geom(geom):
    straight, moved = (
        geom_mesh(mujoco.MjModel.from_xml_string(XML.format(place=place)), geom)
        for place in ("", 'pos="1 2 3" quat=".5 .5 .5 .5"')
    )
    np.testing.assert_allclose(straight.bounds, np.array([[-1], [1]]) * BOUNDS[geom], atol=1e-3)
    # this turn takes x to y, y to z and z to x
    expected = np.roll(straight.vertices, 1, axis=1) + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.vertices, expected, atol=1e-12)


def test_tube_follows_its_path():
    turn = np.linspace(0, 4, 60)
    path = np.stack([np.cos(turn), np.sin(turn), 0.3 * turn], axis=-1)
    rings = tube(path, 0.02).vertices.reshape(60, -1, 3)
    np.testing.assert_allclose(rings.mean(1), path, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rings - path[:, None], axis=-1), 0.02, atol=1e-12)
    across = np.einsum("nki,ni->nk", rings - path[:, None], np.gradient(path, axis=0))
    np.testing.assert_allclose(across, 0, atol=1e-12)


def test_visible_shapes_of_a_body_are_grouped_by_colour():
    model = load_model()
    body = model.body("left_foot").id
    meshes = dict(body_meshes(model, body))
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == body]
    seen = [g for g in geoms if model.geom_group[g] == 1]
    assert 0 < len(seen) < len(geoms)
    assert set(meshes) == {to_color(model.mat_rgba[model.geom_matid[g]]) for g in seen}
    corners = np.concatenate([geom_mesh(model, g).vertices for g in seen])
    drawn = np.concatenate([mesh.vertices for mesh in meshes.values()])
    np.testing.assert_array_equal(np.unique(drawn, axis=0), np.unique(corners, axis=0))
