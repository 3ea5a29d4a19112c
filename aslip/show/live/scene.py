"""What is seen on the page: the robot on a floor that moves under it, and the model it follows."""

from __future__ import annotations

from typing import cast

import mujoco
import numpy as np
import torch
import viser
from tensordict import TensorDictBase

from aslip.library import GaitLibrary
from aslip.show.live.robot import RobotView
from aslip.show.live.rom import RomPlace, RomView

# lines of the floor are so far apart [m]
_CELL, _SECTION = 0.25, 1.0
_FLOOR_COLOR = (240, 242, 245)
_CELL_COLOR, _SECTION_COLOR = (205, 210, 218), (150, 158, 170)

# where the camera starts and what it looks at [m], and how wide its view is upright [rad]
_CAMERA = (2.1, 1.7, 1.1)
_LOOK_AT = (0.0, -0.2, 0.52)
_FIELD_OF_VIEW = 0.6

# of the robot, where the reduced-order model is in its place
_ROBOT_OPACITY = 0.35


class SceneView:
    """The scene; it stays with the robot, so that the view does without being moved.

    Args:
        server: whose scene it is.
        model: the robot with what is looked at, `aslip.robot.model.load_model()`.
        library: the gaits, for footholds.
    """

    def __init__(
        self, server: viser.ViserServer, model: mujoco.MjModel, library: GaitLibrary
    ) -> None:
        scene = server.scene
        self._server = server
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = _CAMERA, _LOOK_AT, _FIELD_OF_VIEW
        self._floor = scene.add_grid(
            "/floor",
            infinite_grid=True,
            fade_distance=12.0,
            cell_size=_CELL,
            cell_color=_CELL_COLOR,
            section_size=_SECTION,
            section_color=_SECTION_COLOR,
            plane_color=_FLOOR_COLOR,
            plane_opacity=1.0,
            shadow_opacity=0.3,
        )
        self._robot = RobotView(scene, model)
        self._rom = RomView(scene, library)

    def place_rom(self, place: RomPlace) -> None:
        """Show the reduced-order model at a place."""
        with self._server.atomic():
            self._rom.place(place)
            self._robot.fade(_ROBOT_OPACITY if place == "through" else None)

    def update(self, td: TensorDictBase) -> None:
        """Draw the present.

        Args:
            td: of one robot; has `command`, `("reference", ...)` and `("truth", ...)`.
        """
        qpos = cast("torch.Tensor", td["truth", "qpos"])[0].numpy()
        with self._server.atomic():
            # the pattern repeats, so that it need not move further than it is wide
            self._floor.position = np.array([*(-qpos[:2] % _SECTION), 0.0])
            self._robot.update(qpos)
            self._rom.update(td)
