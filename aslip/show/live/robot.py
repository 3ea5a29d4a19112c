"""Robot on the page: meshes of its visible shapes on a tree of its bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import viser

from aslip.errors import ConfigurationError
from aslip.robot.model import APPEARANCE_GROUP, geom_color

# sections of a full turn; a multiple of 4, so that corners reach the bounds of the shape
_SECTIONS = 24
# rings from a pole to the equator
_LATITUDES = 6
# sections around the wire of a tube
_WIRE_SECTIONS = 8


class Mesh(NamedTuple):
    """Triangle mesh; faces that meet at a sharp edge share no vertices there."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    faces: np.ndarray
    """(k, 3) indices of vertices, counter-clockwise from outside."""

    @classmethod
    def join(cls, meshes: Sequence[Mesh]) -> Mesh:
        """Join meshes to one."""
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
        faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
        return cls(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))

    def moved(self, position: np.ndarray, quaternion: np.ndarray) -> Mesh:
        """Move the mesh to a position (3,) [m] and orientation (4,), wxyz."""
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, quaternion)
        return Mesh(self.vertices @ rotation.reshape(3, 3).T + position, self.faces)


def geom_mesh(model: mujoco.MjModel, geom: int) -> Mesh:
    """Surface of a geom, in the frame of its body.

    Args:
        model: compiled model.
        geom: id of a sphere, capsule, ellipsoid, cylinder or box.

    Raises:
        ConfigurationError: the geom is of another type.
    """
    kinds = mujoco.mjtGeom
    kind, size = model.geom_type[geom], model.geom_size[geom]
    radius, half = size[:2]
    if kind == kinds.mjGEOM_SPHERE:
        mesh = sphere(radius)
    elif kind == kinds.mjGEOM_ELLIPSOID:
        unit = sphere(1.0)
        mesh = Mesh(unit.vertices * size, unit.faces)
    elif kind == kinds.mjGEOM_CAPSULE:
        ends = _arc(radius, -half, -1.0, 0.0), _arc(radius, half, 0.0, 1.0)
        mesh = revolve([np.concatenate(ends)])
    elif kind == kinds.mjGEOM_CYLINDER:
        mesh = cylinder(radius, half)
    elif kind == kinds.mjGEOM_BOX:
        mesh = _box(size)
    else:
        raise ConfigurationError(f"geom {geom} is not a primitive shape: type {kind}")
    return mesh.moved(model.geom_pos[geom], model.geom_quat[geom])


def sphere(radius: float) -> Mesh:
    """Sphere about the origin, radius [m]."""
    return revolve([_arc(radius, 0.0, -1.0, 1.0)])


def cylinder(radius: float, half: float) -> Mesh:
    """Cylinder about the z axis, from -half to half [m]."""
    rim = np.array([[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
    return revolve([rim[:2], rim[1:3], rim[2:]])


def revolve(profiles: Sequence[np.ndarray]) -> Mesh:
    """Surface of revolution about the z axis.

    Args:
        profiles: (n, 2) points each, distance from the axis and height [m], from bottom to top;
            the surface is smooth along a profile and has an edge between profiles.
    """
    angle = np.linspace(0.0, 2 * np.pi, _SECTIONS, endpoint=False)
    turn = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    meshes = []
    for profile in profiles:
        rings = profile[:, None, :1] * turn + profile[:, None, 1:] * np.array([0.0, 0.0, 1.0])
        meshes.append(_skin(rings))
    return Mesh.join(meshes)


def tube(path: np.ndarray, radius: float) -> Mesh:
    """Round wire along a path.

    Args:
        path: (n, 3) centre line [m].
        radius: radius of the wire [m].
    """
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # the direction across the wire is arbitrary, but must change little from ring to ring
    across = np.empty_like(path)
    across[0] = np.cross(along[0], np.eye(3)[np.abs(along[0]).argmin()])
    for i in range(1, len(path)):
        across[i] = across[i - 1] - (across[i - 1] @ along[i]) * along[i]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(along, across)
    angle = np.linspace(0.0, 2 * np.pi, _WIRE_SECTIONS, endpoint=False)[:, None]
    circle = np.cos(angle) * across[:, None] + np.sin(angle) * third[:, None]
    return _skin(path[:, None] + radius * circle)


def _arc(radius: float, height: float, start: float, end: float) -> np.ndarray:
    """Profile of a part of a sphere at a height, from start to end in quarter turns of latitude."""
    steps = round(_LATITUDES * (end - start))
    latitude = np.linspace(start, end, steps + 1) * np.pi / 2
    return np.stack([radius * np.cos(latitude), radius * np.sin(latitude) + height], axis=-1)


def _skin(rings: np.ndarray) -> Mesh:
    """Surface through rings (n, k, 3), counter-clockwise about the direction from ring to ring."""
    count, sections = rings.shape[:2]
    ring, section = np.meshgrid(np.arange(count - 1), np.arange(sections), indexing="ij")
    a = (ring * sections + section).ravel()
    b = (ring * sections + (section + 1) % sections).ravel()
    c, d = a + sections, b + sections
    faces = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)])
    return Mesh(rings.reshape(-1, 3), faces)


