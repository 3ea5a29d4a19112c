"""Targets against each other: the table, the shaded region, and records that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from aslip.errors import ConfigurationError
from benchmarks.scorecard import trades
from benchmarks.scorecard.direction_targets import TARGETS
from benchmarks.scorecard.trades import PAIRS, Config, claim_of


def write(path: Path, **policies: float) -> Path:
    """Record in which every target of a policy has one value."""
    kept = [
        {
            "name": name,
            "sha256": name,
            "seed": 0,
            "commit": "abc",
            "measured_at": "def",
            "values": {claim.name: value for claim in TARGETS},
        }
        for name, value in policies.items()
    ]
    path.write_text(json.dumps({"settings": {"commands": 7}, "policies": kept}))
    return path


def test_policies_of_all_records_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    records = write(tmp_path / "a.json", one=1.0, two=40.0), write(tmp_path / "b.json", three=99.0)
    found = trades.main(Config(records, tmp_path / "trades.png"))
    assert [*found] == ["one", "two", "three"]
    header, _, *rows = capsys.readouterr().out.splitlines()
    assert "pushes, mean (≥ 45)" in header and "force (≤ 1.5)" in header
    assert rows[1].startswith("| two | 40.000 | 40.00 | 40.0 | 40.0 |")
    assert (tmp_path / "trades.png").stat().st_size > 10_000


def test_records_that_cannot_be_compared_are_refused(tmp_path: Path) -> None:
    first, second = write(tmp_path / "a.json", one=1.0), write(tmp_path / "b.json", two=2.0)
    changed = json.loads(second.read_text())
    second.write_text(json.dumps({**changed, "settings": {"commands": 8}}))
    with pytest.raises(ConfigurationError, match="commands 8, not commands 7"):
        trades.main(Config((first, second)))
    changed["policies"][0]["values"]["speed"] = 1.0
    second.write_text(json.dumps(changed))
    with pytest.raises(ConfigurationError, match=r"targets differ: \['speed'\]"):
        trades.main(Config((first, second)))


def test_every_drawn_target_exists() -> None:
    assert all(claim_of(name) for pair in PAIRS for name in pair)
