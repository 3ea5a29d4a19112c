"""Survival of walks with a changed robot or floor, one parameter at a time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from aslip.base.interval import Interval
from aslip.envs import StackEnv, library_of
from aslip.robot import CASSIE
from aslip.walking import next_start, reset_walks, walk
from benchmarks.common import Subject
from benchmarks.directions.random_commands import random_commands
from benchmarks.robustness.parameters import SWEEPS, Sweeps

# commands of falls that a table shows
_SHOWN = 4


@dataclass(frozen=True)
class SweepResult:
    """Walks of one policy, in the order of `trials`."""

    command: np.ndarray
    """(t, c) commands."""
    survived: np.ndarray
    """(t,) bool, walks without a fall."""


def trials(config: Sweeps) -> list[tuple[str, float]]:
    """Parameter and displayed value of each walk; `config.walks` of each value in a row."""
    return [
        (name, shown)
        for name, sweep in SWEEPS.items()
        for shown in getattr(config, sweep.flag)
        for _ in range(config.walks)
    ]


def measure_sweeps(config: Sweeps, subject: Subject, seed: int, bar: tqdm) -> SweepResult:
    """Walk all `trials` side by side.

    Commands are uniform over the region of the subject's library. Each walk has its own.

    Args:
        config: values of the parameters, and walks.
        subject: policy to measure.
        seed: seed of commands and initial phases.
        bar: progress bar that counts each robot's policy steps.
    """
    changes = trials(config)
    if not changes:
        return SweepResult(np.zeros((0, 1)), np.zeros(0, dtype=bool))
    with closing(subject.walking_env(config, len(changes))) as env:
        for i, (name, shown) in enumerate(changes):
            value = shown / SWEEPS[name].scale
            env.base_env.set_dynamics({name: value}, np.array([i]))
        command = random_commands(library_of(env), len(changes), seed)
        phase = np.random.default_rng(seed).random(len(changes))
        steps = round(config.episode / CASSIE.policy_period)
        walks = walk_on(env, subject.policy, reset_walks(env, command, phase), steps, bar)
    return SweepResult(command, walks[1])


def sweep_rows(config: Sweeps, results: Sequence[SweepResult]) -> list[dict[str, Any]]:
    """Rows of survival, one for each parameter and value, with the commands of all falls.

    The interval of one policy is Wilson's over its walks; of several, Student's over policies.
    """
    changes, rows = trials(config), []
    for name, shown in dict.fromkeys(changes):
        chosen = np.array([change == (name, shown) for change in changes])
        survived = [result.survived[chosen].astype(float) for result in results]
        falls = [result.command[chosen & ~result.survived] for result in results]
        share = Interval.of(survived)
        if len(survived) == 1:
            share = Interval.of_share(int(survived[0].sum()), len(survived[0]))
        rows.append(
            {
                "parameter": name,
                "value": shown,
                **vars(share),
                "trials": int(chosen.sum()) * len(results),
                "falls": np.concatenate(falls).tolist(),
            }
        )
    return rows


def _commands(falls: list[list[float]]) -> str:
    """Text of the first commands, slowest first, and of the number of the others."""
    shown = ["(" + ", ".join(f"{v:.2f}" for v in one) + ")" for one in sorted(falls)[:_SHOWN]]
    if len(falls[:1] and falls[0]) == 1:
        shown = [text.strip("()") for text in shown]
    more = [f"{len(falls) - _SHOWN} more"] if len(falls) > _SHOWN else []
    return ", ".join(shown + more)


COLUMNS = {
    "parameter": lambda row: SWEEPS[row["parameter"]].label,
    "value": "{value:g}",
    "survived [%]": lambda row: Interval.of_row(row).text(0, 100),
    "falls at commands": lambda row: _commands(row["falls"]),
}
"""Columns of the table of survival."""


def walk_on(
    env: StackEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    steps: int,
    bar: tqdm,
    force: np.ndarray | None = None,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk on from a tensordict, which is left as it is, until all robots have fallen.

    Args:
        env: environment of n robots, in the state that belongs to the tensordict.
        actor: policy.
        td: start.
        steps: policy steps.
        bar: progress bar that counts each robot's steps.
        force: (n, 3) force on the pelvis throughout [N, world].

    Returns:
        The tensordict after the last step, and (n,) whether each robot is still up.
    """
    alive = np.ones(env.num_envs, dtype=bool)
    for step in walk(actor, env, td, steps, push=force):
        alive &= ~np.asarray(step["next", "terminated"][:, 0])
        td = next_start(step)
        bar.update(env.num_envs)
        if not alive.any():
            break
    return td, alive
