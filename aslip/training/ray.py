"""Samples from robots in Ray actors, on this machine or on several.

    with RayCollectors(make_env, actor, num_envs=256, samples=2048, num_collectors=8) as collector:
        for data in collector:
            ...  # train the actor; the updated actor collects the next batch

The page on training says how to start Ray on several machines. Without `RAY_ADDRESS` the collector
starts its own Ray on the loopback address, without dashboard and usage statistics, and stops it at
the end.

Guarantees:

- A batch is (num_envs, T), time last. Each row is a robot of one actor, and the rows of an actor
  are adjacent.
- All steps of a batch use the policy's weights and normaliser at the time of the request for it.
- The same seed, number of actors and number of robots give the same batches.
- After `shutdown`, all processes have ended. They also end when this process ends, even if it is
  killed; two agents of a killed Ray take up to a minute.

Traps:

- Only the entries for learning are sent, see `RayCollectors.sent`.
- A resumed training begins new episodes, with new random numbers.
- Ray and TorchRL listen without authentication, unless Ray has a token: a shared network needs a
  firewall.
"""

from __future__ import annotations

import importlib
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from operator import methodcaller
from typing import Any, Final, cast

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.utils import NestedKey, unravel_key
from torch import nn
from torchrl.collectors import BaseCollector, Collector

from aslip.base.imports import extras
from aslip.base.processes import processors
from aslip.envs import StackEnv
from aslip.envs.stack_env import random_seed
from aslip.errors import CollectorError, ConfigurationError
from aslip.policy import add_memory
from aslip.training.collectors import TORCHRL_SETTINGS
from aslip.training.environments import MakeEnv
from aslip.training.settings import check_shares
from aslip.transforms import Difficulty

SENT: Final[tuple[NestedKey, ...]] = (
    "action",
    "action_log_prob",
    "stagger",
    ("next", "reward"),
    ("next", "reward_terms"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "truncated"),
    ("next", "step_count"),
    ("next", "episode_reward"),
    ("next", "truth", "diverged"),
)
"""Entries of every batch for the learner."""

# Ray's object store [byte]; it holds the stack with its library, and batches of 1.3 MB
_STORE = 2**29
# frames of an endless collector
_ENDLESS = 2**62


