"""Footholds that the reduced-order model of a library plans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch

from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError
from aslip.library.library import GaitLibrary
from aslip.robot import SIDES, Side
from aslip.robot.rotation import yaw
from aslip.rom.motion import Motion

STANCE_SPEED = 0.05
"""Speed of the reference's foot below which it is in stance [m/s]."""
# height above its lowest point up to which a foot of a motion is in stance [m]
_STANCE_HEIGHT = 0.005
# samples of a stride in the search for a touchdown
_INSTANTS = 4096
# look-ups of a stride in that search for a command of several axes
_LOOKS = 256


class Footholds:
    """Footholds that the reduced-order model plans.

    Commands are numbers, or sequences with a number for each axis of the library.

    Args:
        library: motions with one swing per foot; steps are interpolated linearly between speeds.
            With several axes they are those of the interpolated motion.
    """

    @on_cpu_in_single
    def __init__(self, library: GaitLibrary) -> None:
        self._library = library
        if library.command_size > 1:
            self._found = lru_cache(maxsize=64)(self._search)
            return
        self._speeds = library.speeds
        self._phases = np.array([touchdown_phases(motion) for motion in library.motions])
        self._strides = np.array([motion.stride for motion in library.motions])
        speeds = torch.tensor(np.array(library.speeds))[:, None]
        self._steps = np.empty((2, len(speeds), 2))
        for i, side in enumerate(SIDES):
            motion = library.lookup(torch.tensor(self._phases[:, i : i + 1]), speeds)
            left, right = motion.left_foot_position, motion.right_foot_position
            step = left - right if side == "left" else right - left
            self._steps[i] = step[:, :2].double().numpy()

    @on_cpu_in_single
    def stride(self, command: float | Sequence[float]) -> float:
        """Duration of a stride of the reduced-order model [s]."""
        if self._library.command_size > 1:
            return float(self._library.stride(torch.tensor([_padded(command)])))
        return float(np.interp(_first(command), self._speeds, self._strides))

    def touchdown_phase(self, side: Side, command: float | Sequence[float]) -> float:
        """Stride fraction at which a foot of the reduced-order model touches down."""
        i = SIDES.index(side)
        if self._library.command_size > 1:
            return self._found(_padded(command))[0][i]
        return float(np.interp(_first(command), self._speeds, self._phases[:, i]))

    def step(self, side: Side, command: float | Sequence[float]) -> np.ndarray:
        """Step (2,) from the stance foot to the landing foot at touchdown, forward and left [m]."""
        i = SIDES.index(side)
        if self._library.command_size > 1:
            return self._found(_padded(command))[1][i]
        steps, speed = self._steps[i], _first(command)
        return np.array([np.interp(speed, self._speeds, steps[:, axis]) for axis in range(2)])

    def planned(
        self,
        side: Side,
        command: float | Sequence[float],
        stance_foot: np.ndarray,
        orientation: np.ndarray,
        phase: float | None = None,
    ) -> np.ndarray:
        """Planned foothold (2,) [m, world].

        Position of the stance foot plus the step of the reduced-order model, turned by the yaw of
        the robot, as in the comparison of the paper (Sec. V-A).

        Args:
            side: foot in swing.
            command: command of the reference.
            stance_foot: (3,) sole centre of the stance foot [m, world].
            orientation: (4,) pelvis to world, wxyz.
            phase: stride fraction now, from which the robot turns until the touchdown; by default
                the touchdown is now.
        """
        ahead = 0.0
        if phase is not None and self._library.command_size > 1:
            wait = (self.touchdown_phase(side, command) - phase) % 1.0 * self.stride(command)
            ahead = _padded(command)[2] * wait
        turn = yaw_rotation(orientation, ahead)[:2, :2]
        return stance_foot[:2] + turn @ self.step(side, command)

    @on_cpu_in_single
    def _search(self, command: tuple[float, ...]) -> tuple[list[float], np.ndarray]:
        """Phases (2) of the touchdowns and steps (2, 2) at a command of several axes.

        A foot swings in the half of the stride after its lift-off: left at phase 0, right at 0.5.
        """
        phase = torch.arange(_LOOKS)[:, None] / _LOOKS
        axes = torch.tensor(command[: self._library.command_size]).expand(_LOOKS, -1)
        motion = self._library.lookup(phase, axes)
        phases, steps = [], np.empty((2, 2))
        for i, velocity in enumerate((motion.left_foot_velocity, motion.right_foot_velocity)):
            start = round(0.5 * i * _LOOKS)
            moving = torch.linalg.vector_norm(velocity, dim=-1).roll(-start) > STANCE_SPEED
            down = (start + int(torch.nonzero(moving[: _LOOKS * 3 // 4])[-1]) + 1) % _LOOKS
            feet = motion.left_foot_position[down], motion.right_foot_position[down]
            steps[i] = (feet[i] - feet[1 - i])[:2].numpy()
            phases.append(down / _LOOKS)
        return phases, steps


def footholds_of(library: GaitLibrary) -> Footholds | None:
    """Footholds of motions; None if a foot does not swing once per stride."""
    try:
        return Footholds(library)
    except ConfigurationError:
        return None


def _first(command: float | Sequence[float]) -> float:
    return float(np.ravel(command)[0])


def _padded(command: float | Sequence[float]) -> tuple[float, ...]:
    """Command of three numbers."""
    given = tuple(float(number) for number in np.ravel(command))
    return (*given, 0.0, 0.0)[:3]


def yaw_rotation(orientation: np.ndarray, more: float = 0.0) -> np.ndarray:
    """Rotation (3, 3) about the vertical by the yaw of an orientation (4,), wxyz.

    Args:
        orientation: orientation of a body.
        more: angle that is added to the yaw [rad].
    """
    angle = float(yaw(np.asarray(orientation, dtype=np.float64))) + more
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def touchdown_phases(motion: Motion) -> tuple[float, float]:
    """Stride fractions at which the left and the right foot of a motion come to rest on the ground.

    Raises:
        ConfigurationError: a foot does not swing once.
    """
    phase = np.arange(_INSTANTS) / _INSTANTS
    feet = motion.sample(phase).feet
    speed, height = np.linalg.norm(feet.velocity, axis=-1), feet.position[..., 2]
    stance = (speed < STANCE_SPEED) & (height < height.min(axis=0) + _STANCE_HEIGHT)
    begins = stance & ~np.roll(stance, 1, axis=0)
    if (begins.sum(axis=0) != 1).any():
        raise ConfigurationError(
            "footholds need motions in which each foot swings once per stride; swings of the left"
            f" and right foot at command {motion.command}: {begins.sum(axis=0).tolist()}"
        )
    first = begins.argmax(axis=0)
    # touchdown is when the speed stops falling
    slower = [np.diff(np.roll(v, -k)) < 0 for v, k in zip(speed.T, first, strict=True)]
    left, right = ((first + [s.argmin() for s in slower]) % _INSTANTS / _INSTANTS).tolist()
    return left, right
