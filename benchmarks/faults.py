"""What goes wrong, on purpose and many times: faults injected, and faults survived.

    python -m benchmarks.faults                        # all of them: half an hour
    python -m benchmarks.faults --steps 0 --kills 0    # without the long ones
    python -m benchmarks.faults --kills 100            # a night of killed trainings

What counts as survived is in each function's docstring. Trainings are tiny ones of
`recipes/ppo_aslip.py`, on one thread, and every one that was stopped is resumed and compared bit by
bit with one that was not.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
import tyro
from tensordict import TensorDictBase
from torchrl import torchrl_logger
from torchrl.collectors import Collector
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

import aslip
from aslip import run as run_module
from aslip.checkpoint import load_checkpoint, save_checkpoint
from aslip.envs import BatchCassieEnv
from aslip.errors import ConfigurationError, FileDamagedError, one_line_errors
from aslip.evaluation import evaluate
from aslip.policy import PolicyShape, RunningNormalizer, make_actor
from aslip.run import TrainingRun, TrainingStoppedError, peak_memory, read_progress, write_text
from benchmarks.common import markdown
from recipes import ppo_aslip

TINY = ppo_aslip.Config(
    num_envs=8, samples=64, total_steps=512, minibatch=32, eval_interval=400, checkpoint_minutes=0
)
"""A training of eight updates, a checkpoint each."""

SHORT_WALKS = partial(evaluate, num_steps=5)
"""What its evaluations are."""

# a policy step that is not over by then hangs [s]
_PATIENCE = 120.0


@dataclass(frozen=True)
class Config:
    """How many of each fault; none skips it."""

    numbers: int = 600
    """NaN, infinities and huge values in one simulation's state."""
    raises: int = 10
    """Simulations that raise in the middle of a training."""
    kills: int = 20
    """Trainings killed at a random moment."""
    workers: int = 2
    """Processes of collectors killed."""
    cuts: int = 100
    """Newest checkpoints truncated at a random offset."""
    flips: int = 100
    """Newest checkpoints with a flipped bit."""
    losses: int = 10
    """Runs all of whose checkpoints are truncated."""
    full_disks: int = 50
    """Disks that are full after a random number of bytes of a checkpoint."""
    strangers: int = 20
    """Policies and checkpoints with a program inside, hidden in four ways."""
    settings: int = 1000
    """Settings of a wrong type or out of range."""
    steps: int = 1_000_000
    """Policy steps of random actions."""
    robots: int = 256
    """Robots of a training whose checkpoints are timed."""
    seed: int = 0
    """Of everything random."""
    report: Path = Path("runs/faults.json")
    """Where to write the numbers."""


Inject = Callable[[int, np.random.Generator, Path], int]
"""Injects so many faults, with a folder for files; returns how many were survived."""


def main(config: Config) -> dict[str, dict[str, int]]:
    """Inject everything; print and write the table. Returns it, by fault."""
    torch.set_num_threads(1)
    # MuJoCo tells of every simulation that diverges
    logging.getLogger("absl").setLevel(logging.ERROR)
    faults: dict[str, tuple[int, Inject]] = {
        "bad number in a simulation's state": (config.numbers, bad_numbers),
        "simulation raises in training": (config.raises, raises),
        "training killed": (config.kills, kills),
        "collector process killed": (config.workers, workers),
        "newest checkpoint truncated": (config.cuts, cuts),
        "bit of the newest checkpoint flipped": (config.flips, flips),
        "all checkpoints truncated": (config.losses, losses),
        "disk full": (config.full_disks, full_disks),
        "program in a policy or checkpoint": (config.strangers, strangers),
        "setting of wrong type or range": (config.settings, settings),
        "policy steps of random actions": (config.steps, steps),
    }
    table: dict[str, dict[str, int]] = {}
    numbers: dict[str, Any] = {"seed": config.seed, "faults": table}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for i, (name, (count, inject)) in enumerate(tqdm(faults.items(), unit="fault")):
            if count:
                rng = np.random.default_rng([config.seed, i])
                table[name] = {"injected": count, "survived": inject(count, rng, folder)}
        if config.robots:
            numbers["checkpoint"] = checkpoint_cost(folder, config.robots)
    rows = [[name, str(n["injected"]), str(n["survived"])] for name, n in table.items()]
    print(markdown(["fault", "injected", "survived"], rows))
    config.report.parent.mkdir(parents=True, exist_ok=True)
    write_text(config.report, json.dumps(numbers, indent=1) + "\n")
    return table


