"""Benchmarks of walks in all directions run, and count what happens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from benchmarks import direction_tracking, path, transitions
from tests.helpers import limp
from tests.library.bent import symmetric_library


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("library") / "gaits.npz"
    symmetric_library().save(file)
    return str(file)


def _written(out: Path, name: str) -> dict:
    assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert (out / f"{name}.md").read_text().startswith("|")
    return json.loads((out / f"{name}.json").read_text())


def test_errors_are_mapped_over_the_region(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(direction_tracking, "_SETTLE", 0.15)
    monkeypatch.setattr(direction_tracking, "_WALK", 0.15)
    config = direction_tracking.Config(library=library, commands=6, out=tmp_path)
    (row,) = direction_tracking.main(config, limp())
    assert row["falls"] == 0
    numbers = _written(tmp_path, "direction_tracking")
    command, twist = np.array(numbers["command"]), np.array(numbers["twist"][0])
    assert command.shape == twist.shape == (6, 3)
    assert np.ptp(command, axis=0).min() > 0.1
    assert row["speed"] == pytest.approx(
        np.linalg.norm((twist - command)[:, :2], axis=1).mean(), abs=1e-9
    )
    with pytest.raises(ConfigurationError, match="commands must be 1 or more"):
        direction_tracking.Config(commands=0)


def test_each_fall_counts_for_the_change_before_it(
    library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a policy robots fall about once a second, start again, and fall again."""
    monkeypatch.setattr(transitions, "_HOLD", (0.6, 1.2))
    config = transitions.Config(library=library, changes=6, robots=3, out=tmp_path)
    (row,) = transitions.main(config, limp())
    assert row["changes"] == 6
    assert len(row["falls"]) >= 3
    assert row["rate"] == pytest.approx(1e4 * len(row["falls"]) / 6)
    for old, new in row["falls"]:
        assert old != new
    _written(tmp_path, "transitions")
    with pytest.raises(ConfigurationError, match="robots must be from 1"):
        transitions.Config(changes=2, robots=3)


def test_a_path_is_walked_over_the_estimate(library: str, tmp_path: Path) -> None:
    config = path.Config(library=library, speed=0.5, duration=0.45, out=tmp_path)
    (row,) = path.main(config, limp())
    assert row["time"] == pytest.approx(0.45)
    assert not row["fell"]
    assert 0 < row["estimate"] <= row["estimate_most"] < 0.3
    # within half a second the estimate does not drift far
    assert row["truth"] == pytest.approx(row["estimate"], abs=0.1)
    _written(tmp_path, "path")
