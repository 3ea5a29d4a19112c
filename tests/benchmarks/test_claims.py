"""Sentences of the paper and targets are judged by numbers of several seeds."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.policy import find_policy
from aslip.walking import Walks
from aslip.walking.metrics import Placement
from benchmarks.paper import foot_placement, ground_force, step_frequency, velocity_tracking
from benchmarks.scorecard import claim_values, claims
from benchmarks.scorecard.claim_list import SENTENCES, TARGETS, Claim
from benchmarks.scorecard.claim_values import SPEEDS

ALL = {claim.name: claim for claim in (*SENTENCES, *TARGETS)}


# -------------------------------------------------------------------------- list


def test_no_claim_is_listed_twice_and_each_has_one_limit() -> None:
    every = [*SENTENCES, *TARGETS]
    assert len({claim.name for claim in every}) == len(every)
    assert len({(claim.measure, claim.limit) for claim in every}) == len(every)
    assert all(math.isinf(claim.at_least) != math.isinf(claim.at_most) for claim in every)
    assert all(claim.sentence[:3] in ("V: ", "V-A", "V-B", "Fig") for claim in SENTENCES)
    assert not any(claim.sentence for claim in TARGETS)


def test_sentences_on_feet_need_more_than_zero() -> None:
    """Wider feet and lagging feet, as the sentences say."""
    assert not ALL["wider feet"].is_met(0.0)
    assert ALL["wider feet"].is_met(0.1)
    assert not ALL["feet lag"].is_met(0.0)
    assert ALL["feet lag"].is_met(-0.1)
    assert ALL["feet to 1.0 m/s"].is_met(3.0)


# ------------------------------------------------------------------------ values


def placements(forward: float, outward: float = 0.01, count: int = 6) -> list[Placement]:
    """Placements of two seeds, with the same error at each footstep."""
    side = np.arange(count) % 2
    left = np.where(side == 0, outward, -outward)
    offset = np.stack([np.full(count, forward), left], axis=1)
    return [Placement(side, offset, np.full(count, 0.2)) for _ in range(2)]


def test_claims_on_feet() -> None:
    by_speed = {0.0: placements(0.03), 1.0: placements(0.05, 0.002), 1.5: placements(0.1)}
    by_speed[2.0] = placements(-0.25)
    # the second seed is worse at 0 m/s
    by_speed[0.0][1] = placements(0.07)[0]
    found = claim_values.foot_claims(by_speed)
    below = [100 * math.hypot(0.03, 0.01), 100 * math.hypot(0.07, 0.01)]
    assert found["feet below 1 m/s"] == pytest.approx(below)
    assert found["feet to 1.0 m/s"] == pytest.approx([100 * math.hypot(0.05, 0.002), below[1]])
    assert found["feet at 2.0 m/s"] == pytest.approx([100 * math.hypot(0.25, 0.01)] * 2)
    assert found["wider feet"] == pytest.approx([0.2, 0.2])
    assert found["feet lag"] == pytest.approx([-30.0, -30.0])
    by_speed[1.0][1] = placements(0.05, count=0)[0]
    found = claim_values.foot_claims(by_speed)
    for name in ("feet to 1.0 m/s", "feet lag", "wider feet"):
        assert np.isnan(found[name]).tolist() == [False, True], name


def test_growing_error_without_lag_is_no_lag() -> None:
    """Feet that are ever farther outward, or ahead, do not lag."""
    by_speed = {v: placements(0.0, 0.01 + 0.02 * v) for v in (0.0, 1.0, 1.5, 2.0)}
    assert claim_values.foot_claims(by_speed)["feet lag"] == pytest.approx([0.0, 0.0])
    by_speed[2.0] = placements(0.2)
    assert min(claim_values.foot_claims(by_speed)["feet lag"]) > 0


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
        # the second seed survives, and never comes near the speed
        {"each": {"steady_error": [0.0, 0.4], "settling": [1.1, math.inf]}},
    ]
    spike = {"each": [{"robot": 0.1, "model": 0.4}, {"robot": 0.2, "model": 0.4}]}
    numbers = {"map": mapped, "steps": steps, "spike": spike}
    expected = {
        "all speeds": [2, 3],
        "velocity tracking": [0.3, 0.1],
        "smooth transitions": [2, 1],
        "settling": [1.2, math.inf],
        "touchdown spikes": [0.25, 0.5],
    }
    found = claim_values.speed_claims(numbers)
    assert list(found) == list(expected)
    for name, values in expected.items():
        assert found[name] == pytest.approx(values), name
    mapped[0]["on_feet"] = [False, True]  # on its heels, it keeps its speed
    mapped[2] |= {"each": [2.0, math.nan], "survived": [True, False], "tracked": [True, False]}
    found = claim_values.speed_claims(numbers)
    assert found["all speeds"] == [2, 2]
    assert np.isnan(found["velocity tracking"]).tolist() == [False, True]


def test_spikes_of_fallen_seed_have_no_ratio() -> None:
    """A robot on the floor has no spikes, which must not pass for a smooth walk."""
    arrays: dict[str, Any] = {field.name: np.zeros((20, 1, 3)) for field in fields(Walks)}
    arrays |= {"command": np.ones((20, 1)), "alive": np.arange(20)[:, None] < 12}
    fell = Walks(**arrays)
    spikes = velocity_tracking.spike_numbers([fell])
    numbers = {"map": [], "steps": [], "spike": spikes}
    assert np.isnan(spikes["robot"])
    assert np.isnan(claim_values.spike_ratios(numbers)).all()


def test_claims_on_forces() -> None:
    """Largest ratio of 0 and 1.0 m/s for humps, smallest of all speeds for a single hump."""

    def rows(method: str, *ratios: tuple[float, float]) -> list[dict[str, Any]]:
        return [{"method": method, "speed": v, "dip_ratio": ratio} for v, ratio in ratios]

    ours = rows("ASLIP", (0.0, 0.3), (0.0, 0.7), (1.0, 0.6), (1.0, 0.5), (2.0, 1.0))
    assert claim_values.force_claims(ours) == {"policy": {"double hump": [0.6, 0.7]}}
    paper = rows("ASLIP, paper's settings", (0.0, 0.8), (1.0, 0.9))
    theirs = rows("single reference", (0.0, 1.0), (1.0, 0.95), (2.0, 0.97))
    assert claim_values.force_claims([*ours, *paper, *theirs]) == {
        "policy": {"double hump": [0.6, 0.7]},
        "paper": {"double hump": [0.9]},
        "baseline": {"baseline's single hump": [0.95]},
    }
    # one that fell has no dip ratio, and no single hump
    del theirs[1]["dip_ratio"]
    assert np.isnan(claim_values.force_claims(theirs)["baseline"]["baseline's single hump"]).all()


def run_folder(path: Path, rows: Sequence[str]) -> str:
    path.mkdir()
    header = "step,elapsed_s,episode_length,episode_return,eval_return"
    (path / "progress.csv").write_text("\n".join([header, *rows]) + "\n")
    return str(path)


def test_training_costs_are_read_from_run_folders(tmp_path: Path) -> None:
    fast = ["1000000,1800,200,120,nan", "2000000,3600,360,305,340", "3000000,7200,390,303,nan"]
    slow = ["1000000,1800,200,120,150", "2000000,3600,300,220,nan"]
    folders = [run_folder(tmp_path / "fast", fast), run_folder(tmp_path / "slow", slow)]
    assert claim_values.training_costs(folders) == {
        "samples": [2.0, math.inf],
        "return": [303.0, 220.0],
        "training time": [1.0, math.inf],
        "evaluation return": [340.0, 150.0],
    }
    # a policy without a folder would leave out a seed
    assert claim_values.training_costs([*folders, "straight"]) == {}
    assert claim_values.training_costs(["straight"]) == {}


@pytest.mark.parametrize("fallen", [False, True])
def test_correlation_of_fallen_seed_is_nan(fallen: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim_values, "_speed_correlation", lambda walk: 1.0)
    monkeypatch.setattr(claim_values, "_leg_correlation", lambda walk: 1.0)
    alive = np.ones((200, 5), dtype=bool)
    alive[150:, 3] = not fallen
    sizes = {field.name: np.zeros((200, 5)) for field in fields(Walks)}
    walks = Walks(**{**sizes, "command": alive.astype(float), "alive": alive})
    found = claim_values.correlation_claims([walks], settle=1.0)
    assert list(found) == ["velocity oscillation", "springy legs"]
    assert all(np.isnan(values).tolist() == [fallen] for values in found.values())


def test_velocity_correlation_excludes_stepping_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model's forward speed is constant there, whatever the robot's does."""
    monkeypatch.setattr(claim_values, "_leg_correlation", lambda walk: 1.0)
    arrays: dict[str, Any] = {field.name: np.zeros((200, 5)) for field in fields(Walks)}
    arrays["command"] = np.tile(SPEEDS, (200, 1))
    arrays["alive"] = np.ones((200, 5), dtype=bool)
    robot = np.random.default_rng(0).normal(size=(200, 5, 3))
    model = robot * [1.0, 0.0, 0.0] + 0.5
    model[:, 0] = 0.01 * np.random.default_rng(1).normal(size=(200, 3))  # of rounding
    arrays |= {"pelvis_velocity": robot, "body_velocity": model}
    found = claim_values.correlation_claims([Walks(**arrays)], settle=1.0)
    assert found["velocity oscillation"] == pytest.approx([1.0])


