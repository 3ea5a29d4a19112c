"""Policy steps per second of collecting: in this process, in others, and in actors of Ray.

    python -m benchmarks.collectors
    python -m benchmarks.collectors --num-collectors 8 --kinds single distributed

All kinds collect the same number of samples from as many robots, one kind after the other in every
round, so that whatever else the machine does touches all alike; who is not collecting waits. Each
has all processors for its physics: one process has a thread for each, others share them. A batch of
other processes is by weights that were sent for it, and has arrived here. A table row is the median
over rounds; the ratio is that of the same round.

On one machine this is what processes cost or save; several machines have more processors.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line
from aslip.training.settings import CollectorKind


@dataclass(frozen=True)
class Config:
    """What to measure."""

    kinds: tuple[CollectorKind, ...] = ("single", "distributed", "ray")
    """Collectors; ratios are to the first."""
    num_envs: int = 256
    """Robots."""
    samples: int = 2048
    """Policy steps of a batch."""
    num_collectors: int = 2
    """Processes or actors."""
    rounds: int = 9
    """Rounds to take the median over, after a batch to warm up."""
    policy: str = "aslip"
    """Who walks, as `aslip.load_policy` names it, with exploration noise."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import statistics
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial

import torch
from tensordict import TensorDict

import aslip
from aslip.policy import policy_stack
from aslip.training.collect import make_collector
from aslip.walking import markdown


def main(config: Config) -> None:
    """Measure and print."""
    # as the other processes have; with more, those would wait for threads that spin
    torch.set_num_threads(1)
    policy = aslip.load_policy(config.policy)
    make_env = partial(aslip.make_env, stack=policy_stack(config.policy))
    with ExitStack() as stack:
        batches: dict[CollectorKind, Iterator[TensorDict]] = {}
        first: dict[CollectorKind, float] = {}
        for kind in config.kinds:
            collector = make_collector(
                make_env,
                policy,
                kind=kind,
                num_envs=config.num_envs,
                samples=config.samples,
                num_collectors=config.num_collectors,
            )
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
    robots, beside = f"{config.num_envs} robots", f"of `{config.kinds[0]}`"
    header = [robots, "policy steps/s", beside, "first batch s"]
    print(markdown(header, rows, ["---", "---:", "---:", "---:"]))


def _seconds(batches: Iterator[TensorDict]) -> float:
    """Until the next batch is there."""
    start = time.perf_counter()
    next(batches)
    return time.perf_counter() - start


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
