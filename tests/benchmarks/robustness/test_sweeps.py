"""Walks of changed robots and floors."""

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.robustness import sweeps
from benchmarks.robustness.parameters import Sweeps
from benchmarks.robustness.sweeps import SweepResult, measure_sweeps, sweep_rows, trials
from tests.benchmarks.robustness import BAR, NO_SWEEPS, SHIPPED


def _config(**settings: Any) -> Sweeps:
    return Sweeps(**{**NO_SWEEPS, "episode": 1.2, **settings})


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
