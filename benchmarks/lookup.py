"""Look-ups of a library over three commands: cost, memory, and accuracy of fewer samples.

    python -m benchmarks.lookup

Cost is CPU time of the look-ups of reference and goal for all robots, in percent of a policy step
of the same robots (policy, environment and physics), all on one thread in one process; both are
medians. The large library holds copies of the shipped gaits, because cost and memory do not depend
on the numbers. Errors are the largest ones, at random phases, against tables of 512 samples.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    num_envs: int = 256
    """Number of robots."""
    grid: tuple[int, int, int] = (14, 11, 13)
    """Number of forward speeds, at most 21, of sideways speeds and of yaw rates."""
    samples: int = 48
    """Samples of a stride in the large library."""
    rounds: int = 12
    """Number of policy steps; the median counts."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch

import aslip
from aslip.library import GaitLibrary, GaitTable, tabulate
from aslip.library.table import ARRAYS
from aslip.walking import markdown

_SAMPLES = (128, 64, 48, 32)
_ERRORS = {
    "feet": ("left_foot_position", 1e3, "mm"),
    "foot velocity": ("left_foot_velocity", 1.0, "m/s"),
    "motor angles": ("motor_position", 1e3, "mrad"),
    "motor velocities": ("motor_velocity", 1.0, "rad/s"),
}


def main(config: Config) -> None:
    """Measure and print."""
    torch.set_num_threads(1)
    library = GaitLibrary.load()
    print(_cost(config, library), _accuracy(library), sep="\n\n")


def _cost(config: Config, straight: GaitLibrary) -> str:
    """Table of the two libraries' costs and sizes."""
    env = aslip.make_env(num_envs=config.num_envs, num_threads=1, seed=0)
    policy, states = aslip.load_policy("straight"), [env.reset()]

    def step() -> None:
        states[0] = env.step_and_maybe_reset(policy(states[0]))[1]

    rows = []
    with torch.no_grad():
        whole = _seconds(step, config.rounds)
        for name, library in (("shipped", straight), ("large", large_library(straight, config))):
            command = torch.rand(config.num_envs, len(library.table.axes))
            command = command.expand(2, *command.shape)
            phase = torch.rand(2, config.num_envs, 1)
            seconds = _seconds(partial(library.lookup, phase, command), 50)
            size = sum(buffer.nbytes for buffer in library.buffers()) / 1e6
            share = f"{1e3 * seconds:.2f} ms, {100 * seconds / whole:.2f} %"
            rows.append([name, str(len(library.table.commands)), f"{size:.1f} MB", share])
    env.close()
    return markdown(["library", "gaits", "memory", f"of {1e3 * whole:.0f} ms a step"], rows)


def large_library(library: GaitLibrary, config: Config) -> GaitLibrary:
    """Library in single precision over three commands, filled with straight gaits."""
    table, grid = library.table, config.grid
    ranges = zip((-0.8, -0.5, -1.0), (2.2, 0.5, 1.0), grid, strict=True)
    columns = {}
    for name in ARRAYS:
        rows = getattr(table, name)[: grid[0]]
        if name != "strides":
            rows = rows[:, : config.samples].astype(np.float32)
        columns[name] = np.repeat(rows, grid[1] * grid[2], axis=0)
    axes = tuple(np.linspace(low, high, count) for low, high, count in ranges)
    return GaitLibrary(None, GaitTable(axes=axes, **columns))


def _accuracy(library: GaitLibrary) -> str:
    """Table of the largest errors at some gaits, by number of samples and precision."""
    gaits = library.gaits[::10]
    phase = torch.rand(500, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def looked_up(samples: int, *, single: bool) -> dict[str, torch.Tensor]:
        made = GaitLibrary(None, tabulate(gaits, samples=samples, single_precision=single))
        found = [made.lookup(phase, torch.full_like(phase, v)) for v in made.speeds]
        names = [name for name, *_ in _ERRORS.values()]
        return {name: torch.stack([getattr(one, name) for one in found]) for name in names}

    exact = looked_up(512, single=False)
    rows = []
    for samples in _SAMPLES:
        for single in (False, True):
            found = looked_up(samples, single=single)
            errors = [
                f"{scale * float((found[name] - exact[name]).abs().max()):.3f} {unit}"
                for name, scale, unit in _ERRORS.values()
            ]
            rows.append([str(samples), "single" if single else "double", *errors])
    return markdown(["samples", "precision", *_ERRORS], rows)


def _seconds(work: Callable[[], object], rounds: int) -> float:
    """Median CPU time after a first call."""
    work()
    found = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return statistics.median(found)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
