"""Samples from robots in several processes on this machine."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import socket
import zlib
from copy import deepcopy
from typing import Any

import torch
from torch import nn
from torchrl.collectors import BaseCollector, Collector

from aslip.sim.pool import processors
from aslip.training.collect.base import SETTINGS
from aslip.training.collect.remote import ENDLESS, RemoteCollectors, sent

_PATIENCE = 10.0  # [s] from SIGTERM to SIGKILL


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
                    total_frames=ENDLESS,
                    backend="distributed",
                    sync=True,
                    backend_options={
                        "launcher": "mp",
                        "backend": "gloo",
                        "tcp_port": _free_port(),
                        "collector_kwargs": {**SETTINGS, "postproc": sent},
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


def _free_port() -> int:
    """A port that no one listens at, or that of the environment variable TCP_PORT."""
    if port := os.environ.get("TCP_PORT"):
        return int(port)
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]
