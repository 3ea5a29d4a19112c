"""Cost of walk logs."""

import json
from pathlib import Path

import pytest

from benchmarks.system import logs


@pytest.mark.slow
def test_black_box_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = tmp_path / "black_box.json"
    config = logs.Config(rounds=1, steps=40, report=report)
    logs.main(config)
    printed = capsys.readouterr().out
    assert "| joints at 2 kHz |" in printed
    numbers = json.loads(report.read_text())
    assert numbers["overhead"]["physics_bytes"] > numbers["overhead"]["policy_bytes"]
