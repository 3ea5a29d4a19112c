"""Tables of many motions in little memory: each is the mean plus a weighted sum of components."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from aslip.errors import ConfigurationError
from aslip.library.interpolation import spline_controls, spline_samples
from aslip.library.reference import COLUMNS
from aslip.library.table import ARRAYS, CommandTable, GaitTable, row_shape
from aslip.robot import CASSIE, Robot

_ROUNDING = 1e-12  # squared size of a component without meaning, relative to the largest

LOW_RANK_ARRAYS = ("strides", "coefficients", "reference", "configuration", "velocity")
"""Names of the arrays of a `LowRankTable`, apart from its axes and its mask."""


@dataclass(frozen=True, eq=False)
class LowRankTable(CommandTable):
    r"""Motions over a grid of commands as sums of their mean and of weighted components.

    .. math:: x_i(\phi) = \bar x(\phi) + \sum_r a_{ir} c_r(\phi)

    Mean and components are periodic cubic splines, stored as control points. With n motions, r
    components and m phases, the k columns of a reference take n r + m (r + 1) k numbers instead of
    n m k. The arrays of `GaitTable` are attributes, too, computed at each access.

    Raises:
        ConfigurationError: an axis does not ascend, a stride is not positive, an entry is not
            finite, or the grid has no motions.
        ShapeError: an array does not have its shape, or there are fewer than four samples.
    """

    axes: tuple[np.ndarray, ...]
    """Values of the command along each axis, see `GaitTable`."""
    strides: np.ndarray
    """(n,) duration of a stride [s]."""
    coefficients: np.ndarray
    """(n, r) weights of the components in each motion."""
    reference: np.ndarray
    """(m, r + 1, k) control points of the columns of `aslip.library.reference.COLUMNS`, in order:
    those of the components, ascending in weight, then those of the mean."""
    configuration: np.ndarray
    """(m, r + 1, 35) control points of `qpos`."""
    velocity: np.ndarray
    """(m, r + 1, 32) control points of `qvel`."""
    robot: Robot = CASSIE
    """Robot of configurations and motors."""
    present: np.ndarray | None = None
    """(*g,) True at points of the grid with a motion, everywhere by default."""

    torque_jumps = False

    def __post_init__(self) -> None:
        """Make the arrays read-only, and check that they fit together."""
        self._check_grid()
        motions, robot = int((~self.missing).sum()), self.robot.indices
        inner = (len(self.reference), self.coefficients.shape[-1] + 1)
        shapes = {
            "strides": (motions,),
            "coefficients": (motions, inner[1] - 1),
            "reference": (*inner, sum(column_widths(self.robot))),
            "configuration": (*inner, robot.num_qpos),
            "velocity": (*inner, robot.num_qvel),
        }
        self._check_arrays(shapes, inner[0])

    @classmethod
    def of(cls, table: GaitTable | LowRankTable, rank: int) -> LowRankTable:
        """Best approximation of a table by a number of components or fewer, in its precision.

        The components are the first singular vectors of the columns of the reference, each column
        relative to its mean and its range over all motions. Configurations, which follow from the
        reference by inverse kinematics, are sums with the same coefficients.

        Raises:
            ConfigurationError: torques jump, which splines cannot follow, or `rank` is not between
                1 and the number of motions.
        """
        motions, precision = len(table.strides), table.qpos.dtype
        if table.torque_jumps:
            raise ConfigurationError("a table whose torques jump cannot be reduced to components")
        if not 1 <= rank <= motions:
            raise ConfigurationError(f"rank must be from 1 to {motions} motions, got {rank}")
        columns = np.concatenate([flat(getattr(table, name)) for name in COLUMNS], axis=-1)
        columns = columns.astype(np.float64)
        extent = np.ptp(columns, axis=(0, 1))
        scaled = (columns - columns.mean(axis=0)) / np.where(extent > 0, extent, 1.0)
        matrix = scaled.reshape(motions, -1)
        # squares ascend, so that sums begin with the smallest terms, which then are rounded least
        squares, vectors = np.linalg.eigh(matrix.T @ matrix)
        kept = (squares > _ROUNDING * squares[-1]) & (np.arange(len(squares), 0, -1) <= rank)
        coefficients = matrix @ vectors[:, kept]

        def controls(values: np.ndarray) -> np.ndarray:
            mean = values.mean(axis=0)
            # least squares, because columns of the coefficients are orthogonal
            parts = np.tensordot(coefficients / squares[kept], values - mean, axes=(0, 0))
            parts = np.concatenate([parts, mean[None]])
            return spline_controls(parts.swapaxes(0, 1)).astype(precision)

        return cls(
            axes=table.axes,
            strides=table.strides,
            coefficients=coefficients.astype(precision),
            reference=controls(columns),
            configuration=controls(flat(table.qpos).astype(np.float64)),
            velocity=controls(flat(table.qvel).astype(np.float64)),
            robot=table.robot,
            present=table.present,
        )

    def __getattr__(self, name: str) -> np.ndarray:
        """Array of `GaitTable` of this name, read-only."""
        if name not in ARRAYS:
            raise AttributeError(f"a table of low rank has no attribute {name!r}")
        whole = {"qpos": self.configuration, "qvel": self.velocity}
        if name in whole:
            controls = whole[name]
        else:
            ends = np.cumsum([0, *column_widths(self.robot)])
            first, last = list(pairwise(ends))[COLUMNS.index(name)]
            controls = self.reference[..., first:last]
        *components, mean = spline_samples(controls).swapaxes(0, 1)
        values = np.tensordot(self.coefficients, components, axes=(1, 0)) + mean
        values = values.reshape(*values.shape[:2], *row_shape(name, self.robot))
        values.setflags(write=False)
        return values

    @property
    def samples(self) -> int:
        """Number m of samples of a stride."""
        return len(self.reference)

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of all arrays, as hexadecimal digits."""
        return self._hash(LOW_RANK_ARRAYS)


def column_widths(robot: Robot) -> list[int]:
    """Number of columns of each array of `COLUMNS`."""
    return [int(np.prod(row_shape(name, robot))) for name in COLUMNS]


def flat(values: np.ndarray) -> np.ndarray:
    """(n, m, ...) values as (n, m, k)."""
    return values.reshape(*values.shape[:2], -1)
