"""Ablations: trainings of several variants with one budget, kept results, one table and picture."""

from __future__ import annotations

import importlib.util
import inspect
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from ablate_settings import Config

import aslip
from aslip.base.assets import user_path
from aslip.base.interval import Interval
from aslip.base.tables import markdown
from aslip.base.writing import claimed
from aslip.envs import MAX_EPISODE_STEPS, Stack, evaluation_stack
from aslip.errors import AssetError, ConfigurationError, FileDamagedError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.show.plots import compare_learning, save_figure
from aslip.training.run import write_text
from aslip.training.settings import SETTINGS_FILE, read_settings
from aslip.transforms import WeightedReward
from aslip.walking import TRACKING_TOLERANCE, WalkResult

NEVER: Final = 10**12
"""Interval of evaluations, longer than a training, so that there is none [policy steps]."""

_RESULTS = "results.json"

Found = dict[str, dict[int, list[WalkResult]]]
"""Name of a variant -> seed -> walks."""

MakeStack = Callable[[GaitLibrary], Stack]
"""Function from a library to the stack of a policy, without what only training has."""


@dataclass(frozen=True)
class Variant:
    """Difference from the default."""

    question: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the recipe that differ from the default."""
    make_stack: MakeStack | None = None
    """Function that makes the stack; by default that of the experiment."""
    networks: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the recipe's `main` for other networks."""


@dataclass(frozen=True)
class Experiment:
    """Variants of a training."""

    variants: Mapping[str, Variant]
    """The variants by name."""
    make_stack: MakeStack
    """Function that makes the stack of the default, which variants of one's own edit."""
    weights: Mapping[str, float]
    """Weights of the reward by which the walks are compared."""
    train: Callable[[Variant, dict[str, Any]], list[WalkResult]]
    """Function that trains a variant with settings of the recipe that all share, and walks."""
    step_seconds: float
    """Duration of a policy step of a training, about [s]."""
    groups: tuple[str, ...] = ("",)
    """Names of the equal parts of a training's walks, in order; each part has a table."""


def without_terms(make_stack: MakeStack, weights: Mapping[str, float], *names: str) -> MakeStack:
    """Stack without some reward terms; the weights of the others are scaled to a sum of 1."""
    rest = 1 - sum(weights[name] for name in names)
    scaled = {key: 0.0 if key in names else w / rest for key, w in weights.items()}
    return lambda library: {**make_stack(library), "reward": WeightedReward(scaled)}


def with_files(experiment: Experiment, config: Config) -> tuple[Experiment, Config]:
    """Put the variants of Python files in place of the files' names.

    Raises:
        AssetError: there is no such file.
        ConfigurationError: it defines no function, or one with the name of another variant.
    """
    variants, names = dict(experiment.variants), []
    for name in config.variants:
        found = own_variants(name, experiment.make_stack) if name.endswith(".py") else {}
        if twice := sorted(found.keys() & variants.keys()):
            raise ConfigurationError(f"{name!r} defines {twice}, which are names of other variants")
        variants |= found
        names += found or [name]
    return replace(experiment, variants=variants), replace(config, variants=tuple(names))


def own_variants(file: str, make_stack: MakeStack) -> dict[str, Variant]:
    """Variants of a Python file: its public functions, each of which edits a stack.

    Raises:
        AssetError, ConfigurationError: see `with_files`.
    """
    path = user_path(file)
    if not path.is_file():
        raise AssetError(f"there is no file {file!r} of variants")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    functions = {
        name: value
        for name, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == spec.name and name[0] != "_"
    }
    if not functions:
        raise ConfigurationError(
            f"{file!r} defines no public function; each variant is a function of the stack, such"
            " as `def no_noise(stack): del stack['noise']`"
        )

    def edited(edit: Callable[[Stack], Stack | None], library: GaitLibrary) -> Stack:
        stack = make_stack(library)
        found = edit(stack)
        return stack if found is None else found

    return {
        name: Variant(
            next(iter((inspect.getdoc(edit) or "").splitlines()), ""),
            make_stack=partial(edited, edit),
        )
        for name, edit in functions.items()
    }


