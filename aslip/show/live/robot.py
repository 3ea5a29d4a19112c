"""Robot on the page: meshes of its visible shapes on a tree of its bodies."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import cast

import mujoco
import numpy as np
import trimesh
import viser
from trimesh import creation, transformations

from aslip.errors import ConfigurationError
from aslip.robot.model import APPEARANCE_GROUP, geom_color

# sections of a full turn; a multiple of 4, so that corners reach the bounds of the shape
_SECTIONS = 24
# sections around the wire of a tube
_WIRE_SECTIONS = 8


def geom_mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Surface of a geom, in the frame of its body; faces at a sharp edge share no vertices there.

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
        mesh = creation.icosphere(radius=radius)
    elif kind == kinds.mjGEOM_ELLIPSOID:
        mesh = creation.icosphere().apply_scale(size)
    elif kind == kinds.mjGEOM_CAPSULE:
        mesh = creation.capsule(2 * half, radius, count=(_SECTIONS, _SECTIONS))
    elif kind == kinds.mjGEOM_CYLINDER:
        mesh = creation.cylinder(radius, 2 * half, sections=_SECTIONS)
    elif kind == kinds.mjGEOM_BOX:
        mesh = creation.box(2 * size)
    else:
        raise ConfigurationError(f"geom {geom} is not a primitive shape: type {kind}")
    pose = transformations.quaternion_matrix(model.geom_quat[geom])
    pose[:3, 3] = model.geom_pos[geom]
    return mesh.smooth_shaded.copy().apply_transform(pose)


def tube(path: np.ndarray, radius: float) -> trimesh.Trimesh:
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
    rings = path[:, None] + radius * circle
    count, sections = rings.shape[:2]
    ring, section = np.meshgrid(np.arange(count - 1), np.arange(sections), indexing="ij")
    a = (ring * sections + section).ravel()
    b = (ring * sections + (section + 1) % sections).ravel()
    c, d = a + sections, b + sections
    faces = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)])
    # the scene sets weights of the vertices in their order
    return trimesh.Trimesh(rings.reshape(-1, 3), faces, process=False)


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
                self._meshes.append(
                    scene.add_mesh_simple(name, mesh.vertices, mesh.faces, color=color)
                )

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


def body_meshes(model: mujoco.MjModel, body: int) -> Iterator[tuple[Color, trimesh.Trimesh]]:
    """Visible shapes of a body, in its frame: one mesh per colour.

    Args:
        model: compiled model.
        body: id of the body.
    """
    shapes: dict[Color, list[trimesh.Trimesh]] = {}
    start = model.body_geomadr[body]
    for geom in range(start, start + model.body_geomnum[body]):
        if model.geom_group[geom] == APPEARANCE_GROUP:
            color = to_color(geom_color(model, geom))
            shapes.setdefault(color, []).append(geom_mesh(model, geom))
    for color, meshes in shapes.items():
        yield color, cast("trimesh.Trimesh", trimesh.util.concatenate(meshes))


def to_color(rgba: Sequence[float] | np.ndarray) -> Color:
    """Red, green and blue from 0 to 255, from numbers between 0 and 1."""
    red, green, blue = (round(255 * float(part)) for part in rgba[:3])
    return red, green, blue
