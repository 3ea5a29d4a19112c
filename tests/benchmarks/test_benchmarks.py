"""Benchmarks run on a policy or a log; claims pass or fail by their numbers."""

from __future__ import annotations

import json
import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.walking import Walks
from aslip.walking.metrics import Placement
from benchmarks import claims, foot_placement, ground_reaction, step_frequency, velocity_tracking
from benchmarks.common import Common, Interval, write_results
from recipes import walk


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short walks, for fast tests."""
    for module in (foot_placement, ground_reaction, step_frequency, velocity_tracking, claims):
        monkeypatch.setattr(module, "_SETTLE", 1.0)
        monkeypatch.setattr(module, "_WALK", 3.0)
    monkeypatch.setattr(foot_placement, "_FOOTSTEPS", 4)
    for name in ("_HOLD", "_BEFORE", "_AFTER"):
        monkeypatch.setattr(velocity_tracking, name, 2.0)


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
    assert all(0 < row["mean"] < 0.15 for row in rows)


def test_foot_placement_of_a_log(tmp_path: Path) -> None:
    log = tmp_path / "walk.mcap"
    walk.main(walk.Config(command="0.5", duration=4.0, log=log))
    found = foot_placement.main(foot_placement.Config(out=tmp_path, log=log))
    assert list(found) == [0.5]
    varied = tmp_path / "varied.mcap"
    walk.main(walk.Config(command="0:0.5,0.2:0.6", duration=0.5, log=varied))
    with pytest.raises(ConfigurationError, match="2 commanded speeds"):
        foot_placement.main(foot_placement.Config(out=tmp_path, log=varied))


def test_step_frequency(tmp_path: Path) -> None:
    rows = step_frequency.main(step_frequency.Config(**settings(tmp_path, 0.5)))
    assert rows[0]["mean"] == pytest.approx(rows[0]["model"], rel=0.05)
    assert written(tmp_path, "step_frequency")["rows"][0]["duty"] > 0.5


def test_velocity_tracking(tmp_path: Path) -> None:
    numbers = velocity_tracking.main(velocity_tracking.Config(**settings(tmp_path, 0.5)))
    commands = [row["command"] for row in numbers["schedule"]]
    assert commands == pytest.approx(velocity_tracking.SCHEDULE)
    assert abs(numbers["map"][0]["mean"] - 0.5) < 0.2
    assert [numbers["map"][0][key] for key in ("survived", "on_feet", "tracked")] == [[True]] * 3
    assert len(numbers["steps"]) == len(velocity_tracking.STEPS)
    assert numbers["spike"]["model"] > 0
    written(tmp_path, "velocity_tracking")


def test_mean_velocity_of_uniform_motion() -> None:
    time = CASSIE.policy_period * np.arange(1, 268)
    position = np.stack([1.5 * time, 2.0 - 0.1 * time], axis=1)
    np.testing.assert_allclose(velocity_tracking.mean_velocity(position), [1.5, -0.1], rtol=1e-12)


def test_ground_reaction(tmp_path: Path) -> None:
    rows = ground_reaction.main(ground_reaction.Config(**settings(tmp_path, 0.5)))
    ours, model = rows
    assert ours["method"] == "ASLIP"
    assert 0.35 < ours["duration"] < 0.65
    # the two feet carry the weight over a stride of 0.8 s
    assert ours["impulse"] == pytest.approx(33.312 * 9.81 * 0.8025 / 2, rel=0.08)
    assert model["dip_ratio"] < 0.1
    written(tmp_path, "ground_reaction")


@pytest.mark.parametrize(
    ("force", "failed"), [(None, "fell"), (np.full((4000, 2), 160.0), "did not step")]
)
def test_report_names_fall_and_standing_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: np.ndarray | None, failed: str
) -> None:
    monkeypatch.setattr(ground_reaction, "vertical_forces", lambda *_: force)
    rows = ground_reaction.main(ground_reaction.Config(**settings(tmp_path, 0.5)))
    assert rows[0]["failed"] == failed
    written(tmp_path, "ground_reaction")
    assert f"| ASLIP | 0.5 | {failed} |" in (tmp_path / "ground_reaction.md").read_text()
    rows = [{**rows[0], "speed": speed} for speed in (0.0, 1.0)]
    assert np.isnan(claims.force_claims(rows)["double hump"]).all()


def test_refuses_empty_list_of_policies() -> None:
    with pytest.raises(ConfigurationError, match="policy"):
        Common(policy=())


# ----------------------------------------------------------------------- claims


def placements(error: float, outward: float = 0.01, count: int = 6) -> list[Placement]:
    """Placements of two seeds, with forward errors and feet slightly outward."""
    side = np.arange(count) % 2
    left = np.where(side == 0, outward, -outward)
    offset = np.stack([np.full(count, error), left], axis=1)
    return [Placement(side, offset, np.full(count, 0.2)) for _ in range(2)]


def test_claims_on_feet() -> None:
    by_speed = {0.0: placements(0.03), 1.0: placements(0.05, 0.002), 1.5: placements(0.1)}
    by_speed[2.0] = placements(0.25)
    # the second seed is worse at 0 m/s
    by_speed[0.0][1] = placements(0.07)[0]
    found = claims.foot_claims(by_speed)
    worst = [100 * math.hypot(0.05, 0.002), 100 * math.hypot(0.07, 0.01)]
    assert found["feet to 1.0 m/s"] == pytest.approx(worst)
    assert found["feet at 2.0 m/s"] == pytest.approx([100 * math.hypot(0.25, 0.01)] * 2)
    assert found["wider feet"] == pytest.approx([0.2, 0.2])
    assert found["feet above 1 m/s"] == pytest.approx([20, 20], abs=0.1)
    by_speed[1.0][1] = placements(0.05, count=0)[0]
    assert np.isnan(claims.foot_claims(by_speed)["feet to 1.0 m/s"]).tolist() == [False, True]


def test_claims_on_speed() -> None:
    offs = ((0.0, 0.02, 0.01), (0.3, -0.04, 0.045), (2.0, -0.3, 0.1))
    mapped = [
        {
            "command": c,
            "each": [c + first, c + second],
            "survived": [True, True],
            "on_feet": [True, True],
            "tracked": [abs(first) < 0.2, abs(second) < 0.2],
        }
        for c, first, second in offs
    ]
    steps = [
        {"each": {"steady_error": [0.0, 0.1], "settling": [1.2, 1.0]}},
        {"each": {"steady_error": [0.0, math.nan], "settling": [1.1, math.inf]}},
    ]
    spike = {"each": [{"robot": 0.1, "model": 0.4}, {"robot": 0.2, "model": 0.4}]}
    numbers = {"map": mapped, "steps": steps, "spike": spike}
    expected = {
        "all speeds": [2, 3],
        "velocity tracking": [0.3, 0.1],
        "slow walking": [0.04, 0.045],
        "smooth transitions": [2, 1],
        "settling": [1.2, math.inf],
        "touchdown spikes": [0.25, 0.5],
    }
    found = claims.speed_claims(numbers)
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name] == pytest.approx(values), name
    mapped[0]["on_feet"] = [False, True]  # a robot on its heels that keeps its speed
    mapped[2] |= {"each": [2.0, math.nan], "survived": [True, False], "tracked": [True, False]}
    found = claims.speed_claims(numbers)
    assert found["all speeds"] == [2, 2]
    assert np.isnan(found["velocity tracking"]).tolist() == [False, True]
    assert found["slow walking"] == pytest.approx([0.04, 0.045])


def test_claims_on_forces() -> None:
    rows = [
        {"method": "ASLIP", "speed": speed, "dip_ratio": ratio}
        for speed, ratio in ((0.0, 0.3), (0.0, 0.7), (1.0, 0.6), (1.0, 0.5), (2.0, 1.0))
    ]
    assert claims.force_claims(rows) == {"double hump": [0.6, 0.7]}
    rows += [
        {"method": "single reference", "speed": speed, "dip_ratio": ratio}
        for speed, ratio in ((0.0, 1.0), (1.0, 0.95), (2.0, 0.97))
    ]
    assert claims.force_claims(rows)["baseline's single hump"] == [0.95]
    # a robot that fell has no dip ratio, and no single hump
    del rows[-2]["dip_ratio"]
    assert np.isnan(claims.force_claims(rows)["baseline's single hump"]).all()


def test_missing_value_of_a_seed_gives_nan() -> None:
    assert claims.interval_over_seeds([1.0, 3.0]).mean == 2.0
    for missing in (math.nan, math.inf):
        assert math.isnan(claims.interval_over_seeds([1.0, missing]).mean)


def test_training_costs_are_read_from_run_folders(tmp_path: Path) -> None:
    header = "step,elapsed_s,episode_length,eval_return"
    rows = ["1000000,1800,200,nan", "2000000,3600,360,310", "3000000,7200,390,nan"]
    (tmp_path / "progress.csv").write_text("\n".join([header, *rows]) + "\n")
    found = claims.training_costs([str(tmp_path)])
    assert found == {"samples": [2.0], "training time": [2.0], "return": [310.0]}
    assert claims.training_costs(["aslip"]) == {}


def test_claims_report_pass_fail_and_lost_claims(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    values = {"step frequency": 0.5, "settling": 2.0, "double hump": 0.4}
    monkeypatch.setattr(
        claims, "claim_values", lambda *_: {name: [v] for name, v in values.items()}
    )
    monkeypatch.setattr(claims, "RECORD", tmp_path / "record.json")
    config = claims.Config(policy=("runs/seed0", "aslip"), out=tmp_path, record=True)
    assert claims.main(config) == 0
    kept = json.loads((tmp_path / "record.json").read_text())
    assert kept["policies"] == ["seed0", "aslip"]
    assert kept["claims"] == {"settling": False, "double hump": True, "step frequency": True}
    printed = capsys.readouterr().out
    assert printed.count("PASS") == 2
    assert printed.count("FAIL") == 1
    values["double hump"] = math.nan
    assert claims.main(claims.Config(out=tmp_path)) == 1
    printed = capsys.readouterr().out
    assert "| none | ≤ 0.7 | FAIL |" in printed
    assert "no longer holds: double hump" in printed
    numbers = json.loads((tmp_path / "claims.json").read_text())["claims"]
    assert [row["name"] for row in numbers if row["holds"]] == ["step frequency"]


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


@pytest.mark.parametrize("fallen", [False, True])
def test_correlation_of_fallen_seed_is_nan(fallen: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claims, "_speed_correlation", lambda walk: 1.0)
    monkeypatch.setattr(claims, "_leg_correlation", lambda walk: 1.0)
    alive = np.ones((200, 5), dtype=bool)
    alive[150:, 3] = not fallen
    sizes = {field.name: np.zeros((200, 5)) for field in fields(Walks)}
    found = claims.correlation_claims(
        [Walks(**{**sizes, "command": alive.astype(float), "alive": alive})]
    )
    assert list(found) == ["velocity oscillation", "springy legs"]
    assert all(np.isnan(values).tolist() == [fallen] for values in found.values())


def test_velocity_correlation_excludes_stepping_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """At zero speed, the model's forward velocity is constant, so no correlation exists."""
    monkeypatch.setattr(claims, "_leg_correlation", lambda walk: 1.0)
    arrays: dict[str, Any] = {field.name: np.zeros((200, 5)) for field in fields(Walks)}
    arrays["command"] = np.tile(claims._SPEEDS, (200, 1))
    arrays["alive"] = np.ones((200, 5), dtype=bool)
    robot = np.random.default_rng(0).normal(size=(200, 5, 3))
    model = robot * [1.0, 0.0, 0.0] + 0.5
    model[:, 0] = 0.01 * np.random.default_rng(1).normal(size=(200, 3))  # rounding errors
    arrays |= {"pelvis_velocity": robot, "body_velocity": model}
    assert claims.correlation_claims([Walks(**arrays)])["velocity oscillation"] == pytest.approx(
        [1.0]
    )


def test_ground_reaction_draws_each_policy(library: GaitLibrary) -> None:
    ones = [ground_reaction.Curve(np.full(200, x), np.full(200, 5.0)) for x in (1.0, 2.0, 3.0)]
    config = ground_reaction.Config(speeds=(1.0,))
    curves = {("ASLIP", 1.0): ones, ("single reference", 1.0): ones[:1]}
    (axis,) = ground_reaction.picture(config, curves, library).axes
    assert len(axis.lines) == 1 + 3 + 1
    assert len(axis.collections) == 1  # a single policy is drawn with a band
    assert axis.get_legend_handles_labels()[1] == ["model", "ASLIP", "single reference"]
