"""Samples from robots in Ray actors, on this machine or on a cluster."""

from __future__ import annotations

import importlib
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from torch import nn
from torchrl.collectors import BaseCollector, Collector

from aslip.errors import ConfigurationError
from aslip.imports import extras
from aslip.processes import processors
from aslip.training.cluster import ENDLESS, RemoteCollectors
from aslip.training.environments import MakeEnv

# Ray's object store [byte]; a batch of 2048 samples has 1.3 MB
_STORE = 2**29


class RayCollectors(RemoteCollectors):
    """Robots in Ray actors, by TorchRL's `RayCollector`.

    Raises:
        MissingExtraError: Ray is not installed.
        ConfigurationError: an argument is wrong, see `RemoteCollectors`.
    """

    _collector: BaseCollector | None = None
    _ours = False

    def __init__(self, make_env: MakeEnv, actor: nn.Module, **settings: Any) -> None:
        with extras():
            importlib.import_module("ray")
        super().__init__(make_env, actor, **settings)

    def _start(self) -> BaseCollector:
        ray = importlib.import_module("ray")
        if not ray.is_initialized():
            self._ours = True
            with _signals_kept():
                _join_ray(ray, self._num)
        free = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        threads = threads_each(free, self._num)
        self._collector = Collector(
            self._robots(threads),
            self._actor,
            frames_per_batch=self._samples,
            total_frames=ENDLESS,
            backend="ray",
            sync=True,
            backend_options={
                "collector_kwargs": self._collector_settings(),
                "remote_configs": {"num_cpus": threads, "scheduling_strategy": "SPREAD"},
            },
        )
        return self._collector

    def shutdown(self) -> None:
        """End the actors, and Ray if this collector started it."""
        if self._collector is not None:
            self._collector.shutdown()
            self._collector = None
        if self._ours:
            importlib.import_module("ray").shutdown()
            self._ours = False


def _join_ray(ray: Any, num_collectors: int) -> None:
    """Join the cluster at `RAY_ADDRESS`, or start Ray on this machine.

    Raises:
        ConfigurationError: the cluster cannot be joined.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    address = os.environ.get("RAY_ADDRESS")
    if address:
        try:
            ray.init(address=address, log_to_driver=False)
        except (
            Exception
        ) as error:  # Ray raises different exceptions for connection, token and version
            raise ConfigurationError(
                f"the Ray cluster at RAY_ADDRESS = {address!r} cannot be joined"
                f" ({type(error).__name__}: {error}); does it run, and are RAY_AUTH_MODE and"
                " RAY_AUTH_TOKEN those of its head?"
            ) from error
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
