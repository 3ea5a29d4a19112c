"""Throughput of the environments relative to bare `mj_step`, side by side in one run.

    python -m benchmarks.system.throughput  # a quarter of an hour
    python -m benchmarks.system.throughput --num-envs 256 --num-threads 2 --rounds 9

In every policy step each candidate advances the same N robots from the same states, in turn, so
that other load on the machine affects all alike. Table rows are medians over rounds; ratios are
taken within a round. The upper bound is `mj_step` alone, with 60 substeps per call and robots
assigned to threads in advance. Two rows of `mujoco.batch` with constant torques show the cost of 60
calls instead of one.

For few robots there are two more candidates: the dm_control task in a loop, and TorchRL's
`ParallelEnv` with a process for each robot, which uses all processors regardless of `num_threads`.

Another table shows the share of learning (everything but collection) in a training iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    num_envs: tuple[int, ...] = (1, 16, 64, 256, 1024)
    """Numbers N of robots."""
    num_threads: tuple[int, ...] = (1, 2)
    """Numbers of physics threads."""
    rounds: int = 5
    """Number of rounds; tables show the median."""
    robot_steps: int = 1024
    """Policy steps of all robots in a round, one to 64 for each robot."""
    single: int = 16
    """Largest N for dm_control in a loop and `ParallelEnv`."""
    updates: bool = True
    """Also measure learning."""
    policy: str = "straight"
    """Policy that walks, as `aslip.load_policy` takes it; its inference is not timed."""
    action_std: float = 0.135
    """Standard deviation of the exploration noise on actions [rad]."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import io
import itertools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase, ParallelEnv

from aslip.base.tables import markdown
from aslip.envs import ON_TRUTH
from aslip.robot import CASSIE
from aslip.robot.model import physics_timesteps
from aslip.sim import SimulationPool, Simulations
from aslip.training.collectors import LocalCollector
from aslip.transforms import ActionDelta
from benchmarks.common import MakeEnv, Policy, Subject
from recipes import ppo_aslip
from recipes.ppo_presets import environments

_BOUND, _LEADER = "`mj_step` (bound)", "environment, all transforms"
_PAUSE = 0.01  # [s]
# largest number of policy steps of a robot in a round
_MOST_STEPS = 64
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class Bound:
    """Upper bound: bare `mj_step` on a number of threads."""

    def __init__(self, model: mujoco.MjModel, num_threads: int) -> None:
        self.model = model
        self.data = [mujoco.MjData(model) for _ in range(num_threads)]
        self.pool = ThreadPoolExecutor(num_threads)

    def advance(self, states: np.ndarray) -> None:
        """Simulate one policy period from each row of (n, k) states."""
        shares = np.array_split(states, len(self.data))
        list(self.pool.map(self._run, self.data, shares))

    def _run(self, data: mujoco.MjData, states: np.ndarray) -> None:
        physics = mujoco.mj_stateSize(self.model, _STATE)
        for state in states[:, :physics]:
            mujoco.mj_setState(self.model, data, state, _STATE)
            mujoco.mj_step(self.model, data, CASSIE.substeps)


class Candidates:
    """Upper bound, bare simulations and environments with transforms, in the same states."""

    def __init__(self, num_envs: int, num_threads: int, config: Config, subject: Subject) -> None:
        batch = partial(subject.env, num_envs, seed=0, num_threads=num_threads)
        self.leader = batch()
        self.envs: dict[str, EnvBase] = {
            "environment, true state": batch(**ON_TRUTH),
            _LEADER: self.leader,
            "environment, physics at 1 kHz": batch(timestep=physics_timesteps()[1]),
        }
        self.pools = [_pool(env) for env in self.envs.values()]
        if num_envs <= config.single:
            self.envs["dm_control, all transforms"] = subject.env(
                num_envs, seed=0, backend="dm_control"
            )
            one = partial(subject.env, 1, num_threads=1)
            self.envs["ParallelEnv of single robots"] = ParallelEnv(num_envs, one)
        self.bare = SimulationPool(num_envs, num_threads=num_threads)
        self.bound = Bound(self.bare.model, num_threads)
        transforms = self.leader.transforms
        self.baseline_key = next(t.baseline_key for t in transforms if isinstance(t, ActionDelta))
        self.policy = subject.policy
        self.std = config.action_std
        self.states = {name: env.reset() for name, env in self.envs.items()}

    def step(self) -> dict[str, float]:
        """Take a policy step of each from the leader's states; returns times [s] by name."""
        states = _pool(self.leader).states()
        for pool in self.pools:
            pool.set_states(states)
        td = self.states[_LEADER]
        with torch.no_grad():
            self.policy(td)
        td["action"] += self.std * torch.randn(td["action"].shape)
        for other in self.states.values():
            other["action"] = td["action"].reshape(*other.batch_size, -1).clone()
        targets = np.asarray(td[self.baseline_key] + td["action"], dtype=np.float64)
        seconds = {_BOUND: _timed(lambda: self.bound.advance(states))}
        bare = {
            "`mujoco.batch`, 60 steps a call": partial(self._step_batches, CASSIE.substeps),
            "`mujoco.batch`, one step a call": partial(self._step_batches, 1),
            "simulations: sensors, drive, delay, checks": partial(self.bare.advance, targets),
        }
        for name, call in bare.items():
            self.bare.set_states(states)
            seconds[name] = _timed(call)
        for name in self.envs:
            seconds[name] = _timed(lambda name=name: self._step_env(name))
        return seconds

    def close(self) -> None:
        """End threads and processes."""
        for env in self.envs.values():
            env.close()

    def _step_batches(self, steps: int) -> None:
        """Simulate a policy period of the bare simulations, a number of substeps per call."""

        def run(part: Simulations) -> None:
            for _ in range(0, CASSIE.substeps, steps):
                part.batch.step(nstep=steps)

        list(self.bound.pool.map(run, self.bare.parts))

    def _step_env(self, name: str) -> None:
        _, following = self.envs[name].step_and_maybe_reset(self.states[name])
        assert isinstance(following, TensorDictBase)
        self.states[name] = following


