r"""Learning curves of the recipes: straight walks, the paper's settings, and all directions.

    python -m benchmarks.scorecard.learning_curves             # train missing runs, then report
    python -m benchmarks.scorecard.learning_curves --jobs 2    # two runs at a time
    python -m benchmarks.scorecard.learning_curves --no-train  # report existing runs
    python -m benchmarks.scorecard.learning_curves --record docs/learning_curves.csv --no-train \
        --variants straight paper baseline --seeds 10 11 12 13 14
    python -m benchmarks.scorecard.learning_curves --out runs --variants directions \
        --seeds 10 11 12 13 14 --total-steps 4990000 --jobs 2 --record docs/direction_curves.csv

Each run is a recipe in its own folder, such as `runs/learning_curves/paper-10`: `ppo_aslip.py`, or
`ppo_directions.py` for the variant `directions`. Interrupted runs resume from their last
checkpoints. A run made elsewhere counts when it is copied there, finished or not. Curves show mean
and range over seeds.

A record, `--record`, collects the curves of finished runs over days and machines, without their run
folders. The report includes its runs, which are not trained again, and adds new finished runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, FileDamagedError, one_line_errors
from benchmarks.flags import check_numbers

Variant = Literal["truth", "default", "straight", "robust", "paper", "baseline", "directions"]


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    out: Path = Path("runs/learning_curves")
    """Parent of the run folders."""
    variants: tuple[Variant, ...] = ("truth", "default")
    """Variants of the recipes."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of each variant."""
    total_steps: int = 1_500_000
    """Policy steps of each run; the report shows longer runs up to there."""
    schedule_steps: int = 0
    """Policy steps after which learning rate and standard deviation have their final values; 0 for
    `total_steps`."""
    jobs: int = 1
    """Number of simultaneous runs; several are bound to one processor each."""
    train: bool = True
    """Train missing runs before the report."""
    record: Path | None = None
    """CSV file with the curves of finished runs; created if missing."""
    picture: Path = Path("runs/learning_curves/learning_curves.png")
    """File for the picture."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_numbers(self, jobs=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from aslip.base.command_line import preset_command_line
from aslip.base.interval import Interval
from aslip.base.processes import signals_exit
from aslip.base.tables import markdown
from aslip.base.writing import claimed
from aslip.policy import POLICY_FILE, read_card
from aslip.show.plots import compare_learning, save_figure
from aslip.training.progress import read_progress, steps_done
from aslip.training.run import write_text
from aslip.training.settings import SETTINGS_FILE, read_settings
from benchmarks.scorecard.learning_record import (
    COLUMNS,
    LENGTHS,
    Run,
    Runs,
    read_record,
    write_record,
)
from recipes.ppo_directions import DirectionConfig
from recipes.ppo_settings import PRESETS

VARIANTS: Final = MappingProxyType(
    {
        "truth": ("truth",),
        "default": (),
        "straight": ("straight",),
        "robust": ("robust",),
        "paper": ("paper",),
        "baseline": (
            "single_reference", "--last-learning-rate", "1e-4", "--last-std", str(math.exp(-2)),
            "--fall-after", "0.6",
        ),
        "directions": (),
    }
)  # fmt: skip
"""Variant -> flags of its recipe. Only `truth` observes the true state. `baseline` is the paper's
baseline with the learning settings of `paper`; its returns are of its own reward."""

_OWN_REWARD = {"baseline": " (return of its own reward)"}

# settings that may differ within a variant
_FREE = {
    "out", "resume", "device", "total_steps", "eval_interval", "checkpoint_minutes",
}  # fmt: skip
_IN_ALL_DIRECTIONS = ("directions",)
_POLL = 5.0  # [s]


def main(config: Config) -> None:
    """Train missing runs, print and draw."""
    config.out.mkdir(parents=True, exist_ok=True)
    for variant, seed in _wanted(config):
        _check_settings(config, variant, seed)
    recorded = read_record(config.record) if config.record else {}
    if config.train:
        _train(config, recorded)
    with claimed(config.record, wait=True) if config.record else nullcontext():
        # another process may have extended it during the training
        recorded = read_record(config.record) if config.record else {}
        found = {key: run for key, run in _found(config).items() if _longer(run, recorded.get(key))}
        done = {k: run.thinned() for k, run in found.items() if run.steps >= config.total_steps}
        if config.record and done:
            write_record(config.record, {**recorded, **done})
    found = {**recorded, **found}
    wanted = [key for key in _wanted(config) if key in found]
    runs = [found[key].until(config.total_steps) for key in wanted]
    if not runs:
        raise ConfigurationError(
            f"there is no run of {config.variants} with seeds {config.seeds} in {str(config.out)!r}"
            " or in --record; leave out --no-train to train them"
        )
    table = report(runs)
    print(table)
    write_text(config.out / "summary.md", table + "\n")
    save_figure(picture(runs), config.picture)


def _longer(run: Run, other: Run | None) -> bool:
    return other is None or run.steps > other.steps


def _wanted(config: Config) -> list[tuple[str, int]]:
    """(Variant, seed) of all runs, variant by variant."""
    pairs = [(variant, seed) for variant in config.variants for seed in config.seeds]
    return list(dict.fromkeys(pairs))


def _folder(config: Config, variant: str, seed: int) -> Path:
    return config.out / f"{variant}-{seed}"


def _check_settings(config: Config, variant: str, seed: int) -> None:
    """Check that the run in a folder, if there is one, is of this variant, seed and schedule.

    Raises:
        ConfigurationError: a setting of learning is another.
    """
    folder = _folder(config, variant, seed)
    if not (folder / SETTINGS_FILE).exists():
        return
    kept = read_settings(folder)[0]
    kept["schedule_steps"] = kept.get("schedule_steps") or kept.get("total_steps")
    wanted = _settings(variant, seed)
    wanted["schedule_steps"] = config.schedule_steps or config.total_steps
    other = {
        name: kept[name]
        for name, value in wanted.items()
        if name not in _FREE and kept.get(name, value) != value
    }
    if other:
        raise ConfigurationError(
            f"the run in {str(folder)!r} is not {variant!r} with seed {seed}, it has {other};"
            f" {variant!r} has { ({name: wanted[name] for name in other}) }; move the run away, or"
            " give its --schedule-steps"
        )


def _settings(variant: str, seed: int) -> dict[str, Any]:
    """Settings of a variant's recipe."""
    flags = [*VARIANTS[variant], "--seed", str(seed)]
    if variant in _IN_ALL_DIRECTIONS:
        return asdict(command_line(DirectionConfig, arguments=flags))
    return asdict(preset_command_line(PRESETS, {}, flags))


