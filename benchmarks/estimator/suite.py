"""Walks, falls, costs, and the report."""

from __future__ import annotations

import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from benchmarks.common import write_results
from benchmarks.estimator.config import Config
from benchmarks.estimator.cost import cost_table, packet_time, throughput
from benchmarks.estimator.picture import picture
from benchmarks.estimator.recovery import recovery, recovery_table
from benchmarks.estimator.walks import walk, walk_rows, walk_table


def main(config: Config) -> None:
    """Measure, print and draw."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        walks = walk(config)
        rows = walk_rows(walks, config.repeats)
        ages = recovery(config)
        costs = {"throughput": throughput(config), "packet": packet_time(config)}
    text = "\n\n".join([walk_table(rows), recovery_table(ages), cost_table(costs, config)])
    numbers = {"policy": config.policy, "seed": config.seed, "walks": rows, "recovery": ages}
    figure = picture(walks, config.repeats)
    write_results(config.out, "estimator", {**numbers, **costs}, text, figure)
