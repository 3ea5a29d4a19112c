"""Evaluation of a policy on deterministic walks at many speeds, and its table of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, Final

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey

from aslip.envs import MAX_EPISODE_STEPS, StackEnv
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.walking.record import record
from aslip.walking.tables import markdown

TRACKING_TOLERANCE: Final = 0.2
"""Largest difference of mean and commanded speed of a walk that tracks its command [m/s]."""

# least share of the weight on the feet, and tolerance for a change of the vertical velocity
_ON_FEET, _BOB = 0.95, 0.5  # [-], [m/s]
_POSITION = ("true_odometry", "pelvis_position")
_FORCE = ("truth", "ground_force")
_RECORDED: Final[list[NestedKey]] = [
    _POSITION,
    ("next", *_POSITION),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "reward"),
    ("next", *_FORCE),
    ("next", "reward_terms"),
]


@dataclass(frozen=True)
class WalkResult:
    """One episode at one commanded speed.

    `survived`, `on_feet` and `tracked` are separate criteria; a successful walk meets all three.
    """

    speed: float
    """Commanded speed [m/s]."""
    steps: int
    """Number of policy steps, up to the end of the episode."""
    survived: bool
    """True if the robot did not fall."""
    total: float
    """Sum of rewards."""
    mean_speed: float
    """Distance along the heading over time [m/s]."""
    lateral_drift: float
    """Final distance of the pelvis from the line along the heading [m]."""
    weight_ratio: float
    """Mean vertical ground force over the simulated robot's weight, payload included; 1 if the feet
    carry it all."""
    terms: dict[str, float]
    """Mean of each reward term."""

    @property
    def on_feet(self) -> bool:
        """True if the feet carried the robot; some policies slide on other parts of the legs."""
        return is_on_feet(self.weight_ratio, self.steps * CASSIE.policy_period)

    @property
    def tracked(self) -> bool:
        """True if the mean speed is within `TRACKING_TOLERANCE` of the command."""
        return tracks_command(self.speed, self.mean_speed)


def is_on_feet(weight_ratio: float, duration: float) -> bool:
    """Check that the feet carried the robot, allowing for vertical momentum in short walks.

    Args:
        weight_ratio: mean vertical ground force on the feet over the robot's weight.
        duration: time over which the mean was taken [s].
    """
    return weight_ratio > _ON_FEET - _BOB / (STANDARD_GRAVITY * duration)


def tracks_command(speed: float, mean_speed: float) -> bool:
    """Check that a mean speed is within `TRACKING_TOLERANCE` of the command; false for NaN.

    Args:
        speed: commanded [m/s].
        mean_speed: measured [m/s].
    """
    return abs(mean_speed - speed) <= TRACKING_TOLERANCE


def evaluate(
    policy: TensorDictModuleBase,
    env: StackEnv,
    speeds: Sequence[float],
    num_steps: int = MAX_EPISODE_STEPS,
) -> list[WalkResult]:
    """Evaluate one walk at each speed, from phase 0, without exploration noise.

    Commands stay constant: `SpeedCommand` does not change them. A walk ends with its
    episode or after `num_steps`.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment with one robot for each speed.
        speeds: commanded speeds [m/s].
        num_steps: largest number of policy steps of a walk, 1 or more.

    Raises:
        ConfigurationError: the environment has another number of robots or lacks their truth, or
            `num_steps` is not a whole number of 1 or more.
    """
    if not isinstance(num_steps, Integral) or isinstance(num_steps, bool) or num_steps < 1:
        raise ConfigurationError(
            f"num_steps must be a whole number of 1 or more, got {num_steps!r}"
        )
    if env.num_envs != len(speeds):
        raise ConfigurationError(
            f"env must have one robot for each of the {len(speeds)} speeds, got {env.num_envs}"
        )
    known = env.observation_spec.keys(True, True)
    if missing := [key for key in (_POSITION, _FORCE) if key not in known]:
        raise ConfigurationError(
            f"an evaluation needs the entries {missing}, which simulated robots have and `keep`"
            " must not hide"
        )
    command = np.tile(np.asarray(speeds, dtype=np.float32), (num_steps, 1))
    rows = record(policy, env, command, _RECORDED, until_all_ended=True)
    return _results(rows, speeds, env.base_env.weight)


def evaluation_means(results: Sequence[WalkResult]) -> dict[str, float]:
    """Columns of a training's log: means of an evaluation, NaN where there was none."""
    count = len(results) or float("nan")
    return {
        "eval_return": sum(r.total for r in results) / count,
        "eval_length": sum(r.steps for r in results) / count,
        "eval_survived": sum(r.survived for r in results) / count,
    }


def _results(rows: TensorDict, speeds: Sequence[float], weight: Any) -> list[WalkResult]:
    """Results of (m, n) recorded policy steps of robots of some weight (n,) [N]."""
    after = rows["next"]
    assert isinstance(after, TensorDictBase)
    ended = after["done"][..., 0].cumsum(0) > 0
    walking = torch.cat([torch.ones_like(ended[:1]), ~ended[:-1]])
    steps = walking.sum(0).float()
    totals = {name: _sum(t, walking) for name, t in after.get("reward_terms", TensorDict()).items()}
    total = _sum(after["reward"], walking)
    force = _sum(after[_FORCE][..., 2].sum(-1, keepdim=True), walking)
    last = walking.sum(0) - 1, torch.arange(len(speeds))
    position, start = after[_POSITION][last], rows[_POSITION][0]
    fell = (after["terminated"][..., 0] & walking).any(0)
    return [
        WalkResult(
            speed=float(speeds[i]),
            steps=int(steps[i]),
            survived=not fell[i],
            total=float(total[i]),
            mean_speed=float((position[i, 0] - start[i, 0]) / (steps[i] * CASSIE.policy_period)),
            lateral_drift=float(position[i, 1].abs()),
            weight_ratio=float(force[i] / steps[i] / weight[i]),
            terms={name: float(sums[i] / steps[i]) for name, sums in totals.items()},
        )
        for i in range(len(speeds))
    ]


def _sum(values: torch.Tensor, walking: torch.Tensor) -> torch.Tensor:
    """(n,) sums of (m, n, 1) values over each robot's walk, in the order of the steps."""
    total = torch.zeros(values.shape[1])
    for value in values[..., 0] * walking:
        total += value
    return total


def walk_table(results: Sequence[WalkResult]) -> str:
    """Markdown table of results, one row for each speed, and a line of totals."""
    names = list(results[0].terms)
    header = [
        "command [m/s]",
        "steps",
        "return",
        "speed [m/s]",
        "drift [m]",
        "force/weight",
        *names,
    ]
    rows = [
        [
            str(round(r.speed, 3)),
            f"{r.steps}" + ("" if r.survived else " fell"),
            f"{r.total:.1f}",
            f"{r.mean_speed:.3f}",
            f"{r.lateral_drift:.3f}",
            f"{r.weight_ratio:.4f}",
            *(f"{r.terms[name]:.3f}" for name in names),
        ]
        for r in results
    ]
    mean = sum(r.total for r in results) / len(results)
    survived, on_feet, tracked = (
        sum(getattr(r, name) for r in results) for name in ("survived", "on_feet", "tracked")
    )
    summary = (
        f"of {len(results)} speeds {survived} survived, {on_feet} on the feet,"
        f" {tracked} tracked within {TRACKING_TOLERANCE:g} m/s; mean return {mean:.1f}"
    )
    return f"{markdown(header, rows)}\n\n{summary}"
