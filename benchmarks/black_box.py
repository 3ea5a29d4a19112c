"""What a log costs, and what survives: overhead, size, crashes, cuts and replays.

    python -m benchmarks.black_box                       # everything
    python -m benchmarks.black_box --rounds 5 --kills 0 --cuts 0 --replays 0

One robot walks under a policy with and without a recorder, side by side: in each round both walk
the same steps one after the other, in small portions, so that whatever else the machine does
touches both alike. Logs are then killed while being written, cut anywhere, and replayed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import FileDamagedError, one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    rounds: int = 3
    """Walks of 12 s, each with and without a log."""
    kills: int = 50
    """Writers to kill."""
    cuts: int = 200
    """Places to cut a log at."""
    replays: int = 20
    """Walks with random commands and pushes to replay."""
    policy: str = "aslip"
    """Who walks."""
    seed: int = 0
    """Seed of all random numbers."""
    report: Path = Path("runs/black_box.json")
    """File for the numbers."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import torch
from tqdm import trange

import aslip
from aslip.envs import EPISODE_ENDS, STACKS
from aslip.library import GaitLibrary
from aslip.log import JointRate, Recorder, check, read, recover, replay
from aslip.policy import policy_stack
from aslip.robot import CASSIE
from aslip.training.run import write_text
from aslip.walking import Walker

# an episode of the paper [policy steps]
_EPISODE = 400
# steps that are timed together, so that a pause of the machine hits one portion only
_PORTION = 20


def main(config: Config) -> None:
    """Measure, and print tables."""
    torch.set_num_threads(1)
    library = GaitLibrary.load()
    numbers: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if config.rounds:
            numbers["overhead"] = overhead(config, library, folder)
        if config.kills:
            numbers["kills"] = kills(config, folder)
        if config.cuts:
            numbers["cuts"] = cuts(config, library, folder)
        if config.replays:
            numbers["replays"] = replays(config, library, folder)
    config.report.parent.mkdir(parents=True, exist_ok=True)
    write_text(config.report, json.dumps(numbers, indent=1) + "\n")


def walking(
    library: GaitLibrary, policy: str, path: Path | None, rate: JointRate = "policy", seed: int = 0
) -> Walker:
    """A robot, recorded if there is a path."""
    stack = STACKS[policy_stack(policy)]()
    if path is not None:
        stack["recorder"] = partial(Recorder, path, joint_rate=rate, policy=policy, library=library)
    env = aslip.make_env(stack=stack, drop=EPISODE_ENDS, seed=seed, num_threads=1)
    return Walker(policy, env, library=library, speed=0.5)


# --------------------------------------------------------------------- overhead


def overhead(config: Config, library: GaitLibrary, folder: Path) -> dict[str, float]:
    """Time of a logged walk over that of the same walk without a log, and sizes."""
    print("\n| log | time of 12 s | slower by | size |\n|---|---:|---:|---:|")
    ratios: dict[str, list[float]] = {"policy": [], "physics": []}
    seconds: dict[str, list[float]] = {"none": [], "policy": [], "physics": []}
    sizes: dict[str, int] = {}
    for round_number in trange(config.rounds, unit="round", leave=False):
        walkers = {"none": walking(library, config.policy, None)}
        paths = {rate: folder / f"{rate}-{round_number}.mcap" for rate in ratios}
        for rate, path in paths.items():
            walkers[rate] = walking(library, config.policy, path, rate)  # pyright: ignore
        spent = portions(walkers)
        for name, walker in walkers.items():
            walker.env.close()
            seconds[name].append(float(spent[name].sum()))
        for rate, path in paths.items():
            # portion by portion, as the machine's speed changes within a walk
            ratios[rate].append(float(np.median(spent[rate] / spent["none"])))
            sizes[rate] = path.stat().st_size
    results: dict[str, float] = {}
    print(f"| none | {statistics.median(seconds['none']):.2f} s | | |")
    for rate, label in (("policy", "33 Hz"), ("physics", "joints at 2 kHz")):
        slower = statistics.median(ratios[rate]) - 1
        print(
            f"| {label} | {statistics.median(seconds[rate]):.2f} s | {100 * slower:.1f} %"
            f" | {sizes[rate] / 1e6:.2f} MB |"
        )
        results |= {f"{rate}_slower": slower, f"{rate}_bytes": sizes[rate]}
    return results