# ------------------------------------------------------------------- simulations

_BAD = (np.nan, np.inf, -np.inf, 1e300)


def bad_numbers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Spoil the state of every other of 2 n robots, and walk on beside an unspoilt copy.

    Survived: the policy's input and the reward stay finite, each number of the neighbour equals
    that of the copy, bit for bit, and the next reset leaves nothing of it.
    """
    del folder
    robots, survived = 2 * np.arange(count), np.ones(count, dtype=bool)
    both = [aslip.make_env(num_envs=2 * count, num_threads=1) for _ in range(2)]
    tds = [env.reset() for env in both]
    for step in range(10):
        if step == 5:
            states = both[0].base_env.states()
            columns = rng.integers(states.shape[1], size=count)
            states[robots, columns] = rng.choice(_BAD, count)
            both[0].base_env.set_states(states)
        action = torch.tensor(rng.normal(0, 0.1, (2 * count, 10)), dtype=torch.float32)
        for i, env in enumerate(both):
            tds[i] = step_mdp(env.step(tds[i].set("action", action)), exclude_reward=False)
        for key in ("observation", "reward"):
            survived &= torch.isfinite(tds[0][key]).all(-1).numpy()[robots]
        survived &= ~_differing(tds[0], tds[1], robots + 1)
    both[0].reset()
    survived &= np.isfinite(both[0].base_env.states()).all(axis=1)[robots]
    for env in both:
        env.close()
    return int(survived.sum())


def _differing(a: TensorDictBase, b: TensorDictBase, rows: np.ndarray) -> np.ndarray:
    """Which rows differ in a bit of any entry."""
    different = np.zeros(len(rows), dtype=bool)
    for key in a.keys(True, True):
        left, right = (td.get(key)[torch.from_numpy(rows)].numpy().copy() for td in (a, b))
        different |= (left.view(np.uint8) != right.view(np.uint8)).reshape(len(rows), -1).any(1)
    return different


def steps(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived are the steps of a process that lives on and whose memory does not grow."""
    del folder
    code = (
        "import json, sys; from benchmarks.faults import random_walk;"
        " print(json.dumps(random_walk(int(sys.argv[1]), int(sys.argv[2]))))"
    )
    command = [sys.executable, "-c", code, str(count), str(int(rng.integers(2**31)))]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        return 0
    told = json.loads(done.stdout.splitlines()[-1])
    tqdm.write(
        f"{told['steps']} policy steps of random actions: {told['episodes']} episodes,"
        f" {told['divergences']} divergences, {told['steps'] / told['seconds']:.0f} steps/s;"
        f" memory {told['memory_mib']:.1f} MiB, and {told['growth_mib']:.2f} MiB more after the"
        " first tenth"
    )
    return told["finite"] if told["growth_mib"] < 16 else 0


