"""Targets of walks in all directions: values, report, and a short run."""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.base.interval import Interval
from aslip.envs import make_env, shipped_library
from aslip.errors import ConfigurationError, SpeedOutOfRangeError
from aslip.policy import read_card
from benchmarks.directions import command_changes, figure_of_eight, stops, tracking
from benchmarks.robustness import pushes, walking_quality
from benchmarks.robustness.parameters import SWEEPS
from benchmarks.scorecard import direction_targets, direction_values
from benchmarks.scorecard.direction_list import TARGETS
from benchmarks.scorecard.direction_targets import Config, benchmarks_of, cell, main
from benchmarks.scorecard.direction_values import (
    measure,
    push_values,
    quality_values,
    standing_values,
    training_values,
)
from tests.helpers import limp
from tests.library.standing import standing_library


def plain(values: Mapping[str, float | Interval]) -> dict[str, float]:
    """Values without their intervals."""
    return {k: one.mean if isinstance(one, Interval) else one for k, one in values.items()}


def test_values_of_standing_are_the_worst_of_all_walks_that_stood() -> None:
    walk = {"planted": 0.4, "lifted": 0}
    row: dict[str, Any] = {
        "falls": {"walk": 0, "stop": 0},
        "walks": [walk, {"planted": math.nan, "lifted": 1}],
        "count": 2,
        "unplanted": 1,
        "drift_most": 0.02,
        "turn_most": math.radians(0.3),
        "power": 30.0,
    }
    expected = {"drift": 2.0, "turn": 0.3, "lifted feet": 1.0, "power, standing": 30.0}
    stopped = {"falls": {"stop": 0}, "count": 2, "unplanted": 0, "planted": 0.9}
    expected["stop"] = 0.9
    found = plain(standing_values(row, stopped))
    assert found == pytest.approx({**expected, "falls, stops": 0.0, "unplanted": 25.0})
    fallen = {**walk, "lifted": math.nan}
    row |= {"falls": {"walk": 0, "stop": 1}, "walks": [*row["walks"], fallen], "count": 3}
    expected |= {"falls, stops": 20.0, "unplanted": 20.0}
    assert plain(standing_values(row, stopped)) == pytest.approx(expected)
    # falls of the stops at 1 m/s count, too
    stopped |= {"falls": {"walk": 1, "stop": 1}, "unplanted": 1}
    expected |= {"falls, stops": 60.0, "unplanted": 40.0}
    assert plain(standing_values(row, stopped)) == pytest.approx(expected)
    none = plain(standing_values({**row, "walks": [fallen]}, stopped))
    assert math.isnan(none["lifted feet"])


def test_sweeps_count_within_the_ranges_of_the_targets() -> None:
    """Each sweep has a target, and so have impulses at the worst direction and phase."""
    values = {name: 1.0 for name in SWEEPS}
    sweeps = [
        {"parameter": name, "value": 1.0, "mean": mean, "trials": 16}
        for name, mean in values.items()
    ]
    sweeps += [
        {"parameter": "payload", "value": 16.0, "mean": 0.5, "trials": 16},
        {"parameter": "payload", "value": 20.0, "mean": 0.0, "trials": 16},
        {"parameter": "floor_friction", "value": 0.2, "mean": 0.0, "trials": 16},
    ]
    pushes = [{"phases": [{"mean": 20.0}, {"mean": 40.0}]}, {"phases": [{"mean": 30.0}] * 2}]
    found = push_values({"pushes": pushes, "sweeps": sweeps})
    assert (found.pop("pushes, least"), found.pop("pushes, mean")) == (20.0, 30.0)
    sweeps = {**dict.fromkeys(["friction", "slope", "delay", "motors"], 100.0), "payload": 75.0}
    assert {name: one.mean for name, one in found.items()} == sweeps  # pyright: ignore
    assert found["payload"] == Interval.of_share(24, 32).scaled(100)


