"""What collectors have in common whose robots are in other processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Final, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import nn
from torchrl.collectors import BaseCollector

from aslip.envs import StackEnv
from aslip.errors import CollectorError, ConfigurationError
from aslip.training.collect.base import SampleCollector

SENT: Final[tuple[NestedKey, ...]] = (
    "observation",
    "action",
    "action_log_prob",
    "stagger",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "reward_terms"),
    ("next", "done"),
    ("next", "terminated"),
    ("next", "truncated"),
    ("next", "step_count"),
    ("next", "episode_reward"),
    ("next", "truth", "diverged"),
)
"""Entries of a batch that leave the process they were made in; those that its stack has."""

# TorchRL's collectors of several processes take -1, which should be endless, for an end at once
ENDLESS: Final = 2**62
"""Frames of a collector that goes on and on."""


class RemoteCollectors(SampleCollector):
    """Robots in other processes, which begin with the first batch.

    Args:
        make_env: see `make_collector`, as all others.
        actor: the policy.
        num_envs: robots.
        samples: policy steps of a batch.
        num_collectors: collectors.
        seed: of environments and actions.
    """

    def __init__(
        self,
        make_env: Callable[..., StackEnv],
        actor: nn.Module,
        num_envs: int,
        samples: int,
        num_collectors: int,
        seed: int,
    ) -> None:
        self._make_env, self._actor = make_env, actor
        self._share = num_envs // num_collectors
        self._samples, self._num, self._seed = samples, num_collectors, seed
        self._batches = 0  # also of the run before this one

    def __iter__(self) -> Iterator[TensorDict]:
        try:
            collector = self._start()
            batches = iter(collector)
            while True:
                collector.update_policy_weights_(self._actor)
                data = next(batches).unbind(0)
                self._batches += 1
                yield _joined(data)
        except (ConfigurationError, GeneratorExit):
            raise
        except Exception as error:  # one cause, a lost process, has many exceptions
            raise CollectorError(
                f"a collector was lost{self._lost()} ({type(error).__name__}: {error})"
            ) from error

    def state_dict(self) -> dict[str, Any]:
        """The number of batches; what robots do now is not in it."""
        return {"batches": self._batches}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Count on, for other random numbers than before."""
        self._batches = state["batches"]

    @abstractmethod
    def _start(self) -> BaseCollector:
        """Begin to collect."""

    def _lost(self) -> str:
        """What is known of those who were lost."""
        return ""

    def _robots(self, num_threads: int) -> list[Robots]:
        """What makes the robots of each collector."""
        return [
            Robots(
                partial(self._make_env, num_envs=self._share, num_threads=num_threads),
                [self._seed, self._batches, index],
            )
            for index in range(self._num)
        ]


class Robots:
    """Makes the robots of one collector, and prepares the process that it arrives in."""

    def __init__(self, make_env: Callable[..., StackEnv], entropy: list[int]) -> None:
        self._make_env = make_env
        seeds = np.random.SeedSequence(entropy).generate_state(2)
        self.env_seed, self.torch_seed = map(int, seeds)
        self._arrived = False  # in a process of its own

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arrived = True

    def __call__(self) -> StackEnv:
        """The robots, with what is drawn for them and their actions seeded."""
        if self._arrived:
            torch.set_num_threads(1)
            _follow_parent()
        env = self._make_env(seed=self.env_seed)
        # for actions, which torch's global generator draws
        torch.manual_seed(self.torch_seed)
        return env


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when it has."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def sent(data: TensorDictBase) -> TensorDictBase:
    """What of a batch is sent; gloo takes contiguous tensors only."""
    return data.select(*SENT, strict=False).contiguous()


def _joined(batches: tuple[TensorDictBase, ...]) -> TensorDict:
    """One batch, rows after rows."""
    data = cast("TensorDict", torch.cat(batches, 0))
    data.names = [None] * (data.ndim - 1) + ["time"]
    return data
