"""Samples from robots in this process, in several processes, or on several machines.

    collector = make_collector(make_env, actor, kind="ray", num_envs=256, samples=2048)
    with collector:
        for data in collector:
            ...  # train the actor; the next batch is by what it is then

| kind | robots are in | needs |
|---|---|---|
| `single` | this process | |
| `distributed` | processes on this machine, which speak gloo | |
| `ray` | actors on this machine, or on a cluster | `pip install 'aslip[ray]'` |

On a cluster the package must be installed on every machine, in the same version:

    ray start --head                            # on one
    ray start --address=HOST:6379               # on each of the others
    RAY_ADDRESS=HOST:6379 python recipes/ppo_aslip.py --collector ray --num-collectors 8

The first prints a token by `ray get-auth-token`; the others and the recipe need it where Ray asks
for one, as `RAY_AUTH_MODE=token RAY_AUTH_TOKEN=...`.

Without `RAY_ADDRESS` a Ray of its own begins on the loopback address, without dashboard and usage
statistics, and ends with the collector.

Guarantees, for all kinds:

- a batch is (num_envs, T), time last; neighbouring rows are of the same collector, and no row has
  steps of two;
- the whole batch is by the weights and the normaliser that the actor has when it is asked for;
- the same seed leads to the same batches, with as many collectors and robots;
- after `shutdown`, and at the latest when this process has ended, however, so have all others; of a
  Ray that was killed, two agents take a minute to see it.

Traps:

- Processes are spawned: a script must not train at its import, but under
  `if __name__ == "__main__":`.
- Only what learning reads (`SENT`) is sent; a batch of `single` has everything.
- The state of `single` resumes exactly. That of others holds how many batches there were: their
  robots begin new episodes, with random numbers that no batch before has seen.
- TorchRL listens on all network interfaces, and asks no one who they are, while processes are told
  weights: a network that others share needs a firewall.
"""

from __future__ import annotations

import importlib
import importlib.util
import multiprocessing
import os
import pickle
import signal
import socket
import threading
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from typing import Any, Final, Literal, Self, cast, get_args

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import nn
from torchrl.collectors import BaseCollector, Collector

from aslip.checkpoint import CollectorState
from aslip.errors import CollectorError, ConfigurationError
from aslip.sim.pool import processors
from aslip.stack import CassieTransformedEnv

CollectorKind = Literal["single", "distributed", "ray"]

