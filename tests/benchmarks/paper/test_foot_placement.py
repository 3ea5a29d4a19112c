"""Foot placement of policies and logs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.walking.metrics import Placement
from benchmarks.common import table
from benchmarks.paper.foot_placement import COLUMNS, Config, main, numbers

Written = Callable[[str], dict[str, Any]]
SHORT: dict[str, Any] = {"settle": 1.0, "walk": 3.0, "footsteps": 4}


def test_placement_of_a_policy(tmp_path: Path, written: Written) -> None:
    found = main(Config(out=tmp_path, speeds=(0.5, 1.0), **SHORT))
    assert [len(found[speed][0].error) for speed in (0.5, 1.0)] == [4, 4]
    rows = written("foot_placement")["rows"]
    assert [row["footsteps"] for row in rows] == [4, 4]
    assert rows[1]["published"] == 0.0922
    assert [row["released"] for row in rows] == [[0.055, 0.045], [0.077, 0.076]]
    assert "| 9.2 | 7.7, 7.6 |" in (tmp_path / "foot_placement.md").read_text()
    assert all(0 < row["mean"] < 0.15 for row in rows)


def test_a_row_counts_falls() -> None:
    sides = np.array([0, 1])
    good = [Placement(sides, np.full((2, 2), x), np.full(2, 0.3)) for x in (0.01, 0.03)]
    fell = Placement(sides[:1], np.full((1, 2), np.nan), np.full(1, np.nan))
    row = numbers(1.0, [*good, fell])
    assert (row["footsteps"], row["survived"], row["policies"], row["std"]) == (4, 2, 3, 0.0)
    assert row["forward"] == pytest.approx(0.02)
    none = numbers(1.0, [fell])
    assert none["footsteps"] == 0
    assert str(none["mean"]) == "nan"
    assert "0 of 1" in table(COLUMNS, [none])
