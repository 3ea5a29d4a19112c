"""Collection rate: in this process, in several processes, and in Ray actors.

    python -m benchmarks.collectors
    python -m benchmarks.collectors --num-collectors 8 --kinds single distributed

All kinds collect equal batches from equally many robots, in turn in every round, so that other load
on the machine affects all alike. Each kind uses all processors: one process has a thread for each,
several share them. The time of a batch includes sending weights to other processes and receiving
the samples. Table rows are medians over rounds; ratios are taken within a round.

On one machine the result is the cost or gain of processes alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line

Kind = Literal["single", "distributed", "ray"]
"""This process, several processes, or Ray actors."""


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    kinds: tuple[Kind, ...] = ("single", "distributed", "ray")
    """Kinds of collectors; ratios are to the first."""
    num_envs: int = 256
    """Number of robots."""
    samples: int = 2048
    """Policy steps in a batch."""
    num_collectors: int = 2
    """Number of processes or actors."""
    rounds: int = 9
    """Number of rounds; tables show the median, after a batch to warm up."""
    policy: str = "straight"
    """Policy that acts, with exploration noise, as `aslip.load_policy` takes it."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict

from aslip.training.cluster import DistributedCollectors
from aslip.training.collectors import LocalCollector
from aslip.training.ray import RayCollectors
from aslip.walking import markdown
from benchmarks.common import MakeEnv, Policy, Subject


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> None:
    """Measure and print.

    Args:
        config: the settings.
        policy: policy that acts; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    # as in the other processes: spinning torch threads would slow them
    torch.set_num_threads(1)
    subject = Subject.load(policy or config.policy, make_env)
    makers: dict[Kind, Callable[..., Any]] = {
        "single": LocalCollector,
        "distributed": partial(DistributedCollectors, num_collectors=config.num_collectors),
        "ray": partial(RayCollectors, num_collectors=config.num_collectors),
    }
    with ExitStack() as stack:
        batches: dict[Kind, Iterator[TensorDict]] = {}
        first: dict[Kind, float] = {}
        for kind in config.kinds:
            size = {"num_envs": config.num_envs, "samples": config.samples}
            collector = makers[kind](subject.env, subject.policy, **size)
            batches[kind] = iter(stack.enter_context(collector))
            first[kind] = _seconds(batches[kind])
        rounds = [
            {kind: _seconds(iterator) for kind, iterator in batches.items()}
            for _ in range(config.rounds)
        ]
    rows = []
    for kind in config.kinds:
        rate = statistics.median(config.samples / r[kind] for r in rounds)
        share = statistics.median(r[config.kinds[0]] / r[kind] for r in rounds)
        rows.append([f"`{kind}`", f"{rate:.0f}", f"{100 * share:.0f} %", f"{first[kind]:.1f}"])
    robots, share = f"{config.num_envs} robots", f"of `{config.kinds[0]}`"
    header = [robots, "policy steps/s", share, "first batch [s]"]
    print(markdown(header, rows, ["---", "---:", "---:", "---:"]))


def _seconds(batches: Iterator[TensorDict]) -> float:
    """Seconds until the next batch has arrived."""
    start = time.perf_counter()
    next(batches)
    return time.perf_counter() - start


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
