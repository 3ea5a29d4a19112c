"""Targets of walks in all directions: values, verdicts, and a short run."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from shutil import copyfile
from typing import Any

import numpy as np
import pytest

from aslip.base.assets import asset_path
from aslip.base.interval import Interval
from aslip.envs import make_env
from aslip.errors import ConfigurationError, FileDamagedError, SpeedOutOfRangeError
from aslip.policy import find_policy, read_card
from benchmarks.directions import command_changes, stops, tracking
from benchmarks.flags import SWEEPS
from benchmarks.paper import foot_placement
from benchmarks.robustness import pushes, walking_quality
from benchmarks.scorecard import direction_targets, target_record
from benchmarks.scorecard.direction_targets import (
    TARGETS,
    Config,
    cell,
    judge,
    judged,
    perturbation_values,
    quality_values,
    standing_values,
    table,
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
    sweeps = [{"parameter": name, "value": 1.0, "mean": mean} for name, mean in values.items()]
    sweeps += [
        {"parameter": "payload", "value": 16.0, "mean": 0.5},
        {"parameter": "payload", "value": 20.0, "mean": 0.0},
        {"parameter": "floor_friction", "value": 0.2, "mean": 0.0},
    ]
    pushes = [{"phases": [{"mean": 20.0}, {"mean": 40.0}]}, {"phases": [{"mean": 30.0}] * 2}]
    found = perturbation_values(Config(), {"pushes": pushes, "sweeps": sweeps})
    assert (found.pop("pushes, least"), found.pop("pushes, mean")) == (20.0, 30.0)
    sweeps = {**dict.fromkeys(["friction", "slope", "delay", "motors"], 100.0), "payload": 75.0}
    assert {name: one.mean for name, one in found.items()} == sweeps  # pyright: ignore
    assert found["payload"] == Interval.of_share(24, 32).scaled(100)


def test_force_and_power_are_those_of_walks_ahead() -> None:
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


def test_table_has_a_limit_and_a_verdict_for_each_target() -> None:
    claim = next(claim for claim in TARGETS if claim.name == "path")
    rows = [{**vars(claim), "found": judge(claim, each)} for each in ([4.0, 5.0], [4.0, math.nan])]
    good, fallen = table(rows).splitlines()[2:]
    assert good.endswith("| ≤ 10 | 4.5 [-1.9, 10.9] | undecided |")
    assert fallen.endswith("| ≤ 10 | no value for 1 of 2 seeds | FAIL |")


def test_shares_of_walks_have_an_interval_if_all_seeds_are_equal() -> None:
    """Wilson's lower limit is 97.7 % if 160 of 160 walks survive, and above 98 % for 400 of 400."""
    claim = next(claim for claim in TARGETS if claim.name == "motors")
    all_walks = Interval(100.0, 100.0, 100.0)
    few, many = (judged(Config(), claim, [all_walks] * seeds) for seeds in (2, 5))
    assert few["interval"]["low"] == pytest.approx(97.66, abs=0.01)
    assert few["interval"]["high"] == few["interval"]["mean"] == 100.0
    assert [few["verdict"], many["verdict"]] == ["undecided", "PASS"]
    less = Interval(96.25, 96.25, 96.25)
    spread = judged(Config(), claim, [all_walks, less])["interval"]  # Student's is wider
    assert (spread["low"], spread["high"]) == (pytest.approx(74.3, abs=0.1), 100.0)


def test_a_target_without_a_value_has_a_dash() -> None:
    claim = next(claim for claim in TARGETS if claim.name == "path")
    assert [cell(claim, value) for value in (4.04, math.nan)] == ["4.0", "-"]


@pytest.mark.parametrize(
    ("name", "value", "shown", "word"),
    [
        ("velocity, 95 %", Interval(0.053, 0.042, 0.07), "0.053 [0.042, 0.070]", "undecided"),
        ("velocity, 95 %", Interval(0.04, 0.03, 0.05), "0.040 [0.030, 0.050]", "met"),
        ("falls, walks", Interval(0.0, 0.0, 18.8), "0 [0, 19]", "met"),
        ("drift", Interval(1.4, 1.4, 1.4), "1.40", "missed"),
    ],
)
def test_one_seed_has_the_interval_of_its_walks(
    name: str, value: Interval, shown: str, word: str
) -> None:
    claim = next(claim for claim in TARGETS if claim.name == name)
    row = {**vars(claim), "found": judged(Config(), claim, [value])}
    assert table([row]).endswith(f"| {claim.limit} | {shown} | {word} by one seed |")


