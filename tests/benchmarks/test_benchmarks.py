"""Benchmarks of a policy run from a policy or a log."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.walking.metrics import Placement
from benchmarks.common import Interval, write_results
from benchmarks.paper import (
    foot_placement,
    ground_force,
    open_loop_force,
    step_frequency,
    velocity_tracking,
)
from benchmarks.scorecard import claim_values, claims
from recipes import walk


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short walks, for fast tests."""
    for module in (foot_placement, ground_force, step_frequency, velocity_tracking):
        monkeypatch.setattr(module, "_SETTLE", 1.0)
        monkeypatch.setattr(module, "_WALK", 3.0)
    monkeypatch.setattr(foot_placement, "_FOOTSTEPS", 4)
    monkeypatch.setattr(velocity_tracking, "_HOLD", 0.5)
    for name in ("_BEFORE", "_AFTER"):
        monkeypatch.setattr(velocity_tracking, name, 1.0)


def settings(out: Path, *speeds: float) -> dict[str, Any]:
    return {"out": out, "speeds": speeds}


def written(out: Path, name: str) -> dict[str, Any]:
    """Numbers of a benchmark; its table and picture must exist."""
    assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert (out / f"{name}.md").read_text().startswith("|")
    return json.loads((out / f"{name}.json").read_text())


def test_foot_placement_of_a_policy(tmp_path: Path) -> None:
    found = foot_placement.main(foot_placement.Config(**settings(tmp_path, 0.5, 1.0)))
    assert [len(found[speed][0].error) for speed in (0.5, 1.0)] == [4, 4]
    rows = written(tmp_path, "foot_placement")["rows"]
    assert [row["footsteps"] for row in rows] == [4, 4]
    assert rows[1]["published"] == 0.0922
    assert [row["released"] for row in rows] == [[0.055, 0.045], [0.077, 0.076]]
    assert "| 9.2 | 7.7, 7.6 |" in (tmp_path / "foot_placement.md").read_text()
    assert all(0 < row["mean"] < 0.15 for row in rows)


def test_foot_placement_of_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = "aslip"
    log = tmp_path / "walk.mcap"
    walk.main(walk.Config(policy, command="0.5", duration=5.4, log=log))
    found = foot_placement.main(foot_placement.Config(out=tmp_path, log=log))
    assert list(found) == [0.5]
    assert 0 < found[0.5][0].error.max() < 0.1
    about = written(tmp_path, "foot_placement")
    assert (about["policies"], about["log"]) == ([], str(log))
    other = foot_placement.Config(out=tmp_path, log=log, library="single_reference")
    monkeypatch.setattr(foot_placement.GaitLibrary, "sha256", "0" * 64)
    with pytest.raises(ConfigurationError, match=r"followed gaits with the hash .* --library"):
        foot_placement.main(other)
    monkeypatch.undo()
    short = tmp_path / "short.mcap"
    walk.main(walk.Config(policy, command="0.5", duration=0.6, log=short))
    with pytest.raises(ConfigurationError, match=r"lasts 0\.6 s, .*; record 16 s"):
        foot_placement.main(foot_placement.Config(out=tmp_path, log=short))
    varied = tmp_path / "varied.mcap"
    walk.main(walk.Config(policy, command="0:0.5,0.2:0.6", duration=0.5, log=varied))
    with pytest.raises(ConfigurationError, match="2 commanded speeds"):
        foot_placement.main(foot_placement.Config(out=tmp_path, log=varied))


def test_step_frequency(tmp_path: Path) -> None:
    rows = step_frequency.main(step_frequency.Config(**settings(tmp_path, 0.5)))
    assert rows[0]["mean"] == pytest.approx(rows[0]["model"], rel=0.05)
    assert written(tmp_path, "step_frequency")["rows"][0]["duty"] > 0.5


def test_velocity_tracking(tmp_path: Path) -> None:
    common = settings(tmp_path, 0.5)
    numbers = velocity_tracking.main(velocity_tracking.Config(policy=("aslip",), **common))
    commands = [row["command"] for row in numbers["schedule"]]
    assert commands == pytest.approx(velocity_tracking.SCHEDULE)
    assert abs(numbers["map"][0]["mean"] - 0.5) < 0.2
    assert [numbers["map"][0][key] for key in ("survived", "on_feet", "tracked")] == [[True]] * 3
    assert len(numbers["steps"]) == len(velocity_tracking.STEPS)
    assert numbers["spike"]["model"] > 0
    written(tmp_path, "velocity_tracking")


def test_velocity_tracking_of_a_log_straight_ahead(tmp_path: Path) -> None:
    log = tmp_path / "walk.mcap"
    walk.main(walk.Config("aslip", command="0:0.5,0.3:0.6", duration=0.6, log=log))
    numbers = velocity_tracking.main(velocity_tracking.Config(out=tmp_path, log=log))
    assert [row["command"] for row in numbers["schedule"]] == pytest.approx([0.5, 0.6])
    log.unlink()
    walk.main(walk.Config("aslip", command="0.5 0 0.2", duration=0.3, log=log))
    for module in (velocity_tracking, foot_placement):
        with pytest.raises(ConfigurationError, match="commanded sideways or to turn"):
            module.main(module.Config(out=tmp_path, log=log))


def test_benchmarks_of_the_papers_gaits_refuse_other_policies(tmp_path: Path) -> None:
    for module in (ground_force, claims):
        with pytest.raises(ConfigurationError, match="'aslip' follows gaits in all directions"):
            module.main(module.Config(policy=("straight", "aslip"), out=tmp_path))