def test_each_kind_of_policies_is_measured_with_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Policies of one kind reach the benchmarks together; forces of all kinds are of one run."""
    asked: dict[str, list[Any]] = {}

    def fake(module: Any, result: Any) -> None:
        def main(config: Any, *_: Any) -> Any:
            asked.setdefault(module.__name__, []).append(config)
            return result

        monkeypatch.setattr(module, "main", main)

    fake(foot_placement, {v: placements(0.01) for v in SPEEDS})
    fake(step_frequency, [{"each": [-0.01, 0.02]}])
    fake(velocity_tracking, {})
    fake(ground_force, [{"method": "ASLIP", "speed": v, "dip_ratio": 0.5} for v in (0.0, 1.0)])
    monkeypatch.setattr(claims, "constant_walks", lambda *_: [])
    monkeypatch.setattr(claims, "load_subjects", lambda *_: [])
    monkeypatch.setattr(claims, "speed_claims", lambda _: {})
    config = claims.Config(policy=("a", "b"), paper=("c",), baseline=("d",), out=tmp_path)
    values = claims.measure(config)
    assert {kind: [*found] for kind, found in values.items()}["policy"][-1] == "double hump"
    assert values["paper"]["step frequency"] == [1, 2]
    for module in (foot_placement, step_frequency, velocity_tracking):
        assert [one.policy for one in asked[module.__name__]] == [("a", "b"), ("c",)]
        assert len({one.out for one in asked[module.__name__]}) == 2
    (forces,) = asked[ground_force.__name__]
    assert (forces.policy, forces.paper, forces.baseline) == (("a", "b"), ("c",), ("d",))
    asked.clear()
    claims.measure(claims.Config(policy=(), paper=("c",), out=tmp_path))
    assert [one.policy for one in asked[foot_placement.__name__]] == [("c",)]


# ---------------------------------------------------------------------- verdicts


@pytest.mark.parametrize(
    ("each", "expected"),
    [
        ([], "not measured"),
        ([0.4], "met by one seed"),
        ([0.7], "missed by one seed"),
        ([math.nan], "FAIL"),
        ([0.40, 0.41, 0.39], "PASS"),
        ([0.40, 0.41, 0.58], "undecided"),  # each seed below the limit, the interval not
        ([0.7, 0.71, 0.69], "FAIL"),
        ([0.40, 0.41, math.inf], "FAIL"),
        ([0.5, 0.5], "PASS"),
    ],
)
def test_verdict_by_interval_over_seeds(each: list[float], expected: str) -> None:
    assert claims.judge(Claim("any", "x", at_most=0.5 + 0.1), each)["verdict"] == expected
    mirrored = Claim("any", "x", at_least=-0.6)
    assert claims.judge(mirrored, [-value for value in each])["verdict"] == expected


def test_verdict_by_each_seed() -> None:
    """One seed that misses fails the row, one far within the limit does not blur it."""
    claim = Claim("humps", "x", at_most=0.7, every_seed=True)
    for each, expected in (([0.1, 0.69, 0.68], "PASS"), ([0.3, 0.3, 0.3, 0.3, 0.8], "FAIL")):
        assert claims.judge(claim, each)["verdict"] == expected
    assert claims.judge(claim, [0.1])["verdict"] == "met by one seed"


def test_strict_limit_is_not_met_by_equal_seeds() -> None:
    assert claims.judge(ALL["wider feet"], [0.0, 0.0])["verdict"] == "FAIL"


def test_policies_are_described_by_their_own_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not by `policy.zip`, which the file of every run is called."""
    run = tmp_path / "run"
    run.mkdir()
    for name in ("run/policy.zip", "mine.zip"):
        (tmp_path / name).write_bytes(find_policy("straight").read_bytes())
    monkeypatch.chdir(run)
    given = ("straight", run, run / "policy.zip", "policy.zip", tmp_path / "mine.zip")
    found = [claims.describe(one) for one in given]
    assert [about["name"] for about in found] == ["straight", "run", "run", "run", "mine"]
    assert {about["seed"] for about in found} == {10}