def _pool(env: EnvBase) -> SimulationPool:
    pool = env.base_env.simulations
    assert isinstance(pool, SimulationPool)
    return pool


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> None:
    """Measure and print.

    Args:
        config: the settings.
        policy: policy that walks; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    subject = Subject.load(policy or config.policy, make_env)
    torch.manual_seed(0)
    torch.set_num_threads(1)
    columns = " | ".join(
        f"{n} thread{'s' * (n > 1)}: steps/s | of bound" for n in config.num_threads
    )
    print(f"| N | candidate | {columns} |\n|---:|---|{'---:|---:|' * len(config.num_threads)}")
    for num_envs in config.num_envs:
        steps = min(max(1, config.robot_steps // num_envs), _MOST_STEPS)
        cells: dict[str, list[str]] = {}
        for num_threads in config.num_threads:
            with closing(Candidates(num_envs, num_threads, config, subject)) as candidates:
                candidates.step()  # warm up
                rounds = [_round(candidates, steps) for _ in range(config.rounds)]
            for name in rounds[0]:
                rate = statistics.median(num_envs * steps / r[name] for r in rounds)
                share = statistics.median(r[_BOUND] / r[name] for r in rounds)
                cells.setdefault(name, []).extend([f"{rate:.0f}", f"{100 * share:.0f} %"])
        for name, row in cells.items():
            print(f"| {num_envs} | {name} | {' | '.join(row)} |", flush=True)
    if config.updates:
        print("\n" + update_table(config))


class TimedCollector(LocalCollector):
    """Collector that records when batches are requested and delivered [s]."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.spans: list[tuple[float, float]] = []

    def __iter__(self) -> Iterator[TensorDict]:
        batches, asked = super().__iter__(), time.perf_counter()
        for batch in batches:
            self.spans.append((asked, time.perf_counter()))
            yield batch
            asked = time.perf_counter()


def update_table(config: Config) -> str:
    """Table of times that a training spends on collection and learning."""
    header = ["settings", "samples", "collection [s]", "learning [s]", "share of learning"]
    rows = []
    presets = {n: p for n, p in ppo_aslip.PRESETS.items() if p.backend == "batch"}
    for name, preset in presets.items():
        training = replace(preset, num_envs=min(preset.num_envs, preset.samples))
        spans = time_iterations(training, config.rounds)
        # the first batch only initialises the normaliser
        collecting = [delivered - asked for asked, delivered in spans[2:]]
        learning = [after[0] - before[1] for before, after in itertools.pairwise(spans[1:])]
        share = statistics.median(u / (c + u) for c, u in zip(collecting, learning, strict=True))
        cells = [name, str(training.samples)]
        cells += [f"{statistics.median(times):.2f}" for times in (collecting, learning)]
        rows.append([*cells, f"{100 * share:.0f} %"])
    return markdown(header, rows, ["---", *["---:"] * 4])


def time_iterations(config: ppo_aslip.Config, number: int) -> list[tuple[float, float]]:
    """Instants at which a training requested and got each of its first batches [s].

    Args:
        config: its settings.
        number: number of iterations timed, after one of warm-up.
    """
    made: list[TimedCollector] = []

    def make_collector(*args: Any, **settings: Any) -> TimedCollector:
        made.append(TimedCollector(*args, **settings))
        return made[-1]

    nowhere = io.StringIO()
    silent = redirect_stdout(nowhere), redirect_stderr(nowhere)
    with tempfile.TemporaryDirectory() as folder, silent[0], silent[1]:
        short = replace(
            config, out=Path(folder), total_steps=config.samples * (number + 1),
            eval_interval=10**9, eval_steps=1, checkpoint_minutes=1e6,
        )  # fmt: skip
        ppo_aslip.main(short, **environments(short), make_collector=make_collector)
    return made[0].spans


def _round(candidates: Candidates, steps: int) -> dict[str, float]:
    """Time of a number of policy steps [s], by candidate."""
    total: dict[str, float] = {}
    for _ in range(steps):
        for name, seconds in candidates.step().items():
            total[name] = total.get(name, 0.0) + seconds
    return total


def _timed(call: Callable[[], object]) -> float:
    # torch's threads spin briefly after their work, which would slow the next candidate
    time.sleep(_PAUSE)
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
