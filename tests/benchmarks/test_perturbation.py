"""Pushes, changed dynamics and initial states of the perturbation benchmark are as stated."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from tqdm import tqdm

from aslip.base.interval import Interval
from benchmarks.common import Subject, walk_on
from benchmarks.flags import SWEEPS
from benchmarks.robustness import pushes, sweeps
from benchmarks.robustness.pushes import (
    Config,
    main,
    measure_pushes,
    push_rows,
    push_table,
    settle,
)
from benchmarks.robustness.sweeps import (
    SweepResult,
    measure_sweeps,
    sweep_rows,
    sweep_table,
    trials,
)

NO_SWEEPS: dict[str, Any] = {s.flag: () for s in SWEEPS.values()}
BAR = tqdm(disable=True)
SHIPPED = Subject.load("straight")


def _config(**settings: Any) -> Config:
    small = {"directions": 2, "phases": 1, "repeats": 1, "bisections": 1, "settle": 0.3}
    small |= {"after": 0.9, "walks": 1, "episode": 1.2, **NO_SWEEPS}
    return Config(**(small | settings))


def test_perturbation_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A robot falls without motor strength or under a push of 240 N s, and otherwise walks."""
    config = _config(
        out=tmp_path, directions=4, bisections=2, largest=480.0, motor_strength=(0.0, 1.0)
    )
    main(config)
    report = json.loads((tmp_path / "pushes.json").read_text())
    assert [row["direction_deg"] for row in report["pushes"]] == [0, 90, 180, 270]
    assert [row["mean"] for row in report["pushes"]] == [0] * 4
    assert report["resolution"] == 120
    assert [(row["value"], row["mean"]) for row in report["sweeps"]] == [(0.0, 0.0), (1.0, 1.0)]
    printed = capsys.readouterr().out
    assert (tmp_path / "pushes.md").read_text() == printed
    (speed,) = report["sweeps"][0]["falls"][0]
    assert f"| motor strength | 0 | 0 [0, 79] | {speed:.2f} |" in printed
    assert "| motor strength | 1 | 100 [21, 100] |  |" in printed
    assert (tmp_path / "pushes.png").read_bytes().startswith(b"\x89PNG")


def test_bisection_converges_from_below() -> None:
    """If every push is survived, on the end of the range."""
    config = _config(bisections=3, largest=1.6, after=0.3)
    survived = measure_pushes(config, SHIPPED, BAR)
    np.testing.assert_allclose(survived, 1.4)
    told = pushes.censored_text(config, survived)
    assert told.startswith(f"{survived.size} of {survived.size} robots survived all pushes, up to")
    assert "`--largest 3.2`" in told
    assert not pushes.censored_text(config, survived - 0.2)


def _measured(
    monkeypatch: pytest.MonkeyPatch, config: Config, yaw: float, standing: list[bool]
) -> tuple[np.ndarray, list[Any]]:
    """Largest pushes of robots that survive all, and the sequence of calls."""
    done: list[Any] = []
    base = SimpleNamespace(states=lambda: "settled", set_states=done.append)
    env = SimpleNamespace(base_env=base, close=lambda: None)
    turn = [[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]] * len(standing)
    td = {("truth", "pelvis_orientation"): torch.tensor(turn)}

    def survives(*arguments: Any) -> np.ndarray:
        done.append(arguments[-2])
        return np.ones(len(standing), dtype=bool)

    monkeypatch.setattr(Subject, "walking_env", lambda *_: env)
    monkeypatch.setattr(pushes, "settle", lambda *_: (td, np.array(standing)))
    monkeypatch.setattr(pushes, "push_robots", survives)
    return measure_pushes(config, SHIPPED, BAR), done


