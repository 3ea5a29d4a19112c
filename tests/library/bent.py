"""Straight gaits bent onto arcs: motions of three commands without a solver."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from aslip.rom import Angle, Gait, MotionSample, Track
from aslip.rom.arc import Pose
from aslip.rom.motion import displacement

if TYPE_CHECKING:
    from aslip.library import GaitLibrary


class Bent:
    """Straight gait that turns and drifts sideways, with feet planted in the world.

    The body deviates from the mean path as that of the gait; each foothold lies where it is seen
    from the moving frame in the middle of the gait's stance, toes along the heading then.
    """

    def __init__(self, gait: Gait, sideways: float = 0.0, yaw_rate: float = 0.0) -> None:
        self.gait = gait
        self.command = np.array([gait.command[0], sideways, yaw_rate])
        self.stride = gait.stride
        self.swing = gait.single_stance / gait.stride

    def sample(self, phase: np.ndarray) -> MotionSample:
        """Sample the motion at phases (m,)."""
        path, straight = displacement(self, phase), self.gait.sample(phase)
        offset = straight.body.position - displacement(self.gait, phase).position
        turn = self.command[2] * np.stack([-offset[:, 1], offset[:, 0], 0 * phase], axis=1)
        drift = np.array([0.0, self.command[1], 0.0])
        feet = [self._foot(phase, straight, side) for side in range(2)]
        position, velocity, toes = (np.stack(part, axis=1) for part in zip(*feet, strict=True))
        return MotionSample(
            body=Track(path.transform(offset), path.rotate(straight.body.velocity + drift + turn)),
            feet=Track(position, velocity),
            ground_force=path.rotate(straight.ground_force),
            heading=Angle(path.angle, np.full(len(phase), self.command[2])),
            foot_heading=toes,
        )

    def _foot(
        self, phase: np.ndarray, straight: MotionSample, side: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position (m, 3), velocity (m, 3) and heading (m,) of a foot."""
        lift_off = 0.5 * side
        stride = np.floor(phase - lift_off)
        s = np.clip((phase - lift_off - stride) / self.swing, 0.0, 1.0)
        (start, before), (end, after) = (
            self._foothold(stride + k + lift_off, side) for k in (-1, 0)
        )
        share = (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None]
        rate = (30 * s**2 * (1 - s) ** 2)[:, None] / (self.swing * self.stride)
        position, velocity = start + share * (end - start), rate * (end - start)
        position[:, 2] = straight.feet.position[:, side, 2]
        velocity[:, 2] = straight.feet.velocity[:, side, 2]
        return position, velocity, before + share[:, 0] * (after - before)

    def _foothold(self, lift_off: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
        """Foothold (m, 3) and heading (m,) of the stance after each lift-off."""
        middle = lift_off + (self.swing + 1) / 2
        seen = self.gait.sample(middle).feet.position[:, side]
        seen = seen - displacement(self.gait, middle).position
        place: Pose = displacement(self, middle)
        return place.transform(seen), place.angle


@cache
def symmetric_library() -> GaitLibrary:
    """Library over three commands whose mirror images it contains; -0.2 to 0.2 m/s, -0.8 to 0.8."""
    # imported late: processes that build a library from these motions need no PyTorch
    from aslip.library import GaitLibrary

    gaits = GaitLibrary.load().gaits
    grid = [(i, y, w) for i in (0, 8) for y in (-0.2, 0.2) for w in (-0.8, 0.8)]
    motions = [Bent(gaits[i], y, w) for i, y, w in grid]
    return GaitLibrary.from_motions(motions, samples=32)
