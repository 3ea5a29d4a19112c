"""Look-ups of the shipped libraries: cost, memory, and accuracy of fewer samples.

    python -m benchmarks.gaits.lookup

Cost is CPU time of reference and target for all robots (`aslip.transforms.ReferenceInjection`), in
percent of a policy step of the same robots with the policy of that library (policy, environment,
and physics of 1 kHz as in training), all on one thread in one process; both are medians. Errors are
the largest ones over three straight gaits, at random phases, against tables of 512 samples.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    num_envs: int = 256
    """Number of robots."""
    rounds: int = 12
    """Number of policy steps; the median counts."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import statistics
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import Any, cast

import torch
from tensordict.nn import TensorDictModuleBase

import aslip
from aslip.base.tables import markdown
from aslip.library import GaitLibrary, tabulate
from aslip.policy import policy_environment
from aslip.transforms.reference import reference_and_target

_POLICIES = {"gaits": "straight", "directions": "directions"}
_TIMESTEP = 1e-3
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
    print(_cost(config), _accuracy(GaitLibrary.load()), sep="\n\n")


def _cost(config: Config) -> str:
    """Table of the libraries' costs and sizes."""
    rows = []
    for name, named in _POLICIES.items():
        library, policy = GaitLibrary.load(name), aslip.load_policy(named)
        size = sum(buffer.nbytes for buffer in library.buffers()) / 1e6
        env = aslip.make_env(
            num_envs=config.num_envs,
            num_threads=1,
            seed=0,
            **policy_environment(named, library),
            timestep=_TIMESTEP,
        )
        with closing(env), torch.no_grad():
            whole, seconds = _times(env, policy, library, config.rounds)
        rows.append(
            [
                name,
                str(len(library.table.commands)),
                f"{size:.1f} MB",
                f"{1e3 * whole:.0f} ms",
                f"{1e3 * seconds:.2f} ms",
                f"{100 * seconds / whole:.2f} %",
            ]
        )
    header = ["library", "gaits", "memory", "policy step", "reference and target", "share"]
    return markdown(header, rows)


def _times(
    env: aslip.envs.StackEnv, policy: TensorDictModuleBase, library: GaitLibrary, rounds: int
) -> tuple[float, float]:
    """CPU times of a policy step, and of reference and target in it [s]."""
    states = [env.reset()]

    def step() -> None:
        states[0] = env.step_and_maybe_reset(policy(states[0]))[1]

    whole, td = _seconds(step, rounds), states[0]
    key = "filtered_command" if library.command_size > 1 else "command"
    command, phase = (cast("torch.Tensor", td[name]) for name in (key, "phase"))
    standing: Any = (td["mode"], td["stand"]) if "stand" in td else None
    work = partial(reference_and_target, library, command, phase, standing=standing)
    return whole, _seconds(work, 50)


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