@pytest.mark.parametrize("yaw", [0.0, 0.4, -2.0])
def test_push_directions_are_relative_to_heading(
    monkeypatch: pytest.MonkeyPatch, yaw: float
) -> None:
    """Forward, left, back and right relative to its yaw, from the same state."""
    config = _config(directions=4, bisections=2, largest=8.0)
    _, done = _measured(monkeypatch, config, yaw, [True] * 4)
    assert done[::2] == ["settled", "settled"]
    for impulses, size in zip(done[1::2], (4.0, 6.0), strict=True):
        ahead = [size * math.cos(yaw), size * math.sin(yaw), 0.0]
        left = [-ahead[1], ahead[0], 0.0]
        expected = [ahead, left, np.negative(ahead), np.negative(left)]
        np.testing.assert_allclose(impulses, expected, atol=1e-5)


def test_a_fall_without_push_gives_zero_impulse(monkeypatch: pytest.MonkeyPatch) -> None:
    config = _config(directions=2, bisections=3, largest=8.0)
    survived, _ = _measured(monkeypatch, config, 0.0, [True, False])
    assert survived.ravel().tolist() == [7.0, 0.0]


def test_pushes_begin_at_their_phase() -> None:
    config = _config(settle=0.51, speed=1.5)
    env = SHIPPED.walking_env(config, 4)
    phase = np.arange(4) / 4
    td, _ = settle(config, env, SHIPPED.policy, phase, BAR)
    difference = np.asarray(td["phase"][:, 0]) - phase
    np.testing.assert_allclose((difference + 0.5) % 1 - 0.5, 0, atol=1e-5)


def test_walks_from_restored_states_repeat() -> None:
    """Bit for bit without noise, with or without pushes in between; pushes have their direction."""
    config = _config(truth=True)
    actor, env = SHIPPED.policy, SHIPPED.walking_env(config, 2)
    td, _ = settle(config, env, actor, np.array([0.0, 0.5]), BAR)
    states = env.base_env.states()
    forces = [None, np.array([[0.0, 100.0, 0.0], [-100.0, 0.0, 0.0]]), None]
    ends = []
    for force in forces:
        env.base_env.set_states(states)
        after, _ = walk_on(env, actor, td, 4, BAR, force)
        ends.append(walk_on(env, actor, after, 4, BAR)[0])
    first, pushed, second = (end["truth", "qvel"].numpy() for end in ends)
    np.testing.assert_array_equal(first, second)
    assert pushed[0, 1] > first[0, 1] + 0.05
    assert pushed[1, 0] < first[1, 0] - 0.05


def test_each_robot_of_a_sweep_has_its_dynamics(monkeypatch: pytest.MonkeyPatch) -> None:
    """In SI units; all other parameters have their defaults."""
    config = _config(slope_deg=(-9.0, 0.0, 9.0), torque_delay_ms=(5.0,), payload=(2.0,), walks=2)
    seen = {}

    def stand(env: Any, *_: Any) -> tuple[None, np.ndarray]:
        seen.update(env.base_env.dynamics)
        return None, np.ones(env.num_envs, dtype=bool)

    monkeypatch.setattr(sweeps, "walk_on", stand)
    result = measure_sweeps(config, SHIPPED, 0, BAR)
    assert result.survived.all()
    assert result.command.shape == (10, 1)
    for i, (name, shown) in enumerate(trials(config)):
        value = {"slope": math.radians(shown), "torque_delay": shown / 1000}.get(name, shown)
        assert seen[name][i] == pytest.approx(value, abs=1e-12)
        others = {"payload": 0.0, "slope": 0.0, "torque_delay": 0.003}
        assert all(seen[other][i] == others[other] for other in others.keys() - {name})


def _result(*survived: bool) -> SweepResult:
    command = np.arange(len(survived)) / 4
    return SweepResult(command[:, None], np.array(survived))


