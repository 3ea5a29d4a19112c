"""The reduced-order model in a browser's scene, and where it would step next."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, cast, get_args

import mujoco
import numpy as np
import torch
import viser
from tensordict import TensorDictBase

from aslip.library import GaitLibrary
from aslip.robot import SIDES, Side
from aslip.show.ghost import (
    BODY_COLOR,
    BODY_RADIUS,
    FOOT_RADIUS,
    LEG_COLORS,
    SWING_FADE,
    WIRE_RADIUS,
    Footholds,
    Ghost,
    yaw_rotation,
)
from aslip.show.live.robot import Color, to_color
from aslip.show.live.shapes import cylinder, sphere, tube
from aslip.show.render import spring_path

RomPlace = Literal["beside", "through", "hidden"]
ROM_PLACES: tuple[RomPlace, ...] = get_args(RomPlace)
"""Where the reduced-order model may be seen: beside the robot, in its place, or nowhere."""

_BESIDE = np.array([0.0, -0.7, 0.0])
"""Where it is beside the robot, from where it belongs [m]: to the robot's right."""

# a disc on the floor, half as thick as it stands out [m]
_FOOTHOLD_RADIUS = 0.05
_FOOTHOLD_HALF = 0.002


class RomView:
    """A sphere on two coil springs that shorten and lengthen, and discs where feet should land.

    Args:
        scene: where it is drawn, with the robot's pelvis above the origin.
        library: the gaits, for footholds.
    """

    def __init__(self, scene: viser.SceneApi, library: GaitLibrary) -> None:
        self._footholds = Footholds(library)
        self._root = scene.add_frame("/rom", show_axes=False)
        self._offset, self._turn = np.zeros(3), np.eye(3)
        self._body = scene.add_mesh_simple(
            "/rom/body", *sphere(BODY_RADIUS), color=to_color(BODY_COLOR)
        )
        self._plans = scene.add_frame("/footholds", show_axes=False)
        self._legs = {side: _LegView(scene, f"/rom/{side}", side) for side in SIDES}
        self._discs = {
            side: scene.add_mesh_simple(
                f"/footholds/{side}",
                *cylinder(_FOOTHOLD_RADIUS, _FOOTHOLD_HALF),
                color=to_color(LEG_COLORS[side]),
                visible=False,
            )
            for side in SIDES
        }

    def place(self, place: RomPlace) -> None:
        """Show it at a place."""
        self._offset = _BESIDE if place == "beside" else np.zeros(3)
        self._root.position = self._turn @ self._offset
        self._root.visible = self._plans.visible = place != "hidden"

    def update(self, td: TensorDictBase) -> None:
        """Move to the reference of the present.

        Args:
            td: of one robot; has `command`, `("reference", ...)` and `("truth", ...)`.
        """
        ghost = Ghost.of(td)
        truth = cast("Mapping[str, torch.Tensor]", td["truth"])
        origin = np.array([ghost.body[0], ghost.body[1], 0.0])
        body = ghost.body - origin
        self._body.position = body
        orientation = truth["pelvis_orientation"][0].double().numpy()
        # beside a robot that has turned, not in its way
        self._turn = yaw_rotation(orientation)
        self._root.position = self._turn @ self._offset
        legs: tuple[tuple[Side, Side, np.ndarray, bool], ...] = (
            ("left", "right", ghost.left, ghost.left_stance),
            ("right", "left", ghost.right, ghost.right_stance),
        )
        for side, other, foot, stance in legs:
            self._legs[side].update(body, foot - origin, stance)
            disc = self._discs[side]
            disc.visible = not stance
            if not stance:
                stance_foot = truth[f"{other}_foot_position"][0].double().numpy()
                speed = float(td["command"])
                plan = self._footholds.planned(side, speed, stance_foot, orientation)
                disc.position = np.array([*(plan - origin[:2]), _FOOTHOLD_HALF])


class _LegView:
    """A coil spring with a round foot, one metre long and stretched to the leg's length.

    It is a skinned mesh, which viewers stretch as readily as they move things; a change of scale or
    colour takes them longer.
    """

    def __init__(self, scene: viser.SceneApi, name: str, side: Side) -> None:
        color = to_color(LEG_COLORS[side])
        red, green, blue = (round(part + SWING_FADE * (255 - part)) for part in color)
        self._colors: tuple[Color, Color] = (red, green, blue), color
        spring = tube(spring_path(np.zeros(3), np.array([0.0, 0.0, 1.0])), WIRE_RADIUS)
        along = spring.vertices[:, 2]
        self._frame = scene.add_frame(name, show_axes=False)
        self._spring = scene.add_mesh_skinned(
            f"{name}/spring",
            *spring,
            bone_wxyzs=np.array([[1.0, 0.0, 0.0, 0.0]] * 2),
            bone_positions=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
            # a linear blend of two ends is a stretch
            skin_weights=np.stack([1.0 - along, along], axis=-1),
            color=color,
        )
        self._foot = scene.add_mesh_simple(f"{name}/foot", *sphere(FOOT_RADIUS), color=color)

    def update(self, body: np.ndarray, foot: np.ndarray, stance: bool) -> None:
        """Stretch between two (3,) points [m]."""
        quaternion = np.empty(4)
        mujoco.mju_quatZ2Vec(quaternion, body - foot)
        self._frame.position = foot
        self._frame.wxyz = quaternion
        self._spring.bones[1].position = np.array([0.0, 0.0, np.linalg.norm(body - foot)])
        self._spring.color = self._foot.color = self._colors[stance]
