"""How fast the recipe learns: on the estimate, on the truth, and with the paper's settings.

    python -m benchmarks.learning_curves                      # train what is missing, then report
    python -m benchmarks.learning_curves --jobs 2             # two runs at once, a processor each
    python -m benchmarks.learning_curves --no-train           # report what there is
    python -m benchmarks.learning_curves --variants estimate paper --seeds 0 1 2 3 4 5 6 7 8 9

Each run is `recipes/ppo_aslip.py` in a folder of its own. Runs that were interrupted, with Ctrl-C
or otherwise, go on from their last checkpoint the next time. Curves are means over seeds with
their range.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
import tyro
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.errors import one_line_errors
from aslip.plots import save_figure
from aslip.run import read_progress, write_text
from benchmarks.common import WALKING_LENGTH

VARIANTS: Final = MappingProxyType(
    {"truth": ("--truth",), "estimate": (), "paper": ("--preset", "paper")}
)
"""Name -> flags of the recipe; the paper's settings are on the estimate, too."""

_COLORS = {"truth": "black", "estimate": "tab:red", "paper": "tab:blue"}

Curves = dict[int, dict[str, np.ndarray]]
"""Seed -> columns of a run's progress."""

_RECIPE = Path(__file__).parents[1] / "recipes" / "ppo_aslip.py"
_POLL = 5.0  # [s]


@dataclass(frozen=True)
class Config:
    """Which runs."""

    out: Path = Path("runs/learning_curves")
    """Folder of the runs, one each, by variant and seed."""
    variants: tuple[Literal["truth", "estimate", "paper"], ...] = ("truth", "estimate")
    """What to compare."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of each variant."""
    total_steps: int = 1_500_000
    """Policy steps of each run."""
    jobs: int = 1
    """Runs at once; more than one are bound to a processor each."""
    train: bool = True
    """Train what is missing; otherwise report what there is."""
    picture: Path = Path("runs/learning_curves/learning_curves.png")
    """Where to draw."""


def main(config: Config) -> None:
    """Train, print and draw."""
    config.out.mkdir(parents=True, exist_ok=True)
    if config.train:
        _train(config)
    curves = {name: _curves(config, name) for name in config.variants}
    table = report(curves)
    print(table)
    write_text(config.out / "summary.md", table + "\n")
    save_figure(picture(curves), config.picture)


def _folder(config: Config, variant: str, seed: int) -> Path:
    return config.out / f"{variant}-{seed}"


# --------------------------------------------------------------------- training


def _train(config: Config) -> None:
    """Run what is missing, seed by seed, so that variants can be compared early."""
    wanted = [(variant, seed) for seed in config.seeds for variant in config.variants]
    total = len(wanted) * config.total_steps
    waiting = [run for run in wanted if _steps(_folder(config, *run)) < config.total_steps]
    running: dict[int, subprocess.Popen[bytes]] = {}
    done = sum(_steps(_folder(config, *run)) for run in wanted)
    with tqdm(total=total, initial=done, unit="step", dynamic_ncols=True) as bar:
        try:
            while waiting or running:
                for slot in range(config.jobs):
                    if slot not in running and waiting:
                        running[slot] = _start(config, *waiting.pop(0), slot)
                time.sleep(_POLL)
                bar.update(sum(_steps(_folder(config, *run)) for run in wanted) - bar.n)
                for slot, process in list(running.items()):
                    if process.poll() is not None:
                        if process.returncode:
                            raise SystemExit(f"a run failed; see the logs in {config.out}/")
                        del running[slot]
        finally:
            for process in running.values():
                process.terminate()


def _start(config: Config, variant: str, seed: int, slot: int) -> subprocess.Popen[bytes]:
    folder = _folder(config, variant, seed)
    command = [sys.executable, str(_RECIPE), "--seed", str(seed), "--out", str(folder)]
    command += ["--total-steps", str(config.total_steps), *VARIANTS[variant]]
    if any((folder / "checkpoints").glob("checkpoint-*")):
        command.append("--resume")
    with (config.out / f"{folder.name}.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    if config.jobs > 1 and hasattr(os, "sched_setaffinity"):
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(process.pid, {processors[slot % len(processors)]})
    return process


def _steps(folder: Path) -> int:
    """Policy steps a run has done."""
    steps = read_progress(folder).get("step")
    return int(steps[-1]) if steps else 0


# ---------------------------------------------------------------------- reports


def _curves(config: Config, variant: str) -> Curves:
    histories = {seed: read_progress(_folder(config, variant, seed)) for seed in config.seeds}
    return {
        seed: {name: np.array(column) for name, column in history.items()}
        for seed, history in histories.items()
        if history.get("step")
    }


def report(curves: dict[str, Curves]) -> str:
    """A row for each run: when it walks, and how well in the end."""
    lines = [
        f"| variant | seed | policy steps | episodes of {WALKING_LENGTH} after"
        " | length at the end | return | evaluation: return | speeds walked |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for variant, runs in curves.items():
        for seed, run in runs.items():
            walking = run["step"][run["episode_length"] >= WALKING_LENGTH]
            evaluated = np.flatnonzero(np.isfinite(run["eval_return"]))
            last = evaluated[-1] if len(evaluated) else -1
            lines.append(
                f"| {variant} | {seed} | {run['step'][-1]:.0f}"
                f" | {f'{walking[0]:.0f}' if len(walking) else 'not yet'}"
                f" | {run['episode_length'][-1]:.0f} | {run['episode_return'][-1]:.0f}"
                f" | {run['eval_return'][last]:.0f} | {100 * run['eval_survived'][last]:.0f} % |"
            )
    return "\n".join(lines)


def picture(curves: dict[str, Curves]) -> Figure:
    """Length and return of training episodes, mean and range over seeds."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, column in zip(axes, ("episode_length", "episode_return"), strict=True):
        for variant, runs in curves.items():
            if not runs:
                continue
            color = _COLORS[variant]
            shortest = min(runs.values(), key=lambda run: len(run["step"]))
            steps = shortest["step"] / 1e6
            values = np.stack([run[column][: len(steps)] for run in runs.values()])
            label = f"{variant}, seeds {', '.join(map(str, runs))}"
            # the shorter on top, as curves of truth and estimate coincide
            axis.plot(steps, values.mean(0), color=color, label=label, zorder=3 - steps[-1] / 100)
            axis.fill_between(steps, values.min(0), values.max(0), color=color, alpha=0.25, lw=0)
        axis.set(xlabel="million policy steps", ylabel=column.replace("_", " "), ylim=(0, 400))
        axis.grid(alpha=0.3)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(tyro.cli(Config))
