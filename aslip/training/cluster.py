"""Samples from robots in several processes on this machine, or on a cluster.

    with RayCollectors(make_env, actor, num_envs=256, samples=2048, num_collectors=8) as collector:
        for data in collector:
            ...  # train the actor; the next batch is by what it is then

| class | robots are in | needs |
|---|---|---|
| `DistributedCollectors` | processes on this machine, connected by gloo | |
| `RayCollectors` (`aslip.training.ray`) | Ray actors, here or on a cluster | `aslip[ray]` |

On a cluster the package must be installed on every machine, in the same version:

    ray start --head                            # on one
    ray start --address=HOST:6379               # on each of the others
    RAY_ADDRESS=HOST:6379 python recipes/ppo_cluster.py --num-collectors 8

The first prints a token by `ray get-auth-token`; the others and the recipe need it where Ray asks
for one, as `RAY_AUTH_MODE=token RAY_AUTH_TOKEN=...`. Without `RAY_ADDRESS` a Ray of its own starts
on the loopback address, without dashboard and usage statistics, and ends with the collector.

Guarantees:

- a batch is (num_envs, T), time last; neighbouring rows are of the same collector, and no row has
  steps of two;
- the whole batch is by the weights and the normaliser that the actor has when it is asked for;
- the same seed, number of collectors and number of robots give the same batches;
- after `shutdown`, and at the latest when this process has ended, however, so have all others; two
  agents of a Ray that was killed need a minute to notice.

Traps:

- Processes are spawned: a script must not train at its import, but under
  `if __name__ == "__main__":`.
- Only what learning reads (`SENT`, and what the actor reads) is sent.
- A resumed training begins new episodes, with random numbers that no batch before has seen.
- TorchRL listens on all network interfaces, without authentication, while processes receive
  weights: a shared network needs a firewall.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import socket
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from functools import partial
from typing import Any, Final, Self, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import nn
from torchrl.collectors import BaseCollector, Collector

from aslip.envs import StackEnv
from aslip.errors import CollectorError, ConfigurationError
from aslip.policy import add_memory, is_recurrent
from aslip.sim.pool import processors
from aslip.training.collectors import TORCHRL_SETTINGS
from aslip.training.environments import MakeEnv
from aslip.training.settings import check_shares

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
"""Entries of a batch that are sent to the learner, where the stack has them."""

ENDLESS: Final = 2**62
"""Frames of an endless collector; of several processes, TorchRL's end at once for -1."""
_PATIENCE = 10.0  # [s] from SIGTERM to SIGKILL


class RemoteCollectors:
    """Base of collectors whose robots are in other processes, which start with the first batch.

    Args:
        make_env: makes the environment; must be picklable with cloudpickle.
        actor: the policy.
        num_envs: robots of all collectors together.
        samples: policy steps of a batch, of all robots together.
        num_collectors: processes that robots are shared out to.
        seed: seed of environments and actions.
        device: must be the CPU, where batches arrive.

    Raises:
        ConfigurationError: robots and samples cannot be shared out equally, or the device is
            another.
    """

    def __init__(
        self,
        make_env: MakeEnv,
        actor: nn.Module,
        *,
        num_envs: int,
        samples: int,
        num_collectors: int = 2,
        seed: int = 0,
        device: str | torch.device = "cpu",
    ) -> None:
        check_shares(num_envs, samples, num_collectors)
        if torch.device(device).type != "cpu":
            raise ConfigurationError(f"robots in other processes need device='cpu', got {device}")
        if is_recurrent(actor):
            make_env = partial(_make_with_memory, make_env, deepcopy(actor))
        self._make_env, self._actor = make_env, actor
        self._share = num_envs // num_collectors
        self._samples, self._num, self._seed = samples, num_collectors, seed
        self._batches = 0  # including those before a resumption

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
        except Exception as error:  # a lost process shows as one of many exceptions
            raise CollectorError(
                f"a collector was lost{self._lost()} ({type(error).__name__}: {error})"
            ) from error

    def state_dict(self) -> dict[str, Any]:
        """Number of batches; robots are not in it."""
        return {"batches": self._batches}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue the count, so that random numbers differ from those before."""
        self._batches = state["batches"]

    def shutdown(self) -> None:
        """End all simulations and processes; may be called more than once."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()

    def _start(self) -> BaseCollector:
        """Start to collect."""
        raise NotImplementedError

    def _lost(self) -> str:
        """Clause about the processes that were lost."""
        return ""

    def _robots(self, num_threads: int) -> list[Robots]:
        """Makers of the robots of each collector."""
        return [
            Robots(
                partial(self._make_env, num_envs=self._share, num_threads=num_threads),
                [self._seed, self._batches, index],
            )
            for index in range(self._num)
        ]

    def _collector_settings(self) -> dict[str, Any]:
        keys = [*SENT, *getattr(self._actor, "in_keys", ())]
        return {**TORCHRL_SETTINGS, "postproc": partial(select_sent, keys=keys)}


