"""Deterministic walks of a policy at many speeds at once, and the table they make."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Integral
from typing import Final

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from aslip.envs import MAX_EPISODE_STEPS, StackEnv
from aslip.errors import ConfigurationError
from aslip.robot import POLICY_PERIOD, STANDARD_GRAVITY
from aslip.transforms import SpeedCommand
from aslip.walking.tables import markdown

TRACKING_TOLERANCE: Final = 0.2
"""Difference of mean and commanded speed up to which a walk tracks its command [m/s]."""

# share of the weight that feet carry on the long run, and what the pelvis may bob up and down [m/s]
_ON_FEET, _BOB = 0.95, 0.5


@dataclass(frozen=True)
class WalkResult:
    """One episode at one commanded speed.

    Whether the robot `survived`, stayed `on_feet` and `tracked` its command are three results; a
    walk that succeeds has all of them.
    """

    speed: float
    """Commanded speed [m/s]."""
    steps: int
    """Policy steps until the episode ended, at most the steps asked for."""
    survived: bool
    """Whether it lasted them all."""
    total: float
    """Sum of rewards."""
    mean_speed: float
    """Distance along the heading over time [m/s]."""
    lateral_drift: float
    """Distance of the pelvis from the line along the heading at the end [m]."""
    weight_ratio: float
    """Mean vertical ground force over the weight of the robot as it is, with its mass and payload;
    one when nothing but the feet carries it."""
    terms: dict[str, float]
    """Mean of each reward term."""

    @property
    def on_feet(self) -> bool:
        """Whether feet carried the robot; robots also learn to shuffle along on their heels."""
        return on_feet(self.weight_ratio, self.steps * POLICY_PERIOD)

    @property
    def tracked(self) -> bool:
        """Whether the mean speed is that of the command, to `TRACKING_TOLERANCE`."""
        return tracks(self.speed, self.mean_speed)


def on_feet(weight_ratio: float, duration: float) -> bool:
    """Whether feet carried the robot, but for what its momentum can carry for a while.

    Args:
        weight_ratio: mean vertical ground force on the feet over the robot's weight.
        duration: time that the mean is over [s].
    """
    return weight_ratio > _ON_FEET - _BOB / (STANDARD_GRAVITY * duration)


def tracks(speed: float, mean_speed: float) -> bool:
    """Whether a mean speed is that of the command, to `TRACKING_TOLERANCE`; NaN is not.

    Args:
        speed: commanded [m/s].
        mean_speed: measured [m/s].
    """
    return abs(mean_speed - speed) <= TRACKING_TOLERANCE


@torch.no_grad()
def evaluate(
    policy: TensorDictModuleBase,
    env: StackEnv,
    speeds: Sequence[float],
    num_steps: int = MAX_EPISODE_STEPS,
) -> list[WalkResult]:
    """Walk once at each speed, from phase 0, without exploration noise.

    The speed is kept, also where the environment's `SpeedCommand` would change it on the way.

    Args:
        policy: maps the environment's tensordict to `action`.
        env: as many robots as there are speeds.
        speeds: commanded speeds [m/s].
        num_steps: policy steps, 1 or more.

    Raises:
        ConfigurationError: the environment has another number of robots, or `num_steps` is no
            whole number of 1 or more.
    """
    if not isinstance(num_steps, Integral) or isinstance(num_steps, bool) or num_steps < 1:
        raise ConfigurationError(
            f"num_steps must be a whole number of 1 or more, got {num_steps!r}"
        )
    if env.num_envs != len(speeds):
        raise ConfigurationError(
            f"{len(speeds)} speeds need an environment of as many robots, got {env.num_envs}"
        )
    command = torch.tensor(speeds, dtype=torch.float32)[:, None]
    start = TensorDict(command=command, phase=torch.zeros_like(command), batch_size=len(command))
    td = env.reset(start)
    position = td["true_odometry", "pelvis_position"].clone()
    start_x = position[:, 0].clone()
    alive = torch.ones(len(speeds), dtype=torch.bool)
    steps = torch.zeros(len(speeds))
    total, force = torch.zeros(len(speeds)), torch.zeros(len(speeds))
    terms: dict[str, torch.Tensor] = {}
    with set_exploration_type(ExplorationType.DETERMINISTIC), _commands_kept(env):
        for _ in range(num_steps):
            after = env.step(policy(td))["next"]
            steps += alive
            total += after["reward"][:, 0] * alive
            force += after["truth", "ground_force"][..., 2].sum(-1) * alive
            for name, term in after.get("reward_terms", TensorDict()).items():
                terms[name] = terms.get(name, 0.0) + term[:, 0] * alive
            position[alive] = after["true_odometry", "pelvis_position"][alive]
            alive &= ~after["terminated"][:, 0]
            if not alive.any():
                break
            td = step_mdp(td)
    weight = env.base_env.weight
    return [
        WalkResult(
            speed=float(speeds[i]),
            steps=int(steps[i]),
            survived=bool(alive[i]),
            total=float(total[i]),
            mean_speed=float((position[i, 0] - start_x[i]) / (steps[i] * POLICY_PERIOD)),
            lateral_drift=float(position[i, 1].abs()),
            weight_ratio=float(force[i] / steps[i] / weight[i]),
            terms={name: float(term[i] / steps[i]) for name, term in terms.items()},
        )
        for i in range(len(speeds))
    ]


@contextmanager
def _commands_kept(env: StackEnv) -> Iterator[None]:
    """Let no command change by itself."""
    commands = [t for t in env.transforms if isinstance(t, SpeedCommand)]
    intervals = [command.interval for command in commands]
    for command in commands:
        command.interval = math.inf
    try:
        yield
    finally:
        for command, interval in zip(commands, intervals, strict=True):
            command.interval = interval


def walk_table(results: Sequence[WalkResult]) -> str:
    """The results as a Markdown table, one row a speed, and a line that sums them up."""
    names = list(results[0].terms)
    header = ["command m/s", "steps", "return", "speed m/s", "drift m", "force/weight", *names]
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