def run(config: Config, experiment: Experiment) -> Found:
    """Train missing variants, then write table and picture; returns the walks."""
    experiment, config = with_files(experiment, config)
    if config.list:
        for name, variant in experiment.variants.items():
            print(f"{name:24s}{variant.question}")
        return {}
    names = [*(config.variants or experiment.variants)]
    for name in names:
        if name not in experiment.variants:
            raise UnknownNameError.among("variant", name, experiment.variants)
    config.out.mkdir(parents=True, exist_ok=True)
    with claimed(config.out):
        return _run(config, experiment, names)


def _run(config: Config, experiment: Experiment, names: Sequence[str]) -> Found:
    """Train, and write table and picture; see `run`."""
    library = GaitLibrary.load(config.library)
    shared = {**budget(config), "library_sha256": library.sha256}
    jobs = [(name, seed, config.out / f"{name}-{seed}") for seed in config.seeds for name in names]
    done = {folder: read_results(folder, shared) for _, _, folder in jobs}
    for folder in [folder for folder, results in done.items() if results is None]:
        is_started(folder, config)  # before hours of training
    for name in {name for name, _, folder in jobs if done[folder] is None}:
        stack = (experiment.variants[name].make_stack or experiment.make_stack)(library)
        for one in (stack, evaluation_stack(stack, library)):
            aslip.make_env(stack=one).close()
    print(announcement(config, experiment, [*done.values()]), flush=True)
    found: Found = {}
    durations: list[float] = []
    for i, (name, seed, folder) in enumerate(jobs):
        results = done[folder]
        if results is None:
            left = ""
            if durations:
                seconds = round(float(np.mean(durations)) * (len(jobs) - i))
                left = f", about {timedelta(seconds=seconds)} left"
            print(f"{i + 1} of {len(jobs)}: {name}, seed {seed}{left}", flush=True)
            start = time.perf_counter()
            settings = {**budget(config), "out": folder, "seed": seed, "eval_interval": NEVER}
            settings |= {"resume": is_started(folder, config), "logger": config.logger}
            results = experiment.train(experiment.variants[name], settings)
            walks = [asdict(result) for result in results]
            kept = json.dumps({**shared, "walks": walks}, indent=1)
            write_text(folder / _RESULTS, kept + "\n")
            durations.append(time.perf_counter() - start)
        found.setdefault(name, {})[seed] = results
        shown = tables(found, config.total_steps, experiment)
        write_text(config.out / "ablation.md", shown + "\n")
        if durations or i + 1 == len(jobs):
            runs = {key: [config.out / f"{key}-{seed}" for seed in found[key]] for key in found}
            save_figure(compare_learning(runs), config.out / "ablation.png")
    print(tables(found, config.total_steps, experiment))
    return found


def announcement(config: Config, experiment: Experiment, done: Sequence[object]) -> str:
    """Message at the start: number of trainings that are not done, and their duration."""
    count, missing = len(done), sum(results is None for results in done)
    if not missing:
        return f"all of {count} trainings are done"
    seconds = missing * experiment.step_seconds * config.total_steps
    about = timedelta(seconds=60 * max(1, round(seconds / 60)))
    return (
        f"{missing} of {count} trainings to go, {config.total_steps} policy steps each: about"
        f" {about} (hours:minutes:seconds) on one core; Ctrl-C saves all finished work"
    )


def is_started(folder: Path, config: Config) -> bool:
    """True if a training was started in a folder, which must have had the same budget.

    Raises:
        ConfigurationError: it had another one.
    """
    started = (folder / SETTINGS_FILE).exists()
    if started:
        check_settings(folder, read_settings(folder)[0], budget(config))
    return started


def budget(config: Config) -> dict[str, int]:
    """Settings that all trainings of a table share."""
    return {"total_steps": config.total_steps, "num_envs": config.num_envs}