def test_force_and_power_are_those_of_straight_walks() -> None:
    rows = [
        {name: {"mean": value} for name in walking_quality.QUANTITIES}
        for value in (3.0, 2.5, 1.0, 2.4, 2.0)
    ]
    found = quality_values(rows)
    assert (found["no contact"], found["force"]) == (300.0, 2.0)
    assert (found["power, 1 m/s"], found["power, 2 m/s"]) == (1.0, 2.0)


def test_cost_of_a_training_is_read_from_the_file() -> None:
    found = training_values("straight")
    assert 1.0 < found["samples"] < 2.0
    assert 5 < found["time"] < 200
    assert all(math.isnan(value) for value in training_values(limp()).values())


def test_a_target_without_a_value_has_a_dash() -> None:
    claim = next(claim for claim in TARGETS if claim.name == "path")
    values = [{"path": Interval(x, x, x)} for x in (4.04, math.nan)]
    assert [cell(claim, one) for one in (*values, {})] == ["4.0", "-", "-"]


def fake_benchmarks(patch: pytest.MonkeyPatch) -> list[Any]:
    """Replace the benchmarks; returns the list of settings with which they are called."""
    asked: list[Any] = []
    errors: dict[str, Any] = {"falls": 0, "count": 200}
    for name, value in {"speed": 0.02, "speed_p95": 0.05, "turn": 0.01, "turn_p95": 0.02}.items():
        errors[name] = vars(Interval(value, 0.8 * value, 1.6 * value))
    stood = {"falls": {"stop": 0}, "walks": [{"planted": 0.8, "lifted": 0}], "planted": 0.8}
    stood |= {"unplanted": 0, "count": 1, "drift_most": 0.0, "turn_most": 0.0, "power": 30.0}
    means = {**dict.fromkeys(walking_quality.QUANTITIES, 0.001), "largest": 1.2, "cost": 0.4}
    sweep = {"value": 1.0, "mean": 1.0, "trials": 16}
    rows = {
        tracking: [errors],
        command_changes: [{"falls": [[[0.0], [1.0]]], "changes": 2000}],
        stops: [stood],
        figure_of_eight: [{"fell": False, "truth": 0.05}],
        walking_quality: [{name: {"mean": value} for name, value in means.items()}] * 5,
        pushes: {
            "pushes": [{"phases": [{"mean": 50.0}]}],
            "sweeps": [{"parameter": name, **sweep} for name in SWEEPS],
        },
    }
    for module, found in rows.items():
        patch.setattr(module, "main", lambda config, *_, found=found: asked.append(config) or found)
    feet = {"feet, straight": 2.0, "feet, turns": 3.0, "no footsteps": 0.0}
    patch.setattr(direction_values, "foot_values", lambda *_: feet)
    # policies that walk straight stand for others
    gaits = shipped_library("directions")
    patch.setattr(direction_targets, "chosen_library", lambda *_: gaits)
    return asked


