"""Stones on the page, which visitors drag, take away and add while the robot walks."""

from __future__ import annotations

import math
import queue
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import viser
from viser import _messages as messages

from aslip.robot.rotation import rotate_level
from aslip.show.live.server import note
from aslip.sim.course import STONE_SIZE
from aslip.sim.stones import FLOOR_DEPTH

_HELP = (
    "Drag a stone to move it, with Shift up and down. Click on it to take it away. A new one"
    " appears to the left of the robot."
)
# place of a new stone, from the pelvis [m]
_NEW = np.array([0.4, 0.6])
_COLOR = (196, 186, 170)
# farthest that stones are dragged from the robot, along the ground, and their heights [m]
_FARTHEST, _HIGHEST = 10.0, 3.0
# numbers of visitors are smaller [m]
_FAR = 1e4


@dataclass(frozen=True)
class Grip:
    """Click on a stone, or a part of its drag, in the frame of the scene [m]."""

    name: str
    """Name of the stone's node."""
    phase: Literal["click", "start", "update", "end"]
    """Part of the drag."""
    point: np.ndarray
    """(3,) where the pointer is, on a plane that faces the camera."""
    eye: np.ndarray
    """(3,) the camera."""
    upright: bool
    """Whether the stone moves up and down instead of along the ground."""

    @classmethod
    def of(cls, message: Any, eye: np.ndarray) -> Grip:
        """Grip of a visitor's message.

        Raises:
            AttributeError, TypeError, ValueError: it is not one.
        """
        click = isinstance(message, messages.SceneNodeClickMessage)
        phase = "click" if click else message.phase
        places = np.array([eye if click else message.end_position, eye], dtype=np.float64)
        if not (np.abs(places) < _FAR).all() or not isinstance(message.name, str):
            raise ValueError(f"neither click nor drag of a stone: {message!r:.80}")
        return cls(message.name, phase, places[0], places[1], message.modifier == "shift")


class StonesView:
    """Boxes at the stones of a course, and what visitors do to them.

    Args:
        scene: scene to draw in, with the frame `/world`.
        gui: interface of the server.
        rows: (s, 6) stones by the columns of `aslip.sim.course.STONE`, NaN for those to add.
    """

    def __init__(self, scene: viser.SceneApi, gui: viser.GuiApi, rows: np.ndarray) -> None:
        self._all = rows.astype(np.float32)
        self.rows = self._all.copy()
        """(s, 6) stones where visitors want them, in single precision as those of the robot."""
        self._grips: queue.SimpleQueue[Grip] = queue.SimpleQueue()
        self._held: tuple[int, np.ndarray] | None = None
        self._frame = scene.add_frame("/world/stones", show_axes=False)
        self._boxes = [
            scene.add_box(f"/world/stones/{i}", _COLOR, visible=False) for i in range(len(rows))
        ]
        for box in self._boxes:
            # declared for browsers; `guard` takes their messages instead
            box.on_click(_ignore)
            box.on_drag("left")(_ignore)
            box.on_drag("left", modifier="shift")(_ignore)
        with gui.add_folder("Stones"):
            self.add = gui.add_button("Add a stone", icon=viser.Icon.PLUS)
            self.restore = gui.add_button("Restore the course", icon=viser.Icon.RESTORE)
            gui.add_html(note(_HELP))
        self.draw()

    def take(self, message: Any, eye: np.ndarray) -> None:
        """Keep a visitor's message for the next turn; on the server's thread; see `Grip.of`."""
        self._grips.put(Grip.of(message, eye))

    def update(self, pelvis: np.ndarray) -> None:
        """Move below a robot whose pelvis is above the origin of `/world`, at (2,) [m]."""
        self._frame.position = np.array([*-pelvis, 0.0])

    def apply(self, place: ScenePlace) -> None:
        """Apply what visitors did since the last turn."""
        for _ in range(self._grips.qsize()):
            self._apply(self._grips.get_nowait(), place)

    def add_stone(self, place: ScenePlace) -> None:
        """Add a stone at the height of the ground, if one is left."""
        free = np.flatnonzero(np.isnan(self.rows[:, 0]))
        if len(free):
            x, y = place.pelvis + rotate_level(_NEW, np.array(place.yaw))
            self.rows[free[0]] = x, y, place.ground, place.yaw, STONE_SIZE, STONE_SIZE

    def restore_all(self) -> None:
        """Put all stones back to where they were at first."""
        self.rows = self._all.copy()

    def _apply(self, grip: Grip, place: ScenePlace) -> None:
        index = next((i for i, box in enumerate(self._boxes) if box.name == grip.name), None)
        if index is None or np.isnan(self.rows[index, 0]):
            return
        if grip.phase == "click":
            self.rows[index] = np.nan
            return
        stone = self.rows[index]
        if grip.phase == "start" or self._held is None or self._held[0] != index:
            self._held = index, place.gripped(grip, stone[2]) - stone[:3]
            return
        point = place.gripped(grip, stone[2]) - self._held[1]
        low = np.array([*place.pelvis - _FARTHEST, -_HIGHEST])
        stone[:3] = point.clip(low, [*place.pelvis + _FARTHEST, _HIGHEST])

    def draw(self) -> None:
        """Draw the present stones."""
        for box, row in zip(self._boxes, self.rows, strict=True):
            box.visible = bool(np.isfinite(row[0]))
            if box.visible:
                x, y, z, yaw, length, width = row.tolist()
                box.position = np.array([x, y, (z + self.floor) / 2])
                box.wxyz = np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
                box.dimensions = (length, width, z - self.floor)

    @property
    def floor(self) -> float:
        """Height of the floor, on which stones are pillars [m]."""
        there = self.rows[np.isfinite(self.rows[:, 0])]
        return float(there[:, 2].min()) - FLOOR_DEPTH if len(there) else 0.0


@dataclass(frozen=True)
class ScenePlace:
    """Place of the frame `/world` of the scene in the simulated world."""

    pelvis: np.ndarray = field(default_factory=lambda: np.zeros(2))
    """(2,) place of the pelvis, above the frame's origin [m]."""
    ground: float = 0.0
    """Height that is at zero in the scene [m]."""
    heading: float = 0.0
    """Yaw by which the frame is turned back [rad]."""
    yaw: float = 0.0
    """Yaw of the pelvis [rad]."""

    def gripped(self, grip: Grip, top: float) -> np.ndarray:
        """(3,) point of the world at which a grip has a stone whose top is at a height [m]."""
        point, eye = self._in_world(grip.point), self._in_world(grip.eye)
        if grip.upright:
            return point
        ray = point - eye
        # a ray that does not come down to the top ends far away
        share = (top - eye[2]) / ray[2] if ray[2] * (top - eye[2]) > 0 else math.inf
        ray = ray * min(share, _FARTHEST / max(float(np.linalg.norm(ray[:2])), 1e-6))
        return np.array([*(eye + ray)[:2], top])

    def _in_world(self, point: np.ndarray) -> np.ndarray:
        level = rotate_level(point[:2], np.array(self.heading)) + self.pelvis
        return np.array([*level, point[2] + self.ground])


async def _ignore(event: object) -> None:
    del event
