"""Scene of the page: robot, reduced-order model, and a floor that moves below them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import mujoco
import numpy as np
import torch
import viser
from tensordict import TensorDictBase

from aslip.library import GaitLibrary
from aslip.library.footholds import footholds_of, yaw_rotation
from aslip.robot import SIDES, Side
from aslip.robot.rotation import yaw
from aslip.show.ghost import (
    BODY_COLOR,
    BODY_RADIUS,
    FOOT_RADIUS,
    LEG_COLORS,
    SWING_FADE,
    WIRE_RADIUS,
    Ghost,
)
from aslip.show.live.robot import Color, RobotView, to_color, tube
from aslip.show.live.stones import ScenePlace, StonesView
from aslip.show.model_place import BESIDE, BESIDE_STEPS, RomPlace
from aslip.show.render import spring_path
from aslip.transforms.plan_state import followed, footholds_in_world, landing_foot

# radius and half thickness of a disc on the floor [m]
_FOOTHOLD_RADIUS = 0.05
_FOOTHOLD_HALF = 0.002
# footholds ahead to draw of each foot
_FOOTHOLDS = 2
# share of the way to the height of the ground by which the picture follows in a policy step
_FOLLOW = 0.1


class RomView:
    """Reduced-order model, a sphere on two coil springs, and discs at planned footholds.

    They are the next ones of a plan, or of robots that follow none that of the foot in swing.

    Args:
        scene: scene to draw in, with the frame `/world` and the pelvis above its origin.
        library: gaits for footholds, which are not drawn of feet that do not swing once a stride.
    """

    def __init__(self, scene: viser.SceneApi, library: GaitLibrary) -> None:
        self._footholds = footholds_of(library)
        self._beside = BESIDE if library.command_size == 1 else BESIDE_STEPS
        self._root = scene.add_frame("/world/rom", show_axes=False)
        self._offset, self._turn = np.zeros(3), np.eye(3)
        self._body = scene.add_icosphere("/world/rom/body", BODY_RADIUS, color=to_color(BODY_COLOR))
        self._plans = scene.add_frame("/world/footholds", show_axes=False)
        self._legs = {side: _LegView(scene, f"/world/rom/{side}", side) for side in SIDES}
        self._discs = {
            side: [
                scene.add_cylinder(
                    f"/world/footholds/{side}_{i}",
                    _FOOTHOLD_RADIUS,
                    2 * _FOOTHOLD_HALF,
                    color=to_color(LEG_COLORS[side]),
                    visible=False,
                )
                for i in range(_FOOTHOLDS)
            ]
            for side in SIDES
        }

    def place(self, place: RomPlace) -> None:
        """Show the model beside the robot, in its place, or not at all."""
        self._offset = self._beside if place == "beside" else np.zeros(3)
        self._root.position = self._turn @ self._offset
        self._root.visible = self._plans.visible = place != "hidden"

    def update(self, td: TensorDictBase) -> None:
        """Move to the present reference.

        Args:
            td: tensordict of one robot with `command`, `("reference", ...)` and `("truth", ...)`.
        """
        ghost = Ghost.of(td)
        truth = cast("Mapping[str, torch.Tensor]", td["truth"])
        origin = np.array([ghost.body[0], ghost.body[1], 0.0])
        body = ghost.body - origin
        self._body.position = body
        orientation = truth["pelvis_orientation"][0].double().numpy()
        # the offset turns with the robot
        self._turn = yaw_rotation(orientation)
        self._root.position = self._turn @ self._offset
        legs: tuple[tuple[Side, Side, np.ndarray, bool], ...] = (
            ("left", "right", ghost.left, ghost.left_stance),
            ("right", "left", ghost.right, ghost.right_stance),
        )
        plans = "plan" in td and bool(followed(td))
        for side, other, foot, stance in legs:
            self._legs[side].update(body, foot - origin, stance)
            if not plans:
                ahead = np.empty((0, 3))
                if self._footholds is not None and not stance:
                    stance_foot = truth[f"{other}_foot_position"][0].double().numpy()
                    command = cast("torch.Tensor", td.get("filtered_command", td["command"]))[0]
                    phase = float(cast("torch.Tensor", td["phase"]))
                    place = self._footholds.planned(
                        side, command.tolist(), stance_foot, orientation, phase
                    )
                    ahead = np.array([[*place, 0.0]])
                self._mark(side, ahead, origin)
        if plans:
            self._mark_plan(td, origin)

    def _mark_plan(self, td: TensorDictBase, origin: np.ndarray) -> None:
        """Draw the footholds of a robot's plan."""
        ahead = footholds_in_world(td)[0].double().numpy()
        first = int(landing_foot(td))
        for i, side in enumerate(SIDES):
            self._mark(side, ahead[(i - first) % 2 :: 2], origin)

    def _mark(self, side: Side, places: np.ndarray, origin: np.ndarray) -> None:
        """Draw discs at places (k, 3) of the footholds of a foot [m]."""
        for i, disc in enumerate(self._discs[side]):
            disc.visible = i < len(places)
            if disc.visible:
                disc.position = places[i] - origin + [0.0, 0.0, _FOOTHOLD_HALF]