def test_every_target_has_a_value_from_its_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each benchmark runs once for each policy, in a folder of its own."""
    asked = fake_benchmarks(monkeypatch)
    config = Config(policy=("straight", "robust"), out=tmp_path)
    found = {row["name"]: row["found"]["policy"] for row in main(config)}
    assert list(found) == [claim.name for claim in TARGETS]
    assert found["velocity"]["each"] == [0.02, 0.02]
    assert found["falls, changes"]["each"] == [5.0, 5.0]
    assert found["path"]["each"] == [5.0, 5.0]
    text = capsys.readouterr().out
    assert "0 in 400 walks at random commands (at most" in text
    assert "2 in 4000 sudden changes (at most" in text
    missed = [name for name, one in found.items() if one["verdict"] != "PASS"]
    assert set(missed) - {"time"} == {"falls, changes", "payload", "delay", "motors"}
    assert found["motors"]["verdict"] == "undecided"  # too few walks of two seeds
    assert {one.out.name for one in asked} == {"straight", "robust", "stops"}
    assert len(asked) == 2 * 7  # stops are measured twice
    # each policy walks at commands drawn from the seed of its training
    seeds = {name: read_card(name)["made_by"]["settings"]["seed"] for name in config.policy}
    assert {(one.policy[0], one.seed) for one in asked} == {*seeds.items()}


def test_a_record_keeps_values_and_is_of_one_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = fake_benchmarks(monkeypatch)
    record = tmp_path / "new" / "seeds.json"
    config = Config(policy=("robust",), out=tmp_path, record=record)
    main(config)
    both = dataclasses.replace(
        config, policy=("straight", "robust"), picture=tmp_path / "picture.png"
    )
    each = [row["found"]["policy"]["each"] for row in main(both)]
    assert all(len(values) == 2 for values in each)
    assert len(asked) == 2 * 7  # the second call measures one policy only
    text = capsys.readouterr().out
    assert "| target | limit | robust | straight |\n" in text
    assert "\n| velocity | ≤ 0.03 | 0.020 | 0.020 |\n" in text
    assert "Policies: `robust` (seed " in text
    assert (tmp_path / "picture.png").stat().st_size > 10_000
    kept = json.loads(record.read_text())["policies"][0]
    assert kept["intervals"]["velocity"] == pytest.approx([0.016, 0.032])
    written = json.loads((tmp_path / "direction_targets.json").read_text())
    assert written["policies"] == ["robust", "straight"]
    for settings, message in (
        ({"commands": 10}, "measured with commands 200, not commands 10;"),
        ({"walks": 0}, "walks must be 1 or more, got 0"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            main(dataclasses.replace(both, **settings))
    with pytest.raises(ConfigurationError, match="50, or a multiple of it, got 60"):
        dataclasses.replace(config, changes=60)
    for policy, made in ((limp(), None), (None, make_env)):
        with pytest.raises(ConfigurationError, match="leave out record, or"):
            main(config, policy, made)
    # of the library the content counts, not the path
    monkeypatch.setattr(direction_targets, "chosen_library", lambda *_: standing_library())
    monkeypatch.setattr(direction_targets, "SPEEDS", ())
    with pytest.raises(ConfigurationError, match=r"library_sha256 '[0-9a-f]+', not "):
        main(both)
    assert len(asked) == 2 * 7


def test_a_library_of_slow_gaits_is_refused_before_any_walk(
    tmp_path: Path, standing_gaits: str
) -> None:
    config = Config(library=standing_gaits, out=tmp_path / "out")
    with pytest.raises(SpeedOutOfRangeError, match="forward"):
        main(config, limp())


@pytest.mark.slow
def test_all_targets_are_measured(tmp_path: Path, standing_gaits: str) -> None:
    """On robots without a policy, which fall, so that few targets have a value."""
    config = Config(
        library=standing_gaits, out=tmp_path, commands=2, changes=2, placements=1, stops=1,
        walks=1, stand=0.5, path=0.06,
    )  # fmt: skip
    settings = benchmarks_of(config, limp())
    turns, count = settings.pop("turns")
    brief: dict[str, Any] = {"settle": 0.03, "walk": 0.06}
    slow = {**brief, "speeds": (0.0, 0.1, 0.2, 0.3, 0.4)}
    stop = {"before": 0.06, "rest": 0.06, "after": 0.06}
    push = {"directions": 1, "phases": 1, "repeats": 1, "bisections": 1, "settle": 0.03}
    push |= {"after": 0.03, "episode": 0.03, "duration": 0.03, "speed": 0.4}
    changed = {
        "tracking": brief, "changes": {"hold": (0.06, 0.06)}, "standing": stop, "stops": stop,
        "path": {}, "quality": slow, "pushes": push, "straight": slow,
    }  # fmt: skip
    short = {name: dataclasses.replace(settings[name], **new) for name, new in changed.items()}
    found = measure({**short, "turns": (dataclasses.replace(turns, **brief), count)}, limp())
    assert {*found} == {claim.name for claim in TARGETS}
    assert plain(found)["payload"] == 100.0
    assert np.isfinite(plain(found)["path"])
    assert (tmp_path / "TensorDictModule" / "pushes.md").exists()
