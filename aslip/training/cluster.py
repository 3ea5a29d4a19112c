"""Samples from robots in several processes on this machine, or on a cluster.

    with RayCollectors(make_env, actor, num_envs=256, samples=2048, num_collectors=8) as collector:
        for data in collector:
            ...  # train the actor; the updated actor collects the next batch

| class | robots are in | needs |
|---|---|---|
| `DistributedCollectors` | processes on this machine, connected by gloo | |
| `RayCollectors` (`aslip.training.ray`) | Ray actors, here or on a cluster | `aslip[ray]` |

On a cluster the package must be installed on every machine, in the same version:

    ray start --head                            # on one
    ray start --address=HOST:6379               # on each of the others
    RAY_ADDRESS=HOST:6379 python recipes/ppo_cluster.py --num-collectors 8

If Ray asks for a token, print it on the first machine with `ray get-auth-token`, and pass it to the
other machines and the recipe as `RAY_AUTH_MODE=token RAY_AUTH_TOKEN=...`. Without `RAY_ADDRESS` the
collector starts its own Ray on the loopback address, without dashboard and usage statistics, and
stops it at the end.

Guarantees:

- A batch is (num_envs, T), time last. Each row is a robot of one collector, and the rows of a
  collector are adjacent.
- All steps of a batch use the actor's weights and normaliser at the time of the request for it.
- The same seed, number of collectors and number of robots give the same batches.
- After `shutdown`, all worker processes have ended. They also end when this process ends, even if
  it is killed; two agents of a killed Ray take up to a minute.

Traps:

- Processes are spawned: a script must start training under `if __name__ == "__main__":`.
- Only the entries for learning are sent: `SENT`, and the inputs of the actor.
- A resumed training begins new episodes, with new random numbers.
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
from aslip.processes import ENDINGS, end_with_parent, processors
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
"""Entries of a batch that are sent to the learner, if the stack has them."""

ENDLESS: Final = 2**62
"""Frames of an endless collector; TorchRL's multi-process collectors stop at once with -1."""
_PATIENCE = 10.0  # time from SIGTERM to SIGKILL [s]


class RemoteCollectors:
    """Base class of collectors with robots in worker processes, which start at the first batch.

    Args:
        make_env: makes the environment; must be picklable with cloudpickle.
        actor: the policy.
        num_envs: total number of robots.
        samples: total number of policy steps of a batch.
        num_collectors: number of processes, each with the same number of robots.
        seed: seed of environments and actions.
        device: device of the batches; only the CPU is supported.

    Raises:
        ConfigurationError: robots or samples cannot be divided equally, or the device is not the
            CPU.
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
        self._batches = 0  # including those before a resume

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
        except Exception as error:  # the type of exception depends on how the process was lost
            raise CollectorError(
                f"a collector was lost{self._lost()} ({type(error).__name__}: {error})"
            ) from error

    def state_dict(self) -> dict[str, Any]:
        """State: the number of batches, without the robots."""
        return {"batches": self._batches}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue the count of batches, so that random numbers are new."""
        self._batches = state["batches"]

    def shutdown(self) -> None:
        """End all simulations and processes; may be called more than once."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()

    def _start(self) -> BaseCollector:
        """Start the processes."""
        raise NotImplementedError

    def _lost(self) -> str:
        """Details of the lost processes, for the error message."""
        return ""

    def _robots(self, num_threads: int) -> list[Robots]:
        """Functions that make the robots, one per collector."""
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

    TorchRL's launchers `submitit` and `submitit_delayed`, which start processes on other machines
    through SLURM, are untested and not supported.
    """

    _processes: tuple[Any, ...] = ()

    def _start(self) -> BaseCollector:
        before = set(multiprocessing.active_children())
        try:
            # TorchRL also collects a batch in this process to find its entries, which must not
            # change the random numbers of the training
            with torch.random.fork_rng(devices=[]):
                return Collector(
                    self._robots(max(1, processors() // self._num)),
                    self._actor,
                    # a module that is sent directly would share its memory with the process
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
        """End the processes; TorchRL's method takes 6 s, and fails if one has already ended."""
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
    """Function that makes the robots of one collector; unpickling it prepares the worker process.

    Args:
        make_env: makes the environment from the keyword `seed`.
        entropy: numbers from which seeds are derived.
    """

    def __init__(self, make_env: Callable[..., StackEnv], entropy: list[int]) -> None:
        self._make_env = make_env
        seeds = np.random.SeedSequence(entropy).generate_state(2)
        self.env_seed, self.torch_seed = map(int, seeds)
        self._arrived = False  # set when unpickled, which happens in a worker process

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arrived = True

    def __call__(self) -> StackEnv:
        """Make the robots, and seed their random numbers and those of actions."""
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
    """Ignore signals to all processes of a terminal or job, and exit when the parent has ended.

    The parent handles them, and sends SIGTERM.
    """
    if threading.current_thread() is threading.main_thread():
        for number in {signal.SIGINT, *ENDINGS} - {signal.SIGTERM}:
            signal.signal(number, signal.SIG_IGN)
    end_with_parent()


def select_sent(data: TensorDictBase, keys: list[NestedKey]) -> TensorDictBase:
    """Entries of a batch to send, contiguous, as gloo requires."""
    return data.select(*keys, strict=False).contiguous()


def _joined(batches: tuple[TensorDictBase, ...]) -> TensorDict:
    """Concatenate the batches of all collectors along the robots."""
    data = cast("TensorDict", torch.cat(batches, 0))
    data.names = [None] * (data.ndim - 1) + ["time"]
    return data


class _Blank:
    """Function that makes copies of a policy without weights; the weights are sent afterwards.

    It keeps the pickled arguments of a process small. If they do not fit into the pipe, the parent
    waits until the process has finished its imports before it starts the next one.
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
    """Unused port, or the one in the environment variable TCP_PORT."""
    if port := os.environ.get("TCP_PORT"):
        return int(port)
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]
