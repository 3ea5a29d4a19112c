"""Faults of files: checkpoints that were cut, spoilt, or not written for want of space."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from tqdm import tqdm

from aslip.errors import FileDamagedError
from aslip.training import run as run_module
from aslip.training.checkpoint import load_checkpoint, save_checkpoint
from aslip.training.run import TrainingRun
from benchmarks.common import quiet
from benchmarks.faults.trainings import TINY, Holder, same, train, undisturbed
from recipes import ppo_aslip


def cuts(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the one before is loaded, and a warning names the file."""

    def cut(data: bytes) -> bytes:
        return data[: int(rng.integers(len(data)))]

    return sum(_falls_back(folder, cut) for _ in range(count))


def flips(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: as for `cuts`; or the bit is none of the content's, and all is as it was."""

    def flip(data: bytes) -> bytes:
        spoilt = bytearray(data)
        spoilt[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        return bytes(spoilt)

    return sum(_falls_back(folder, flip, harmless=True) for _ in range(count))


def losses(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: an error names the folder and every file, and the files are still there."""
    survived = 0
    for _ in range(count):
        out, config, components = finished(folder)
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
    """Survived: the training goes on and says so, what was there is as it was, the next is whole.

    A limit on the size of files stands in for the disk: the system writes up to it, and then fails.
    """
    import resource  # not on Windows

    survived = 0
    for _ in range(count):
        out, config, components = finished(folder)
        run = TrainingRun(out, config, resume=True)
        with quiet():
            kept = run.restore(components)
        assert kept is not None
        before = {path: path.read_bytes() for path in (out / "checkpoints").iterdir()}
        largest = max(map(len, before.values()))
        limit = int(rng.integers(largest))

        def write(*args: Any, limit: int = limit) -> None:
            soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
            try:
                save_checkpoint(*args)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

        with quiet() as said, run.saving(components, 0.0) as keep:
            with mock.patch.object(run_module, "save_checkpoint", write):
                keep(kept["step"] + 1, kept)
            after = {path: path.read_bytes() for path in (out / "checkpoints").iterdir()}
            keep(kept["step"] + 2, kept)
        newest = out / "checkpoints" / f"checkpoint-{kept['step'] + 2:012d}.zip"
        told = any("could not be written" in line and "goes on" in line for line in said)
        survived += told and after == before and _loads(newest, components)
    return survived


def _falls_back(folder: Path, spoil: Callable[[bytes], bytes], *, harmless: bool = False) -> bool:
    """Whether a run with a spoilt newest checkpoint goes on from the one before."""
    out, config, components = finished(folder)
    *_, before, newest = sorted((out / "checkpoints").iterdir())
    loadable = {path: _loaded(path, components) for path in (before, newest)}
    newest.write_bytes(spoil(newest.read_bytes()))
    with quiet() as said:
        kept = TrainingRun(out, config, resume=True).restore(components)
    state = {name: holder.state for name, holder in components.items()}
    if harmless and newest.exists():
        return same((kept, state), loadable[newest])
    told = any(newest.name in line and "falling back" in line for line in said)
    aside = not newest.exists() and newest.with_name(newest.name + ".damaged").exists()
    return told and aside and same((kept, state), loadable[before])


def finished(folder: Path) -> tuple[Path, ppo_aslip.Config, dict[str, Holder]]:
    """A copy of a finished training, its settings, and what its states can be loaded into."""
    source, out = folder / "undisturbed", folder / "copy"
    undisturbed(folder)
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(source, out)
    names = ("actor", "critic", "optimizer", "rng", "collector")
    return out, replace(TINY, out=out), {name: Holder() for name in names}


def _loaded(path: Path, components: Mapping[str, Holder]) -> tuple[Any, dict[str, Any]]:
    metadata = load_checkpoint(path, components)
    return metadata, {name: holder.state for name, holder in components.items()}


def _loads(path: Path, components: Mapping[str, Holder]) -> bool:
    before = {name: holder.state for name, holder in components.items()}
    return same(_loaded(path, components)[1], before)


def checkpoint_cost(folder: Path, num_envs: int) -> dict[str, float]:
    """Times to copy and to write what a training of so many robots resumes from [s]; its bytes."""
    times: dict[str, list[float]] = {"copied_s": [], "written_s": []}

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*args: Any) -> Any:
            start = time.perf_counter()
            result = function(*args)
            times[name].append(time.perf_counter() - start)
            return result

        return run

    samples = 8 * num_envs
    config = replace(
        ppo_aslip.Config(), num_envs=num_envs, samples=samples, total_steps=3 * samples,
        checkpoint_minutes=0, out=folder / "cost",
    )  # fmt: skip
    with (
        mock.patch.object(run_module, "snapshot", timed("copied_s", run_module.snapshot)),
        mock.patch.object(run_module, "save_checkpoint", timed("written_s", save_checkpoint)),
    ):
        train(config)
    size = max((config.out / "checkpoints").iterdir()).stat().st_size
    copied, written = (max(values) for values in times.values())
    tqdm.write(
        f"a checkpoint of {num_envs} robots has {size / 1e6:.1f} MB; at worst it was copied in"
        f" {1e3 * copied:.0f} ms and written in {1e3 * written:.0f} ms"
    )
    return {"robots": num_envs, "bytes": size, "copied_s": copied, "written_s": written}
