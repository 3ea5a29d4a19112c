"""Libraries of inverted-pendulum walks: for an ablation, and for the single-reference baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from aslip.errors import ConfigurationError
from aslip.library.library import GaitLibrary
from aslip.library.table import ARRAYS, PAPER_SPEEDS, GaitTable
from aslip.library.tabulate import tabulate
from aslip.rom.gait import Gait
from aslip.rom.motion import PHASE_SAMPLES, MotionSample, Track, displacement
from aslip.rom.pendulum import PendulumWalk, pendulum_walks

SINGLE_REFERENCE_WALK: Final = PendulumWalk(clearance=0.15)
"""Motion of the baseline. Its clearance is lower than the spring-mass model's; the shipped policy
`single_reference` was trained with it."""


def pendulum_library(
    gaits: Sequence[Gait], walk: PendulumWalk | None = None, *, samples: int = PHASE_SAMPLES
) -> GaitLibrary:
    """Library of pendulum walks that replace optimal gaits, see `aslip.rom.pendulum_walks`.

    Args:
        gaits: gaits in order of speed.
        walk: mass, width, clearance and share of swing of all walks; by default mass, width and
            clearance of each gait's model.
        samples: samples of a stride.

    Raises:
        UnreachablePoseError: the robot cannot take a pose of a walk.
    """
    walks = pendulum_walks(gaits, walk)
    return GaitLibrary.from_motions(walks, samples=samples, torque_jumps=True)


def single_reference_library(
    walk: PendulumWalk | None = None,
    *,
    samples: int = PHASE_SAMPLES,
) -> GaitLibrary:
    """Library of one walk: the command scales the forward motion of the pelvis only.

    Joint angles are those of the walk at every speed (Xie et al. 2018). The table has two rows, at
    rest and at the largest speed of the paper; between them everything is linear in speed.

    Args:
        walk: reference motion, `SINGLE_REFERENCE_WALK` by default.
        samples: samples of a stride.

    Raises:
        ConfigurationError: the speed of the walk is not positive.
        UnreachablePoseError: the robot cannot take a pose of the walk.
    """
    walk = walk or SINGLE_REFERENCE_WALK
    if walk.speed <= 0:
        raise ConfigurationError(
            f"the forward speed of the walk must be positive, got {walk.speed} m/s"
        )
    speeds = np.array([0.0, PAPER_SPEEDS[-1]])
    one = tabulate([walk], samples=samples, torque_jumps=True)
    walks = [StretchedWalk(walk, float(speed)) for speed in speeds]
    return GaitLibrary(walks, _stretched(one, speeds))


@dataclass(frozen=True)
class StretchedWalk:
    """Walk at another speed: its forward motion is scaled, its feet stay below the body."""

    walk: PendulumWalk
    """Walk before scaling."""
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
        """Sample the walk at phases (m,); velocities of the feet are not scaled."""
        sample = self.walk.sample(phase)
        factor = np.array([self.speed / self.walk.speed, 1.0, 1.0])
        deviation = sample.body.position - displacement(self.walk, phase).position
        position = deviation * factor + displacement(self, phase).position
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
