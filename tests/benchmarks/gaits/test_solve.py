"""Gaits in several directions."""

from pathlib import Path

import pytest

from benchmarks.gaits import solve


@pytest.mark.slow
def test_draws_gaits_in_several_directions(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = solve.Config(commands=((0.5, 0.2, 0.3),), picture=tmp_path / "paths.png")
    (gait,) = solve.main(config)
    assert gait.command.tolist() == [0.5, 0.2, 0.3]
    assert config.picture.read_bytes().startswith(b"\x89PNG")
    assert "| 0.5, 0.2, 0.3 |" in capsys.readouterr().out