# --------------------------------------------------------------------- training


def _train(config: Config, recorded: Runs) -> None:
    """Train missing runs seed by seed, so that variants can be compared early."""
    kept = {key for key, run in recorded.items() if run.steps >= config.total_steps}
    wanted = [run for run in _wanted(config) if run not in kept]
    wanted.sort(key=lambda run: run[1])
    total = len(wanted) * config.total_steps
    waiting = [run for run in wanted if steps_done(_folder(config, *run)) < config.total_steps]
    running: dict[int, subprocess.Popen[bytes]] = {}
    done = sum(steps_done(_folder(config, *run)) for run in wanted)
    bar = tqdm(total=total, initial=done, unit="step", dynamic_ncols=True)
    with bar, signals_exit():
        try:
            while waiting or running:
                for slot in range(config.jobs):
                    if slot not in running and waiting:
                        running[slot] = _start(config, *waiting.pop(0), slot)
                time.sleep(_POLL)
                bar.update(sum(steps_done(_folder(config, *run)) for run in wanted) - bar.n)
                for slot, process in list(running.items()):
                    if process.poll() is not None:
                        if process.returncode:
                            raise SystemExit(f"a run failed; see the logs in {config.out}/")
                        del running[slot]
        finally:
            for process in running.values():
                process.terminate()
            # wait until they have saved
            for process in running.values():
                process.wait()


def _start(config: Config, variant: str, seed: int, slot: int) -> subprocess.Popen[bytes]:
    folder = _folder(config, variant, seed)
    recipe = ["train", *(["directions"] if variant in _IN_ALL_DIRECTIONS else [])]
    command = [sys.executable, "-m", "aslip", *recipe, *VARIANTS[variant]]
    command += ["--seed", str(seed), "--out", str(folder), "--total-steps", str(config.total_steps)]
    command += ["--schedule-steps", str(config.schedule_steps)]
    # without a checkpoint, --resume starts from the beginning
    if (folder / "config.json").exists():
        command.append("--resume")
    with (config.out / f"{folder.name}.log").open("ab") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    if config.jobs > 1 and hasattr(os, "sched_setaffinity"):
        processors = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(process.pid, {processors[slot % len(processors)]})
    return process


