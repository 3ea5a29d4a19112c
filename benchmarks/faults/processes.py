"""Faults of programs: simulations that raise, trainings and collectors that are killed."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from torchrl.collectors import Collector

import aslip
from aslip.envs import BatchEnv
from aslip.policy import PolicyShape, RunningNormalizer, make_actor
from aslip.training.run import TrainingStoppedError
from benchmarks.faults.trainings import PATIENCE, TINY, killed, resumed, train, undisturbed


def raises(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: a clear error, nothing half-written; resumed, it equals the undisturbed run."""
    expected = undisturbed(folder)
    advance, survived = BatchEnv._advance, 0
    for i in range(count):
        # of all policy steps but those of the first two batches
        left = int(rng.integers(16, 16 + 7 * 8))

        def fail(env: BatchEnv, *args: Any) -> np.ndarray:
            nonlocal left
            if env.num_envs == TINY.num_envs:
                left -= 1
            if left < 0:
                raise RuntimeError("a simulation raises")
            return advance(env, *args)

        config, error = replace(TINY, out=folder / f"raises-{i}"), ""
        with mock.patch.object(BatchEnv, "_advance", fail):
            try:
                train(config)
            except TrainingStoppedError as stop:
                error = str(stop)
        clear = "RuntimeError: a simulation raises" in error and "--resume" in error
        survived += clear and not _unfinished(config.out) and resumed(config) == expected
    return survived


def kills(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: resumed after SIGKILL, the run equals the undisturbed one."""
    expected, survived = undisturbed(folder), 0
    for i in range(count):
        config = replace(TINY, out=folder / f"kills-{i}")
        killed(config.out, int(rng.integers(8)), float(rng.uniform(0, 0.3)))
        survived += resumed(config) == expected
    return survived


def workers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the collector ends with an error, within a minute, and leaves no process.

    For who collects in several processes; recipes collect in their own. TorchRL's error names the
    process that failed, or, on a slow machine, another that it was about to end.
    """
    del folder
    survived = 0
    for _ in range(count):
        collector = Collector(
            [partial(aslip.make_env, num_envs=2, num_threads=1)] * 2,
            make_actor(RunningNormalizer(64), PolicyShape()),
            num_collectors=2,
            sync=True,
            frames_per_batch=16,
            total_frames=-1,
            trust_policy=True,
        )
        processes = collector.procs
        moment, start = int(rng.integers(4)), time.monotonic()
        try:
            for i, _ in enumerate(collector):
                if i == moment:
                    start = time.monotonic()
                    os.kill(processes[int(rng.integers(2))].pid, signal.SIGKILL)
                if i > moment + 3:
                    break
        except (RuntimeError, ValueError):
            survived += all(map(_ended, processes)) and time.monotonic() - start < 60
        with contextlib.suppress(Exception):
            collector.shutdown()
    return survived


def _ended(process: Any) -> bool:
    try:
        process.join(PATIENCE)
        return not process.is_alive()
    except ValueError:  # closed, which only ended processes can be
        return True


def _unfinished(out: Path) -> list[Path]:
    """Files that were to be something else."""
    return [*out.rglob("*.part"), *(out / "checkpoints").glob(".*")]
