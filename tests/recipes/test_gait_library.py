"""The recipe that builds the gait library."""

from pathlib import Path

import pytest

from aslip import GaitLibrary
from aslip.errors import ConfigurationError, SpeedOutOfRangeError
from recipes import gait_library


def test_builds_library_of_other_speeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = gait_library.Config(
        out=tmp_path / "mine.npz", speeds=(0.5, 0.75), samples=32, pictures=tmp_path
    )
    gait_library.main(config)
    library = GaitLibrary.load(tmp_path / "mine.npz")
    assert library.speeds.tolist() == [0.5, 0.75]
    assert library.made_by["command"].startswith("python ")
    for picture in ("gait.png", "gaits.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    table = capsys.readouterr().out
    assert "KKT" in table
    assert " 0.8025 " in table


def test_refuses_to_replace_shipped_library() -> None:
    with pytest.raises(ConfigurationError, match=r"give another file with --out"):
        gait_library.Config(speeds=(0.5, 1.0))


def test_a_library_of_impossible_speeds_leaves_no_file(tmp_path: Path) -> None:
    config = gait_library.Config(out=tmp_path / "mine.npz", speeds=(0.5, 9.0), pictures=tmp_path)
    with pytest.raises(SpeedOutOfRangeError, match="9"):
        gait_library.main(config)
    assert not list(tmp_path.iterdir())