def test_mean_velocity_of_uniform_motion() -> None:
    time = CASSIE.policy_period * np.arange(1, 268)
    position = np.stack([1.5 * time, 2.0 - 0.1 * time], axis=1)
    np.testing.assert_allclose(velocity_tracking.mean_velocity(position), [1.5, -0.1], rtol=1e-12)


def test_ground_reaction(tmp_path: Path) -> None:
    rows = ground_force.main(ground_force.Config(**settings(tmp_path, 0.5)))
    ours, model = rows
    assert ours["method"] == "ASLIP"
    assert 0.35 < ours["duration"] < 0.65
    # the two feet carry the weight over a stride of 0.8 s
    assert ours["impulse"] == pytest.approx(33.312 * 9.81 * 0.8025 / 2, rel=0.08)
    assert model["dip_ratio"] < 0.1
    written(tmp_path, "ground_force")


def test_ground_reaction_names_methods_that_fell_at_the_first_speed(library: GaitLibrary) -> None:
    config = ground_force.Config(speeds=(0.0, 1.0))
    curve = ground_force.curve(np.tile(np.repeat([0.0, 300.0], 800), 4))
    curves = {("single reference", 1.0): [curve], ("ASLIP", 0.0): [curve], ("ASLIP", 1.0): [curve]}
    figure = ground_force.picture(config, curves, library)
    legend = figure.axes[0].get_legend()
    assert legend is not None
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["model", "ASLIP", "single reference"]


def test_only_the_default_stack_feeds_forces_forward(tmp_path: Path) -> None:
    config = open_loop_force.Config(speeds=(1.0,), out=tmp_path)
    found = {row["stack"]: row["correlation"] for row in open_loop_force.main(config)}
    assert found["default"] > 0.8
    assert abs(found["paper"]) < 0.4
    assert "| default | 1 |" in (tmp_path / "open_loop_force.md").read_text()


@pytest.mark.parametrize(
    ("force", "failed"), [(None, "fell"), (np.full((4000, 2), 160.0), "did not step")]
)
def test_report_names_fall_and_standing_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: np.ndarray | None, failed: str
) -> None:
    monkeypatch.setattr(ground_force, "vertical_forces", lambda *_: force)
    rows = ground_force.main(ground_force.Config(**settings(tmp_path, 0.5)))
    assert rows[0]["failed"] == failed
    written(tmp_path, "ground_force")
    assert f"| ASLIP | 0.5 | {failed} |" in (tmp_path / "ground_force.md").read_text()
    rows = [{**rows[0], "speed": speed} for speed in (0.0, 1.0)]
    assert np.isnan(claim_values.force_claims(rows)["policy"]["double hump"]).all()


def test_interval_over_seeds_or_values() -> None:
    several = Interval.of([np.array([1.0, 3.0]), np.array([4.0])])
    assert several.mean == 3.0
    assert several.high - several.mean == pytest.approx(12.706 * 1.0, rel=1e-3)
    alone = Interval.of([np.random.default_rng(0).normal(size=400)])
    assert alone.high - alone.low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert math.isnan(Interval.of([np.array([np.nan])]).mean)
    few = Interval.of([np.array([1.0, 2.0, 6.0])])
    assert few == Interval(3.0, 3.0, 3.0)


def test_interval_ignores_nonfinite_values() -> None:
    """NaN values are left out of their group; the others count."""
    some = [np.array([1.0, np.nan, 3.0]), np.array([np.nan]), np.array([4.0, np.inf])]
    assert Interval.of(some) == Interval.of([np.array([1.0, 3.0]), np.array([4.0])])


@pytest.mark.parametrize("groups", [[np.full(20, 0.1)], [np.array([0.1])] * 3])
def test_interval_of_equal_values_is_empty(groups: list[np.ndarray]) -> None:
    """Exactly, otherwise tables would show an interval."""
    assert Interval.of(groups) == Interval(0.1, 0.1, 0.1)


def test_results_are_valid_json_with_nan(tmp_path: Path) -> None:
    write_results(tmp_path, "mine", {"rows": [{"a": math.nan, "b": (1.0, -math.inf)}]}, "|")
    text = (tmp_path / "mine.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {"rows": [{"a": None, "b": [1.0, None]}]}


def test_foot_placement_table_counts_falls() -> None:
    sides = np.array([0, 1])
    good = [Placement(sides, np.full((2, 2), x), np.full(2, 0.3)) for x in (0.01, 0.03)]
    fell = Placement(sides[:1], np.full((1, 2), np.nan), np.full(1, np.nan))
    header, _, row = foot_placement.table({1.0: [*good, fell]}).splitlines()
    cells = dict(zip(header.split(" | "), row.split(" | "), strict=True))
    assert cells["survived"] == "2 of 3"
    assert cells["std [cm]"] == "0.0"
    (numbers,) = foot_placement.numbers({1.0: [*good, fell]})["rows"]
    assert (numbers["footsteps"], numbers["survived"], numbers["policies"]) == (4, 2, 3)
    assert numbers["left_x"] == pytest.approx(0.02)
    (none,) = foot_placement.numbers({1.0: [fell]})["rows"]
    assert none["footsteps"] == 0
    assert str(none["mean"]) == "nan"
    assert "0 of 1" in foot_placement.table({1.0: [fell]})