def random_walk(count: int, seed: int, num_envs: int = 50) -> dict[str, float]:
    """Steps of random actions, from hundredths of a radian to hundreds.

    Returns:
        `steps`; how many of them were `finite` in the policy's input and reward; `episodes` ended;
        `divergences`; `seconds`; `memory_mib` after a tenth; `growth_mib` from there on.
    """
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    env = aslip.make_env(num_envs=num_envs, seed=seed, num_threads=1)
    td = env.reset()
    rounds = -(-count // num_envs)
    finite, episodes, memory, start = 0, 0, 0.0, time.perf_counter()
    for k in tqdm(range(rounds), unit="step", unit_scale=num_envs, leave=False):
        scale = 10 ** (4 * torch.rand(num_envs, 1, generator=generator) - 2)
        td["action"] = scale * torch.randn(num_envs, 10, generator=generator)
        full, td = env.step_and_maybe_reset(td)
        after = full["next"]
        rows = torch.cat([after["observation"], after["reward"]], dim=-1)
        finite += int(torch.isfinite(rows).all(-1).sum())
        episodes += int(after["done"].sum())
        if k == rounds // 10:
            memory = resident()
    return {
        "steps": rounds * num_envs,
        "finite": finite,
        "episodes": episodes,
        "divergences": env.base_env.divergences,
        "seconds": time.perf_counter() - start,
        "memory_mib": memory,
        "growth_mib": resident() - memory,
    }


def resident() -> float:
    """Memory held at present [MiB]; where the system does not tell, the most ever held."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 1024 * peak_memory()
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


# --------------------------------------------------------------------- trainings


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


def raises(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: a clear error, nothing half-written; resumed, it equals the undisturbed run."""
    expected = _undisturbed(folder)
    advance, survived = BatchCassieEnv._advance, 0
    for i in range(count):
        # of all policy steps but those of the first two batches
        left = int(rng.integers(16, 16 + 7 * 8))

        def fail(env: BatchCassieEnv, *args: Any) -> np.ndarray:
            nonlocal left
            if env.num_envs == TINY.num_envs:
                left -= 1
            if left < 0:
                raise RuntimeError("a simulation raises")
            return advance(env, *args)

        config, error = replace(TINY, out=folder / f"raises-{i}"), ""
        with mock.patch.object(BatchCassieEnv, "_advance", fail):
            try:
                train(config)
            except TrainingStoppedError as stop:
                error = str(stop)
        clear = "RuntimeError: a simulation raises" in error and "--resume" in error
        survived += clear and not _unfinished(config.out) and resumed(config) == expected
    return survived


_VICTIM = """
import sys, torch
from dataclasses import replace
from pathlib import Path
torch.set_num_threads(1)
from benchmarks.faults import TINY, train
train(replace(TINY, out=Path(sys.argv[1])))
"""


def kills(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: resumed after SIGKILL, the run equals the undisturbed one."""
    expected, survived = _undisturbed(folder), 0
    for i in range(count):
        config = replace(TINY, out=folder / f"kills-{i}")
        killed(config.out, int(rng.integers(8)), float(rng.uniform(0, 0.3)))
        survived += resumed(config) == expected
    return survived


def killed(out: Path, after: int, delay: float) -> None:
    """Train in a process of its own, and kill it after so many updates and a delay [s].

    Raises:
        RuntimeError: it ended, or hung, before.
    """
    command = [sys.executable, "-c", _VICTIM, str(out)]
    victim = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + _PATIENCE
        while not (out / "config.json").exists() or updates(out) < after:
            if victim.poll() is not None or time.monotonic() > until:
                raise RuntimeError(f"the training in {out} ended or hung on its own")
            time.sleep(0.005)
        time.sleep(delay)
    finally:
        victim.kill()
        victim.wait()


def updates(out: Path) -> int:
    """How many a training has told of."""
    try:
        return len(read_progress(out).get("step", ()))
    except (OSError, ValueError):  # read while a row was being written
        return 0


def train(config: ppo_aslip.Config) -> dict[str, Any]:
    """Train, with short evaluations and without a word; returns what `fingerprint` says."""
    with quiet(), mock.patch.object(ppo_aslip, "evaluate", SHORT_WALKS):
        ppo_aslip.main(config)
    return fingerprint(config.out)


def resumed(config: ppo_aslip.Config) -> dict[str, Any]:
    """Train on to the end."""
    return train(replace(config, resume=True))


def _undisturbed(folder: Path) -> dict[str, Any]:
    """What a training leaves that nothing happens to; trained once a folder."""
    config = replace(TINY, out=folder / "undisturbed")
    return fingerprint(config.out) if config.out.exists() else train(config)


def fingerprint(out: Path) -> dict[str, Any]:
    """All of a finished run that is no time: its progress, last checkpoint, and policy.

    Of the global generators only torch's: those of Python and NumPy are neither seeded nor used.
    """
    progress = read_progress(out)
    del progress["elapsed_s"]
    newest = max((out / "checkpoints").glob("checkpoint-*.torchrl"))
    with zipfile.ZipFile(newest) as archive:
        kept = json.loads(archive.read("manifest.json"))["metadata"]
    del kept["elapsed_s"]
    generators = Holder()
    load_checkpoint(newest, {"rng": generators})
    states = {name: crc for name, crc in _checksums(newest).items() if "rng" not in name}
    return {
        # NaN equals NaN in text
        "progress": json.dumps(progress),
        "kept": kept,
        "checkpoint": newest.name,
        "states": states,
        "generator": generators.state["torch_cpu"].tolist(),
        "policy": _checksums(out / "policy.zip"),
    }


def _checksums(path: Path) -> dict[str, int]:
    """Of everything in an archive but its manifest, which has the time in it."""
    with zipfile.ZipFile(path) as archive:
        return {
            info.filename: info.CRC
            for info in archive.infolist()
            if info.filename != "manifest.json"
        }


def _unfinished(out: Path) -> list[Path]:
    """Files that were to be something else."""
    return [*out.rglob("*.part"), *(out / "checkpoints").glob(".*")]


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
        process.join(_PATIENCE)
        return not process.is_alive()
    except ValueError:  # closed, which only ended processes can be
        return True


# --------------------------------------------------------------------- checkpoints


class Holder:
    """Something to load any state into."""

    def __init__(self, state: Any = None) -> None:
        self.state = state

    def state_dict(self) -> Any:
        """What was loaded."""
        return self.state

    def load_state_dict(self, state: Any) -> None:
        """Keep it."""
        self.state = state


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
        out, config, components = _finished(folder)
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
        out, config, components = _finished(folder)
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
        newest = out / "checkpoints" / f"checkpoint-{kept['step'] + 2:012d}.torchrl"
        told = any("could not be written" in line and "goes on" in line for line in said)
        survived += told and after == before and _loads(newest, components)
    return survived


def _falls_back(folder: Path, spoil: Callable[[bytes], bytes], *, harmless: bool = False) -> bool:
    """Whether a run with a spoilt newest checkpoint goes on from the one before."""
    out, config, components = _finished(folder)
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


def _finished(folder: Path) -> tuple[Path, ppo_aslip.Config, dict[str, Holder]]:
    """A copy of a finished training, its settings, and what its states can be loaded into."""
    source, out = folder / "undisturbed", folder / "copy"
    _undisturbed(folder)
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


def same(a: Any, b: Any) -> bool:
    """Whether two states are equal, bit for bit."""
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b


# ----------------------------------------------------------------------- strangers


class Program:
    """Something whose unpickling runs code: it makes a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def strangers(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: the program has not run, whether the file is refused or read without it."""
    del rng
    out, _, components = _finished(folder)
    newest, survived = max((out / "checkpoints").iterdir()), 0
    for i in range(count):
        mark, path = folder / f"ran-{i}", folder / "stranger.zip"
        ways = _hidden(Program(mark))
        way = ways[i % len(ways)]
        _rewrite(newest if "arrays.npz" in way else out / "policy.zip", path, way)
        with contextlib.suppress(FileDamagedError), quiet():
            if "arrays.npz" in way:
                load_checkpoint(path, components)
            else:
                aslip.load_policy(path)
        survived += not mark.exists()
    return survived


def _hidden(program: Program) -> list[dict[str, bytes]]:
    """Files to put into the folder of each component; those of one way a dict.

    TorchRL reads "state.pt" in place of arrays, and "state.tdz" in place of a folder of them;
    TensorDict unpickles what is not a tensor, NumPy arrays of objects.
    """
    saved, archive, arrays = io.BytesIO(), io.BytesIO(), io.BytesIO()
    torch.save(program, saved)
    kind = json.dumps({"_type": "<class 'tensordict.tensorclass.NonTensorData'>"}).encode()
    pickled = pickle.dumps({"data": program})
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("meta.json", kind)
        file.writestr("other.pickle", pickled)
    objects = np.empty(1, dtype=object)
    objects[0] = program
    np.savez(arrays, allow_pickle=True, arr_0=objects)
    return [
        {"state.pt": saved.getvalue()},
        {"state/meta.json": kind, "state/other.pickle": pickled},
        {"state.tdz": archive.getvalue()},
        {"arrays.npz": arrays.getvalue()},
    ]


def _rewrite(source: Path, path: Path, files: Mapping[str, bytes]) -> None:
    """Copy an archive with other files in each component, but for what says how to read them."""
    with zipfile.ZipFile(source) as archive:
        manifest = json.loads(archive.read("manifest.json"))
        parts = {name: archive.read(name) for name in archive.namelist() if "/state/" not in name}
    for record in manifest["components"].values():
        record["files"] = sorted({"state.json", "tree.json"} & set(record["files"]) | set(files))
        parts |= {f"{record['path']}/{name}": data for name, data in files.items()}
    parts["manifest.json"] = json.dumps(manifest).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


# ------------------------------------------------------------------------ settings

_JUNK = (None, "", "8", b"8", [], [8], (), {}, {8: 8}, object(), 1j, float("nan"), float("inf"))


def settings(count: int, rng: np.random.Generator, folder: Path) -> int:
    """Survived: an error that names the setting."""
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
    """A value that a setting of the recipe may not have."""
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


# -------------------------------------------------------------------------- output


@contextlib.contextmanager
def quiet() -> Iterator[list[str]]:
    """Print nothing and show no bars; yields the list that TorchRL's log messages go to."""
    said: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            said.append(record.getMessage())

    handlers = torchrl_logger.handlers[:]
    torchrl_logger.handlers[:] = [Listener()]
    silence = io.StringIO()
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            yield said
    finally:
        torchrl_logger.handlers[:] = handlers


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Config))
