"""Foot placement of policies and logs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.walking.metrics import Placement
from benchmarks.common import table
from benchmarks.paper.foot_placement import COLUMNS, Config, main, numbers
from recipes import walk

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


def test_placement_of_a_log(
    tmp_path: Path, written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "walk.mcap"
    walk.main(walk.Config("aslip", command="0.5", duration=2.7, log=log))
    found = main(Config(out=tmp_path, log=log, **SHORT))
    assert list(found) == [0.5]
    assert 0 < found[0.5][0].error.max() < 0.1
    about = written("foot_placement")
    assert (about["policies"], about["log"]) == ([], str(log))
    monkeypatch.setattr(GaitLibrary, "sha256", "0" * 64)
    with pytest.raises(ConfigurationError, match=r"followed gaits with the hash .* --library"):
        main(Config(out=tmp_path, log=log, library="single_reference"))
    monkeypatch.undo()
    for command, message in (
        ("0.5", r"lasts 0\.6 s, .*; record 16 s"),
        ("0:0.5,0.2:0.6", "2 commanded speeds"),
        ("0.5 0 0.2", "commanded sideways or to turn"),
    ):
        log.unlink()
        walk.main(walk.Config("aslip", command=command, duration=0.6, log=log))
        with pytest.raises(ConfigurationError, match=message):
            main(Config(out=tmp_path, log=log))


def test_a_row_counts_falls() -> None:
    sides = np.array([0, 1])
    good = [Placement(sides, np.full((2, 2), x), np.full(2, 0.3)) for x in (0.01, 0.03)]
    fell = Placement(sides[:1], np.full((1, 2), np.nan), np.full(1, np.nan))
    row = numbers(1.0, [*good, fell])
    assert (row["footsteps"], row["survived"], row["policies"], row["std"]) == (4, 2, 3, 0.0)
    assert row["left_x"] == pytest.approx(0.02)
    none = numbers(1.0, [fell])
    assert none["footsteps"] == 0
    assert str(none["mean"]) == "nan"
    assert "0 of 1" in table(COLUMNS, [none])
