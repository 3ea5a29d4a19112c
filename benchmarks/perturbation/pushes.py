"""Largest survivable pushes, by bisection."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

import aslip
from aslip.envs import StackEnv
from aslip.robot import CASSIE
from aslip.show.ghost import heading
from aslip.transforms import PhaseClock
from aslip.walking import markdown, policy_steps
from benchmarks.common import Interval, environment
from benchmarks.perturbation.config import SIDES, Config
from benchmarks.perturbation.walking import reset, walk


def push_steps(config: Config) -> int:
    """Policy steps of a push."""
    return policy_steps(config.duration)


def survived_pushes(config: Config, policy: str, bar: tqdm) -> np.ndarray:
    """(directions, phases, repeats) largest impulses that one policy was seen to survive [N s].

    Zero where it falls without a push.
    """
    shape = (config.directions, config.phases, config.repeats)
    if not config.phases:
        return np.zeros(shape)
    direction, phase, _ = (grid.ravel() for grid in np.indices(shape))
    actor, env = aslip.load_policy(policy), environment(config, policy, len(phase))
    try:
        td, standing = settled(config, env, actor, phase / config.phases, bar)
        states = env.base_env.states()
        orientation = np.asarray(td["truth", "pelvis_orientation"])
        toward = 2 * np.pi * direction / config.directions + heading(orientation)
        unit = np.stack([np.cos(toward), np.sin(toward), np.zeros(len(phase))], axis=1)
        survived, fatal = np.zeros(len(phase)), np.full(len(phase), config.largest)
        for _ in range(config.bisections):
            impulse = (survived + fatal) / 2
            env.base_env.set_states(states)
            alive = standing & survives(config, env, actor, td, impulse[:, None] * unit, bar)
            survived, fatal = np.where(alive, impulse, survived), np.where(alive, fatal, impulse)
    finally:
        env.close()
    return survived.reshape(shape)


def settled(
    config: Config,
    env: StackEnv,
    actor: TensorDictModuleBase,
    phase: np.ndarray,
    bar: tqdm,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk until the start has been forgotten, all at the same time at phases (n,).

    Returns:
        The tensordict at that time, and (n,) who has not fallen.
    """
    steps = round(config.settle / CASSIE.policy_period)
    start = phase - steps * CASSIE.policy_period / stride(env, config.speed)
    td = reset(env, np.full(len(phase), config.speed), start % 1.0)
    return walk(env, actor, td, steps, bar)


def survives(
    config: Config,
    env: StackEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    impulse: np.ndarray,
    bar: tqdm,
) -> np.ndarray:
    """(n,) who has not fallen a while after a push of impulses (n, 3) [N s, world]."""
    steps = push_steps(config)
    td, during = walk(env, actor, td, steps, bar, impulse / (steps * CASSIE.policy_period))
    _, after = walk(env, actor, td, round(config.after / CASSIE.policy_period), bar)
    return during & after


def stride(env: StackEnv, speed: float) -> float:
    """Duration of a stride of the environment's reference [s]."""
    clock = next(t for t in env.transforms if isinstance(t, PhaseClock))
    return float(clock.library.stride(torch.full((1, 1), speed)))


def push_rows(config: Config, pushes: list[np.ndarray]) -> list[dict[str, Any]]:
    """A row a direction: over all phases, and at each."""
    return [
        {
            "direction_deg": 360 * i / config.directions,
            **vars(Interval.of([found[i].ravel() for found in pushes])),
            "phases": [
                {"phase": j / config.phases, **vars(Interval.of([found[i, j] for found in pushes]))}
                for j in range(config.phases)
            ],
        }
        for i in range(config.directions if config.phases else 0)
    ]


def push_table(numbers: dict[str, Any]) -> str:
    """A row a direction."""
    rows = []
    for row in numbers["pushes"]:
        extremes = [pick(row["phases"], key=lambda cell: cell["mean"]) for pick in (min, max)]
        rows.append(
            [
                SIDES.get(row["direction_deg"], f"{row['direction_deg']:.0f}°"),
                Interval.of_row(row).text(1),
                *(f"{Interval.of_row(cell).text(1)} at {cell['phase']:.3g}" for cell in extremes),
            ]
        )
    header = ["push", "impulse N s", "least, at phase", "greatest, at phase"]
    return markdown(header, rows) if rows else ""
