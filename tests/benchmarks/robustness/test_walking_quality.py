"""Quality of walks: report, methods with seeds, and quantities of made-up walks."""

import json
from pathlib import Path

import numpy as np
import pytest

from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.walking import Substeps
from benchmarks.common import table
from benchmarks.robustness.walking_quality import (
    COLUMNS,
    QUANTITIES,
    Config,
    main,
    model_rows,
    quantities,
    summary,
)

WEIGHT, SECOND = 320.0, 2000


def made_up_walk(speed: float) -> Substeps:
    """Four seconds of alternating footsteps: 400 N for 0.4 s, with gaps of 0.1 s.

    Feet land with 640 N, push sideways and slide at 0.05 m/s. One motor works with 100 W, and one
    brakes.
    """
    time = np.arange(4 * SECOND) / SECOND
    force = np.zeros((len(time), 2, 3))
    for i, offset in enumerate((0.1, 0.6)):
        force[:, i, 2] = np.where((time - offset) % 1.0 < 0.4, 400.0, 0.0)
        force[:, i, 2] += np.where((time - offset) % 1.0 < 0.01, 240.0, 0.0)
    # the left foot uses all friction for 10 ms a second, and is pulled while unloaded
    force.reshape(4, SECOND, 2, 3)[:, 400:420, 0, 0] = -400.0
    force.reshape(4, SECOND, 2, 3)[:, 1400:1500, 0, 1] = 10.0
    torque, velocity = np.zeros((2, len(time), 10))
    torque[:, 3], velocity[:, 3], torque[:, 8], velocity[:, 8] = 20.0, 5.0, 20.0, -5.0
    along = np.stack([time, 0 * time, 0 * time], axis=1)
    feet = np.repeat(0.05 * along[:, None], 2, axis=1)
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (len(time), 1))
    return Substeps(speed * along, upright, feet, force, torque, velocity, fell=False)


def test_quantities_of_made_up_walk() -> None:
    found = quantities(made_up_walk(0.5), WEIGHT, 0.5, 0.15)
    expected = {"airborne": 0.2, "longest": 0.1, "unloaded": 0.2, "slip": 0.02, "impact": 2.0}
    expected |= {"largest": 2.0, "friction": 0.01, "power": 100.0, "cost": 100 / (WEIGHT * 0.5)}
    assert list(found) == list(QUANTITIES)
    assert found == pytest.approx(expected, rel=5e-3)
    in_place = quantities(made_up_walk(0.01), WEIGHT, 0.0, 0.15)
    assert np.isnan(in_place["cost"])
    assert in_place["power"] == pytest.approx(100.0)


def test_report_of_a_policy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = main(
        Config(policy=("mine=straight",), speeds=(0.5,), settle=0.5, walk=1.6, out=tmp_path)
    )
    robot, model = rows
    assert (robot["method"], robot["walked"], robot["seeds"]) == ("mine", 1, 1)
    assert 0 < robot["airborne"]["mean"] <= robot["unloaded"]["mean"] < 0.5
    assert 1 < robot["impact"]["mean"] <= robot["largest"]["mean"] < 5
    assert 0.2 < robot["cost"]["mean"] < 2
    assert model["unloaded"]["mean"] == pytest.approx(0.11, abs=0.01)
    assert capsys.readouterr().out == (tmp_path / "walking_quality.md").read_text()
    assert (tmp_path / "walking_quality.png").read_bytes().startswith(b"\x89PNG")
    written = json.loads((tmp_path / "walking_quality.json").read_text())
    assert written["rows"][0]["power"] == robot["power"]


def _seed(value: float) -> dict[str, float]:
    return dict.fromkeys(QUANTITIES, value)


def test_several_seeds_have_mean_and_interval_and_falls_are_counted() -> None:
    row = summary("m", 1.0, [_seed(0.1), None, _seed(0.3)])
    assert (row["walked"], row["seeds"]) == (2, 3)
    half = 12.706 * 0.1
    expected = {"mean": 0.2, "low": 0.2 - half, "high": 0.2 + half}
    assert row["airborne"] == pytest.approx(expected, rel=1e-4)
    assert "| m | 1.0 | 20.0 [-107.1, 147.1] |" in table(COLUMNS, [row])
    assert table(COLUMNS, [row]).endswith("| 2 of 3 |")
    fell = summary("m", 1.0, [None])
    assert table(COLUMNS, [fell]).endswith("| m | 1.0 |  |  |  |  |  |  |  |  |  | 0 of 1 |")


def test_model_carries_little_in_mid_stance() -> None:
    """Up to 1.5 m/s, both legs carry less than 20 N for some time; at 2 m/s never."""
    slow, fast = model_rows(GaitLibrary.load(), (0.0, 2.0))
    assert slow["unloaded"]["mean"] > 0.1
    assert fast["unloaded"]["mean"] == 0.0
    assert slow["largest"]["mean"] * CASSIE.total_mass * 9.81 == pytest.approx(430.0, rel=0.01)
    assert np.isnan(slow["airborne"]["mean"])
