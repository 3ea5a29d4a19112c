"""Convex regions of commands inside a grid."""

from pathlib import Path

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError, SpeedOutOfRangeError
from aslip.library import GaitLibrary
from aslip.library.interpolation import CommandGrid
from aslip.library.region import extrapolate

from .conftest import Shuffle

AXES = (np.array([0.0, 0.5, 1.0, 2.0]), np.array([-1.0, 0.0, 1.0]), np.array([-0.5, 0.0, 0.5]))
X, Y, W = np.meshgrid(*AXES, indexing="ij")
MISSING = ((np.abs(Y) + np.abs(W) > 1.01) | ((X == 2) & (np.abs(Y) + np.abs(W) > 0))).ravel()


def _box(count: int) -> torch.Tensor:
    """Commands in and around the box of the axes."""
    generator = torch.Generator().manual_seed(3)
    draw = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    return torch.tensor([-0.5, -1.5, -1.0]) + draw * torch.tensor([3.0, 3.0, 2.0])


def test_commands_move_into_the_region_continuously() -> None:
    grid, command = CommandGrid(AXES, MISSING), _box(2000)
    inside = grid.clamp(command)
    assert grid.gauge(inside).max() <= 1 + 1e-12
    torch.testing.assert_close(grid.clamp(inside), inside, rtol=0, atol=1e-12)
    step = 1e-6 * torch.randn(2000, 3, dtype=torch.float64, generator=torch.manual_seed(1))
    moved = (grid.clamp(command + step) - inside).norm(dim=1)
    assert (moved <= 20 * step.norm(dim=1)).all()
    assert (inside - command).norm(dim=1).max() > 0.5


def test_axes_of_one_value_keep_it() -> None:
    """Commands of one forward speed move to rest sideways and in yaw only."""
    one = (np.array([0.5]), *AXES[1:])
    y, w = np.meshgrid(*AXES[1:], indexing="ij")
    grid = CommandGrid(one, (np.abs(y) + np.abs(w) > 1.01).ravel())
    inside = grid.clamp(_box(200))
    assert (inside[:, 0] == 0.5).all()
    assert inside[:, 1:].abs().amax() > 0.4
    torch.testing.assert_close(grid.clamp(inside), inside, rtol=0, atol=1e-12)


def test_commands_of_motions_stay_where_they_are() -> None:
    grid = CommandGrid(AXES, MISSING)
    command = torch.tensor(np.stack([X.ravel(), Y.ravel(), W.ravel()], axis=1))
    moved = (grid.clamp(command) - command).abs().amax(1) > 1e-12
    assert moved.tolist() == MISSING.tolist()


UNEVEN = np.array([0.0, 1.0, 1.5, 3.0, 3.5]), np.array([0.0, 0.2, 1.0, 1.1]), np.arange(3.0)


def _outside(values: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Values with NaN beyond a slanted plane of the grid, and the mask of the others."""
    present = np.indices(values.shape[:3]).sum(0) < reach
    return np.where(present[..., None], values, np.nan), present


def test_linear_values_are_extrapolated_exactly_over_uneven_axes() -> None:
    x, y, w = np.meshgrid(*UNEVEN, indexing="ij")
    values = np.stack([1 + x - 2 * y + 3 * w, 0 * x + 7], axis=-1)
    filled = extrapolate(*_outside(values, 5), UNEVEN)
    near = np.indices(values.shape[:3]).sum(0) < 7
    np.testing.assert_allclose(filled[near], values[near], atol=1e-12)
    assert np.isfinite(filled).all()


def test_last_corner_of_a_cell_has_terms_mixed_over_two_axes() -> None:
    x, y, w = np.meshgrid(*UNEVEN, indexing="ij")
    values = (x**2 + x * y - y**2 + 2 * w * x - w)[..., None]
    holes, present = _outside(values, 99)
    present[4, 3, 2], holes[4, 3, 2] = False, np.nan
    np.testing.assert_allclose(extrapolate(holes, present, UNEVEN), values, atol=1e-12)


def test_library_of_a_convex_region_is_built_saved_and_looked_up(tmp_path: Path) -> None:
    """The corners of fast drifts are missing."""
    kept = [(x, y) for x in (0.2, 0.4, 0.6) for y in (-0.1, 0.0, 0.1) if x < 0.5 or y == 0]
    library = GaitLibrary.from_motions([Shuffle(*c) for c in kept], samples=8, missing=True)
    library.save(tmp_path / "cut.npz")
    loaded = GaitLibrary.load(tmp_path / "cut.npz")
    assert library.table.missing.sum() == 2
    np.testing.assert_array_equal(loaded.table.missing, library.table.missing)
    # only present motions are stored, the others are extrapolated again
    assert loaded.table.sha256 == library.table.sha256
    with np.load(tmp_path / "cut.npz") as archive:
        assert archive["table/qpos"].shape == (7, 8, 35)
        assert "table/motor_position" not in archive
    assert len(loaded.motions) == 7
    phase, border = torch.tensor([[0.3]]), torch.tensor([[0.5, 0.05]])
    assert loaded.check_command((0.5, 0.05)) == (0.5, 0.05)
    velocity = loaded.lookup(phase, border).body_velocity[0, :2]
    expected = [Shuffle(x, 0.05).sample(np.array([0.3])).body.velocity[0] for x in (0.4, 0.6)]
    np.testing.assert_allclose(velocity, np.mean(expected, axis=0)[:2], atol=0.01)
    with pytest.raises(SpeedOutOfRangeError, match=r"outside the region .*\(0\.4875, 0\.05625\)"):
        loaded.check_command((0.6, 0.1))


def test_region_must_be_convex() -> None:
    kept = [(x, y) for x in (0.2, 0.4, 0.6) for y in (-0.1, 0.0, 0.1) if (x, y) != (0.4, 0.0)]
    with pytest.raises(ConfigurationError, match=r"missing at \[0\.4, 0\.0\], in the middle"):
        GaitLibrary.from_motions([Shuffle(*c) for c in kept], samples=4, missing=True)


def test_commands_on_a_line_span_no_region() -> None:
    motions = [Shuffle(x, x / 2) for x in (0.2, 0.4)]
    with pytest.raises(ConfigurationError, match="must span the grid"):
        GaitLibrary.from_motions(motions, samples=4, missing=True)


def test_look_ups_read_rows_of_motions_and_of_filled_corners_only() -> None:
    """A point that no row was kept for would be read as the first motion."""
    axes = (np.linspace(-1.0, 2.0, 7), np.linspace(-1.0, 1.0, 5), np.linspace(-1.0, 1.0, 9))
    points = np.stack([m.ravel() for m in np.meshgrid(*axes, indexing="ij")], axis=1)
    missing = np.abs(points).sum(axis=1) > 1.7
    grid = CommandGrid(axes, missing)
    kept = grid.fill(np.arange(np.count_nonzero(~missing), dtype=float)[:, None])
    assert len(kept) < len(points)
    draws = 2.5 * torch.rand(20_000, 3, generator=torch.Generator().manual_seed(0)).double() - 1.2
    command = torch.cat([draws, 3.0 * draws])
    found, weights = grid.corners(command)
    grid.rows = torch.arange(len(points))
    place, _ = grid.corners(command)
    assert found.max() < len(kept)
    # one row for each point of the grid, and one point for each row
    pairs = torch.stack([found.flatten(), place.flatten()]).unique(dim=1)
    assert len(pairs[0].unique()) == len(pairs[1].unique()) == pairs.shape[1]
    assert all(((w >= 0) & (w <= 1)).all() for w in weights)
