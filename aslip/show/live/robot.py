"""The robot in a browser's scene: its visible shapes, hung from each other as its bodies are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
import viser

from aslip.robot.model import APPEARANCE_GROUP, geom_color
from aslip.show.live.shapes import Mesh, geom_mesh

Color = tuple[int, int, int]


class RobotView:
    """The robot's bodies, each a child of its parent body.

    All its joints turn about the origin of their body, so that where a body is in its parent never
    changes, and only orientations need be sent.

    Args:
        scene: where it is drawn, with the pelvis above the origin.
        model: the robot with what is looked at, `aslip.robot.model.load_model()`.
    """

    def __init__(self, scene: viser.SceneApi, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._bodies: list[viser.FrameHandle] = []
        self._meshes: list[viser.MeshHandle] = []
        names = ["/robot"]
        scene.add_frame(names[0], show_axes=False)
        for body in range(1, model.nbody):
            names.append(f"{names[model.body_parentid[body]]}/{model.body(body).name}")
            place = {"wxyz": model.body_quat[body], "position": model.body_pos[body]}
            self._bodies.append(scene.add_frame(names[body], show_axes=False, **place))
            for i, (color, mesh) in enumerate(body_meshes(model, body)):
                name = f"{names[body]}/shape{i}"
                self._meshes.append(scene.add_mesh_simple(name, *mesh, color=color))

    def update(self, qpos: np.ndarray) -> None:
        """Move to a configuration (35,), MuJoCo's conventions; x and y of the pelvis count as 0."""
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
        """Let what is behind the robot shine through; None for not at all."""
        for mesh in self._meshes:
            mesh.opacity = opacity


def body_meshes(model: mujoco.MjModel, body: int) -> Iterator[tuple[Color, Mesh]]:
    """What is seen of a body, in its frame: a mesh for every colour.

    Args:
        model: the compiled model.
        body: id.
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
    """Red, green and blue from 0 to 255, of what is from 0 to 1."""
    red, green, blue = (round(255 * float(part)) for part in rgba[:3])
    return red, green, blue