class DistributedCollectors(RemoteCollectors):
    """Robots in processes on this machine, by TorchRL's `DistributedCollector` over gloo.

    TorchRL could start its processes on other machines by SLURM (its launchers `submitit` and
    `submitit_delayed`), which is not tested and not offered here.
    """

    _processes: tuple[Any, ...] = ()

    def _start(self) -> BaseCollector:
        before = set(multiprocessing.active_children())
        try:
            # TorchRL collects a batch in this process, too, to see its entries; training must not
            # draw other numbers for that
            with torch.random.fork_rng(devices=[]):
                return Collector(
                    self._robots(max(1, processors() // self._num)),
                    self._actor,
                    # a module that is sent as it is shares its memory with the process
                    policy_factory=_Blank(self._actor),
                    frames_per_batch=self._samples,
                    total_frames=ENDLESS,
                    backend="distributed",
                    sync=True,
                    backend_options={
                        "launcher": "mp",
                        "backend": "gloo",
                        "tcp_port": _free_port(),
                        "collector_kwargs": self._collector_settings(),
                    },
                )
        finally:
            self._processes = tuple(set(multiprocessing.active_children()) - before)

    def _lost(self) -> str:
        codes = sorted(process.exitcode for process in self._processes if process.exitcode)
        return f", exit codes {codes}" if codes else ""

    def shutdown(self) -> None:
        """End the processes; TorchRL's way takes 6 s, or fails if one has ended already."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join(_PATIENCE)
            process.kill()
            process.join()
        self._processes = ()
        if torch.distributed.is_initialized():
            torch.distributed.destroy_process_group()


# ------------------------------------------------------------------- in the processes


class Robots:
    """Makes the robots of one collector, and prepares the process that it arrives in.

    Args:
        make_env: makes the environment, of the keyword `seed`.
        entropy: numbers that seeds are derived from.
    """

    def __init__(self, make_env: Callable[..., StackEnv], entropy: list[int]) -> None:
        self._make_env = make_env
        seeds = np.random.SeedSequence(entropy).generate_state(2)
        self.env_seed, self.torch_seed = map(int, seeds)
        self._arrived = False  # in a process of its own

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arrived = True

    def __call__(self) -> StackEnv:
        """Make the robots, their random numbers and those of actions seeded."""
        if self._arrived:
            torch.set_num_threads(1)
            _follow_parent()
        env = self._make_env(seed=self.env_seed)
        # torch's global generator draws actions
        torch.manual_seed(self.torch_seed)
        return env


def _make_with_memory(make_env: MakeEnv, actor: nn.Module, **settings: Any) -> StackEnv:
    return add_memory(make_env(**settings), actor)


def _follow_parent() -> None:
    """Leave Ctrl-C to the parent, and end when it has ended."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def select_sent(data: TensorDictBase, keys: list[NestedKey]) -> TensorDictBase:
    """Entries of a batch that are sent; gloo takes contiguous tensors only."""
    return data.select(*keys, strict=False).contiguous()


def _joined(batches: tuple[TensorDictBase, ...]) -> TensorDict:
    """One batch, rows after rows."""
    data = cast("TensorDict", torch.cat(batches, 0))
    data.names = [None] * (data.ndim - 1) + ["time"]
    return data


class _Blank:
    """Makes copies of a policy without weights, which are sent when processes are connected.

    The pickled policy is small: a process starts only after the one before it has read its
    arguments, which takes as long as its imports if they do not fit a pipe.
    """

    def __init__(self, actor: nn.Module) -> None:
        blank = deepcopy(actor)
        with torch.no_grad():
            for parameter in blank.parameters():
                parameter.zero_()
        self._pickled = zlib.compress(pickle.dumps(blank))

    def __call__(self) -> nn.Module:
        return pickle.loads(zlib.decompress(self._pickled))


def _free_port() -> int:
    """Unused port, or that of the environment variable TCP_PORT."""
    if port := os.environ.get("TCP_PORT"):
        return int(port)
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]