class _LegView:
    """Coil spring with a round foot, one metre long and stretched to the length of the leg.

    The spring is a skinned mesh, because viewers stretch a skin faster than they scale a mesh.
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
            spring.vertices,
            spring.faces,
            bone_wxyzs=np.array([[1.0, 0.0, 0.0, 0.0]] * 2),
            bone_positions=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
            # a linear blend of both ends stretches the mesh
            skin_weights=np.stack([1.0 - along, along], axis=-1),
            color=color,
        )
        self._foot = scene.add_icosphere(f"{name}/foot", FOOT_RADIUS, color=color)

    def update(self, body: np.ndarray, foot: np.ndarray, stance: bool) -> None:
        """Stretch the leg between two points (3,) [m]."""
        quaternion = np.empty(4)
        mujoco.mju_quatZ2Vec(quaternion, body - foot)
        self._frame.position = foot
        self._frame.wxyz = quaternion
        self._spring.bones[1].position = np.array([0.0, 0.0, np.linalg.norm(body - foot)])
        self._spring.color = self._foot.color = self._colors[stance]


# distances of the lines on the floor [m]
_CELL, _SECTION = 0.25, 1.0
_FLOOR_COLOR = (240, 242, 245)
_CELL_COLOR, _SECTION_COLOR = (205, 210, 218), (150, 158, 170)

# first position and target of the camera [m], and its vertical field of view [rad]
_CAMERA = (2.1, 1.7, 1.1)
_LOOK_AT = (0.0, -0.2, 0.52)
# the same on stones, of which more are seen
_CAMERA_ON_STONES, _LOOK_AT_STONES = (1.7, 2.6, 1.7), (0.3, -0.1, 0.3)
_FIELD_OF_VIEW = 0.6

# narrowest picture, width over height, with the model beside the robot and this field of view
_NARROWEST = 0.85

# opacity of the robot with the reduced-order model in its place
_ROBOT_OPACITY = 0.35


class RobotScene:
    """Scene in which the robot stays at the origin and the floor moves, for a fixed camera.

    The floor also turns, so that a robot on its path faces the same side of the picture at all
    headings, and left is left.

    Args:
        server: server of the page.
        model: the robot with its visible geoms, `aslip.robot.model.load_model()`.
    """

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel) -> None:
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = _CAMERA, _LOOK_AT, _FIELD_OF_VIEW
        server.on_client_connect(_keep_whole)
        self._world = server.scene.add_frame("/world", show_axes=False)
        self._floor = server.scene.add_grid(
            "/world/floor",
            infinite_grid=True,
            fade_distance=12.0,
            cell_size=_CELL,
            cell_color=_CELL_COLOR,
            section_size=_SECTION,
            section_color=_SECTION_COLOR,
            plane_color=_FLOOR_COLOR,
            plane_opacity=0.15,
            shadow_opacity=0.3,
        )
        self.robot = RobotView(server.scene, model)
        """Meshes of the robot."""

    def update(
        self, qpos: np.ndarray, heading: float = 0.0, ground: float = 0.0, floor: float = 0.0
    ) -> None:
        """Draw a configuration (35,), in MuJoCo's conventions.

        Args:
            qpos: the configuration.
            heading: yaw of a robot that faces along the x axis of the picture [rad].
            ground: height of the ground below the robot, which is at zero in the picture [m].
            floor: height of the floor [m].
        """
        self._world.wxyz = np.array([math.cos(heading / 2), 0.0, 0.0, -math.sin(heading / 2)])
        self._world.position = np.array([0.0, 0.0, -ground])
        # the pattern of the floor repeats after a section
        self._floor.position = np.array([*(-qpos[:2] % _SECTION), floor])
        self.robot.update(qpos)


def _keep_whole(client: viser.ClientHandle) -> None:
    client.camera.on_update(_fit)


def _fit(camera: viser.CameraHandle) -> None:
    """Widen the field of view of a narrow picture, so that the robot is not cut."""
    wider = max(1.0, _NARROWEST / camera.aspect)
    angle = 2 * math.atan(wider * math.tan(_FIELD_OF_VIEW / 2))
    if abs(angle - camera.fov) > 0.01:
        camera.fov = angle


class SceneView:
    """Robot and reduced-order model.

    Args:
        server: server of the page.
        model: the robot with its visible geoms, `aslip.robot.model.load_model()`.
        library: gaits for footholds.
    """

    def __init__(
        self, server: viser.ViserServer, model: mujoco.MjModel, library: GaitLibrary
    ) -> None:
        self._server = server
        self._scene = RobotScene(server, model)
        self._rom = RomView(server.scene, library)
        self._stones: StonesView | None = None
        self.place = ScenePlace()
        """Place of the frame `/world` in the simulated world, at the last update."""

    def add_stones(self, stones: StonesView) -> None:
        """Move stones with the ground, and let new visitors look at those in front of the robot."""
        self._stones = stones
        camera = self._server.initial_camera
        camera.position, camera.look_at = _CAMERA_ON_STONES, _LOOK_AT_STONES

    def place_rom(self, place: RomPlace) -> None:
        """Show the reduced-order model beside the robot, in its place, or not at all."""
        with self._server.atomic():
            self._rom.place(place)
            self._scene.robot.fade(_ROBOT_OPACITY if place == "through" else None)

    def update(self, td: TensorDictBase) -> None:
        """Draw the present instant.

        Args:
            td: tensordict of one robot with `command`, `("reference", ...)` and `("truth", ...)`,
                and with `heading` for stacks that have it.
        """
        truth = cast("Mapping[str, torch.Tensor]", td["truth"])
        qpos, ground = truth["qpos"][0].numpy(), self.place.ground
        ground += _FOLLOW * (float(truth["ground_height"]) - ground)
        heading = float(cast("torch.Tensor", td.get("heading", 0.0)))
        turn = yaw(truth["pelvis_orientation"][0].double().numpy())
        self.place = ScenePlace(qpos[:2].copy(), ground, heading, float(turn))
        with self._server.atomic():
            floor = 0.0 if self._stones is None else self._stones.floor
            self._scene.update(qpos, heading, ground, floor)
            if self._stones is not None:
                self._stones.update(self.place.pelvis)
            self._rom.update(td)
