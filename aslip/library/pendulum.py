"""Libraries of the linear inverted pendulum: of an ablation, and of the single-reference method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aslip.errors import ConfigurationError
from aslip.library.library import GaitLibrary
from aslip.library.table import ARRAYS, PAPER_SPEEDS, GaitTable
from aslip.rom.gait import Gait
from aslip.rom.motion import PHASE_SAMPLES, MotionSample, Track, displacement
from aslip.rom.pendulum import PendulumWalk, pendulum_walks

SINGLE_REFERENCE_WALK: Final = PendulumWalk(clearance=0.15)
"""The one motion of the baseline. Its feet rise less than the model's: with this clearance the
shipped policy `single_reference` was trained."""


def pendulum_library(
    gaits: Sequence[Gait], walk: PendulumWalk | None = None, *, samples: int = PHASE_SAMPLES
) -> GaitLibrary:
    """Library of pendulum walks in place of optimal gaits, see `aslip.rom.pendulum_walks`.

    Args:
        gaits: in order of speed.
        walk: mass, width, clearance and share of swing of all of them; by default mass, width and
            clearance of the gait's own model.
        samples: of a stride.

    Raises:
        UnreachablePoseError: the robot cannot take a pose of a walk.
    """
    walks = pendulum_walks(gaits, walk)
    return GaitLibrary.from_motions(walks, samples=samples, torque_jumps=True)


def single_reference_library(
    walk: PendulumWalk | None = None,
    *,
    top_speed: float = PAPER_SPEEDS[-1],
    samples: int = PHASE_SAMPLES,
) -> GaitLibrary:
    """Library of one walk: only the forward motion of the pelvis is stretched by the command.

    Joint angles stay those of the one walk (Xie et al. 2018). Between the two rows of this library,
    at rest and at the top speed, everything is linear in speed, so that every speed is covered.

    Args:
        walk: the one motion, `SINGLE_REFERENCE_WALK` by default.
        top_speed: of the library [m/s].
        samples: of a stride.

    Raises:
        ConfigurationError: the walk does not go forward.
        UnreachablePoseError: the robot cannot take a pose of the walk.
    """
    walk = walk or SINGLE_REFERENCE_WALK
    if walk.speed <= 0:
        raise ConfigurationError(f"a walk to be stretched must go forward, got {walk.speed} m/s")
    speeds = np.array([0.0, top_speed])
    one = GaitLibrary.from_motions([walk], samples=samples, torque_jumps=True)
    walks = [StretchedWalk(walk, float(speed)) for speed in speeds]
    return GaitLibrary(walks, _stretched(one.table, speeds))


@dataclass(frozen=True)
class StretchedWalk:
    """A walk at another speed: the body's forward motion is stretched, all else goes with it."""

    walk: PendulumWalk
    """The walk as it is."""
    speed: float
    """Mean forward speed of the body [m/s]."""

    @property
    def command(self) -> np.ndarray:
        """(1,) mean forward speed [m/s]."""
        return np.array([self.speed])

    @property
    def stride(self) -> float:
        """Duration of a stride [s]."""
        return self.walk.stride

    def sample(self, phase: np.ndarray) -> MotionSample:
        """The walk at phases (m,); velocities of the feet are those of the walk as it is."""
        sample = self.walk.sample(phase)
        factor = np.array([self.speed / self.walk.speed, 1.0, 1.0])
        deviation = sample.body.position - displacement(self.walk, phase)
        position = deviation * factor + displacement(self, phase)
        moved = (position - sample.body.position)[:, None]
        return replace(
            sample,
            body=Track(position, sample.body.velocity * factor),
            feet=Track(sample.feet.position + moved, sample.feet.velocity),
        )


def _stretched(table: GaitTable, speeds: np.ndarray) -> GaitTable:
    """Table of one motion at each of several speeds."""
    columns = {name: np.repeat(getattr(table, name), len(speeds), axis=0) for name in ARRAYS}
    stretch = speeds / table.axes[0]
    for name in ("body_position", "body_velocity", "qpos", "qvel"):
        columns[name][..., 0] *= stretch[:, None]
    return replace(table, axes=(speeds,), **columns)