def _box(half: np.ndarray) -> Mesh:
    """Box about the origin, (3,) half sizes [m]."""
    square = np.array([[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
    sides = []
    for axis in range(3):
        top = np.roll(square, axis + 1, axis=1)
        for vertices in (top, -top[::-1]):
            sides.append(Mesh(vertices * half, np.array([[0, 1, 2], [0, 2, 3]])))
    return Mesh.join(sides)


Color = tuple[int, int, int]


class RobotView:
    """Bodies of the robot, each a child of its parent body.

    Joints turn about the origin of their body, so positions in the parent are constant and only
    orientations are sent.

    Args:
        scene: scene to draw in, with the frame `/world` and the pelvis above its origin.
        model: the robot with its visible geoms, `aslip.robot.model.load_model()`.
    """

    def __init__(self, scene: viser.SceneApi, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._bodies: list[viser.FrameHandle] = []
        self._meshes: list[viser.MeshHandle] = []
        names = ["/world/robot"]
        scene.add_frame(names[0], show_axes=False)
        for body in range(1, model.nbody):
            names.append(f"{names[model.body_parentid[body]]}/{model.body(body).name}")
            place = {"wxyz": model.body_quat[body], "position": model.body_pos[body]}
            self._bodies.append(scene.add_frame(names[body], show_axes=False, **place))
            for i, (color, mesh) in enumerate(body_meshes(model, body)):
                name = f"{names[body]}/shape{i}"
                self._meshes.append(scene.add_mesh_simple(name, *mesh, color=color))

    def update(self, qpos: np.ndarray) -> None:
        """Move to a configuration (nq,), MuJoCo's conventions, with x and y of the pelvis at 0."""
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        self._bodies[0].position = np.array([0.0, 0.0, data.xpos[1, 2]])
        inverse, local = np.empty(4), np.empty(4)
        for body, frame in enumerate(self._bodies, start=1):
            mujoco.mju_negQuat(inverse, data.xquat[model.body_parentid[body]])
            mujoco.mju_mulQuat(local, inverse, data.xquat[body])
            frame.wxyz = local

    def fade(self, opacity: float | None) -> None:
        """Set the opacity of the robot; None for opaque."""
        for mesh in self._meshes:
            mesh.opacity = opacity


def body_meshes(model: mujoco.MjModel, body: int) -> Iterator[tuple[Color, Mesh]]:
    """Visible shapes of a body, in its frame: one mesh per colour.

    Args:
        model: compiled model.
        body: id of the body.
    """
    shapes: dict[Color, list[Mesh]] = {}
    start = model.body_geomadr[body]
    for geom in range(start, start + model.body_geomnum[body]):
        if model.geom_group[geom] == APPEARANCE_GROUP:
            color = to_color(geom_color(model, geom))
            shapes.setdefault(color, []).append(geom_mesh(model, geom))
    for color, meshes in shapes.items():
        yield color, Mesh.join(meshes)


def to_color(rgba: Sequence[float] | np.ndarray) -> Color:
    """Red, green and blue from 0 to 255, from numbers between 0 and 1."""
    red, green, blue = (round(255 * float(part)) for part in rgba[:3])
    return red, green, blue
