"""Train without each part of the method, several seeds, and compare in one table and one picture.

    python recipes/ablate.py                                        # all variants, three seeds
    python recipes/ablate.py --variants default no_delta --seeds 0 1 --total-steps 500000
    python recipes/ablate.py --list

Variants are trained one after the other with the same budget. Finished work is kept: the same
command resumes an interrupted training and adds new rows to the table. All policies are evaluated
on the same task (`aslip.envs.evaluation_stack`): walks at 21 speeds, with the paper's reward on the
true state and the motion of the actuated spring-mass model. Each policy gets the observation with
which it was trained.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import ConfigurationError, FileDamagedError, UnknownNameError, one_line_errors
from aslip.training.command_line import command_line, this_command

NAMES = (
    "default", "no_com_vel", "no_foot_pos", "no_straight_diff", "no_foot_orient", "no_action_diff",
    "no_delta", "no_feedforward", "no_symmetry", "no_model_inputs", "pendulum", "truth",
    "reward_on_estimate", "no_delay", "no_reflected_inertia",
)  # fmt: skip
"""Names of the variants."""


@dataclass(frozen=True)
class Config:
    """Settings of the ablations."""

    variants: tuple[str, ...] = NAMES
    """Names of the variants to train."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of each variant."""
    total_steps: int = 500_000
    """Policy steps of each training."""
    num_envs: int = 256
    """Robots simulated side by side."""
    out: Path = Path("runs/ablation")
    """Folder of all trainings, the table `ablation.md` and the picture `ablation.png`."""
    list: bool = False
    """List the variants and train nothing."""

    def __post_init__(self) -> None:
        """Check the names.

        Raises:
            UnknownNameError: a variant is unknown.
            ConfigurationError: there is no variant or no seed.
        """
        for name in self.variants:
            if name not in NAMES:
                raise UnknownNameError.among("variant", name, NAMES)
        if not self.variants or not self.seeds:
            raise ConfigurationError("name at least one variant and one seed")


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, field, replace
from datetime import timedelta
from functools import partial
from typing import Any

import numpy as np
import ppo_aslip
import torch
from ppo_settings import PRESETS
from tensordict import TensorDictBase
from torchrl.data import Composite