class RayCollectors(AbstractContextManager[Any]):
    """Robots in Ray actors, by TorchRL's `RayCollector`; they start at the first batch.

    Args:
        make_env: makes the environment; must be picklable with cloudpickle.
        actor: the policy.
        num_envs: total number of robots.
        samples: total number of policy steps of a batch.
        num_collectors: number of actors, each with the same number of robots.
        seed: seed of environments and actions, by default its own.
        device: device of the batches; only the CPU is supported.
        keys: entries that are sent with their successors, such as the inputs of the critic.

    Raises:
        MissingExtraError: Ray is not installed.
        ConfigurationError: robots or samples cannot be divided equally, or the device is not the
            CPU.
    """

    _collector: BaseCollector | None = None
    _ours = False

    def __init__(
        self,
        make_env: MakeEnv,
        actor: nn.Module,
        *,
        num_envs: int,
        samples: int,
        num_collectors: int = 2,
        seed: int | None = None,
        device: str | torch.device = "cpu",
        keys: Sequence[NestedKey] = ("observation",),
    ) -> None:
        with extras():
            importlib.import_module("ray")
        check_shares(num_envs, samples, num_collectors)
        if torch.device(device).type != "cpu":
            raise ConfigurationError(f"robots in other processes need device='cpu', got {device}")
        self._make_env, self._actor = make_env, actor
        self._share = num_envs // num_collectors
        self._samples, self._num = samples, num_collectors
        self._seed = random_seed() if seed is None else seed
        following = [unravel_key(("next", key)) for key in keys]
        self.sent: list[NestedKey] = [*SENT, *getattr(actor, "in_keys", ()), *keys, *following]
        """Entries of a batch that are sent, if the stack has them."""
        self._batches = 0  # including those before a resume

    def __iter__(self) -> Iterator[TensorDict]:
        try:
            collector = self._start()
            batches = iter(collector)
            while True:
                collector.update_policy_weights_(self._actor)
                data = next(batches).unbind(0)
                self._batches += 1
                batch = cast("TensorDict", torch.cat(data, 0))
                batch.names = [None] * (batch.ndim - 1) + ["time"]
                yield batch
        except (ConfigurationError, GeneratorExit):
            raise
        except Exception as error:  # of any type, whether Ray cannot be joined or lost a process
            raise CollectorError(f"Ray failed ({type(error).__name__}: {error})") from error

    def state_dict(self) -> dict[str, int]:
        """State: the number of batches, without the robots."""
        return {"batches": self._batches}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue the count of batches, so that random numbers are new.

        The state may be that of a `LocalCollector`, too.
        """
        local = "torchrl" in state
        self._batches = state["torchrl"]["frames"] // self._samples if local else state["batches"]

    def shutdown(self) -> None:
        """End the actors, and Ray if this collector started it; may be called more than once."""
        if self._collector is not None:
            self._collector.shutdown()
            self._collector = None
        if self._ours:
            importlib.import_module("ray").shutdown()
            self._ours = False

    def __exit__(self, *exception: object) -> None:
        self.shutdown()

    def _start(self) -> BaseCollector:
        """Start the actors."""
        ray = importlib.import_module("ray")
        if not ray.is_initialized():
            self._ours = True
            with _signals_kept():
                _join_ray(ray, self._num)
        free = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        threads = threads_each(free, self._num)
        # stored once for all actors, as a stack may hold a large library
        made = ray.put((self._make_env, self._actor))
        settings = {"num_envs": self._share, "num_threads": threads}
        steps = self._batches * self._samples // (self._num * self._share)
        self._collector = Collector(
            [
                partial(make_robots, made, [self._seed, self._batches, index], steps, **settings)
                for index in range(self._num)
            ],
            self._actor,
            frames_per_batch=self._samples,
            total_frames=_ENDLESS,
            backend="ray",
            sync=True,
            backend_options={
                "collector_kwargs": {
                    **TORCHRL_SETTINGS,
                    "postproc": methodcaller("select", *self.sent, strict=False),
                },
                "remote_configs": {"num_cpus": threads, "scheduling_strategy": "SPREAD"},
            },
        )
        return self._collector


def make_robots(made: Any, entropy: list[int], steps: int, **settings: Any) -> StackEnv:
    """Make the robots of one actor in its process, and seed them and its actions.

    Args:
        made: Ray's reference to the function that makes the environment, and the policy.
        entropy: numbers from which the seeds follow.
        steps: policy steps of each robot before a resume, for its difficulty.
        settings: keywords of the function.
    """
    make_env, policy = importlib.import_module("ray").get(made)
    torch.set_num_threads(1)
    env_seed, torch_seed = map(int, np.random.SeedSequence(entropy).generate_state(2))
    env = add_memory(make_env(seed=env_seed, **settings), policy)
    for transform in env.transforms:
        if isinstance(transform, Difficulty):
            transform.resume(steps)
    # torch's global generator draws actions
    torch.manual_seed(torch_seed)
    return env


def _join_ray(ray: Any, num_collectors: int) -> None:
    """Join the cluster at `RAY_ADDRESS`, or start Ray on this machine."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if address := os.environ.get("RAY_ADDRESS"):
        ray.init(address=address, log_to_driver=False)
        return
    ray.init(
        address="local",
        num_cpus=max(processors(), num_collectors),
        object_store_memory=_STORE,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="warning",
        _node_ip_address="127.0.0.1",
    )


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Context in which Ray cannot replace the handler of SIGTERM."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def threads_each(processors: list[int], num_collectors: int) -> int:
    """Largest number of physics threads that every collector can have.

    Args:
        processors: number of processors of each machine.
        num_collectors: number of collectors.

    Raises:
        ConfigurationError: there are fewer processors than collectors; Ray would wait for more.
    """
    for threads in range(max(processors, default=0), 0, -1):
        if sum(number // threads for number in processors) >= num_collectors:
            return threads
    raise ConfigurationError(
        f"num_collectors must be at most {sum(processors)}, the processors of the Ray cluster, got"
        f" {num_collectors}"
    )
