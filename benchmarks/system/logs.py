"""Walk logs: overhead and size.

    python -m benchmarks.system.logs --rounds 5

One robot walks with and without a recorder. Both take the same steps in turn, in small portions, so
that other load on the machine affects both alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    rounds: int = 3
    """Walks, each with and without a log."""
    steps: int = 400
    """Policy steps of a walk; the paper's episodes have 400."""
    policy: str = "straight"
    """Policy that walks, as `aslip.load_policy` takes it."""
    report: Path = Path("runs/black_box.json")
    """JSON file for the results."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import json
import statistics
import tempfile
import time

import numpy as np
import torch
from tqdm import trange

from aslip.base.tables import markdown
from aslip.log import JointRate, Recorder
from aslip.training.run import write_text
from aslip.walking import Walker
from benchmarks.common import MakeEnv, Policy, Subject
from benchmarks.flags import Common

# policy steps timed together; a pause of the machine affects one portion only
_PORTION = 20


def main(config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None) -> None:
    """Measure, print the table and write the results.

    Args:
        config: the settings.
        policy: policy that walks; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    torch.set_num_threads(1)
    subject = Subject.load(policy or config.policy, make_env)
    with tempfile.TemporaryDirectory() as folder:
        numbers = {"overhead": overhead(config, subject, Path(folder))}
    config.report.parent.mkdir(parents=True, exist_ok=True)
    write_text(config.report, json.dumps(numbers, indent=1) + "\n")


def make_walker(subject: Subject, path: Path | None, rate: JointRate = "policy") -> Walker:
    """Walker of a subject, with a recorder if a path is given."""
    env = subject.walking_env(Common(), 1, num_threads=1)
    if path is not None:
        policy = subject.name if subject.stored else None
        env.append_transform(Recorder(path, joint_rate=rate, policy=policy))
    return Walker(subject.policy, env, library=subject.library, speed=0.5)


def overhead(config: Config, subject: Subject, folder: Path) -> dict[str, float]:
    """Measure the slowdown of walks by a recorder, and the size of logs."""
    ratios: dict[str, list[float]] = {"policy": [], "physics": []}
    seconds: dict[str, list[float]] = {"none": [], "policy": [], "physics": []}
    sizes: dict[str, int] = {}
    for round_number in trange(config.rounds, unit="round", leave=False):
        walkers = {"none": make_walker(subject, None)}
        paths = {rate: folder / f"{rate}-{round_number}.mcap" for rate in ratios}
        for rate, path in paths.items():
            walkers[rate] = make_walker(subject, path, rate)  # pyright: ignore
        spent = portions(walkers, config.steps)
        for name, walker in walkers.items():
            walker.env.close()
            seconds[name].append(float(spent[name].sum()))
        for rate, path in paths.items():
            # by portion, as the machine's speed varies during a walk
            ratios[rate].append(float(np.median(spent[rate] / spent["none"])))
            sizes[rate] = path.stat().st_size
    results: dict[str, float] = {}
    rows = [["none", f"{statistics.median(seconds['none']):.2f} s", "", ""]]
    for rate, label in (("policy", "33 Hz"), ("physics", "joints at 2 kHz")):
        slower = statistics.median(ratios[rate]) - 1
        took, size = statistics.median(seconds[rate]), sizes[rate] / 1e6
        rows.append([label, f"{took:.2f} s", f"{100 * slower:.1f} %", f"{size:.2f} MB"])
        results |= {f"{rate}_slower": slower, f"{rate}_bytes": sizes[rate]}
    print("\n" + markdown(["log", "time of a walk", "slowdown", "size"], rows))
    return results


def portions(walkers: dict[str, Walker], steps: int) -> dict[str, np.ndarray]:
    """Wall time of each portion of an episode [s], all walkers in turn."""
    spent: dict[str, list[float]] = {name: [] for name in walkers}
    order = list(walkers)
    for _ in range(steps // _PORTION):
        for name in order:
            start = time.perf_counter()
            for _ in range(_PORTION):
                walkers[name].step()
            spent[name].append(time.perf_counter() - start)
        order = order[1:] + order[:1]
    return {name: np.array(times) for name, times in spent.items()}


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
