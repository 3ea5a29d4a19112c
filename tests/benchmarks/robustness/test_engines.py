"""The benchmark of physics engines walks, and sums up falls."""

from pathlib import Path

import pytest

from benchmarks.robustness import engines
from benchmarks.robustness.engines import EngineWalk, summary

ENGINES = ("mujoco", "stiff", "drake")


def _walk(command: float, speed: float, *, fell: bool = False) -> EngineWalk:
    return EngineWalk(
        "mine", "drake", command, 12.0, fell=fell, speed=speed, height=0.9, estimate_error=0.01
    )


def test_the_report_has_a_row_per_speed_and_per_engine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pydrake", exc_type=ImportError)
    config = engines.Config(
        policy=("straight",), engine=ENGINES, speeds=(0.0, 1.0), duration=0.03, out=tmp_path
    )
    engines.main(config)
    table, summaries = (tmp_path / "engines.md").read_text().split("\n\n")
    assert table in capsys.readouterr().out
    assert [row.split("|")[1].strip() for row in table.splitlines()[2:]] == ["0.0", "1.0"]
    assert [row.split("|")[2:4] for row in summaries.splitlines()[2:]] == [
        [f" {engine} ", " 2 of 2 "] for engine in ENGINES
    ]


def test_falls_are_counted_and_kept_out_of_the_means() -> None:
    walks = [_walk(0.5, 0.53), _walk(1.0, 0.98), _walk(2.0, -1.0, fell=True)]
    assert summary("mine", "drake", walks)[2:4] == ["2 of 3", "0.030"]
    assert str(walks[2]) == "fell at 12.0 s"
    assert summary("mine", "drake", walks[2:])[2:4] == ["0 of 1", "-"]
