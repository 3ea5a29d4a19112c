"""Errors and cost of the state estimator."""

import json
from pathlib import Path

import pytest

from benchmarks.system import estimator


@pytest.mark.usefixtures("made")
def test_errors_recovery_and_cost_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = estimator.Config(steps=12, repeats=1, falls=2, ages=(0, 1, 4, 20), out=tmp_path)
    estimator.main(config)
    printed = capsys.readouterr().out
    assert [line[:7] for line in printed.splitlines() if line[2:3] in "012"][:5] == [
        f"| {speed:.1f} |" for speed in (0.0, 0.5, 1.0, 1.5, 2.0)
    ]
    assert "One packet of one robot: " in printed
    numbers = json.loads((tmp_path / "estimator.json").read_text())
    assert all(max(row["velocity"]) < 0.3 for row in numbers["walks"])
    assert sum(row["samples"] for row in numbers["recovery"]) > 0
    assert (tmp_path / "estimator.png").read_bytes().startswith(b"\x89PNG")
