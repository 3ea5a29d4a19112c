"""Fault injection into simulations: bad numbers in the state, and random actions."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

import aslip
from aslip.envs import StackEnv
from aslip.training.provenance import peak_memory

_BAD = (np.nan, np.inf, -np.inf, 1e300)


def bad_numbers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Put a bad number into the state of every second robot, and compare with undamaged copies.

    Survived: observation and reward stay finite, the neighbouring robots equal their copies bit for
    bit, and the next reset restores a finite state.
    """
    del folder
    robots, survived = 2 * np.arange(count), np.ones(count, dtype=bool)
    both = [aslip.make_env(num_envs=2 * count, num_threads=1, seed=0) for _ in range(2)]
    tds = [env.reset() for env in both]
    for step in range(10):
        if step == 5:
            states = both[0].base_env.states()
            columns = rng.integers(states.shape[1], size=count)
            states[robots, columns] = rng.choice(_BAD, count)
            both[0].base_env.set_states(states)
        action = torch.tensor(rng.normal(0, 0.1, (2 * count, 10)), dtype=torch.float32)
        for i, env in enumerate(both):
            tds[i] = step_mdp(env.step(tds[i].set("action", action)), exclude_reward=False)
        for key in ("observation", "reward"):
            survived &= torch.isfinite(tds[0][key]).all(-1).numpy()[robots]
        survived &= ~_differing_rows(tds[0], tds[1], robots + 1)
    both[0].reset()
    survived &= np.isfinite(both[0].base_env.states()).all(axis=1)[robots]
    for env in both:
        env.close()
    return int(survived.sum())


def _differing_rows(a: TensorDictBase, b: TensorDictBase, rows: np.ndarray) -> np.ndarray:
    """Mask of rows in which an entry differs in at least one bit."""
    different = np.zeros(len(rows), dtype=bool)
    for key in a.keys(True, True):
        left, right = (td.get(key)[torch.from_numpy(rows)].numpy().copy() for td in (a, b))
        different |= (left.view(np.uint8) != right.view(np.uint8)).reshape(len(rows), -1).any(1)
    return different


def random_steps(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Take random actions in a process of its own.

    Survived: all output is finite, and the process neither crashes nor grows.
    """
    del folder
    code = (
        "import json, sys; from benchmarks.faults.simulations import random_walk;"
        " print(json.dumps(random_walk(int(sys.argv[1]), int(sys.argv[2]))))"
    )
    command = [sys.executable, "-c", code, str(count), str(int(rng.integers(2**31)))]
    process = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if process.returncode:
        return 0
    result = json.loads(process.stdout.splitlines()[-1])
    tqdm.write(
        f"{result['steps']} policy steps of random actions: {result['episodes']} episodes,"
        f" {result['divergences']} divergences, {result['steps'] / result['seconds']:.0f} steps/s;"
        f" memory {result['memory_mib']:.1f} MiB after the first tenth,"
        f" growth {result['growth_mib']:.2f} MiB from there on"
    )
    return result["finite"] if result["growth_mib"] < 16 else 0


def random_walk(count: int, seed: int, num_envs: int = 50) -> dict[str, float]:
    """Step robots with random actions of 0.01 to 100 rad.

    Returns:
        Number of `steps`, of steps with `finite` observation and reward, of `episodes` ended and
        of `divergences`; `seconds`; `memory_mib` after a tenth; `growth_mib` from there on.
    """
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    with closing(aslip.make_env(num_envs=num_envs, seed=seed, num_threads=1)) as env:
        return _random_walk(env, -(-count // num_envs), generator)


def _random_walk(env: StackEnv, rounds: int, generator: torch.Generator) -> dict[str, float]:
    """Results of `random_walk` over a number of steps of all robots."""
    num_envs, td = env.num_envs, env.reset()
    finite, episodes, memory, start = 0, 0, 0.0, time.perf_counter()
    for k in tqdm(range(rounds), unit="step", unit_scale=num_envs, leave=False):
        scale = 10 ** (4 * torch.rand(num_envs, 1, generator=generator) - 2)
        td["action"] = scale * torch.randn(num_envs, 10, generator=generator)
        full, td = env.step_and_maybe_reset(td)
        after = full["next"]
        rows = torch.cat([after["observation"], after["reward"]], dim=-1)
        finite += int(torch.isfinite(rows).all(-1).sum())
        episodes += int(after["done"].sum())
        if k == rounds // 10:
            memory = resident_memory()
    return {
        "steps": rounds * num_envs,
        "finite": finite,
        "episodes": episodes,
        "divergences": env.base_env.divergences,
        "seconds": time.perf_counter() - start,
        "memory_mib": memory,
        "growth_mib": resident_memory() - memory,
    }


def resident_memory() -> float:
    """Resident memory [MiB]; its peak on systems without `/proc`."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 1024 * peak_memory()
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