import aslip
from aslip.envs import (
    MAX_EPISODE_STEPS,
    ON_TRUTH,
    STACKS,
    Stack,
    command_speeds,
    default_stack,
    edit_stack,
    evaluation_stack,
    insert_before,
)
from aslip.library import pendulum_library
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.plots import compare_learning, save_figure
from aslip.training.progress import read_progress
from aslip.training.run import write_text
from aslip.training.settings import SETTINGS_FILE, read_settings
from aslip.transforms import (
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    ClockInput,
    RandomDynamics,
    SeededTransform,
    WeightedReward,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import TRACKING_TOLERANCE, Interval, WalkResult, evaluate, markdown

_RESULTS = "judged.json"
_NEVER = 10**12  # policy steps; evaluations would take a tenth of such a short training
_TIMED_STEPS, _UPDATES_TOO = 4, 1.2  # of an estimated duration: policy steps, factor for updates


class StandingBaseline(SeededTransform):
    """Write the motor angles of the standing robot under `("baseline", "motor_position")`."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[("baseline", "motor_position")])
        model = load_model()
        motors = CASSIE.indices.motor_qpos
        self._angles = torch.tensor(model.key("standing").qpos[motors], dtype=torch.float32)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        angles = self._angles.expand(*next_tensordict.batch_size, -1)
        return next_tensordict.set(self.out_keys[0], angles.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the angles."""
        return extend_spec(observation_spec, {self.out_keys[0]: len(CASSIE.motor_names)})


@dataclass(frozen=True)
class Variant:
    """One experiment."""

    question: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of `ppo_aslip.py` that differ from the default."""
    edits: Callable[[], dict[str, Any]] = dict
    """Function that makes the arguments of `aslip.make_env` that differ from the default."""


def without_term(name: str) -> Variant:
    """Variant without a reward term; the others share its weight, so the largest reward is 1."""
    rest = 1 - PAPER_WEIGHTS[name]
    weights = {key: 0.0 if key == name else w / rest for key, w in PAPER_WEIGHTS.items()}
    reward = partial(WeightedReward, weights)
    return Variant(f"no reward for {name}", edits=lambda: {"replace": {"reward": reward}})


def with_dynamics(name: str, value: float) -> Callable[[], dict[str, Any]]:
    """Function that makes the edits for robots with other dynamics."""

    def edits() -> dict[str, Any]:
        dynamics = partial(RandomDynamics, {name: (value, value)})
        return {"stack": insert_before(default_stack(), "start", dynamics=dynamics)}

    return edits


def _absolute_actions() -> dict[str, Any]:
    stack: Stack = insert_before(default_stack(), "action", standing=StandingBaseline)
    stack["action"] = lambda: ActionDelta(("baseline", "motor_position"))
    return {"stack": stack}


def _blind_to_the_model() -> dict[str, Any]:
    stack = insert_before(default_stack(), "observation", clock_input=ClockInput)
    stack["observation"] = lambda: AssembleObservation(SINGLE_REFERENCE_TABLE)
    return {"stack": stack}


VARIANTS: Mapping[str, Variant] = {
    "default": Variant("everything"),
    **{f"no_{name}": without_term(name) for name in PAPER_WEIGHTS},
    "no_delta": Variant(
        "actions are added to a standing pose, not to the reference", edits=_absolute_actions
    ),
    "no_feedforward": Variant("motor targets as in the paper", edits=lambda: {"stack": "paper"}),
    "no_symmetry": Variant("no left-right symmetry of the networks", {"symmetric": False}),
    "no_model_inputs": Variant(
        "clock and speed as inputs instead of the reduced-order model", edits=_blind_to_the_model
    ),
    "pendulum": Variant(
        "linear inverted pendulum instead of the actuated spring-mass model",
        edits=lambda: {"library": pendulum_library(aslip.GaitLibrary.load().gaits)},
    ),
    "truth": Variant("the true state instead of the estimate", edits=lambda: dict(ON_TRUTH)),
    "reward_on_estimate": Variant(
        "rewards of the estimated state", edits=lambda: {"reward_on": "estimate"}
    ),
    "no_delay": Variant("no torque delay", edits=with_dynamics("torque_delay", 0.0)),
    "no_reflected_inertia": Variant(
        "no reflected inertia of the motors", edits=with_dynamics("reflected_inertia", 0.0)
    ),
}
"""Name -> difference from the default."""


def main(config: Config, go_on: str = "the same call") -> dict[str, dict[int, list[WalkResult]]]:
    """Train missing variants, then write table and picture; returns the walks.

    Args:
        config: the settings.
        go_on: command that continues after an interruption, for messages.
    """
    if config.list:
        print("\n".join(f"{name:24s}{variant.question}" for name, variant in VARIANTS.items()))
        return {}
    jobs = [(seed, name) for seed in config.seeds for name in config.variants]
    found: dict[str, dict[int, list[WalkResult]]] = {}
    durations: list[float] = []
    print(announcement(config, len(jobs)), flush=True)
    for i, (seed, name) in enumerate(jobs):
        folder = config.out / f"{name}-{seed}"
        results = read_results(folder, config)
        if results is None:
            left = ""
            if durations:
                seconds = round(float(np.mean(durations)) * (len(jobs) - i))
                left = f", about {timedelta(seconds=seconds)} left"
            print(f"{i + 1} of {len(jobs)}: {name}, seed {seed}{left}", flush=True)
            start = time.perf_counter()
            results = train(config, folder, VARIANTS[name], seed, go_on)
            durations.append(time.perf_counter() - start)
        found.setdefault(name, {})[seed] = results
        write_text(config.out / "ablation.md", table(found, config.total_steps) + "\n")
        if durations or i + 1 == len(jobs):
            runs = {
                key: [read_progress(config.out / f"{key}-{s}") for s in found[key]] for key in found
            }
            save_figure(compare_learning(runs), config.out / "ablation.png")
    print(table(found, config.total_steps))
    return found


def announcement(config: Config, count: int) -> str:
    """Message at the start: number of trainings, and their duration."""
    names = [f"{name}-{seed}" for seed in config.seeds for name in config.variants]
    done = sum((config.out / name / _RESULTS).exists() for name in names)
    if done == count:
        return f"all of {count} trainings are done"
    seconds = (count - done) * estimated_seconds(config)
    about = timedelta(seconds=60 * max(1, round(seconds / 60)))
    return (
        f"{count - done} of {count} trainings to go, {config.total_steps} policy steps each: about"
        f" {about} (hours:minutes:seconds) on this machine; Ctrl-C saves all finished work"
    )


def estimated_seconds(config: Config) -> float:
    """Duration of a training and two evaluations, extrapolated from a few policy steps [s]."""
    env = aslip.make_env(num_envs=config.num_envs)
    env.rollout(1)
    start = time.perf_counter()
    env.rollout(_TIMED_STEPS, break_when_any_done=False)
    seconds = (time.perf_counter() - start) / (_TIMED_STEPS * config.num_envs)
    speeds = len(command_speeds(env))
    env.close()
    return seconds * (_UPDATES_TOO * config.total_steps + 2 * speeds * MAX_EPISODE_STEPS)


def trained_on(variant: Variant) -> Stack:
    """Stack on which the policies of a variant are trained."""
    edits = {"stack": "aslip", **variant.edits()}
    stack = edits["stack"]
    if isinstance(stack, str):
        stack = STACKS[stack](edits.get("library"), edits.get("reward_on", "truth"))
    return edit_stack(stack, edits.get("drop", ()), edits.get("replace", {}))


def judge(folder: Path, variant: Variant, seed: int) -> list[WalkResult]:
    """Walks of a training's policy at all speeds, on the common task of evaluations."""
    speeds = aslip.GaitLibrary.load().speeds.tolist()
    stack = evaluation_stack(trained_on(variant))
    with closing(aslip.make_env(num_envs=len(speeds), seed=seed, stack=stack)) as env:
        return evaluate(aslip.load_policy(folder), env, speeds, PRESETS["default"].eval_steps)


def train(
    config: Config, folder: Path, variant: Variant, seed: int, go_on: str
) -> list[WalkResult]:
    """Train or resume one run, and return its walks.

    Raises:
        ConfigurationError: the run was started with another budget.
    """
    resume = (folder / SETTINGS_FILE).exists()
    if resume:
        check_budget(folder, read_settings(folder)[0], config)
    settings = replace(
        PRESETS["default"], out=folder, seed=seed, total_steps=config.total_steps,
        num_envs=config.num_envs, eval_interval=_NEVER, resume=resume, **variant.settings,
    )  # fmt: skip
    make_env = partial(aslip.make_env, **variant.edits())
    ppo_aslip.main(settings, make_env, go_on=go_on)
    results = judge(folder, variant, seed)
    kept = {**budget(config), "walks": [asdict(result) for result in results]}
    write_text(folder / _RESULTS, json.dumps(kept, indent=1) + "\n")
    return results


def budget(config: Config) -> dict[str, int]:
    """Settings that all trainings of a table share."""
    return {"total_steps": config.total_steps, "num_envs": config.num_envs}


def read_results(folder: Path, config: Config) -> list[WalkResult] | None:
    """Walks of a finished training; None if there is none.

    Raises:
        ConfigurationError: the training had another budget, to which its schedule belongs.
        FileDamagedError: the results cannot be read.
    """
    path = folder / _RESULTS
    if not path.exists():
        return None
    try:
        kept = json.loads(path.read_text())
        walks = [WalkResult(**walk) for walk in kept["walks"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileDamagedError(
            f"{str(path)!r} is damaged ({error}); without it the training is evaluated again"
        ) from error
    check_budget(folder, kept, config)
    return walks


def check_budget(folder: Path, kept: Mapping[str, Any], config: Config) -> None:
    """Check the budget of a training.

    Raises:
        ConfigurationError: the training has another budget.
    """
    other = {k: kept.get(k) for k, value in budget(config).items() if kept.get(k) != value}
    if other:
        raise ConfigurationError(
            f"the training in {str(folder)!r} had {other}, not {budget(config)}; choose another"
            " --out"
        )


def measures(results: Sequence[WalkResult]) -> dict[str, float]:
    """Columns of the table; a walk that ends in a fall counts up to the fall."""
    returns = [
        r.steps * sum(weight * r.terms[name] for name, weight in PAPER_WEIGHTS.items())
        for r in results
    ]
    return {
        "survived": float(sum(r.survived for r in results)),
        "on the feet": float(sum(r.on_feet for r in results)),
        "tracked": float(sum(r.tracked for r in results)),
        "paper's return": float(np.mean(returns)),
        "speed error m/s": float(np.mean([abs(r.mean_speed - r.speed) for r in results])),
        **{name: float(np.mean([r.terms[name] for r in results])) for name in PAPER_WEIGHTS},
    }


def table(found: Mapping[str, Mapping[int, Sequence[WalkResult]]], total_steps: int) -> str:
    """Table with a row for each variant: means and 95 % intervals over seeds."""
    rows = []
    for name, by_seed in found.items():
        means = [measures(results) for results in by_seed.values()]
        cells = [cell([m[key] for m in means]) for key in means[0]]
        rows.append([name, str(len(means)), *cells])
    first = next(iter(next(iter(found.values())).values()))
    names = [*measures(first)]
    text = markdown(["variant", "seeds", *names], rows, ["---", "---:", *["---:"] * len(names)])
    near = f"tracked within {TRACKING_TOLERANCE:g} m/s"
    counted = f"Counts are of {len(first)} speeds: survived, on the feet, and {near}."
    return f"{text}\n\n{total_steps} policy steps each; {_cells(found)}. {counted}"


def _cells(found: Mapping[str, Mapping[int, Any]]) -> str:
    """Sentence about the cells of a table."""
    seeds = [len(by_seed) for by_seed in found.values()]
    told = "mean and 95 % interval over seeds"
    if max(seeds) == 1:
        told = "values of one seed; small differences mean nothing, as seeds differ"
    elif min(seeds) == 1:
        told += ", if a variant has several"
    return f"{told}; the largest return is {MAX_EPISODE_STEPS}"


def cell(values: Sequence[float]) -> str:
    """Mean over seeds, and half the width of its interval if there are several values."""
    found = Interval.of([np.array([value]) for value in values])
    digits = 0 if found.mean >= 100 else 1 if found.mean >= 10 else 3
    half = f" ± {found.high - found.mean:.{digits}f}" if len(values) > 1 else ""
    return f"{found.mean:.{digits}f}{half}"


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG, go_on=this_command())
