"""Recipes and benchmarks run from start to end on small settings."""

from pathlib import Path

import pytest

from aslip import GaitLibrary
from aslip.errors import SpeedOutOfRangeError
from aslip.library.file import read_made_by
from benchmarks import throughput
from recipes import gait_library


def test_a_library_of_other_speeds_can_be_built(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = gait_library.Config(
        out=tmp_path / "mine.npz", speeds=(0.5, 0.75), samples=32, pictures=tmp_path
    )
    gait_library.main(config)
    library = GaitLibrary.load(tmp_path / "mine.npz")
    assert library.speeds.tolist() == [0.5, 0.75]
    assert read_made_by(tmp_path / "mine.npz")["command"].startswith("python recipes/")
    for picture in ("gait.png", "gaits.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    table = capsys.readouterr().out
    assert "KKT" in table
    assert " 0.8025 " in table


def test_a_library_of_impossible_speeds_leaves_no_file(tmp_path: Path) -> None:
    config = gait_library.Config(out=tmp_path / "mine.npz", speeds=(0.5, 9.0), pictures=tmp_path)
    with pytest.raises(SpeedOutOfRangeError, match="9"):
        gait_library.main(config)
    assert not list(tmp_path.iterdir())


def test_throughput_is_reported_for_every_candidate(capsys: pytest.CaptureFixture[str]) -> None:
    throughput.main(throughput.Config(num_envs=(2, 3), rounds=1, steps=1))
    rows = [line for line in capsys.readouterr().out.splitlines() if line[:3] in ("| 2", "| 3")]
    assert len(rows) == 6
    assert all(row.endswith("% |") for row in rows)
