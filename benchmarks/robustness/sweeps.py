"""Survival of walks with a changed robot or floor, one parameter at a time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.envs import library_of
from aslip.robot import CASSIE
from aslip.walking import reset_walks
from benchmarks.common import Subject, walk_on
from benchmarks.directions.random_commands import random_commands
from benchmarks.flags import SWEEPS, Sweeps

__all__ = ["SweepResult", "measure_sweeps", "sweep_rows", "sweep_table", "trials"]

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


def sweep_table(rows: Sequence[dict[str, Any]]) -> str:
    """Table of survival, a row for each parameter and value; empty without rows."""
    lines = [
        [
            SWEEPS[row["parameter"]].label,
            f"{row['value']:g}",
            Interval.of_row(row).text(0, 100),
            _commands(row["falls"]),
        ]
        for row in rows
    ]
    header = ["parameter", "value", "survived [%]", "falls at commands"]
    return markdown(header, lines) if lines else ""


def _commands(falls: list[list[float]]) -> str:
    """Text of the first commands, slowest first, and of the number of the others."""
    shown = ["(" + ", ".join(f"{v:.2f}" for v in one) + ")" for one in sorted(falls)[:_SHOWN]]
    if len(falls[:1] and falls[0]) == 1:
        shown = [text.strip("()") for text in shown]
    more = [f"{len(falls) - _SHOWN} more"] if len(falls) > _SHOWN else []
    return ", ".join(shown + more)