def portions(walkers: dict[str, Walker]) -> dict[str, np.ndarray]:
    """Seconds of each portion of an episode, of all walkers in turn."""
    spent: dict[str, list[float]] = {name: [] for name in walkers}
    order = list(walkers)
    for _ in range(_EPISODE // _PORTION):
        for name in order:
            start = time.perf_counter()
            for _ in range(_PORTION):
                walkers[name].step()
            spent[name].append(time.perf_counter() - start)
        order = order[1:] + order[:1]
    return {name: np.array(times) for name, times in spent.items()}


# ------------------------------------------------------------------------ kills

_VICTIM = """
import sys
from pathlib import Path
from benchmarks.black_box import walking
from aslip.library import GaitLibrary
from aslip.policy import policy_stack
walker = walking(GaitLibrary.load(), sys.argv[1], Path(sys.argv[2]))
while True:
    walker.step()
    print(walker.steps, flush=True)
"""


def kills(config: Config, folder: Path) -> dict[str, float]:
    """Kill writers at random times; recover what they have left."""
    rng = np.random.default_rng(config.seed)
    lost, failures = [], 0
    for i in trange(config.kills, unit="kill", leave=False):
        path = folder / f"victim-{i}.mcap"
        reached = killed(config.policy, path, int(rng.integers(34, _EPISODE)), rng)
        saved = recover(path.with_name(path.name + ".part"))
        loss = reached * CASSIE.policy_period - saved.until
        lost.append(loss)
        whole = loss <= 1.0 + CASSIE.policy_period and not check(saved.path)
        failures += not (whole and replay(saved.path).equal)
    print(
        f"\n{config.kills - failures} of {config.kills} killed writers recovered up to one second"
        f" before; lost {statistics.median(lost):.2f} s in the median, {max(lost):.2f} s at most"
    )
    return {"kills": config.kills, "failures": failures, "worst_loss": max(lost)}


def killed(policy: str, path: Path, steps: int, rng: np.random.Generator) -> int:
    """Kill a writer a random instant after so many steps; returns the last step it told of."""
    command, told = [sys.executable, "-c", _VICTIM, policy, str(path)], 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as victim:
        assert victim.stdout is not None
        for line in victim.stdout:
            told = int(line)
            if told >= steps:
                time.sleep(float(rng.uniform(0, 0.02)))
                os.kill(victim.pid, signal.SIGKILL)
                break
        # what it told of before it died
        for line in victim.stdout:
            told = int(line) if line.endswith("\n") else told
    return told


# ------------------------------------------------------------------------- cuts


def cuts(config: Config, library: GaitLibrary, folder: Path) -> dict[str, int]:
    """Cut a log anywhere: it is read up to the cut, or there is a clear error."""
    path = folder / "whole.mcap"
    with closed(walking(library, config.policy, path)) as walker:
        for _ in range(200):
            walker.step()
    data, whole = path.read_bytes(), read(path)
    rng = np.random.default_rng(config.seed)
    counts = {"saved": 0, "clear error": 0, "wrong": 0}
    for i in trange(config.cuts, unit="cut", leave=False):
        cut = folder / f"cut-{i}.mcap.part"
        cut.write_bytes(data[: int(rng.integers(len(data)))])
        counts[outcome(cut, whole.series["/truth"].time)] += 1
    print(f"\n{config.cuts} cuts: " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return counts


def outcome(cut: Path, time: np.ndarray) -> str:
    """What became of a cut log: "saved", "clear error" or "wrong"."""
    if not check(cut):
        return "wrong"
    try:
        read(cut)
        return "wrong"
    except FileDamagedError:
        pass
    try:
        saved = recover(cut)
    except FileDamagedError:
        return "clear error"
    rest = read(saved.path)
    kept = rest.series["/truth"].time
    alike = np.array_equal(kept, time[: len(kept)])
    return "saved" if alike and not check(saved.path) else "wrong"


# ---------------------------------------------------------------------- replays


def replays(config: Config, library: GaitLibrary, folder: Path) -> dict[str, int]:
    """Replay walks with random commands and pushes, from the start and from the middle."""
    rng = np.random.default_rng(config.seed)
    equal, states, falls = 0, 0, 0
    for i in trange(config.replays, unit="walk", leave=False):
        path = folder / f"replay-{i}.mcap"
        with closed(walking(library, config.policy, path, seed=i)) as walker:
            for step in range(_EPISODE):
                if step % 50 == 0:
                    walker.command = float(rng.uniform(0, 2))
                if rng.random() < 0.02:
                    walker.push(rng.normal(0, 60, 3).tolist(), float(rng.uniform(0.03, 0.2)))
                walker.step()
                if walker.fallen:
                    falls += 1
                    walker.reset()
        recording = read(path, ["/step", "/state", "/dynamics"])
        middle = float(recording["/state"].time[-1]) / 2
        results = [replay(recording, start) for start in (0.0, middle)]
        equal += all(result.equal for result in results)
        states += sum(result.compared for result in results)
    print(
        f"\n{equal} of {config.replays} walks replayed bit for bit, from the start and from the"
        f" middle: {states} states compared, {falls} falls among them"
    )
    return {"walks": config.replays, "equal": equal, "states": states, "falls": falls}


@contextmanager
def closed(walker: Walker) -> Iterator[Walker]:
    """A walker whose environment, and log, is closed in the end."""
    try:
        yield walker
    finally:
        walker.env.close()


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