def read_results(folder: Path, expected: Mapping[str, Any]) -> list[WalkResult] | None:
    """Walks of a finished training; None if there is none.

    Args:
        folder: folder of the training.
        expected: its budget, and the hash of its gaits.

    Raises:
        ConfigurationError: the training had another budget, to which its schedule belongs, or other
            gaits.
        FileDamagedError: the results cannot be read.
    """
    path = folder / _RESULTS
    if not path.is_file():
        return None
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        walks = [WalkResult(**walk) for walk in kept["walks"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileDamagedError(
            f"{str(path)!r} is damaged ({error}); without it the training is evaluated again"
        ) from error
    check_settings(folder, kept, expected)
    return walks


def check_settings(folder: Path, kept: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Check what all trainings of a table share.

    Raises:
        ConfigurationError: the training has something else.
    """
    other = {name: kept.get(name) for name, value in expected.items() if kept.get(name) != value}
    if other:
        raise ConfigurationError(
            f"the training in {str(folder)!r} had {other}, not {dict(expected)}; choose another"
            " --out"
        )


def measures(results: Sequence[WalkResult], weights: Mapping[str, float]) -> dict[str, float]:
    """Columns of the table; a walk that ends in a fall counts up to the fall.

    The return is that of the common reward, whatever the training's was.
    """
    returns = [
        r.steps * sum(weight * r.terms[name] for name, weight in weights.items()) for r in results
    ]
    return {
        "survived": float(sum(r.survived for r in results)),
        "on the feet": float(sum(r.on_feet for r in results)),
        "tracked": float(sum(r.tracked for r in results)),
        "return": float(np.mean(returns)),
        "speed error m/s": float(np.mean([_speed_error(r) for r in results])),
        **{name: float(np.mean([r.terms[name] for r in results])) for name in weights},
    }


def _speed_error(walk: WalkResult) -> float:
    """Distance between mean and commanded velocity over the ground [m/s]."""
    sideways = walk.mean_sideways_speed - walk.sideways_speed
    return float(np.hypot(walk.mean_speed - walk.speed, sideways))


def tables(found: Found, total_steps: int, experiment: Experiment) -> str:
    """A table for each group of the walks, under its name."""
    parts = []
    for i, group in enumerate(experiment.groups):
        of_group = {
            name: {seed: _part(walks, i, len(experiment.groups)) for seed, walks in runs.items()}
            for name, runs in found.items()
        }
        heading = f"## {group}\n\n" if group else ""
        parts.append(heading + table(of_group, total_steps, experiment.weights))
    return "\n\n".join(parts)


def _part(walks: Sequence[WalkResult], index: int, parts: int) -> Sequence[WalkResult]:
    """One of equal parts of a training's walks."""
    size = len(walks) // parts
    return walks[index * size : (index + 1) * size]


def table(
    found: Mapping[str, Mapping[int, Sequence[WalkResult]]],
    total_steps: int,
    weights: Mapping[str, float],
) -> str:
    """Table with a row for each variant: means and 95 % intervals over seeds."""
    rows = []
    for name, by_seed in found.items():
        means = [measures(results, weights) for results in by_seed.values()]
        cells = [cell([m[key] for m in means]) for key in means[0]]
        rows.append([name, str(len(means)), *cells])
    first = next(iter(next(iter(found.values())).values()))
    names = [*measures(first, weights)]
    text = markdown(["variant", "seeds", *names], rows, ["---", "---:", *["---:"] * len(names)])
    near = f"tracked within {TRACKING_TOLERANCE:g} m/s"
    counted = f"Counts are of {len(first)} commands: survived, on the feet, and {near}."
    return f"{text}\n\n{total_steps} policy steps each; {_cells(found)}. {counted}"


def _cells(found: Mapping[str, Mapping[int, Any]]) -> str:
    """Sentence about the cells of a table."""
    seeds = [len(by_seed) for by_seed in found.values()]
    text = "mean and 95 % interval over seeds"
    if max(seeds) == 1:
        text = "values of one seed; small differences mean nothing, as seeds differ"
    elif min(seeds) == 1:
        text += ", if a variant has several"
    return f"{text}; the largest return is {MAX_EPISODE_STEPS}"


def cell(values: Sequence[float]) -> str:
    """Mean over seeds, and half the width of its interval if there are several values."""
    found = Interval.of([np.array([value]) for value in values])
    digits = 0 if found.mean >= 100 else 1 if found.mean >= 10 else 3
    half = f" ± {found.high - found.mean:.{digits}f}" if len(values) > 1 else ""
    return f"{found.mean:.{digits}f}{half}"