def test_every_target_has_a_value_from_its_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each benchmark runs once for each policy, in a folder of its own."""
    folders, seeds = [], set()

    def fake(rows: Any) -> Any:
        def main(config: Any, *of: Any) -> Any:
            folders.append(config.out)
            seeds.add((config.policy[0], config.seed))
            return rows

        return main

    errors: dict[str, Any] = {"falls": 0}
    for name, value in {"speed": 0.02, "speed_p95": 0.05, "turn": 0.01, "turn_p95": 0.02}.items():
        errors[name] = vars(Interval(value, 0.8 * value, 1.6 * value))
    walk = {"planted": 0.8, "lifted": 0}
    stood = {"falls": {"stop": 0}, "walks": [walk], "planted": 0.8, "unplanted": 0}
    stood |= {"count": 1, "drift_most": 0.0, "turn_most": 0.0, "power": 30.0}
    means = {**dict.fromkeys(walking_quality.QUANTITIES, 0.001), "largest": 1.2, "cost": 0.4}
    quality = [{name: {"mean": value} for name, value in means.items()}] * 5
    sweeps = [{"parameter": name, "value": 1.0, "mean": 1.0} for name in SWEEPS]
    rows = {
        tracking: [errors],
        command_changes: [{"falls": [[[0.0], [1.0]]], "changes": 2000}],
        stops: [stood],
        direction_targets.figure_of_eight: [{"fell": False, "truth": 0.05}],
        walking_quality: quality,
        pushes: {"pushes": [{"phases": [{"mean": 50.0}]}], "sweeps": sweeps},
    }
    for module, found in rows.items():
        monkeypatch.setattr(module, "main", fake(found))
    feet = {"feet, straight": 2.0, "feet, turns": 3.0, "no footsteps": 0.0}
    monkeypatch.setattr(direction_targets, "foot_values", lambda *_: feet)
    file = tmp_path / "robust" / "policy.zip"
    file.parent.mkdir()
    copyfile(find_policy("robust"), file)
    config = Config(policy=("straight", str(file)), out=tmp_path)
    found = {row["name"]: row["found"] for row in direction_targets.main(config)}
    assert list(found) == [claim.name for claim in TARGETS]
    assert found["velocity"]["each"] == [0.02, 0.02]
    assert found["falls, changes"]["each"] == [5.0, 5.0]
    assert "0 in 400 walks at random commands (at most" in (text := capsys.readouterr().out)
    assert "2 in 4000 sudden changes (at most" in text
    assert found["path"]["each"] == [5.0, 5.0]
    missed = [name for name, one in found.items() if one["verdict"] != "PASS"]
    assert set(missed) - {"time"} == {"falls, changes", "payload", "delay", "motors"}
    assert found["motors"]["verdict"] == "undecided"  # too few walks of two seeds
    assert {folder.name for folder in folders} == {"straight", "robust", "stops"}
    runs = len(rows) + 1  # stops are measured twice
    assert len(folders) == 2 * runs
    # each policy walks at commands drawn from the seed of its training
    trained = {name: read_card(name)["made_by"]["settings"]["seed"] for name in config.policy}
    assert seeds == {*trained.items()}
    record = tmp_path / "new" / "seeds.json"
    kept = dataclasses.replace(config, policy=("robust",), record=record)
    direction_targets.main(kept)
    again = dataclasses.replace(kept, policy=("straight", "robust"))
    each = [row["found"]["each"] for row in direction_targets.main(again)]
    assert len(folders) == 4 * runs  # the second call measures one policy only
    assert all(len(values) == 2 for values in each)
    assert f"robust (seed {trained[str(file)]}, " in (text := capsys.readouterr().out)
    assert "| target | limit | robust | straight |\n" in text
    assert "\n| velocity | ≤ 0.03 | 0.020 | 0.020 |\n" in text
    kept_values = json.loads(record.read_text())["policies"][0]
    assert kept_values["intervals"]["velocity"] == pytest.approx([0.016, 0.032])
    # of the library the content counts, not the path
    elsewhere = str(asset_path("directions.npz"))
    direction_targets.main(dataclasses.replace(again, library=elsewhere))
    with pytest.raises(ConfigurationError, match=r"library_sha256 '[0-9a-f]+', not .* None;"):
        direction_targets.main(dataclasses.replace(again, library=None))
    with pytest.raises(ConfigurationError, match="measured with commands 200, not commands 10;"):
        direction_targets.main(dataclasses.replace(kept, commands=10))
    changed = file.parent.with_name("straight") / file.name  # weights of robust
    changed.parent.mkdir(exist_ok=True)
    copyfile(file, changed)
    with pytest.raises(ConfigurationError, match="another policy named 'straight', trained at"):
        direction_targets.main(dataclasses.replace(kept, policy=(str(changed),)))
    values = json.loads(record.read_text())
    values["policies"][0]["values"]["changes"] = 1.0
    record.write_text(json.dumps(values))
    with pytest.raises(ConfigurationError, match=r"targets differ: \['changes'\]; use another"):
        direction_targets.main(again)
    copied = tmp_path / "other" / "robust.zip"
    copied.parent.mkdir()
    copyfile(file, copied)
    with pytest.raises(ConfigurationError, match=r"several have \['robust'\]"):
        direction_targets.main(dataclasses.replace(config, policy=("robust", str(copied))))
    with pytest.raises(ConfigurationError, match="walks must be 1 or more, got 0"):
        direction_targets.main(dataclasses.replace(config, walks=0))
    with pytest.raises(ConfigurationError, match="50, or a multiple of it, got 60"):
        dataclasses.replace(config, changes=60)
    assert len(folders) == 4 * runs
    for text in ("[]", '{"settings": [], "policies": []}', json.dumps({**values, "settings": [1]})):
        record.write_text(text)
        with pytest.raises(FileDamagedError, match="no record of targets"):
            direction_targets.main(kept)
    del values["policies"][0]["sha256"]
    record.write_text(json.dumps(values))
    with pytest.raises(FileDamagedError, match=r"no record of targets: .*sha256"):
        direction_targets.main(kept)
    errors["falls"] = 1
    found = {row["name"]: row["found"] for row in direction_targets.main(config)}
    assert found["falls, walks"]["each"] == [5.0, 5.0]
    assert found["falls, walks"]["verdict"] == "FAIL"


def test_a_record_names_all_of_its_policies_also_without_a_commit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {claim.name: Interval(1.0, 0.5, 1.5) for claim in TARGETS}
    monkeypatch.setattr(direction_targets, "measure", lambda *_: values)
    monkeypatch.setattr(target_record, "provenance", lambda: {"commit": None})
    config = Config(policy=("robust",), record=tmp_path / "record.json", out=tmp_path)
    direction_targets.main(config)
    direction_targets.main(dataclasses.replace(config, policy=("straight",)))
    assert "Measured at no commit." in capsys.readouterr().out
    written = json.loads((tmp_path / "direction_targets.json").read_text())
    assert written["policies"] == ["robust", "straight"]


def test_a_record_is_of_policies_in_files_in_their_own_environments(tmp_path: Path) -> None:
    config = Config(policy=("straight",), record=tmp_path / "record.json", out=tmp_path)
    for policy, made in ((limp(), None), (None, make_env)):
        with pytest.raises(ConfigurationError, match="leave out record, or policy and make_env"):
            direction_targets.main(config, policy, made)
    assert not [*tmp_path.iterdir()]


def test_a_library_of_slow_gaits_is_refused_before_any_walk(tmp_path: Path) -> None:
    standing_library().save(tmp_path / "gaits.npz")
    config = Config(library=str(tmp_path / "gaits.npz"), out=tmp_path / "out")
    with pytest.raises(SpeedOutOfRangeError, match="forward"):
        direction_targets.main(config, limp())


@pytest.mark.slow
def test_all_targets_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On robots without a policy, which fall, so that few targets have a value."""
    for module in (tracking, walking_quality, foot_placement):
        monkeypatch.setattr(module, "_SETTLE", 0.03)
        monkeypatch.setattr(module, "_WALK", 0.06)
    for name in ("_WALK", "_REST", "_GO_ON"):
        monkeypatch.setattr(stops, name, 0.06)
    monkeypatch.setattr(command_changes, "_HOLD", (0.06, 0.06))
    monkeypatch.setattr(direction_targets, "_SPEEDS", (0.0, 0.1, 0.2, 0.3, 0.4))
    full = pushes.Config
    short = {"directions": 1, "phases": 1, "repeats": 1, "bisections": 1, "settle": 0.03}
    short |= {"after": 0.03, "episode": 0.03, "duration": 0.03, "speed": 0.4}
    monkeypatch.setattr(pushes, "Config", lambda **given: full(**{**given, **short}))
    standing_library().save(tmp_path / "gaits.npz")
    config = Config(
        library=str(tmp_path / "gaits.npz"), out=tmp_path / "out", commands=2, changes=2,
        placements=1, stops=1, walks=1, stand=0.5, path=0.06,
    )  # fmt: skip
    rows = direction_targets.main(config, limp())
    assert [row["name"] for row in rows] == [claim.name for claim in TARGETS]
    found = {row["name"]: row["found"] for row in rows}
    assert found["samples"]["verdict"] == "FAIL"  # a module has no training
    assert found["payload"]["each"] == [100.0]
    assert np.isfinite(found["path"]["each"]).all()
    assert "| path | mean distance" in capsys.readouterr().out
    written = json.loads((tmp_path / "out" / "direction_targets.json").read_text())
    assert len(written["rows"]) == len(TARGETS)
    assert (tmp_path / "out" / "TensorDictModule" / "pushes.md").exists()
