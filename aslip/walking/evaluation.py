"""Evaluation of a policy on deterministic walks at many speeds, and its table of results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey

from aslip.base.checks import check_count
from aslip.base.decorators import check_types, on_cpu_in_single
from aslip.base.tables import markdown
from aslip.envs import MAX_EPISODE_STEPS, StackEnv
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, STANDARD_GRAVITY
from aslip.transforms.path import wrap
from aslip.transforms.rotation import conjugate, multiply, yaw
from aslip.walking.record import record

TRACKING_TOLERANCE: Final = 0.2
"""Largest difference of mean and commanded velocity of a walk that tracks its command [m/s, rad/s].
"""

# least share of the weight on the feet, and tolerance for a change of the vertical velocity
_ON_FEET, _BOB = 0.95, 0.5  # [-], [m/s]
_POSITION = ("true_odometry", "pelvis_position")
_FORCE = ("truth", "ground_force")
_VELOCITY = ("true_odometry", "pelvis_velocity")
_ORIENTATION = ("true_odometry", "pelvis_orientation")
_POSES: Final[list[NestedKey]] = [
    ("next", *_VELOCITY),
    _ORIENTATION,
    ("next", *_ORIENTATION),
    "heading",
    ("next", "heading"),
]
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
    """Distance along the heading over time; in a frame that moves along a path, mean of the forward
    speed at the ends of policy steps [m/s]."""
    lateral_drift: float
    """Final distance of the pelvis from the line along the heading, or from the path [m]."""
    weight_ratio: float
    """Mean vertical ground force over the simulated robot's weight, payload included; 1 if the feet
    carry it all."""
    terms: dict[str, float]
    """Mean of each reward term."""
    sideways_speed: float = 0.0
    """Commanded sideways speed [m/s]; like the numbers below, 0 with a straight library."""
    yaw_rate: float = 0.0
    """Commanded yaw rate [rad/s]."""
    mean_sideways_speed: float = 0.0
    """Mean speed to the left, along the y axis of the moving frame [m/s]."""
    mean_yaw_rate: float = 0.0
    """Turn of the pelvis about the vertical over time [rad/s]."""

    @property
    def on_feet(self) -> bool:
        """True if the feet carried the robot; some policies slide on other parts of the legs."""
        return is_on_feet(self.weight_ratio, self.steps * CASSIE.policy_period)

    @property
    def tracked(self) -> bool:
        """True if each mean velocity is within `TRACKING_TOLERANCE` of the command."""
        pairs = (
            (self.speed, self.mean_speed),
            (self.sideways_speed, self.mean_sideways_speed),
            (self.yaw_rate, self.mean_yaw_rate),
        )
        return all(tracks_command(*pair) for pair in pairs)


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
        speed: commanded [m/s, rad/s].
        mean_speed: measured [m/s, rad/s].
    """
    return abs(mean_speed - speed) <= TRACKING_TOLERANCE


@check_types
@on_cpu_in_single
def evaluate(
    policy: TensorDictModuleBase,
    env: StackEnv,
    speeds: Sequence[float] | Sequence[Sequence[float]],
    num_steps: int = MAX_EPISODE_STEPS,
) -> list[WalkResult]:
    """Evaluate one walk at each command, from phase 0, without exploration noise.

    All commands stay constant: `RandomCommand` and `StandCommand` do not change them. A walk ends
    with its episode or after `num_steps`.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: environment with one robot for each speed.
        speeds: commanded speeds [m/s]; in a stack for all directions, (n, 3) commands.
        num_steps: largest number of policy steps of a walk, 1 or more.

    Raises:
        ConfigurationError: the environment has another number of robots, or lacks their truth,
            or `num_steps` is not a whole number of 1 or more.
    """
    check_count("num_steps", num_steps)
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
    command = np.asarray(speeds, dtype=np.float32)
    repeated = np.repeat(command[None], num_steps, axis=0)
    keys = [*_RECORDED, *_POSES] if command.ndim == 2 else _RECORDED
    rows = record(policy, env, repeated, keys, until_all_ended=True)
    given = np.asarray(speeds, dtype=np.float64).reshape(len(speeds), -1)
    results = _results(rows, given[:, 0], env.base_env.weight)
    return _turned(results, rows, given) if command.ndim == 2 else results


