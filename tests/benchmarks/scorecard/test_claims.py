"""Values of the paper's claims, and the report on them."""

import json
import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.walking import Walks
from aslip.walking.metrics import Placement
from benchmarks.paper import foot_placement, ground_force, step_frequency, velocity_tracking
from benchmarks.scorecard import claims, paper_values
from benchmarks.scorecard.claims import Config, main
from benchmarks.scorecard.paper_list import SENTENCES
from benchmarks.scorecard.paper_values import SPEEDS


def placement(forward: float, outward: float = 0.01, count: int = 6) -> Placement:
    """Placement with the same error at each footstep."""
    side = np.arange(count) % 2
    left = np.where(side == 0, outward, -outward)
    offset = np.stack([np.full(count, forward), left], axis=1)
    return Placement(side, offset, np.full(count, 0.2))


def test_values_of_feet() -> None:
    by_speed = {0.0: placement(0.03), 1.0: placement(0.05, 0.002), 1.5: placement(0.1)}
    by_speed[2.0] = placement(-0.25)
    found = paper_values.foot_values(by_speed)
    assert found["feet below 1 m/s"] == pytest.approx(100 * math.hypot(0.03, 0.01))
    assert found["feet to 1.0 m/s"] == pytest.approx(100 * math.hypot(0.05, 0.002))
    assert found["feet at 2.0 m/s"] == pytest.approx(100 * math.hypot(0.25, 0.01))
    assert found["wider feet"] == pytest.approx(0.2)
    assert found["feet lag"] == pytest.approx(-30.0)
    by_speed[0.0] = placement(0.07)
    assert paper_values.foot_values(by_speed)["feet to 1.0 m/s"] == pytest.approx(
        100 * math.hypot(0.07, 0.01)
    )
    by_speed[1.0] = placement(0.05, count=0)
    found = paper_values.foot_values(by_speed)
    assert np.isnan([found[name] for name in ("feet to 1.0 m/s", "feet lag", "wider feet")]).all()


def test_growing_error_without_lag_is_no_lag() -> None:
    """Feet that are ever farther outward, or ahead, do not lag."""
    by_speed = {v: placement(0.0, 0.01 + 0.02 * v) for v in (0.0, 1.0, 1.5, 2.0)}
    assert paper_values.foot_values(by_speed)["feet lag"] == pytest.approx(0.0)
    by_speed[2.0] = placement(0.2)
    assert paper_values.foot_values(by_speed)["feet lag"] > 0


def test_values_of_speed() -> None:
    kept: dict[str, Any] = {"survived": [True], "on_feet": [True]}
    mapped = [
        {"command": c, "mean": c + off, "tracked": [abs(off) < 0.2], **kept}
        for c, off in ((0.0, 0.02), (0.3, -0.04), (2.0, -0.3))
    ]
    steps = [{"settling": 1.2}, {"settling": 1.1}]
    numbers = {"map": mapped, "steps": steps, "spike": {"robot": 0.1, "model": 0.4}}
    assert paper_values.speed_values(numbers) == pytest.approx(
        {
            "all speeds": 2,
            "velocity tracking": 0.3,
            "smooth transitions": 2,
            "settling": 1.2,
            "touchdown spikes": 0.25,
        }
    )
    mapped[0]["on_feet"] = [False]  # on its heels, it keeps its speed
    mapped[2] |= {"mean": math.nan, "survived": [False]}
    steps[1]["settling"] = math.inf  # it survives, and never comes near the speed
    found = paper_values.speed_values(numbers)
    assert (found["all speeds"], found["smooth transitions"], found["settling"]) == (1, 1, math.inf)
    assert math.isnan(found["velocity tracking"])


def run_folder(path: Path, rows: Sequence[str]) -> str:
    path.mkdir()
    header = "step,elapsed_s,episode_length,episode_return,eval_return"
    (path / "progress.csv").write_text("\n".join([header, *rows]) + "\n")
    return str(path)


def test_training_costs_are_read_from_run_folders(tmp_path: Path) -> None:
    fast = ["1000000,1800,200,120,nan", "2000000,3600,360,305,340", "3000000,7200,390,303,nan"]
    slow = ["1000000,1800,200,120,150", "2000000,3600,300,220,nan"]
    names = ("samples", "return", "training time", "evaluation return")
    for rows, values in ((fast, (2.0, 303.0, 1.0, 340.0)), (slow, (math.inf, 220, math.inf, 150))):
        folder = run_folder(tmp_path / str(len(rows)), rows)
        assert paper_values.training_costs(folder) == dict(zip(names, values, strict=True))
    assert paper_values.training_costs("straight") == {}


def walks(**arrays: np.ndarray) -> Walks:
    """Walks at all speeds; what is not given is zero."""
    given: dict[str, Any] = {field.name: np.zeros((200, 5, 3)) for field in fields(Walks)}
    given |= {"command": np.tile(SPEEDS, (200, 1)), "alive": np.ones((200, 5), dtype=bool)}
    given |= {"foot_position": np.zeros((200, 5, 2, 3)), "body_to_foot": np.zeros((200, 5, 2, 3))}
    return Walks(**{**given, **arrays})


