"""Robots and floors unlike the policy's own, one parameter at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from tqdm import tqdm

import aslip
from aslip.robot import CASSIE
from aslip.walking import markdown
from benchmarks.common import CONFIDENCE, Interval, environment
from benchmarks.perturbation.config import SWEEPS, Config
from benchmarks.perturbation.walking import reset, walk


@dataclass(frozen=True)
class Trial:
    """A walk of a robot unlike its own."""

    parameter: str
    shown: float
    """Value of the parameter, as it is shown."""
    speed: float
    """Commanded [m/s]."""
    phase: float
    """At which it begins."""


def trials(config: Config) -> list[Trial]:
    """All walks of all sweeps."""
    return [
        Trial(name, shown, speed, (i / len(config.speeds) + k / config.episodes) % 1.0)
        for name, sweep in SWEEPS.items()
        for shown in getattr(config, sweep.flag)
        for i, speed in enumerate(config.speeds)
        for k in range(config.episodes)
    ]


def survived_sweeps(config: Config, policy: str, bar: tqdm) -> np.ndarray:
    """(n,) whether one policy survived each of the `trials`."""
    all_trials = trials(config)
    if not all_trials:
        return np.zeros(0, dtype=bool)
    actor, env = aslip.load_policy(policy), environment(config, policy, len(all_trials))
    try:
        for i, trial in enumerate(all_trials):
            value = trial.shown / SWEEPS[trial.parameter].shown
            env.base_env.set_dynamics({trial.parameter: value}, np.array([i]))
        speed, phase = (
            np.array([getattr(t, name) for t in all_trials]) for name in ("speed", "phase")
        )
        steps = round(config.episode / CASSIE.policy_period)
        return walk(env, actor, reset(env, speed, phase), steps, bar)[1]
    finally:
        env.close()


def wilson(successes: int, trials: int) -> Interval:
    """Share of successes and Wilson's 95 % interval, which holds at 0 and 1, too."""
    found = stats.binomtest(successes, trials)
    interval = found.proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / trials, float(interval.low), float(interval.high))


def sweep_rows(config: Config, sweeps: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """A row a parameter and value, over all policies."""
    all_trials, survived = trials(config), np.array(sweeps)
    rows = []
    for name, shown in dict.fromkeys((t.parameter, t.shown) for t in all_trials):
        columns = [(t.parameter, t.shown) == (name, shown) for t in all_trials]
        found = survived[:, columns]
        at = np.array([t.speed for t in all_trials])[columns]
        rows.append(
            {
                "parameter": name,
                "value": shown,
                **vars(wilson(int(found.sum()), found.size)),
                "trials": found.size,
                "by_speed": {str(v): float(found[:, at == v].mean()) for v in config.speeds},
            }
        )
    return rows


def sweep_table(numbers: dict[str, Any]) -> str:
    """A row a parameter and value."""
    rows = [
        [
            SWEEPS[row["parameter"]].label,
            f"{row['value']:g}",
            Interval.of_row(row).text(0, 100),
            ", ".join(speed for speed, share in row["by_speed"].items() if share < 1),
        ]
        for row in numbers["sweeps"]
    ]
    header = ["changed", "value", "walks survived %", "falls when told to walk at m/s"]
    return markdown(header, rows) if rows else ""
