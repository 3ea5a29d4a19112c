"""Standing and the transitions to and from it: their table, looked up by phase and mode.

The phase of the stride also measures a transition, so the clock never jumps. A stop begins
at a touchdown, phase p of the gait in place, and ends in the middle between it and the next
lift-off; there the robot stands, and from there a start leads to the lift-off:

    phase          0          p      (p + 0.5) / 2     0.5
    left foot      swings     lands      .              .
    right foot     .          .          .             leaves
    mode           walk       stop ...  stand   start ...   walk

Half a stride later left and right are exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property

import numpy as np
import torch
from torch import Tensor, nn

from aslip.errors import ConfigurationError, ShapeError
from aslip.library.interpolation import OpenTable
from aslip.library.table import hash_arrays

HALF = 0.5
"""Phase between the touchdowns, and lift-offs, of left and right foot."""


class WalkMode(IntEnum):
    """Mode of a robot: walking, standing, or a transition in between."""

    WALK = 0
    STOP = 1
    STAND = 2
    START = 3


@dataclass(frozen=True, eq=False)
class TransitionTable:
    """Stop and start of a robot, sampled at equal steps from end to end.

    Arrays have the shape (2, 2, m, ...): stop and start; after the left and after the right
    touchdown; m samples, both ends included. Their columns and frame are those of
    `aslip.library.GaitTable`, at zero command. Arrays are read-only, in double precision.

    Raises:
        ConfigurationError: an entry is not finite, a duration not positive, or the touchdown not
            between 0 and 0.5.
        ShapeError: an array does not have that shape, or has fewer than four samples.
    """

    touchdown: float
    """Phase of the left touchdown in the gait in place."""
    durations: np.ndarray
    """(2,) durations of stop and start [s]."""
    body_position: np.ndarray
    body_velocity: np.ndarray
    body_heading: np.ndarray
    foot_position: np.ndarray
    foot_velocity: np.ndarray
    foot_heading: np.ndarray
    motor_position: np.ndarray
    motor_velocity: np.ndarray
    motor_torque: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray

    def __post_init__(self) -> None:
        """Check the numbers and make the arrays read-only."""
        for name in ("durations", *TRANSITION_ARRAYS):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        samples = self.qpos.shape[2] if self.qpos.ndim == 4 else 0
        for name in TRANSITION_ARRAYS:
            array = getattr(self, name)
            if array.shape[:3] != (2, 2, samples) or samples < 4:
                raise ShapeError(
                    f"{name} of transitions must have shape (2, 2, m, ...) with m >= 4, got"
                    f" {array.shape}"
                )
            if not np.isfinite(array).all():
                raise ConfigurationError(f"{name} of transitions has non-finite entries")
        durations = self.durations
        if durations.shape != (2,) or not ((durations > 0) & (durations < np.inf)).all():
            raise ConfigurationError(
                f"stop and start need positive durations, got {durations.tolist()} s"
            )
        if not 0 < self.touchdown < HALF:
            raise ConfigurationError(
                f"the left touchdown must have a phase between 0 and 0.5, got {self.touchdown}"
            )

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all arrays, as hexadecimal digits."""
        arrays = {name: getattr(self, name) for name in ("durations", *TRANSITION_ARRAYS)}
        return hash_arrays(arrays, f"{self.touchdown}")

    @property
    def standing(self) -> float:
        """Phase of standing after the left touchdown; after the right one, half a stride later."""
        return (self.touchdown + HALF) / 2

    @property
    def rates(self) -> tuple[float, float]:
        """Phase per second in a stop and in a start [1/s]."""
        stop, start = self.durations.tolist()
        return (self.standing - self.touchdown) / stop, (HALF - self.standing) / start


TRANSITION_ARRAYS = tuple(
    f.name for f in fields(TransitionTable) if f.name not in ("touchdown", "durations")
)
"""Names of the arrays over the samples."""


class Transitions(nn.Module):
    """Look a table of transitions up by phase and mode.

    Args:
        table: stop and start.
        columns: names of the arrays of a reference, in order.
    """

    def __init__(self, table: TransitionTable, columns: Sequence[str]) -> None:
        super().__init__()
        self.table = table
        flat = {name: _flat(getattr(table, name)) for name in TRANSITION_ARRAYS}
        self._reference = OpenTable(np.concatenate([flat[name] for name in columns], axis=-1))
        self._qpos, self._qvel = OpenTable(flat["qpos"]), OpenTable(flat["qvel"])

    def reference(self, phase: Tensor, mode: Tensor) -> Tensor:
        """Columns (*b, k) at phases (*b, 1) and modes (*b, 1)."""
        return self._reference(*self.place(phase, mode))

    def state(self, phase: Tensor, mode: Tensor) -> tuple[Tensor, Tensor]:
        """`qpos` and `qvel` (*b, k) of the robot at phases (*b, 1) and modes (*b, 1)."""
        place = self.place(phase, mode)
        return self._qpos(*place), self._qvel(*place)

    def place(self, phase: Tensor, mode: Tensor) -> tuple[Tensor, Tensor]:
        """Fraction (*b, 1) and index (*b, 1) of the transition at phases and modes (*b, 1).

        Standing is the end of a stop.
        """
        phase = phase.double() % 1.0
        # tensors, because exporters round other numbers to single precision
        ends = self.table.touchdown, self.table.standing
        touchdown, standing = (phase.new_tensor(end) for end in ends)
        within, right = phase % HALF, phase >= HALF
        stopped = (within - touchdown) / (standing - touchdown)
        started = (within - standing) / (HALF - standing)
        starting = mode == WalkMode.START
        fraction = torch.where(starting, started, stopped).clamp(0.0, 1.0)
        fraction = torch.where(mode == WalkMode.STAND, 1.0, fraction)
        return fraction, 2 * starting.long() + right.long()


def _flat(values: np.ndarray) -> np.ndarray:
    """(2, 2, m, ...) values as (4, m, k)."""
    return values.reshape(4, values.shape[2], -1)
