"""Policy steps per second: the environments against bare `mj_step`, side by side in one run.

    python -m benchmarks.throughput
    python -m benchmarks.throughput --num-envs 16 64 256 1024 --rounds 9

In every policy step of the run each candidate advances the same N robots from the same states, one
after the other, so that whatever else the machine does touches all alike. A table row is the median
over rounds; the ratio is that of the same round. The bound is `mj_step` alone, 60 substeps a call
and simulations shared out to threads in advance: no environment around this physics can beat it.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
import tyro
from tensordict import TensorDictBase

import aslip
from aslip.cassie import SUBSTEPS
from aslip.envs import BatchCassieEnv
from aslip.policy import policy_stack
from aslip.sim import SimulationPool
from aslip.transforms import ActionDelta, TrueState

_PAUSE = 0.01  # [s]
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclass(frozen=True)
class Config:
    """What to measure."""

    num_envs: tuple[int, ...] = (16, 64, 256)
    """Numbers of robots N."""
    num_threads: int = 2
    """Threads for the physics of every candidate."""
    rounds: int = 7
    """Rounds to take the median over."""
    steps: int = 4
    """Policy steps of a round."""
    policy: str = "aslip"
    """Who walks, as `aslip.load_policy` names it; its own time is not counted."""
    action_std: float = 0.135
    """Exploration noise on its actions [rad]."""


class Bound:
    """`mj_step` and nothing else, on as many threads."""

    def __init__(self, model: mujoco.MjModel, num_threads: int) -> None:
        self.model = model
        self.data = [mujoco.MjData(model) for _ in range(num_threads)]
        self.pool = ThreadPoolExecutor(num_threads)

    def advance(self, states: np.ndarray) -> None:
        """One policy period from each row of (n, k) states."""
        shares = np.array_split(states, len(self.data))
        list(self.pool.map(self._run, self.data, shares))

    def _run(self, data: mujoco.MjData, states: np.ndarray) -> None:
        physics = mujoco.mj_stateSize(self.model, _STATE)
        for state in states[:, :physics]:
            mujoco.mj_setState(self.model, data, state, _STATE)
            mujoco.mj_step(self.model, data, SUBSTEPS)


class Candidates:
    """The bound, bare simulations, and environments with transforms, kept in step."""

    def __init__(self, num_envs: int, config: Config) -> None:
        edits: dict[str, dict[str, Any]] = {
            "environment on the truth": {"drop": ["noise"], "replace": {"estimator": TrueState}},
            "environment, all transforms": {},
        }
        self.envs = {
            name: aslip.make_env(
                num_envs=num_envs,
                stack=policy_stack(config.policy),
                num_threads=config.num_threads,
                **edit,
            )
            for name, edit in edits.items()
        }
        self.pools: list[SimulationPool] = []
        for env in self.envs.values():
            assert isinstance(env.base_env, BatchCassieEnv)
            self.pools.append(env.base_env.simulations)
        self.bare = SimulationPool(num_envs, num_threads=config.num_threads)
        self.bound = Bound(self.bare.model, config.num_threads)
        transforms = list(self.envs.values())[-1].transforms
        self.baseline_key = next(t.baseline_key for t in transforms if isinstance(t, ActionDelta))
        self.policy = aslip.load_policy(config.policy)
        self.std = config.action_std
        self.states = {name: env.reset() for name, env in self.envs.items()}

    def step(self) -> dict[str, float]:
        """One policy step of each from the last one's states; seconds by name."""
        states = self.pools[-1].states()
        for pool in (self.bare, *self.pools):
            pool.set_states(states)
        td = list(self.states.values())[-1]
        with torch.no_grad():
            self.policy(td)
        td["action"] += self.std * torch.randn(self.bare.num, 10)
        for other in self.states.values():
            other["action"] = td["action"].clone()
        targets = np.asarray(td[self.baseline_key] + td["action"], dtype=np.float64)
        seconds = {
            "mj_step (bound)": _timed(lambda: self.bound.advance(states)),
            "simulations": _timed(lambda: self.bare.advance(targets)),
        }
        for name in self.envs:
            seconds[name] = _timed(lambda name=name: self._step_env(name))
        return seconds

    def _step_env(self, name: str) -> None:
        _, following = self.envs[name].step_and_maybe_reset(self.states[name])
        assert isinstance(following, TensorDictBase)
        self.states[name] = following


def main(config: Config) -> None:
    """Measure and print."""
    torch.manual_seed(0)
    print("| N | candidate | policy steps/s | share of the bound |\n|---:|---|---:|---:|")
    for num_envs in config.num_envs:
        candidates = Candidates(num_envs, config)
        candidates.step()  # warm up
        rounds = [_round(candidates, config.steps) for _ in range(config.rounds)]
        for name in rounds[0]:
            rate = statistics.median(num_envs * config.steps / r[name] for r in rounds)
            share = statistics.median(r["mj_step (bound)"] / r[name] for r in rounds)
            print(f"| {num_envs} | {name} | {rate:.0f} | {100 * share:.0f} % |", flush=True)


def _round(candidates: Candidates, steps: int) -> dict[str, float]:
    """Seconds of some policy steps, by candidate."""
    total: dict[str, float] = {}
    for _ in range(steps):
        for name, seconds in candidates.step().items():
            total[name] = total.get(name, 0.0) + seconds
    return total


def _timed(call: Callable[[], object]) -> float:
    # torch's threads go on spinning for a while after their work and would slow the next candidate
    time.sleep(_PAUSE)
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


if __name__ == "__main__":
    main(tyro.cli(Config))