def test_sweep_rows_have_intervals_over_walks_or_policies_and_the_commands_of_falls() -> None:
    config = _config(payload=(0.0, 5.0), walks=2)
    (row, other) = sweep_rows(config, [_result(True, False, False, False)])
    assert (row["mean"], row["trials"], row["falls"]) == (0.5, 2, [[0.25]])
    assert (row["low"], row["high"]) == pytest.approx((0.0945, 0.9055), abs=1e-4)  # Wilson's
    assert (other["mean"], other["falls"]) == (0.0, [[0.5], [0.75]])
    results = [_result(True, True, True, False), _result(True, False, False, False)]
    rows = sweep_rows(config, results)
    assert [(row["mean"], row["trials"]) for row in rows] == [(0.75, 4), (0.25, 4)]
    half = 12.706 * 0.25  # Student's interval of 1 and 0.5
    assert (rows[0]["low"], rows[0]["high"]) == pytest.approx((0.75 - half, 0.75 + half), 1e-3)


def test_sweep_table_shows_four_commands_of_falls() -> None:
    falls = [[0.5 * i, 0.0, 0.1] for i in range(6)]
    row = {"parameter": "payload", "value": 4.0, "mean": 0.0, "low": 0.0, "high": 0.0}
    lines = sweep_table([{**row, "falls": falls}, {**row, "falls": [[1.0]]}]).splitlines()
    assert lines[-2].endswith("| (0.00, 0.00, 0.10), (0.50, 0.00, 0.10), (1.00, 0.00, 0.10),"
                              " (1.50, 0.00, 0.10), 2 more |")  # fmt: skip
    assert lines[-1].endswith("| 1.00 |")
    assert sweep_table([]) == ""


def test_commands_and_phases_of_a_sweep_are_random(monkeypatch: pytest.MonkeyPatch) -> None:
    """Uniform over the library's speeds, the same for the same seed."""
    config = _config(payload=(0.0,), walks=40)
    seen = []

    def start(_: Any, command: np.ndarray, phase: np.ndarray) -> None:
        seen.append((command, phase))

    monkeypatch.setattr(sweeps, "reset_walks", start)
    monkeypatch.setattr(
        sweeps, "walk_on", lambda env, *_: (None, np.ones(env.num_envs, dtype=bool))
    )
    for seed in (0, 0, 1):
        measure_sweeps(config, SHIPPED, seed, BAR)
    (command, phase), again, other = seen
    assert command.min() < 0.3
    assert command.max() > 1.7
    assert np.ptp(phase) > 0.8
    np.testing.assert_array_equal(command, again[0])
    np.testing.assert_array_equal(phase, again[1])
    assert (command != other[0]).all()


def _pushes(*impulses: float) -> np.ndarray:
    """One direction and two phases with two repeats each."""
    return np.repeat(np.array(impulses), 2).reshape(1, 2, 2)


def test_pushes_have_mean_and_range_over_phases_and_intervals_over_policies() -> None:
    config = _config(directions=1, phases=2, repeats=2)
    (row,) = push_rows(config, [_pushes(20.0, 40.0)])
    assert (row["mean"], row["low"], row["high"]) == (30.0, 30.0, 30.0)
    table = push_table({"pushes": [row]})
    assert table.splitlines()[-1] == "| forward | 30.0 | 20.0 at 0 | 40.0 at 0.5 |"
    (row,) = push_rows(config, [_pushes(20.0, 40.0), _pushes(22.0, 42.0)])
    # Student's interval of 30 and 32 N s
    half = 12.706 * math.sqrt(2.0) / math.sqrt(2.0)
    assert (row["mean"], row["low"], row["high"]) == pytest.approx(
        (31.0, 31 - half, 31 + half), 1e-3
    )


@pytest.mark.parametrize(
    ("successes", "low", "high"), [(0, 0.0, 0.2775), (5, 0.2366, 0.7634), (10, 0.7225, 1.0)]
)
def test_wilsons_interval(successes: int, low: float, high: float) -> None:
    """For ten trials, from published tables."""
    interval = Interval.of_share(successes, 10)
    assert interval.mean == successes / 10
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=1e-4)


def test_wilsons_interval_contains_the_proportion() -> None:
    """Rounding must not exclude it, as plots need low <= mean <= high."""
    for count in range(1, 80):
        for successes in range(count + 1):
            interval = Interval.of_share(successes, count)
            assert 0 <= interval.low <= interval.mean <= interval.high <= 1
