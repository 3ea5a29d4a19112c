"""Look tables of motions up by phase and command, in torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from aslip.library.interpolation import (
    CommandGrid,
    LocalTable,
    PeriodicTable,
    SplineTable,
    corner_weights,
    multilinear,
    read_only_view,
    sum_rows,
)
from aslip.library.low_rank import LowRankTable, column_widths, flat
from aslip.library.reference import COLUMNS
from aslip.library.table import GaitTable


class TableLookup(nn.Module):
    """Look-ups in a table: cubic in phase, multilinear in the command.

    A table of low rank is not expanded: coefficients are interpolated over the command, and
    multiplied with the components at the phase.

    Args:
        table: motions over a grid of commands.
    """

    strides: Tensor
    """(p, 1) durations of a stride of all motions, and of corners around the region [s]."""
    table: GaitTable | LowRankTable
    """The table, whose arrays are views of the buffers, so that no number is stored twice."""

    def __init__(self, table: GaitTable | LowRankTable) -> None:
        super().__init__()
        self.widths = column_widths(table.robot)
        """Number of columns of each array of `COLUMNS`."""
        self.grid = CommandGrid(table.axes, table.missing)
        low_rank = isinstance(table, LowRankTable)
        self.table = self._of_components(table) if low_rank else self._of_motions(table)
        strides = torch.from_numpy(self.grid.fill(table.strides[:, None].copy()))
        self.register_buffer("strides", strides, persistent=False)

    def reference(self, phase: Tensor, command: Tensor) -> Tensor:
        """Columns (*b, k) of a reference at phases (*b, 1) and commands (*b, c)."""
        return self._interpolate(self._reference, phase, command)

    def state(self, phase: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """`qpos` and `qvel` (*b, k) at phases (*b, 1) and commands (*b, c)."""
        return (
            self._interpolate(self._qpos, phase, command),
            self._interpolate(self._qvel, phase, command),
        )

    def stride(self, command: Tensor) -> Tensor:
        """Duration (*b, 1) of a stride at commands (*b, c) [s]."""
        motion, weights = self.grid.corners(command)
        return multilinear(self.strides[motion], weights)

    def _interpolate(
        self, table: PeriodicTable | LocalTable | SplineTable, phase: Tensor, command: Tensor
    ) -> Tensor:
        motion, weights = self.grid.corners(command)
        if isinstance(table, SplineTable):
            return table(phase, sum_rows(self._coefficients, motion, corner_weights(weights)))
        return multilinear(table(phase, motion), weights)

    def _of_motions(self, table: GaitTable) -> GaitTable:
        """Store the samples of each motion."""
        jumps = np.repeat(
            [table.torque_jumps and name == "motor_torque" for name in COLUMNS], self.widths
        )
        names = (*COLUMNS, "qpos", "qvel")
        columns = self.grid.fill(np.concatenate([flat(getattr(table, n)) for n in names], axis=-1))
        parts = np.cumsum([len(jumps), table.qpos.shape[-1]])
        reference, qpos, qvel = np.split(columns, parts, axis=-1)
        self._reference = PeriodicTable(reference, jumps)
        self._qpos, self._qvel = LocalTable(qpos), LocalTable(qvel)
        filled = np.split(self._reference.values(), np.cumsum(self.widths)[:-1], axis=-1)
        filled += [self._qpos.values(), self._qvel.values()]
        views = {n: v[: len(table.strides)] for n, v in zip(names, filled, strict=True)}
        shaped = {n: view.reshape(getattr(table, n).shape, copy=False) for n, view in views.items()}
        return replace(table, **shaped)

    def _of_components(self, table: LowRankTable) -> LowRankTable:
        """Store coefficients of each motion, and the components."""
        self._coefficients: Tensor
        filled = torch.from_numpy(self.grid.fill(table.coefficients.copy()))
        self.register_buffer("_coefficients", filled, persistent=False)
        self._reference, self._qpos, self._qvel = (
            SplineTable(controls)
            for controls in (table.reference, table.configuration, table.velocity)
        )
        return replace(
            table,
            coefficients=read_only_view(filled)[: len(table.strides)],
            reference=self._reference.values(),
            configuration=self._qpos.values(),
            velocity=self._qvel.values(),
        )