def evaluation_means(results: Sequence[WalkResult]) -> dict[str, float]:
    """Columns of a training's log: means of an evaluation, NaN where there was none."""
    count = len(results) or float("nan")
    return {
        "eval_return": sum(r.total for r in results) / count,
        "eval_length": sum(r.steps for r in results) / count,
        "eval_survived": sum(r.survived for r in results) / count,
    }


def _results(rows: TensorDict, speeds: np.ndarray, weight: Any) -> list[WalkResult]:
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


def _turned(
    results: Sequence[WalkResult], rows: TensorDict, command: np.ndarray
) -> list[WalkResult]:
    """Results with the mean velocities of walks (m, n) along the paths of commands (n, 3)."""
    speeds, before, after, heading, next_heading = (
        cast("torch.Tensor", rows[key]).double() for key in _POSES
    )
    # the frame turns, and the pelvis turns in the frame
    in_frame = yaw(multiply(after, conjugate(before)))
    turns = (in_frame + wrap(next_heading - heading))[..., 0].numpy()
    velocity = speeds.numpy()
    turned = []
    for i, result in enumerate(results):
        forward, sideways, _ = velocity[: result.steps, i].mean(axis=0)
        rate = turns[: result.steps, i].mean() / CASSIE.policy_period
        turned.append(
            replace(
                result,
                sideways_speed=float(command[i, 1]),
                yaw_rate=float(command[i, 2]),
                mean_speed=float(forward),
                mean_sideways_speed=float(sideways),
                mean_yaw_rate=float(rate),
            )
        )
    return turned


def _sum(values: torch.Tensor, walking: torch.Tensor) -> torch.Tensor:
    """(n,) sums of (m, n, 1) values over each robot's walk, in the order of the steps."""
    total = torch.zeros(values.shape[1])
    for value in values[..., 0] * walking:
        total += value
    return total


def walk_table(results: Sequence[WalkResult]) -> str:
    """Markdown table of results, one row for each speed, and a line of totals."""
    names = list(results[0].terms)
    turning = any(r.sideways_speed or r.yaw_rate for r in results)
    unit = "m/s, m/s, rad/s" if turning else "m/s"
    header = [f"command [{unit}]", "steps", "return", f"speed [{unit}]", "drift [m]"]
    rows = []
    for r in results:
        command, speed = str(round(r.speed, 3)), f"{r.mean_speed:.3f}"
        if turning:
            command = f"{r.speed:.3f}, {r.sideways_speed:.3f}, {r.yaw_rate:.3f}"
            speed += f", {r.mean_sideways_speed:.3f}, {r.mean_yaw_rate:.3f}"
        steps = f"{r.steps}" + ("" if r.survived else " fell")
        cells = [command, steps, f"{r.total:.1f}", speed, f"{r.lateral_drift:.3f}"]
        terms = [f"{r.terms[name]:.3f}" for name in names]
        rows.append([*cells, f"{r.weight_ratio:.4f}", *terms])
    mean = sum(r.total for r in results) / len(results)
    survived, on_feet, tracked = (
        sum(getattr(r, name) for r in results) for name in ("survived", "on_feet", "tracked")
    )
    summary = (
        f"of {len(results)} speeds {survived} survived, {on_feet} on the feet,"
        f" {tracked} tracked within {TRACKING_TOLERANCE:g} m/s; mean return {mean:.1f}"
    )
    return f"{markdown([*header, 'force/weight', *names], rows)}\n\n{summary}"
