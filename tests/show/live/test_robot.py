"""Meshes have the bounds of their geoms, are closed and face outwards."""

import mujoco
import numpy as np
import pytest

from aslip.robot.model import load_model
from aslip.show.live.robot import Mesh, body_meshes, geom_mesh, revolve, sphere, to_color, tube

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
# half sizes of the boxes around them, and volumes
BOUNDS = [(0.2, 0.2, 0.2), (0.1, 0.1, 0.4), (0.1, 0.2, 0.3), (0.2, 0.2, 0.3), (0.1, 0.2, 0.3)]
VOLUMES = [
    4 / 3 * np.pi * 0.2**3,
    4 / 3 * np.pi * 0.1**3 + np.pi * 0.1**2 * 0.6,
    4 / 3 * np.pi * 0.1 * 0.2 * 0.3,
    np.pi * 0.2**2 * 0.6,
    8 * 0.1 * 0.2 * 0.3,
]


def compiled(place: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML.format(place=place))


def volume(mesh: Mesh) -> float:
    """Volume of a closed mesh; negative if its faces point inwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def is_closed(mesh: Mesh) -> bool:
    """True if every edge is passed as often in one direction as in the other."""
    _, corner = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    faces = corner.reshape(-1)[mesh.faces]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] != edges[:, 1]]
    there, back = (np.unique(e, axis=0, return_counts=True) for e in (edges, edges[:, ::-1]))
    return all(np.array_equal(a, b) for a, b in zip(there, back, strict=True))


@pytest.mark.parametrize("geom", range(5))
def test_mesh_has_the_bounds_and_volume_of_its_geom(geom):
    mesh = geom_mesh(compiled(""), geom)
    np.testing.assert_allclose(mesh.vertices.max(0), BOUNDS[geom], atol=1e-12)
    np.testing.assert_allclose(mesh.vertices.min(0), -np.array(BOUNDS[geom]), atol=1e-12)
    # round shapes are cut by their facets
    assert 0.93 * VOLUMES[geom] < volume(mesh) <= VOLUMES[geom] + 1e-12
    assert is_closed(mesh)


@pytest.mark.parametrize("geom", range(5))
def test_mesh_has_the_pose_of_its_geom(geom):
    place = 'pos="1 2 3" quat=".5 .5 .5 .5"'
    straight, moved = geom_mesh(compiled(""), geom), geom_mesh(compiled(place), geom)
    # this turn takes x to y, y to z and z to x
    expected = np.roll(straight.vertices, 1, axis=1) + np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.vertices, expected, atol=1e-12)


def test_meshes_are_joined_with_their_faces():
    one, two = sphere(0.1), revolve([np.array([[0.2, 0.0], [0.2, 1.0]])])
    both = Mesh.join([one, two])
    triangles = np.concatenate([one.vertices[one.faces], two.vertices[two.faces]])
    np.testing.assert_array_equal(both.vertices[both.faces], triangles)


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


def test_geom_without_material_has_its_own_colour():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><geom group="1" size=".1" rgba="1 .5 0 1"/></body></worldbody>'
        "</mujoco>"
    )
    assert [color for color, _ in body_meshes(model, 1)] == [(255, 128, 0)]
