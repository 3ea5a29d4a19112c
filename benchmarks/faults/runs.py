"""Faults of training runs: errors, kills, damaged checkpoints, full disks, wrong settings."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs.transforms import Transform
from tqdm import tqdm

import aslip
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor
from aslip.training.checkpoint import load_checkpoint
from aslip.training.collectors import LocalCollector
from aslip.training.run import TrainingRun, TrainingStoppedError
from benchmarks.common import Holder, checkpoint_times, quiet
from benchmarks.faults.trainings import (
    PATIENCE,
    TINY,
    identical,
    kill_training,
    reference_result,
    resume_training,
    train,
)
from recipes import ppo_aslip

_COMPONENTS = ("actor", "critic", "optimizer", "rng", "collector")


# ------------------------------------------------------------------ errors and kills


class RaiseError(Transform):
    """Raise an exception in one policy step.

    Args:
        step: number of policy steps before the exception.
    """

    def __init__(self, step: int) -> None:
        super().__init__()
        self._left = step

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        del tensordict
        self._left -= 1
        if self._left < 0:
            raise RuntimeError("error in a simulation")
        return next_tensordict


def faulty_collector(make_transform: Callable[[], Transform]) -> Callable[..., LocalCollector]:
    """Make a `make_collector` whose environments have one more transform."""

    def make_collector(make_env: Any, actor: Any, **settings: Any) -> LocalCollector:
        def make_faulty_env(**keywords: Any) -> Any:
            env = make_env(**keywords)
            env.append_transform(make_transform())
            return env

        return LocalCollector(make_faulty_env, actor, **settings)

    return make_collector


def simulation_errors(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: a clear error, no partial file, and the resumed run equals the reference."""
    expected, survived = reference_result(folder), 0
    for i in range(count):
        # any policy step after the first two batches
        step = int(rng.integers(16, 16 + 7 * 8))
        config, error = replace(TINY, out=folder / f"raises-{i}"), ""
        try:
            train(config, make_collector=faulty_collector(partial(RaiseError, step)))
        except TrainingStoppedError as stop:
            error = str(stop)
        clear = "RuntimeError: error in a simulation" in error and "--resume" in error
        survived += (
            clear and not _unfinished_files(config.out) and resume_training(config) == expected
        )
    return survived