SENT: Final[tuple[NestedKey, ...]] = (
    "observation",
    "action",
    "action_log_prob",
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

_SETTINGS: dict[str, Any] = {"trust_policy": True, "auto_register_policy_transforms": False}
# TorchRL's other collectors take -1, which should be endless, for an end at once
_ENDLESS = 2**62
# of Ray's store of objects [byte]; a batch of 2048 samples has 1.3 MB
_RAY_STORE = 2**29
_PATIENCE = 10.0  # [s] from SIGTERM to SIGKILL


def make_collector(
    make_env: Callable[..., CassieTransformedEnv],
    actor: nn.Module,
    *,
    kind: CollectorKind = "single",
    num_envs: int,
    samples: int,
    num_collectors: int = 2,
    seed: int = 0,
) -> SampleCollector:
    """What yields batches of samples that the actor took, on and on.

    Args:
        make_env: of keywords `num_envs`, `seed` and `num_threads`, as `aslip.make_env`; must be
            possible to pickle with cloudpickle, unless for `single`.
        actor: the policy, in this process.
        kind: where robots are, see above.
        num_envs: robots, of all collectors together.
        samples: policy steps of a batch, of all robots together.
        num_collectors: processes or actors to share robots out to, unless for `single`.
        seed: of their environments and actions; those of `single` have the seed of `make_env`, and
            torch's.

    Raises:
        ConfigurationError: unknown kind; Ray is not installed; or robots and samples cannot be
            shared out equally.
    """
    if kind not in get_args(CollectorKind):
        kinds = get_args(CollectorKind)
        raise ConfigurationError(f"collector must be one of {kinds}, got {kind!r}")
    if kind == "single":
        return LocalCollector(make_env(num_envs=num_envs), actor, samples)
    check_shares(num_envs, samples, num_collectors)
    if kind == "ray" and importlib.util.find_spec("ray") is None:
        raise ConfigurationError("the collector 'ray' needs Ray: pip install 'aslip[ray]'")
    remote = DistributedCollectors if kind == "distributed" else RayCollectors
    return remote(make_env, actor, num_envs, samples, num_collectors, seed)


def check_shares(num_envs: int, samples: int, num_collectors: int) -> None:
    """Check that each collector gets as many robots, and each robot as many samples.

    Raises:
        ConfigurationError: it does not.
    """
    if num_collectors < 1:
        raise ConfigurationError(f"num_collectors must be 1 or more, got {num_collectors}")
    if num_envs % num_collectors:
        raise ConfigurationError(
            f"num_envs must be a multiple of num_collectors = {num_collectors}, got {num_envs}"
        )
    if samples % num_envs:
        raise ConfigurationError(
            f"samples must be a multiple of num_envs = {num_envs}, got {samples}"
        )


class SampleCollector(ABC):
    """Batches of samples, on and on; a context that ends with `shutdown`."""

    @abstractmethod
    def __iter__(self) -> Iterator[TensorDict]:
        """Batches (num_envs, T), each by the actor as it is when the batch is asked for.

        Raises:
            CollectorError: a process or an actor that collects was lost.
        """

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """What to go on from, between batches."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned, before the first batch."""

    @abstractmethod
    def shutdown(self) -> None:
        """End all simulations and processes; once or more often."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.shutdown()


class LocalCollector(SampleCollector):
    """Robots in this process; resumes bit for bit.

    Args:
        env: the robots.
        actor: the policy.
        samples: policy steps of a batch.
    """

    def __init__(self, env: CassieTransformedEnv, actor: nn.Module, samples: int) -> None:
        self._collector = Collector(
            env, actor, frames_per_batch=samples, total_frames=-1, **_SETTINGS
        )
        self._state = CollectorState(self._collector)

    def __iter__(self) -> Iterator[TensorDict]:
        return cast("Iterator[TensorDict]", iter(self._collector))

    def state_dict(self) -> dict[str, Any]:
        """The state of all simulations, see `CollectorState`."""
        return self._state.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state_dict` returned.

        Raises:
            ConfigurationError: it is of another environment.
        """
        self._state.load_state_dict(state)

    def shutdown(self) -> None:
        """Close the environment."""
        self._collector.shutdown()


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
        make_env: Callable[..., CassieTransformedEnv],
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

    def _robots(self, num_threads: int) -> list[_Robots]:
        """What makes the robots of each collector."""
        return [
            _Robots(
                partial(self._make_env, num_envs=self._share, num_threads=num_threads),
                [self._seed, self._batches, index],
            )
            for index in range(self._num)
        ]


class DistributedCollectors(RemoteCollectors):
    """Robots in processes on this machine, by TorchRL's `DistributedCollector` over gloo.

    TorchRL could start its processes on other machines by SLURM (its launchers `submitit` and
    `submitit_delayed`); that is not tested here, and not offered. Ray is.
    """

    _processes: tuple[Any, ...] = ()

    def _start(self) -> BaseCollector:
        before = set(multiprocessing.active_children())
        try:
            # TorchRL collects a batch in this process, too, to see what one looks like; training
            # must not draw other numbers for that
            with torch.random.fork_rng(devices=[]):
                return Collector(
                    self._robots(max(1, processors() // self._num)),
                    self._actor,
                    # a module that is sent as it is shares its memory with the process
                    policy_factory=_Blank(self._actor),
                    frames_per_batch=self._samples,
                    total_frames=_ENDLESS,
                    backend="distributed",
                    sync=True,
                    backend_options={
                        "launcher": "mp",
                        "backend": "gloo",
                        "tcp_port": _free_port(),
                        "collector_kwargs": {**_SETTINGS, "postproc": _sent},
                    },
                )
        finally:
            self._processes = tuple(set(multiprocessing.active_children()) - before)

    def _lost(self) -> str:
        codes = sorted(process.exitcode for process in self._processes if process.exitcode)
        return f", exit codes {codes}" if codes else ""

    def shutdown(self) -> None:
        """End the processes.

        TorchRL's way takes 6 s, or fails if one has ended already; they have nothing to lose.
        """
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join(_PATIENCE)
            process.kill()
            process.join()
        self._processes = ()
        if torch.distributed.is_initialized():
            torch.distributed.destroy_process_group()


class RayCollectors(RemoteCollectors):
    """Robots in actors of Ray, by TorchRL's `RayCollector`."""

    _collector: BaseCollector | None = None
    _ours = False

    def _start(self) -> BaseCollector:
        ray = importlib.import_module("ray")
        if not ray.is_initialized():
            self._ours = True
            with _signals_kept():
                _join_ray(ray, self._num)
        processors = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        threads = _threads(processors, self._num)
        self._collector = Collector(
            self._robots(threads),
            self._actor,
            frames_per_batch=self._samples,
            total_frames=_ENDLESS,
            backend="ray",
            sync=True,
            backend_options={
                "collector_kwargs": {**_SETTINGS, "postproc": _sent},
                "remote_configs": {"num_cpus": threads, "scheduling_strategy": "SPREAD"},
            },
        )
        return self._collector

    def shutdown(self) -> None:
        """End the actors, and Ray, if it began with them."""
        if self._collector is not None:
            self._collector.shutdown()
            self._collector = None
        if self._ours:
            importlib.import_module("ray").shutdown()
            self._ours = False


class _Blank:
    """Makes copies of a policy without weights, which are sent when processes are connected.

    Small, as a process is not started before the one before it has read all that it needs, which
    takes its imports if that does not fit a pipe.
    """

    def __init__(self, actor: nn.Module) -> None:
        blank = deepcopy(actor)
        with torch.no_grad():
            for parameter in blank.parameters():
                parameter.zero_()
        self._pickled = zlib.compress(pickle.dumps(blank))

    def __call__(self) -> nn.Module:
        return pickle.loads(zlib.decompress(self._pickled))


class _Robots:
    """Makes the robots of one collector, and prepares the process that it arrives in."""

    def __init__(self, make_env: Callable[..., CassieTransformedEnv], entropy: list[int]) -> None:
        self._make_env = make_env
        seeds = np.random.SeedSequence(entropy).generate_state(2)
        self.env_seed, self.torch_seed = map(int, seeds)
        self._arrived = False  # in a process of its own

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arrived = True

    def __call__(self) -> CassieTransformedEnv:
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


def _sent(data: TensorDictBase) -> TensorDictBase:
    """What of a batch is sent; gloo takes contiguous tensors only."""
    return data.select(*SENT, strict=False).contiguous()


def _joined(batches: tuple[TensorDictBase, ...]) -> TensorDict:
    """One batch, rows after rows."""
    data = cast("TensorDict", torch.cat(batches, 0))
    data.names = [None] * (data.ndim - 1) + ["time"]
    return data


def _join_ray(ray: Any, num_collectors: int) -> None:
    """Join the cluster of `RAY_ADDRESS`, or begin a Ray here.

    Raises:
        ConfigurationError: the cluster does not let us in.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    address = os.environ.get("RAY_ADDRESS")
    if address:
        try:
            ray.init(address=address, log_to_driver=False)
        except Exception as error:  # connection, token, version: Ray has one for each
            raise ConfigurationError(
                f"the Ray cluster at RAY_ADDRESS = {address!r} cannot be joined"
                f" ({type(error).__name__}: {error}); does it run, and are RAY_AUTH_MODE and"
                " RAY_AUTH_TOKEN those of its head?"
            ) from error
        return
    ray.init(
        address="local",
        num_cpus=max(processors(), num_collectors),
        object_store_memory=_RAY_STORE,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="warning",
        _node_ip_address="127.0.0.1",
    )


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Let the body, Ray, not take over what SIGTERM does to a training."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _threads(processors: list[int], num_collectors: int) -> int:
    """The most physics threads a collector may have, with machines of so many processors.

    Raises:
        ConfigurationError: there are fewer processors than collectors, which Ray would wait for.
    """
    for threads in range(max(processors, default=0), 0, -1):
        if sum(number // threads for number in processors) >= num_collectors:
            return threads
    raise ConfigurationError(
        f"num_collectors must be at most {sum(processors)}, the processors of the Ray cluster, got"
        f" {num_collectors}"
    )


def _free_port() -> int:
    """A port that no one listens at, or that of the environment variable TCP_PORT."""
    if port := os.environ.get("TCP_PORT"):
        return int(port)
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]
