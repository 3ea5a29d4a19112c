"""Targets of walks over stones: each is the worst row that it is about."""

from pathlib import Path

import pytest

from aslip.sim.course import PATTERNS
from benchmarks.directions import command_changes
from benchmarks.planning import stepping_stones
from benchmarks.robustness import pushes
from benchmarks.scorecard import stone_targets


def test_values_are_those_of_the_worst_courses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """One command walks all kinds of courses, is pushed, and changes commands."""
    asked = []

    def walked(config: stepping_stones.Config, *_: object):
        asked.append(config)
        courses = stepping_stones.courses_of(config)
        share = {"1": config.size, "zigzag": 0.3, "stairs -0.1 m": 0.4, "vanishing": 0.8}
        return [
            {"course": name, "mean": share.get(name, 0.9), "low": 0.1, "high": 0.94}
            | {"distance": 0.03, "distance_p95": 0.06, "late": 0.02}
            for name in courses
        ]

    phases = [{"mean": impulse} for impulse in (12.0, 30.0)]
    monkeypatch.setattr(stepping_stones, "main", walked)
    monkeypatch.setattr(pushes, "main", lambda *_: {"pushes": [{"phases": phases}]})
    monkeypatch.setattr(
        command_changes, "main", lambda *_: [{"falls": [None] * 2, "changes": 10_000}]
    )
    config = stone_targets.Config(out=tmp_path, trials=2)
    rows = stone_targets.main(config)
    values = {row["name"]: row["found"]["policy"]["each"][0] for row in rows}
    verdicts = {row["name"]: row["found"]["policy"]["verdict"] for row in rows}
    assert [one.size for one in asked] == [0.2, 0.3, 0.15]
    assert (len(asked[0].patterns), asked[1].patterns) == (len(PATTERNS), ())
    expected = {"20 cm": 20, "30 cm": 30, "15 cm": 15, "patterns": 30, "vanishing": 80}
    expected |= {"stairs, 10 cm": 40, "stairs, 15 cm": 90, "feet": 3, "feet, 95 %": 6}
    expected |= {"touchdown": 20, "pushes, least": 12, "pushes, mean": 21, "falls, changes": 2}
    assert {name: values[name] for name in expected} == pytest.approx(expected)
    assert verdicts["samples"] == "met by one seed"
    assert verdicts["patterns"] == "missed by one seed"
    assert (tmp_path / "stone_targets.md").read_text().count("by one seed") == len(rows)