def kills(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the run resumed after SIGKILL equals the reference."""
    expected, survived = reference_result(folder), 0
    for i in range(count):
        config = replace(TINY, out=folder / f"kills-{i}")
        kill_training(config.out, int(rng.integers(8)), float(rng.uniform(0, 0.3)))
        survived += resume_training(config) == expected
    return survived


def worker_kills(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the collector stops with an error within a minute and leaves no process.

    Recipes collect in their own process; users may choose TorchRL's collectors with several.
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
            survived += all(map(_has_ended, processes)) and time.monotonic() - start < 60
        with contextlib.suppress(Exception):
            collector.shutdown()
    return survived


def _has_ended(process: Any) -> bool:
    try:
        process.join(PATIENCE)
        return not process.is_alive()
    except ValueError:  # only ended processes can be closed
        return True


def _unfinished_files(out: Path) -> list[Path]:
    """Temporary files in a run folder."""
    return [*out.rglob("*.part"), *(out / "checkpoints").glob(".*")]


# ----------------------------------------------------------------------- checkpoints


def truncations(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the previous checkpoint is loaded and a warning names the truncated file."""

    def cut(data: bytes) -> bytes:
        return data[: int(rng.integers(len(data)))]

    return sum(_falls_back(folder, cut) for _ in range(count))


def bit_flips(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: as for `truncations`, or the bit is outside the content, which loads unchanged."""

    def flip(data: bytes) -> bytes:
        damaged = bytearray(data)
        damaged[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        return bytes(damaged)

    return sum(_falls_back(folder, flip, harmless=True) for _ in range(count))


def lost_checkpoints(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: an error names the folder and every file, and no file is deleted."""
    survived = 0
    for _ in range(count):
        out, config, components = copy_run(folder)
        paths = sorted((out / "checkpoints").iterdir())
        for path in paths:
            path.write_bytes(path.read_bytes()[: int(rng.integers(path.stat().st_size))])
        try:
            with quiet():
                TrainingRun(out, config, resume=True).restore(components)
        except FileDamagedError as error:
            survived += all(p.name in str(error) for p in paths) and str(out) in str(error)
            survived -= sorted((out / "checkpoints").iterdir()) != paths
    return survived


def full_disks(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the training warns and continues, old files stay, the next checkpoint is intact.

    A limit on file size imitates the full disk: writes fail beyond it.
    """
    survived = 0
    for _ in range(count):
        out, config, components = copy_run(folder)
        run = TrainingRun(out, config, resume=True)
        with quiet():
            kept = run.restore(components)
        assert kept is not None
        before = {path: path.read_bytes() for path in (out / "checkpoints").iterdir()}
        limit = int(rng.integers(max(map(len, before.values()))))
        with quiet() as messages, run.saving(components, 0.0) as keep:
            with _full_disk(limit):
                keep(kept["step"] + 1, kept)
            after = {path: path.read_bytes() for path in (out / "checkpoints").iterdir()}
            keep(kept["step"] + 2, kept)
        newest = max((out / "checkpoints").iterdir())
        named = f"{kept['step'] + 2:012d}" in newest.name
        told = any("could not be written" in line and "continues" in line for line in messages)
        survived += told and after == before and named and _loads(newest, components)
    return survived


@contextmanager
def _full_disk(limit: int) -> Iterator[None]:
    """Limit the size of files [bytes]."""
    import resource  # not on Windows

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def _falls_back(folder: Path, damage: Callable[[bytes], bytes], *, harmless: bool = False) -> bool:
    """Check that a run resumes from the previous checkpoint when the newest is damaged."""
    out, config, components = copy_run(folder)
    *_, before, newest = sorted((out / "checkpoints").iterdir())
    loadable = {path: _load(path, components) for path in (before, newest)}
    newest.write_bytes(damage(newest.read_bytes()))
    with quiet() as messages:
        kept = TrainingRun(out, config, resume=True).restore(components)
    state = {name: holder.state for name, holder in components.items()}
    if harmless and newest.exists():
        return identical((kept, state), loadable[newest])
    told = any(newest.name in line and "falling back" in line for line in messages)
    aside = not newest.exists() and newest.with_name(newest.name + ".damaged").exists()
    return told and aside and identical((kept, state), loadable[before])


def copy_run(folder: Path) -> tuple[Path, ppo_aslip.Config, dict[str, Holder]]:
    """Copy a finished training; returns its folder, settings and state holders."""
    source, out = folder / "reference", folder / "copy"
    reference_result(folder)
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(source, out)
    return out, replace(TINY, out=out), {name: Holder() for name in _COMPONENTS}


def _load(path: Path, components: Mapping[str, Holder]) -> tuple[Any, dict[str, Any]]:
    metadata = load_checkpoint(path, components)
    return metadata, {name: holder.state for name, holder in components.items()}


def _loads(path: Path, components: Mapping[str, Holder]) -> bool:
    before = {name: holder.state for name, holder in components.items()}
    return identical(_load(path, components)[1], before)


def checkpoint_cost(folder: Path, num_envs: int) -> dict[str, float]:
    """Size of a training's checkpoint [bytes], time to copy its states and to write it [s]."""
    samples = 8 * num_envs
    config = replace(
        ppo_aslip.Config(), num_envs=num_envs, samples=samples, total_steps=3 * samples,
        out=folder / "cost",
    )  # fmt: skip
    train(config)
    cost = checkpoint_times(max((config.out / "checkpoints").iterdir()))
    tqdm.write(
        f"checkpoint of {num_envs} robots: {cost['bytes'] / 1e6:.1f} MB, copied in"
        f" {1e3 * cost['copied_s']:.0f} ms, written in {1e3 * cost['written_s']:.0f} ms"
    )
    return {"robots": num_envs, **cost}


# -------------------------------------------------------------------------- settings

_JUNK = (None, "", "8", b"8", [], [8], (), {}, {8: 8}, object(), 1j, float("nan"), float("inf"))


def bad_settings(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: a `ConfigurationError` names the setting."""
    del folder
    survived = 0
    names = [field.name for field in fields(ppo_aslip.Config)]
    for name in rng.choice(names, count).tolist():
        try:
            replace(TINY, **{name: bad_value(name, rng)})
        except ConfigurationError as error:
            survived += name in str(error)
        except Exception:
            continue
    return survived


def bad_value(name: str, rng: np.random.Generator) -> Any:
    """Invalid value of a setting of the recipe."""
    default = getattr(ppo_aslip.Config(), name)
    junk: list[Any] = [value for value in _JUNK if type(value) is not type(default)]
    if isinstance(default, bool):
        junk += [0, 1, 2]
    elif isinstance(default, int):
        junk += [True, False, 2.5, 8.0, -int(rng.integers(1, 2**40)), -(10**30)]
    elif isinstance(default, float):
        junk += [True, -float(rng.exponential()) - 1e-12, float("nan"), -float("inf"), 10**400]
    elif isinstance(default, str):
        junk += ["", "ASLIP", default + " ", 3, True]
    else:
        junk += [3, True, 2.5]
    return junk[int(rng.integers(len(junk)))]
