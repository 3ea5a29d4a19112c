"""Pushes and sweeps of all policies, and the report."""

from __future__ import annotations

from typing import Any

import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type
from tqdm import tqdm

from aslip.robot import CASSIE
from benchmarks.common import write_report
from benchmarks.perturbation.config import Config
from benchmarks.perturbation.picture import picture
from benchmarks.perturbation.pushes import push_rows, push_steps, push_table, survived_pushes
from benchmarks.perturbation.sweeps import survived_sweeps, sweep_rows, sweep_table, trials


def main(config: Config) -> dict[str, Any]:
    """Measure, print and draw; returns the numbers."""
    total = len(config.policy) * robot_steps(config)
    with (
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
        tqdm(total=total, unit="step", unit_scale=True, leave=False) as bar,
    ):
        pushes = [survived_pushes(config, policy, bar) for policy in config.policy]
        sweeps = [survived_sweeps(config, policy, bar) for policy in config.policy]
    numbers = {
        "speed": config.speed,
        "push_duration": push_steps(config) * CASSIE.policy_period,
        "resolution": config.largest * 0.5**config.bisections,
        "pushes": push_rows(config, pushes),
        "sweeps": sweep_rows(config, sweeps),
    }
    tables = [make(numbers) for make in (push_table, sweep_table)]
    text = "\n\n".join(table for table in tables if table)
    write_report(config, "perturbation", numbers, text, picture(config, numbers))
    return numbers


def robot_steps(config: Config) -> int:
    """Policy steps times robots that one policy takes at most."""
    pushed = config.directions * config.phases * config.repeats
    once = push_steps(config) + round(config.after / CASSIE.policy_period)
    each = round(config.settle / CASSIE.policy_period) + config.bisections * once
    return pushed * each + len(trials(config)) * round(config.episode / CASSIE.policy_period)