def test_velocity_correlation_excludes_stepping_in_place() -> None:
    """The model's forward speed is constant there, whatever the robot's does."""
    random = np.random.default_rng(0)
    robot, leg = random.normal(size=(200, 5, 3)), random.normal(size=(200, 5, 2, 3))
    model = robot * [1.0, 0.0, 0.0] + 0.5
    model[:, 0] = 0.01 * random.normal(size=(200, 3))  # of rounding
    given = {"pelvis_velocity": robot, "body_velocity": model}
    given |= {"foot_position": leg, "body_to_foot": leg}
    found = paper_values.correlations(walks(**given), settle=1.0)
    assert found == pytest.approx({"velocity oscillation": 1.0, "springy legs": 1.0})
    alive = np.arange(200)[:, None] < [200, 200, 200, 150, 200]
    found = paper_values.correlations(walks(**given, alive=alive), settle=1.0)
    assert np.isnan([*found.values()]).all()


def test_each_kind_of_policies_is_measured_for_its_claims(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each policy alone, in a folder of its own; the baseline has one claim only."""
    asked: list[tuple[str, Any]] = []

    def fake(module: Any, result: Any) -> None:
        def run(config: Any, *_: Any) -> Any:
            asked.append((module.__name__.rpartition(".")[2], config))
            return result

        monkeypatch.setattr(module, "main", run)

    fake(foot_placement, {v: [placement(0.01)] for v in SPEEDS})
    fake(step_frequency, [{"off": -0.01}, {"off": 0.02}])
    speed = {"command": 0.0, "mean": 0.0, "survived": [1], "on_feet": [1], "tracked": [1]}
    spike = {"robot": 0.1, "model": 0.4}
    fake(velocity_tracking, {"map": [speed], "steps": [{"settling": 1.0}], "spike": spike})
    ratios = [{"method": "ASLIP", "dip_ratio": 0.5}, {"method": "ASLIP"}, {"method": "model"}]
    fake(ground_force, ratios)
    monkeypatch.setattr(paper_values, "constant_walks", lambda *_: [walks()])
    monkeypatch.setattr(paper_values, "correlations", lambda *_: {})
    found = paper_values.measure(Config(out=tmp_path), "paper", "straight")
    assert found["step frequency"] == 2
    assert math.isnan(found["double hump"])  # it fell at the second speed
    assert [name for name, _ in asked] == [
        "ground_force", "step_frequency", "velocity_tracking", "foot_placement",
    ]  # fmt: skip
    assert {(one.policy, one.out) for _, one in asked} == {(("straight",), tmp_path / "straight")}
    asked.clear()
    found = paper_values.measure(Config(out=tmp_path), "baseline", "single_reference")
    assert [*found] == ["baseline's single hump"]
    assert [name for name, _ in asked] == ["ground_force"]


def values_of(kind: str, policy: str) -> dict[str, float]:
    """Values of two policies of each kind."""
    first = policy in ("straight", "single_reference")
    if kind == "baseline":
        return {"baseline's single hump": 0.95 if first else 1.0}
    if kind == "paper":
        pair = {"double hump": (0.8, 0.9), "feet lag": (-4.0, -4.2), "wider feet": (0.1, -0.1)}
    else:
        pair = {"double hump": (0.01, 0.02), "feet at 2.0 m/s": (3.0, 3.1), "settling": (1.4, 1.4)}
    return {name: two[0 if first else 1] for name, two in pair.items()}


def test_report_has_two_tables_with_verdicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[str, str]] = []

    def measure(config: Config, kind: str, policy: str, make_env: Any) -> dict[str, float]:
        calls.append((kind, policy))
        return values_of(kind, policy)

    monkeypatch.setattr(claims, "measure", measure)
    both = ("straight", "robust")
    settings = {"paper": both, "baseline": ("single_reference",), "out": tmp_path}
    config = Config(both, record=tmp_path / "record.json", **settings)
    main(config)
    printed = capsys.readouterr().out
    lines = {line.split("|")[1].strip(): line for line in printed.splitlines() if "|" in line}
    assert lines["double hump"].endswith(
        "| ≤ 0.7 (ours) | 0.85 (0.80 to 0.90) | FAIL | 0.01 (0.01 to 0.02) | PASS (an input) |"
    )
    assert lines["feet lag"].endswith("| -4.1 [-5.4, -2.8] | PASS |  | not measured |")
    assert "| undecided |" in lines["wider feet"]
    assert lines["baseline's single hump"].endswith("| baseline: 0.95 | met by one seed |  |  |")
    assert lines["samples"].endswith("|  | not measured |  | not measured |")
    assert lines["settling"].endswith("| 1.40 | PASS |")
    assert "paper's settings: 1 PASS, 1 FAIL, 1 undecided, 11 not measured" in printed
    assert "Targets, straight: 2 PASS, 3 not measured." in printed
    # seed, commit and budget of shipped policies are on their cards
    assert "- straight: `straight` (seed 10, commit " in printed
    rows = json.loads((tmp_path / "claims.json").read_text())
    assert len(rows["sentences"]) == len(SENTENCES)
    assert len(calls) == 5
    main(config)  # nothing is measured again
    assert len(calls) == 5
    assert capsys.readouterr().out == printed


def test_policies_for_other_gaits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="'directions' follows gaits in all directions"):
        main(Config(policy=("straight", "directions"), out=tmp_path))