# ----------------------------------------------------------------------- record


def _found(config: Config) -> Runs:
    """Runs in the folder, finished or not."""
    runs = {}
    for variant, seed in _wanted(config):
        folder = _folder(config, variant, seed)
        history = read_progress(folder)
        if history.get("step"):
            if lacking := [name for name in COLUMNS if name not in history]:
                raise FileDamagedError(f"the progress in {str(folder)!r} lacks {lacking}")
            columns = {name: np.array(history[name]) for name in COLUMNS}
            runs[variant, seed] = Run(variant, seed, _commit(folder), columns)
    return runs


def _commit(folder: Path) -> str:
    """Commit that trained the policy of a run; empty without a policy."""
    policy = folder / POLICY_FILE
    return read_card(policy)["made_by"].get("commit") or "" if policy.exists() else ""


# ---------------------------------------------------------------------- reports


def report(runs: Sequence[Run]) -> str:
    """Table of time until walking and final results, for each run and each variant's mean."""
    header = ["variant", "seed", "commit", "steps [10³]", "time [min]"]
    header += [f"steps to length {length} [10³]" for length in LENGTHS]
    header += ["final length", "final return", "evaluation return", "commands survived [%]"]
    header += ["divergences"]
    # Student's interval may exceed 100 %
    most = [100.0 if name.endswith("[%]") else math.inf for name in header[3:]]
    lines = []
    for variant in dict.fromkeys(run.variant for run in runs):
        group = [run for run in runs if run.variant == variant]
        values = np.array([_numbers(run) for run in group])
        for run, row in zip(group, values, strict=True):
            cells = map(_cell, row[:, None], most)
            # a plus marks uncommitted changes
            commit = run.commit[:7] + "+" * run.commit.endswith("+")
            lines.append([variant, str(run.seed), commit, *cells])
        if len(group) > 1:
            lines.append([variant, f"{len(group)} seeds", "", *map(_cell, values.T, most)])
    return markdown(header, lines)


def _numbers(run: Run) -> list[float]:
    """Numbers of a run's row in the report; NaN for events that did not happen."""
    columns = run.columns
    reached = [run.after(length) for length in LENGTHS]
    evaluations = run.evaluations()
    last = evaluations[-1] if len(evaluations) else None
    numbers = [
        run.steps / 1000,
        columns["elapsed_s"][-1] / 60,
        *(math.nan if row is None else columns["step"][row] / 1000 for row in reached),
        columns["episode_length"][-1],
        columns["episode_return"][-1],
        math.nan if last is None else columns["eval_return"][last],
        math.nan if last is None else 100 * columns["eval_survived"][last],
        columns["divergences"][-1],
    ]
    return [float(number) for number in numbers]


def _cell(values: np.ndarray, most: float) -> str:
    """Cell with one run's value, or mean and interval over runs if all have a value."""
    if not np.isfinite(values).all():
        return f"{np.isfinite(values).sum()} of {len(values)}" if len(values) > 1 else "not yet"
    interval = Interval.of([values[i : i + 1] for i in range(len(values))])
    return replace(interval, high=min(interval.high, most)).text(0)


def picture(runs: Sequence[Run]) -> Figure:
    """Draw length and return of episodes and evaluations, mean and range over seeds."""
    groups: dict[str, list[Mapping[str, np.ndarray]]] = {}
    for variant in dict.fromkeys(run.variant for run in runs):
        group = [run for run in runs if run.variant == variant]
        seeds = _seeds_text([run.seed for run in group])
        groups[f"{variant}{_OWN_REWARD.get(variant, '')}, {seeds}"] = [run.columns for run in group]
    return compare_learning(groups)


def _seeds_text(seeds: Sequence[int]) -> str:
    """Seeds of a curve, without a break as a range."""
    first, last = min(seeds), max(seeds)
    if len(seeds) > 2 and sorted(seeds) == [*range(first, last + 1)]:
        return f"seeds {first} to {last}"
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
