"""What the benchmarks of a policy share: flags, walks, intervals, reports."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy import stats

import aslip
from aslip.envs import EPISODE_ENDS, ON_TRUTH, StackEnv, check_policy_fits
from aslip.library import GaitLibrary
from aslip.policy import policy_stack
from aslip.robot import CASSIE
from aslip.rom import Gait
from aslip.show.plots import save_figure
from aslip.training.run import write_text
from aslip.walking import Walks, record_walks
from benchmarks.flags import Common

WALKING_LENGTH = 350
"""Mean length of training episodes that counts as having learned to walk, of 400 [policy steps]."""

CONFIDENCE = 0.95
"""Of all intervals."""

_RESAMPLES = 2000
# a bootstrap of fewer is too narrow
_LEAST_VALUES = 10


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % confidence interval, which single values may well be outside."""

    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, groups: Sequence[np.ndarray]) -> Interval:
        """Of the mean over groups, one a seed.

        With several groups Student's interval over their means; with one group a bootstrap over its
        values, none if they are fewer than ten. NaN are left out.
        """
        kept = [group[np.isfinite(group)] for group in map(np.asarray, groups)]
        kept = [group for group in kept if len(group)]
        if not kept:
            return cls(np.nan, np.nan, np.nan)
        means = np.array([group.mean() for group in kept])
        mean = float(means.mean())
        values = means if len(means) > 1 else kept[0]
        if np.ptp(values) == 0:
            mean = float(values[0])  # without what rounding adds
            return cls(mean, mean, mean)
        if len(means) > 1:
            half = stats.t.ppf(0.5 + CONFIDENCE / 2, len(means) - 1) * stats.sem(means)
            return cls(mean, mean - float(half), mean + float(half))
        if len(values) < _LEAST_VALUES:
            return cls(mean, mean, mean)
        rng = np.random.default_rng(0)
        drawn = rng.choice(values, (_RESAMPLES, len(values))).mean(axis=1)
        low, high = np.quantile(drawn, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
        return cls(mean, float(low), float(high))

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> Interval:
        """From numbers that `vars` of one are among."""
        return cls(row["mean"], row["low"], row["high"])

    def text(self, digits: int, scale: float = 1.0) -> str:
        """Mean and, if it has one, interval, with so many digits, times `scale`."""
        mean, low, high = (f"{scale * v:.{digits}f}" for v in (self.mean, self.low, self.high))
        return mean if self.low == self.high else f"{mean} [{low}, {high}]"


def environment(config: Common, policy: str, num_envs: int, **settings: Any) -> StackEnv:
    """The stack of a policy without an end of episodes but falls."""
    edits = ON_TRUTH if config.truth else {}
    env = aslip.make_env(
        num_envs=num_envs,
        seed=config.seed,
        stack=policy_stack(policy),
        drop=[*EPISODE_ENDS, *edits.get("drop", ())],
        replace=edits.get("replace"),
        **settings,
    )
    check_policy_fits(policy, env)
    return env


def constant_walks(config: Common, speeds: Sequence[float], duration: float) -> list[Walks]:
    """Walks at constant speeds side by side, one `Walks` a policy.

    Args:
        config: which policies.
        speeds: commanded [m/s].
        duration: [s].
    """
    steps = round(duration / CASSIE.policy_period)
    command = np.tile(np.array(speeds), (steps, 1))
    return [walks_of(config, policy, command) for policy in config.policy]


def walks_of(config: Common, policy: str, command: np.ndarray) -> Walks:
    """Walks of one policy through commands (m, n) [m/s]."""
    env = environment(config, policy, command.shape[1])
    try:
        return record_walks(aslip.load_policy(policy), env, command)
    finally:
        env.close()


def strides(library: GaitLibrary, speeds: Sequence[float]) -> np.ndarray:
    """(n,) durations of the library's strides [s]."""
    column = torch.tensor(np.array(speeds, dtype=np.float64))[:, None]
    return library.stride(column)[:, 0].numpy()


def nearest_gait(library: GaitLibrary, speed: float) -> Gait:
    """The gait whose speed is nearest to one [m/s]."""
    return min(library.gaits, key=lambda gait: abs(gait.speed - speed))


def shortest_swing(library: GaitLibrary, speed: float) -> float:
    """Half of the model's swing [s]: a robot's foot without load for a shorter time has not swung.

    A leg that follows the model carries nothing for a while in the middle of its stance.
    """
    gait = nearest_gait(library, speed)
    return (1 - gait.duty_factor) * gait.stride / 2


def write_report(
    config: Common, name: str, numbers: dict[str, Any], table: str, figure: Figure | None = None
) -> None:
    """Report about policies: `write_results` with what every benchmark of them is told."""
    about = {"policies": list(config.policy), "seed": config.seed, "truth": config.truth}
    write_results(config.out, name, {**about, **numbers}, table, figure)


def write_results(
    out: Path, name: str, numbers: dict[str, Any], table: str, figure: Figure | None = None
) -> None:
    """Print a table; write it, numbers and picture into a folder, by name."""
    print(table)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / f"{name}.md", table + "\n")
    text = json.dumps(_finite(numbers), indent=1, allow_nan=False)
    write_text(out / f"{name}.json", text + "\n")
    if figure is not None:
        save_figure(figure, out / f"{name}.png")


def _finite(value: Any) -> Any:
    """The same with None in place of numbers that JSON does not have."""
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
