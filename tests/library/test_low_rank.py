"""Tables of low rank: as near to the motions as can be, and looked up like other tables."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aslip.base.archive import npy
from aslip.errors import ConfigurationError, FileDamagedError, ShapeError
from aslip.library import GaitLibrary
from aslip.library.interpolation import sum_rows
from aslip.library.low_rank import LowRankTable
from aslip.library.reference import COLUMNS
from aslip.library.table import ARRAYS
from tests.contracts.archives import forge_archive, read_zip

from .bent import Bent
from .conftest import Shuffle

SAMPLES, RANK = 12, 5


@pytest.fixture(scope="module")
def dense(library: GaitLibrary) -> GaitLibrary:
    """Twelve turning motions."""
    gaits = library.gaits[0], library.gaits[8]
    motions = [Bent(gait, v, w) for gait in gaits for v in (-0.1, 0.2) for w in (-0.3, 0.0, 0.6)]
    return GaitLibrary.from_motions(motions, samples=SAMPLES)


def reduced(dense: GaitLibrary, rank: int) -> GaitLibrary:
    """The motions as sums of components."""
    return GaitLibrary(dense.motions, LowRankTable.of(dense.table, rank))


def places(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Phases (n, 1) and commands (n, 3) of the motions' region."""
    draw = torch.rand(count, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    low, high = torch.tensor([[0.0, -0.1, -0.3], [0.8, 0.2, 0.6]])
    return draw[:, :1], low + (high - low) * draw[:, 1:]


def test_no_sum_of_as_many_components_is_nearer_to_the_motions(dense: GaitLibrary) -> None:
    """Columns count relative to their range; the least error is that of the singular values."""
    low = LowRankTable.of(dense.table, RANK)
    true, found = (
        np.concatenate([getattr(t, n).reshape(12, SAMPLES, -1) for n in COLUMNS], axis=-1)
        for t in (dense.table, low)
    )
    extent = np.ptp(true, axis=(0, 1))
    extent[extent == 0] = 1.0
    left = np.linalg.svd(((true - true.mean(axis=0)) / extent).reshape(12, -1), compute_uv=False)[
        RANK:
    ]
    error = (found - true) / extent
    assert np.linalg.norm(error) == pytest.approx(np.linalg.norm(left), rel=1e-6)
    for name in ARRAYS:
        values, expected = getattr(low, name), getattr(dense.table, name)
        assert values.shape == expected.shape
        assert not values.flags.writeable


def test_look_ups_of_all_components_are_those_of_the_motions(dense: GaitLibrary) -> None:
    """A mean and as many components as there are other motions are exact, also between samples."""
    low, (phase, command) = reduced(dense, 11), places(200)
    found, true = low.lookup(phase, command), dense.lookup(phase, command)
    for name, value in vars(true).items():
        torch.testing.assert_close(getattr(found, name), value, rtol=1e-5, atol=1e-5)
    assert torch.equal(low.stride(command), dense.stride(command))
    nodes = (phase * SAMPLES).floor() / SAMPLES
    states = zip(*(one.initial_state(nodes, command) for one in (low, dense)), strict=True)
    for found, true in states:
        torch.testing.assert_close(found, true, rtol=1e-9, atol=1e-9)


def test_look_ups_are_periodic_smooth_and_the_same_for_one_robot_and_many(
    dense: GaitLibrary,
) -> None:
    low, (phase, command) = reduced(dense, RANK), places(100)
    many = low.lookup(phase, command)
    for i in range(3):
        for name, value in vars(low.lookup(phase[i], command[i])).items():
            assert torch.equal(value, getattr(many, name)[i]), name
    for name, value in vars(low.lookup(phase + 2.0, command)).items():
        torch.testing.assert_close(value, getattr(many, name), rtol=0, atol=1e-6)
    for node in (0.0, 1.0, 5 / SAMPLES):
        steps = node + torch.tensor([[-1e-5], [0.0], [1e-5]], dtype=torch.float64)
        before, at, after = low.initial_state(steps, command[:1])[0]
        torch.testing.assert_close(after - at, at - before, rtol=0, atol=1e-8)
    one = low.lookup(torch.stack([phase, 1 - phase]), command)
    expected = low.lookup(1 - phase, command).motor_torque
    assert torch.equal(one.motor_torque[1], expected)


def test_corners_around_a_region_are_extrapolated_like_those_of_motions() -> None:
    kept = [(x, y) for x in (0.2, 0.4, 0.6) for y in (-0.1, 0.0, 0.1) if x < 0.5 or y == 0]
    motions = [Shuffle(*c) for c in kept]
    dense, low = (
        GaitLibrary.from_motions(motions, samples=8, missing=True, rank=rank) for rank in (7, 6)
    )
    assert isinstance(low.table, LowRankTable)
    assert not isinstance(dense.table, LowRankTable)  # which would take more memory
    phase, border = torch.tensor([[0.3], [0.8]]), torch.tensor([[0.5, 0.05], [0.55, -0.025]])
    found, true = low.lookup(phase, border), dense.lookup(phase, border)
    torch.testing.assert_close(found.body_velocity, true.body_velocity, rtol=0, atol=1e-6)
    assert torch.equal(low.nearest(2 * border), dense.nearest(2 * border))


def test_a_file_has_the_components_and_a_library_stores_no_number_twice(
    dense: GaitLibrary, tmp_path: Path
) -> None:
    low, file = reduced(dense, RANK), tmp_path / "low.npz"
    low.save(file)
    loaded = GaitLibrary.load(file)
    assert loaded.sha256 == low.sha256 != dense.sha256
    assert len(loaded.motions) == 12
    phase, command = places(10)
    for name, value in vars(low.lookup(phase, command)).items():
        assert torch.equal(value, getattr(loaded.lookup(phase, command), name))
    table, buffers = loaded.table, list(loaded.buffers())
    assert isinstance(table, LowRankTable)
    for name in ("coefficients", "reference", "configuration", "velocity"):
        shared = [np.shares_memory(getattr(table, name), b.numpy()) for b in buffers]
        assert sum(shared) == 1, name
    changed = np.load(file)["table/coefficients"][:, 1:]
    parts = {**read_zip(file.read_bytes()), "table/coefficients.npy": npy(changed)}
    file.write_bytes(forge_archive(parts))
    with pytest.raises(FileDamagedError, match=r"reference must have shape \(12, 5, 51\)"):
        GaitLibrary.load(file)


def test_tables_that_do_not_fit_together_are_refused(dense: GaitLibrary) -> None:
    low = LowRankTable.of(dense.table, RANK)
    with pytest.raises(ShapeError, match=r"velocity must have shape \(12, 6, 32\)"):
        replace(low, velocity=low.configuration)
    with pytest.raises(ConfigurationError, match="reference has non-finite entries"):
        replace(low, reference=np.nan * low.reference)
    with pytest.raises(ConfigurationError, match="torques jump"):
        LowRankTable.of(replace(dense.table, torque_jumps=True), RANK)
    with pytest.raises(ConfigurationError, match="from 1 to 12 motions, got 13"):
        LowRankTable.of(dense.table, 13)
    with pytest.raises(AttributeError, match="'speed'"):
        _ = low.speed


def test_exported_sums_are_those_of_pytorch(monkeypatch: pytest.MonkeyPatch) -> None:
    table, weights = torch.randn(40, 5), torch.randn(2, 3, 6, dtype=torch.float64)
    index = torch.randint(0, 40, (2, 3, 6), dtype=torch.int32)
    plain = sum_rows(table, index, weights)
    monkeypatch.setattr(torch.compiler, "is_exporting", lambda: True)
    torch.testing.assert_close(sum_rows(table, index, weights), plain)
