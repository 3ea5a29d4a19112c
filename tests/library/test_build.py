"""Builds of many motions: in processes, resumed, in single precision."""

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from aslip.library import GaitLibrary, tabulate
from aslip.library.build import _Chunk
from aslip.library.rows import FramedMotion, Rows
from aslip.library.table import ARRAYS, GaitTable
from aslip.robot import CASSIE

from .bent import Bent


@pytest.fixture(scope="module")
def motions(library: GaitLibrary) -> list[Bent]:
    """Twenty-four turning motions."""
    return [Bent(gait, 0.1, w) for gait in library.gaits[:12] for w in (-0.3, 0.6)]


@pytest.fixture(scope="module")
def table(motions: list[Bent]) -> GaitTable:
    """Table of the motions, made in this process."""
    return tabulate(motions, samples=4)


def _assert_equal(found: GaitTable, expected: GaitTable) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_number_of_processes_changes_no_bit(motions: list[Bent], table: GaitTable) -> None:
    """Nor a class that only this process has."""

    class Local(Bent):
        pass

    seen: list[tuple[int, int]] = []
    motions = [Local(motions[0].gait, *motions[0].command[1:]), *motions[1:]]
    found = tabulate(motions, samples=4, workers=2, progress=lambda *at: seen.append(at))
    _assert_equal(found, table)
    assert [count for _, count in seen] == [24, 24]
    assert seen[-1] == (24, 24)


def test_motions_of_the_main_script_are_sampled_before_they_are_sent(
    motions: list[Bent], monkeypatch: pytest.MonkeyPatch
) -> None:
    chunk = _Chunk(motions[:1], CASSIE, np.arange(4) / 4, False, None)
    assert chunk.portable() is chunk
    monkeypatch.setattr(sys.modules["__main__"], "Bent", Bent, raising=False)
    monkeypatch.setattr(Bent, "__module__", "__main__")
    sent = pickle.loads(pickle.dumps(chunk.portable()))
    assert [type(motion) for motion in sent.motions] == [FramedMotion]
    for name, rows in sent.rows()[0].items():
        np.testing.assert_array_equal(rows, chunk.rows()[0][name])


def test_interrupted_build_resumes(
    motions: list[Bent], table: GaitTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damaged files, and those of other motions, are not used."""

    def stop(done: int, count: int) -> None:
        if done == 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tabulate(motions, samples=4, folder=tmp_path, progress=stop)
    (file,) = tmp_path.iterdir()
    solved: list[Rows] = []
    plain = FramedMotion.rows
    monkeypatch.setattr(
        FramedMotion, "rows", lambda *a, **k: solved.append(plain(*a, **k)) or solved[-1]
    )
    _assert_equal(tabulate(motions, samples=4, folder=tmp_path), table)
    assert len(solved) == 8
    file.write_bytes(file.read_bytes()[:-40])
    _assert_equal(tabulate(motions, samples=4, folder=tmp_path), table)
    assert len(solved) == 8 + 16
    tabulate(motions[:16], samples=5, folder=tmp_path)
    assert len(solved) == 8 + 16 + 16
    tabulate(motions[:16], samples=5, folder=tmp_path, leg_dynamics=True)
    assert len(solved) == 8 + 16 + 16 + 16


def test_library_in_single_precision_is_half_as_large_and_close(
    motions: list[Bent], tmp_path: Path
) -> None:
    double, single = (
        GaitLibrary.from_motions(motions, samples=8, single_precision=s, keep_motions=not s)
        for s in (False, True)
    )
    sizes = [sum(buffer.nbytes for buffer in one.buffers()) for one in (double, single)]
    assert sizes[1] < 0.51 * sizes[0]
    assert np.shares_memory(single.table.qpos, single._lookup._qpos.values())
    assert not single.motions
    single.save(tmp_path / "single.npz")
    loaded = GaitLibrary.load(tmp_path / "single.npz")
    phase, command = torch.rand(50, 1), torch.tensor([[0.73, 0.1, 0.2]]).expand(50, 3)
    for name, value in vars(single.lookup(phase, command)).items():
        exact = getattr(double.lookup(phase, command), name)
        torch.testing.assert_close(value, exact, rtol=1e-4, atol=1e-4)
        assert torch.equal(value, getattr(loaded.lookup(phase, command), name))
    qpos, qvel = loaded.initial_state(phase, command)
    assert qpos.dtype == qvel.dtype == torch.float64
    torch.testing.assert_close(qpos, double.initial_state(phase, command)[0], rtol=0, atol=1e-5)
