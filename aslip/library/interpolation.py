"""Interpolation of tables over a grid of commands and over phase, in torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from aslip.library.region import extrapolate, hull_gauge, reached_corners

_BLOCK = 256  # motions whose splines are computed at once
# six times the weights of four control points: factors of t^3, t^2, t and 1
_BASIS = ((-1, 3, -3, 1), (3, -6, 0, 4), (-3, 3, 3, 1), (1, 0, 0, 0))


class CommandGrid(nn.Module):
    """Grid of commands, one ascending row of values per axis.

    Args:
        axes: values along each axis.
        missing: (p,) True at points of the flattened grid without a motion; the region is then the
            convex hull of the others instead of the box.

    Raises:
        ConfigurationError: a motion is missing amid others.
    """

    rows: Tensor
    """(p,) row of each point of a cut grid in what `fill` returns; 0 beyond all cells."""

    def __init__(self, axes: Sequence[np.ndarray], missing: np.ndarray | None = None) -> None:
        super().__init__()
        self._count = len(axes)
        for i, axis in enumerate(axes):
            self.register_buffer(f"_axis{i}", torch.from_numpy(np.array(axis)), persistent=False)
        ends = torch.tensor(np.array([[axis[i] for axis in axes] for i in (0, -1)]))
        self.register_buffer("_ends", ends, persistent=False)
        self._cut = missing is not None and bool(missing.any())
        if missing is not None and self._cut:
            self._axes, self._present = tuple(axes), ~missing.reshape([len(axis) for axis in axes])
            self._cut_at_hull(missing)

    def _cut_at_hull(self, missing: np.ndarray) -> None:
        """Prepare the gauge of the hull, and the rows of motions and of corners around them."""
        wide = [i for i, axis in enumerate(self._axes) if len(axis) > 1]
        axes = [self._axes[i] for i in wide]
        mesh = np.meshgrid(*axes, indexing="ij")
        gauge = hull_gauge(np.stack([m.ravel() for m in mesh], axis=1), missing)
        self._beyond = np.flatnonzero(reached_corners(axes, *gauge).ravel() & missing)
        filled = np.concatenate([np.flatnonzero(~missing), self._beyond])
        rows = np.zeros(len(missing), dtype=int)
        rows[filled] = np.arange(len(filled))
        centre = np.array([axis[0] for axis in self._axes])  # of axes of one value
        centre[wide] = gauge[1]
        normals = np.zeros((len(gauge[0]), len(centre)))
        normals[:, wide] = gauge[0]
        for name, array in (("_normals", normals), ("_centre", centre), ("rows", rows)):
            self.register_buffer(name, torch.from_numpy(array.copy()), persistent=False)

    def fill(self, values: np.ndarray) -> np.ndarray:
        """Values (n, ...) of all motions, with those extrapolated to corners around the region.

        Rows are the motions, then the corners; see `extrapolate`.
        """
        if not self._cut:
            return values
        grid = np.zeros((*self._present.shape, *values.shape[1:]), values.dtype)
        grid[self._present] = values
        grid = extrapolate(grid, self._present, self._axes)
        return np.concatenate([values, grid.reshape(-1, *values.shape[1:])[self._beyond]])

    def gauge(self, command: Tensor) -> Tensor:
        """Distance (*b, 1) of commands from the centre of a cut region, 1 at its border."""
        normals = self.get_buffer("_normals")
        offset = command.to(normals.dtype) - self.get_buffer("_centre")
        return (offset @ normals.T).amax(-1, keepdim=True)

    def clamp(self, command: Tensor) -> Tensor:
        """Commands (*b, c) moved into the region, continuously.

        Each axis is clamped; commands outside a convex hull then move towards its centre, which is
        the zero command if the hull contains it.
        """
        low, high = self.get_buffer("_ends")
        command = command.to(low.dtype).clamp(low, high)
        if self._cut:
            centre = self.get_buffer("_centre")
            command = centre + (command - centre) / self.gauge(command).clamp(min=1.0)
        return command

    def corners(self, command: Tensor) -> tuple[Tensor, list[Tensor]]:
        """Corners of the grid cells around commands (*b, c), which are clamped to the region.

        Returns:
            Rows (*b, 2^c) of the corners in what `fill` returns, and for each axis the weight
            (*b, 1) of the upper corners. An axis of one value is left out.
        """
        index = torch.zeros_like(command[..., :1], dtype=torch.long)
        weights = []
        command = self.clamp(command)
        for i in range(self._count):
            axis = self.get_buffer(f"_axis{i}")
            size = len(axis)
            if size == 1:
                continue
            value = command[..., i : i + 1]
            # with so few values, counting the smaller ones is faster than a search
            row = (value.unsqueeze(-1) >= axis[1:-1]).sum(-1)
            low, high = axis[row], axis[row + 1]
            weights.append((value - low) / (high - low))
            neighbours = torch.cat([row, row + 1], dim=-1)
            index = (index.unsqueeze(-1) * size + neighbours.unsqueeze(-2)).flatten(-2)
        return self.rows[index] if self._cut else index, weights


def multilinear(values: Tensor, weights: Sequence[Tensor]) -> Tensor:
    """Values (*b, 2^c, k) at the corners of cells, interpolated to (*b, k)."""
    for weight in reversed(weights):
        low, high = values.unflatten(-2, (-1, 2)).unbind(-2)
        values = torch.lerp(low, high, weight.unsqueeze(-1).to(values.dtype))
    return values.squeeze(-2)


class PeriodicTable(nn.Module):
    """Interpolation of n motions over phase, from m samples of k values at phases j / m.

    Cubic splines, or monotone cubics.

    Args:
        values: (n, m, k) samples, in the precision of the table.
        jumps: (k,) mask of columns interpolated monotonically; the others are twice differentiable.
    """

    nodes: Tensor
    """(n, m, 2, k) value and slope of each sample, adjacent in memory."""

    def __init__(self, values: np.ndarray, jumps: np.ndarray | None = None) -> None:
        super().__init__()
        n, samples, columns = values.shape
        nodes = np.empty((n, samples, 2, columns), values.dtype)
        nodes[:, :, 0] = values
        for i in range(0, n, _BLOCK):
            nodes[i : i + _BLOCK, :, 1] = _slopes(values[i : i + _BLOCK], jumps)
        self.register_buffer("nodes", torch.from_numpy(nodes), persistent=False)

    def values(self) -> np.ndarray:
        """(n, m, k) samples: a read-only view of the nodes."""
        return read_only_view(self.nodes)[:, :, 0]

    def forward(self, phase: Tensor, motion: Tensor) -> Tensor:
        """Values (*b, r, k) of motions (*b, r), by index, at phases (*b, 1)."""
        samples = self.nodes.shape[1]
        column, fraction = _place(phase.to(self.nodes.dtype), samples)
        first = motion * samples
        after = _nodes_at(self.nodes, first + (column + 1) % samples)
        before = _nodes_at(self.nodes, first + column)
        return _hermite(before, after, fraction)


class LocalTable(nn.Module):
    """Interpolation over phase like that of `PeriodicTable`, in half the memory.

    Cubics whose slopes are differences of sixth order of the samples, computed at each look-up.

    Args:
        values: (n, m, k) samples, in the precision of the table.
    """

    samples: Tensor
    """(n, m, k) samples."""

    def __init__(self, values: np.ndarray) -> None:
        super().__init__()
        self.register_buffer("samples", torch.from_numpy(values.copy()), persistent=False)
        slopes = self.samples.new_tensor([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60
        self.register_buffer("_slopes", slopes, persistent=False)

    def values(self) -> np.ndarray:
        """(n, m, k) samples: a read-only view."""
        return read_only_view(self.samples)

    def forward(self, phase: Tensor, motion: Tensor) -> Tensor:
        """Values (*b, r, k) of motions (*b, r), by index, at phases (*b, 1)."""
        count = self.samples.shape[1]
        column, fraction = _place(phase.to(self.samples.dtype), count)
        columns = (column + torch.arange(-3, 5, device=column.device)) % count
        index = motion.unsqueeze(-1) * count + columns.unsqueeze(-2)
        around = _nodes_at(self.samples, index)
        slopes = self.get_buffer("_slopes")
        before, after = (
            torch.stack([around[..., i, :], slopes @ around[..., i - 3 : i + 4, :]], dim=-2)
            for i in (3, 4)
        )
        return _hermite(before, after, fraction)


class SplineTable(nn.Module):
    """Interpolation over phase of motions that are a mean plus weighted sums of r components.

    Periodic cubic splines, like those of `PeriodicTable`. The components are summed before anything
    is interpolated over phase, so a look-up costs no more than that of eight motions. The sum for
    one robot does not depend on the others.

    Args:
        controls: (m, r + 1, k) control points of the components, then of the mean, see
            `spline_controls`.
    """

    controls: Tensor
    """(m + 3, r + 1, k) control points: the last ones, all, and the first two."""

    def __init__(self, controls: np.ndarray) -> None:
        super().__init__()
        around = torch.from_numpy(np.concatenate([controls[-1:], controls, controls[:2]]))
        self.register_buffer("controls", around, persistent=False)
        # the four control points of a component one after another, so that sums end with the mean
        rows = np.arange(4 * controls.shape[1], dtype=np.int32).reshape(4, -1).T.flatten()
        self.register_buffer("_rows", torch.from_numpy(rows), persistent=False)
        basis = torch.from_numpy(np.transpose(_BASIS) / 6)
        self.register_buffer("_basis", basis, persistent=False)

    def values(self) -> np.ndarray:
        """(m, r + 1, k) control points: a read-only view."""
        return read_only_view(self.controls)[1:-2]

    def forward(self, phase: Tensor, coefficients: Tensor) -> Tensor:
        """Values (*b, k) of motions with coefficients (*b, r), at phases (*b, 1)."""
        samples, components = len(self.controls) - 3, self.controls.shape[1]
        column, fraction = _place(phase.double(), samples)
        index = column.int() * components + self.get_buffer("_rows")
        basis, *lower = self.get_buffer("_basis")
        for term in lower:
            basis = term + fraction.squeeze(-1) * basis
        # the sum of these weights is 1, to the last digit only in double precision
        basis = basis.to(coefficients.dtype).unsqueeze(-2)
        weights = nn.functional.pad(coefficients, (0, 1), value=1.0).unsqueeze(-1) * basis
        return sum_rows(self.controls.flatten(0, 1), index, weights.flatten(-2))


class OpenTable(nn.Module):
    """Interpolation of n motions with two ends, from m samples of k values, both ends included.

    Cubic splines whose slopes at both ends are those of the cubics through the four samples there.

    Args:
        values: (n, m, k) samples, in the precision of the table.
    """

    nodes: Tensor
    """(n, m, 2, k) value and slope of each sample, adjacent in memory."""

    def __init__(self, values: np.ndarray) -> None:
        super().__init__()
        nodes = np.stack([values, open_slopes(values)], axis=2)
        self.register_buffer("nodes", torch.from_numpy(nodes), persistent=False)

    def forward(self, fraction: Tensor, motion: Tensor) -> Tensor:
        """Values (*b, k) of motions (*b, 1), by index, at fractions (*b, 1) from 0 to 1."""
        samples = self.nodes.shape[1]
        position = fraction.to(self.nodes.dtype) * (samples - 1)
        left = position.floor().clamp(max=samples - 2)
        first = motion * samples + left.long()
        before, after = (_nodes_at(self.nodes, first + step) for step in (0, 1))
        return _hermite(before, after, (position - left).unsqueeze(-1)).squeeze(-2)


def read_only_view(buffer: Tensor) -> np.ndarray:
    """Numbers of a buffer, as a read-only view."""
    view = buffer.numpy()
    view.setflags(write=False)
    return view


def corner_weights(weights: Sequence[Tensor]) -> Tensor:
    """Weights (*b, 2^c) of the corners of cells, from those (*b, 1) of the upper ones per axis."""
    product = torch.ones_like(weights[0])
    for weight in weights:
        pair = torch.cat([1 - weight, weight], dim=-1)
        product = (product.unsqueeze(-1) * pair.unsqueeze(-2)).flatten(-2)
    return product


def sum_rows(table: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    """Weighted sums (*b, k) of rows (*b, j), by index, of a table (n, k); rows are not copied."""
    if torch.compiler.is_exporting():  # a graph could do the sum below in a loop only
        rows = table.index_select(0, index.flatten().long()).reshape(*index.shape, -1)
        return (weights.double().unsqueeze(-2) @ rows.double()).squeeze(-2).to(table.dtype)
    weights = weights.to(table.dtype)
    flat = index.reshape(-1, index.shape[-1])
    summed = nn.functional.embedding_bag(
        flat, table, per_sample_weights=weights.reshape(flat.shape), mode="sum"
    )
    return summed.reshape(*index.shape[:-1], table.shape[-1])


def _place(phase: Tensor, samples: int) -> tuple[Tensor, Tensor]:
    """Last sample (*b, 1) of a period before phases (*b, 1), and the fraction (*b, 1, 1) after."""
    position = (phase % 1.0) * samples
    left = position.floor()
    return left.long() % samples, (position - left).unsqueeze(-1)


def _nodes_at(nodes: Tensor, index: Tensor) -> Tensor:
    """Nodes (*b, ...) of a table (n, m, ...) by the index of a sample among all n m samples.

    Selecting rows is several times faster than indexing twice.
    """
    chosen = nodes.flatten(0, 1).index_select(0, index.flatten())
    return chosen.reshape(*index.shape, *chosen.shape[1:])


def periodic_slopes(values: np.ndarray) -> np.ndarray:
    """Slopes (n, m, k) per sample of the periodic cubic splines through samples (n, m, k).

    They solve s[j - 1] + 4 s[j] + s[j + 1] = 3 (y[j + 1] - y[j - 1]), and equal those of
    `scipy.interpolate.CubicSpline` bit for bit, without its import of 0.3 s.
    """
    steps = np.diff(values, axis=1, append=values[:, :1]).swapaxes(0, 1)
    return _periodic(3 * (steps + np.roll(steps, 1, axis=0))).swapaxes(0, 1)


def spline_controls(values: np.ndarray) -> np.ndarray:
    """Control points (m, n, k) of the periodic cubic splines through samples (m, n, k).

    They solve c[j - 1] + 4 c[j] + c[j + 1] = 6 y[j]; `spline_samples` is the inverse.
    """
    return _periodic(6 * values)


def spline_samples(controls: np.ndarray) -> np.ndarray:
    """Samples (m, n, k) of periodic cubic splines with control points (m, n, k)."""
    return (np.roll(controls, 1, axis=0) + 4 * controls + np.roll(controls, -1, axis=0)) / 6


def _periodic(right: np.ndarray) -> np.ndarray:
    """Solution (m, ...) of x[j - 1] + 4 x[j] + x[j + 1] = right[j], periodic.

    The system is reduced by its last unknown to a tridiagonal one.
    """
    ends = np.zeros((len(right) - 1, *(1 for _ in right.shape[1:])))
    ends[[0, -1]] = -1.0
    free, bound = _tridiagonal(right[:-1]), _tridiagonal(ends)
    last = (right[-1] - free[0] - free[-1]) / (4 + bound[0] + bound[-1])
    return np.concatenate([free + last * bound, last[None]])


def open_slopes(values: np.ndarray) -> np.ndarray:
    """Slopes (n, m, k) per sample of the cubic splines through samples (n, m, k) of `OpenTable`."""
    y, cubic = values.swapaxes(0, 1), np.array([-11.0, 18.0, -9.0, 2.0]) / 6
    first = np.tensordot(cubic, y[:4], axes=1)
    last = -np.tensordot(cubic, y[:-5:-1], axes=1)
    right = 3 * (y[2:] - y[:-2])
    right[0] -= first
    right[-1] -= last
    return np.concatenate([first[None], _tridiagonal(right), last[None]]).swapaxes(0, 1)


def _tridiagonal(right: np.ndarray) -> np.ndarray:
    """Solution (m, ...) of x[j - 1] + 4 x[j] + x[j + 1] = right[j], zero beyond both ends.

    Gaussian elimination.
    """
    x, diagonal = right.copy(), np.full(len(right), 4.0)
    for j in range(1, len(x)):
        factor = 1 / diagonal[j - 1]
        diagonal[j] -= factor
        x[j] -= factor * x[j - 1]
    x[-1] /= diagonal[-1]
    for j in reversed(range(len(x) - 1)):
        x[j] = (x[j] - x[j + 1]) / diagonal[j]
    return x


def _monotone_slopes(values: np.ndarray) -> np.ndarray:
    """Slopes (n, m, k) per sample of monotone cubics through samples (n, m, k) of a period."""
    from scipy.interpolate import PchipInterpolator

    around = np.concatenate([values[:, -1:], values, values[:, :1]], axis=1)
    samples = values.shape[1]
    monotone = PchipInterpolator(np.arange(-1, samples + 1), around, axis=1)
    return monotone(np.arange(samples), 1)


def _slopes(values: np.ndarray, jumps: np.ndarray | None) -> np.ndarray:
    """Slopes (n, m, k) at samples, in double precision; see `PeriodicTable`."""
    values = values.astype(np.float64, copy=False)
    slopes = periodic_slopes(values)
    if jumps is not None and jumps.any():
        slopes[..., jumps] = _monotone_slopes(values[..., jumps])
    return slopes


def _hermite(left: Tensor, right: Tensor, t: Tensor) -> Tensor:
    """Cubic through two (*b, 2, k) nodes of value and slope, at t (*b, 1) in [0, 1]."""
    step = right[..., 0, :] - left[..., 0, :]
    a = left[..., 1, :] - step
    b = step - right[..., 1, :]
    return left[..., 0, :] + t * (step + (1 - t) * ((1 - t) * a + t * b))