# ------------------------------------------------------------------------ report

VALUES: dict[str, dict[str, list[float]]] = {
    "paper": {"double hump": [0.8, 0.9], "feet lag": [-4.0, -4.2], "wider feet": [0.1, -0.1]},
    "policy": {"double hump": [0.01, 0.02], "feet at 2.0 m/s": [3.0, 3.1], "settling": [1.4]},
    "baseline": {"baseline's single hump": [0.95, 1.0]},
}


@pytest.fixture
def values(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, list[float]]]:
    """Values that are measured, to be changed; the record is in the test's folder."""
    found = {kind: dict(of_kind) for kind, of_kind in VALUES.items()}
    monkeypatch.setattr(claims, "measure", lambda *_: found)
    monkeypatch.setattr(claims, "RECORD", tmp_path / "record.json")
    return found


@pytest.mark.usefixtures("values")
def test_report_has_two_tables_with_verdicts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert claims.main(claims.Config(baseline=("single_reference",), out=tmp_path)) == 0
    printed = capsys.readouterr().out
    lines = {line.split("|")[1].strip(): line for line in printed.splitlines() if "|" in line}
    assert lines["double hump"].endswith(
        "| ≤ 0.7 (ours) | 0.85 (0.80 to 0.90) | FAIL | 0.01 (0.01 to 0.02) | PASS (an input) |"
    )
    assert lines["feet lag"].endswith("| -4.1 [-5.4, -2.8] | PASS |  | not measured |")
    assert "| undecided |" in lines["wider feet"]
    assert lines["baseline's single hump"].endswith(
        "| baseline: 0.97 (0.95 to 1.00) | PASS |  |  |"
    )
    assert lines["samples"].endswith("|  | not measured |  | not measured |")
    assert lines["settling"].endswith("| 1.40 | met by one seed |")
    assert "paper's settings: 1 PASS, 1 FAIL, 1 undecided, 11 not measured" in printed
    assert "Targets, default: 1 PASS, 1 met by one seed, 3 not measured." in printed
    # seed, commit and budget of shipped policies are on their cards
    assert "- default: `straight` (seed 10, commit " in printed
    assert "- paper's settings: none" in printed
    rows = json.loads((tmp_path / "claims.json").read_text())
    assert len(rows["sentences"]) == len(SENTENCES)


def test_missing_values_of_seeds_are_counted(
    tmp_path: Path, values: dict[str, dict[str, list[float]]], capsys: pytest.CaptureFixture[str]
) -> None:
    values["paper"]["double hump"] = [0.3, math.nan]
    claims.main(claims.Config(out=tmp_path))
    assert "| no value for 1 of 2 seeds | FAIL |" in capsys.readouterr().out


def test_record_names_policies_and_verdicts_and_finds_lost_rows(
    tmp_path: Path, values: dict[str, dict[str, list[float]]], capsys: pytest.CaptureFixture[str]
) -> None:
    config = claims.Config(baseline=("single_reference",), out=tmp_path, record=True)
    assert claims.main(config) == 0
    kept = json.loads((tmp_path / "record.json").read_text())
    (policy,) = kept["policies"]["policy"]
    assert (policy["name"], policy["seed"]) == ("straight", 10)
    assert len(policy["commit"]) >= 7
    assert kept["policies"]["paper"] == []
    assert kept["sentences"]["double hump"] == {"paper": "FAIL", "policy": "PASS"}
    assert kept["sentences"]["baseline's single hump"] == {"baseline": "PASS"}
    assert kept["targets"]["feet at 2.0 m/s"] == {"policy": "PASS"}
    again = claims.Config(out=tmp_path)
    assert claims.main(again) == 0
    values["policy"]["double hump"] = [0.5, 0.9]
    values["paper"]["feet lag"] = [-1.0, 0.5]
    values["policy"]["feet at 2.0 m/s"] = []  # not measured is not lost
    values["baseline"]["baseline's single hump"] = [0.5]  # nor is a single seed
    assert claims.main(again) == 2
    printed = capsys.readouterr().out
    assert "no longer passes: double hump (default)" in printed
    assert "no longer passes: feet lag (paper's settings)" in printed
    values["policy"]["double hump"] = [math.nan]  # a fall is, even of one seed
    assert claims.main(again) == 2


def test_shipped_record_is_of_the_listed_claims() -> None:
    record = claims.read_record()
    assert {name for table in record.values() for name in table} == ALL.keys()
