"""Subjects, walks and reports shared by the benchmarks.

A subject is a policy and a way to make its environment. On the command line a policy is the name of
a shipped one, a file or a run folder, and its environment follows from its card. In Python `main`
of a benchmark also takes any TensorDict module, and a function that makes environments:

    def my_env(**settings):                    # num_envs, seed, drop, ... of `aslip.make_env`
        return aslip.make_env(stack=my_stack(), **settings)

    foot_placement.main(foot_placement.Config(), policy=my_actor, make_env=my_env)
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl import torchrl_logger
from tqdm import tqdm

import aslip
from aslip.base.interval import Interval
from aslip.envs import EPISODE_ENDS, ON_TRUTH, StackEnv, shipped_library
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds
from aslip.library.library import SHIPPED
from aslip.log import read, read_walk
from aslip.policy import add_memory, check_policy_fits, policy_library, policy_stack
from aslip.robot import CASSIE, SIDES
from aslip.rom import Gait
from aslip.show.plots import save_figure
from aslip.training.checkpoint import load_checkpoint, save_checkpoint, snapshot
from aslip.training.run import write_text
from aslip.walking import Walks, command_library, next_start, record_walks, walk
from benchmarks.flags import Common, WithLibrary

__all__ = [
    "WALKING_LENGTH",
    "Common",
    "Holder",
    "Interval",
    "MakeEnv",
    "Policy",
    "Subject",
    "check_straight",
    "checkpoint_times",
    "chosen_library",
    "constant_walks",
    "load_library",
    "load_subjects",
    "load_with_library",
    "logged_walk",
    "nearest_gait",
    "quiet",
    "record_subject",
    "shortest_swing",
    "straight",
    "strides",
    "walk_on",
    "write_report",
    "write_results",
]

WALKING_LENGTH = 350
"""Mean episode length from which a training counts as walking, of at most 400 [policy steps]."""

Policy = TensorDictModuleBase | str | Path
"""Policy module, or what `aslip.load_policy` takes."""

MakeEnv = Callable[..., StackEnv]
"""Function that makes an environment, with the keywords of `aslip.make_env`."""


@dataclass(frozen=True)
class Subject:
    """Policy to measure, and the function that makes its environment."""

    name: str
    """Name in reports, see `policy_name`."""
    policy: TensorDictModuleBase
    """TensorDict module that writes `action`."""
    make_env: MakeEnv
    """Function that makes its environments."""
    stored: bool
    """True for a policy file, whose card environments are checked against."""
    find_library: Callable[[], GaitLibrary]
    """Function that loads the library of its gaits."""

    @classmethod
    def load(
        cls,
        policy: Policy,
        make_env: MakeEnv | None = None,
        library: GaitLibrary | None = None,
    ) -> Subject:
        """Make a subject of a policy's name, path or module.

        Args:
            policy: the policy.
            make_env: function that makes its environment; by default `aslip.make_env` with the
                stack named in the policy's card. For a module it is the default stack, or the one
                for all directions if the library has several axes.
            library: library of the default environment; by default that of the stack.

        Raises:
            AssetError: no such policy exists.
            ConfigurationError: the card names no stack, and `make_env` is not given.
        """
        stored = isinstance(policy, str | Path)
        if make_env is None:
            several = library is not None and library.command_size > 1
            stack = policy_stack(policy) if stored else "directions" if several else "default"
            make_env = partial(aslip.make_env, stack=stack, library=library)
        module = aslip.load_policy(policy) if stored else policy
        find_library = partial(command_library, policy) if library is None else lambda: library
        return cls(policy_name(policy), module, make_env, stored, find_library)

    def env(self, num_envs: int, **settings: Any) -> StackEnv:
        """Environment of the policy whose episodes end as in training.

        `drop` and `replace` add to those of a `make_env` that is a `functools.partial`.

        Raises:
            ConfigurationError: observation or action baseline differ from the policy's card.
        """
        settings = _joined(self.make_env, settings)
        env = self.make_env(num_envs=num_envs, **settings)
        if self.stored:
            check_policy_fits(self.name, env)
        add_memory(env, self.policy)
        return env

    def walking_env(self, config: Common, num_envs: int, **settings: Any) -> StackEnv:
        """Environment of the policy whose episodes end only in falls."""
        drop = [*EPISODE_ENDS]
        if config.truth:
            drop += ON_TRUTH["drop"]
            settings["replace"] = ON_TRUTH["replace"]
        return self.env(num_envs, seed=config.seed, drop=drop, **settings)


def _joined(make_env: MakeEnv, settings: dict[str, Any]) -> dict[str, Any]:
    """Settings that do not undo what a `functools.partial` drops and replaces."""
    bound = make_env.keywords if isinstance(make_env, partial) else {}
    joined = dict(settings)
    if "drop" in settings and "drop" in bound:
        first = [bound["drop"]] if isinstance(bound["drop"], str) else bound["drop"]
        joined["drop"] = [*first, *settings["drop"]]
    if "replace" in settings and "replace" in bound:
        joined["replace"] = {**(bound["replace"] or {}), **settings["replace"]}
    return joined


def load_subjects(
    config: Common,
    policy: Policy | None = None,
    make_env: MakeEnv | None = None,
    library: GaitLibrary | None = None,
) -> list[Subject]:
    """Subjects of a benchmark: a policy given in Python, or those of the command line."""
    policies = config.policy if policy is None else [policy]
    return [Subject.load(one, make_env, library) for one in policies]


def load_with_library(
    config: WithLibrary, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> tuple[list[Subject], GaitLibrary]:
    """Subjects of a benchmark, and the library of their gaits.

    The library is the flag's, or the shipped one of the first policy.
    """
    subjects = load_subjects(config, policy, make_env, chosen_library(config))
    return subjects, subjects[0].find_library()


def chosen_library(config: WithLibrary) -> GaitLibrary | None:
    """Library of the flag, if it is given."""
    return None if config.library is None else load_library(config.library)


def load_library(path: str) -> GaitLibrary:
    """Library by name or file, as `GaitLibrary.load`; a shipped one is read once."""
    return shipped_library(path) if path in SHIPPED else GaitLibrary.load(path)


def policy_name(policy: Policy) -> str:
    """Name of a policy in reports: name, path, or class of the module."""
    return str(policy) if isinstance(policy, str | Path) else str(policy.__class__.__name__)


def constant_walks(
    config: Common, subjects: Sequence[Subject], speeds: Sequence[float], duration: float
) -> list[Walks]:
    """Record walks at constant speeds side by side, one `Walks` for each subject.

    Args:
        config: settings of the walks.
        subjects: the subjects.
        speeds: commanded speeds [m/s].
        duration: duration [s].
    """
    steps = round(duration / CASSIE.policy_period)
    command = np.tile(np.array(speeds), (steps, 1))
    return [record_subject(config, subject, command) for subject in subjects]


def record_subject(config: Common, subject: Subject, command: np.ndarray) -> Walks:
    """Record walks of one subject through commands (m, n) [m/s]."""
    with contextlib.closing(subject.walking_env(config, command.shape[1])) as env:
        return record_walks(subject.policy, env, command)


def logged_walk(path: Path) -> Walks:
    """Read the walk of a log, straight ahead.

    Raises:
        ConfigurationError: the walk is commanded sideways, or to turn.
    """
    walk = read_walk(read(path))
    if walk.command.ndim == 3 and walk.command[..., 1:].any():
        raise ConfigurationError(
            f"{str(path)!r} is commanded sideways or to turn, and the benchmark measures walks"
            ' straight ahead: record with recipes/walk.py --command "0:0.5,4:1.0"'
        )
    return walk


def check_straight(policies: Sequence[Policy]) -> None:
    """Check that policies follow the paper's gaits, straight ahead; modules count as such.

    Raises:
        ConfigurationError: one follows gaits in all directions.
    """
    for policy in policies:
        if isinstance(policy, str | Path) and policy_library(policy) == "directions":
            raise ConfigurationError(
                f"the benchmark is about the paper's gaits, straight ahead, and {str(policy)!r}"
                " follows gaits in all directions; --policy straight is measured by default"
            )


def walk_on(
    env: StackEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    steps: int,
    bar: tqdm,
    force: np.ndarray | None = None,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk on from a tensordict, which is left as it is, until all robots have fallen.

    Args:
        env: environment of n robots, in the state that belongs to the tensordict.
        actor: policy.
        td: start.
        steps: policy steps.
        bar: progress bar that counts each robot's steps.
        force: (n, 3) force on the pelvis throughout [N, world].

    Returns:
        The tensordict after the last step, and (n,) whether each robot is still up.
    """
    alive = np.ones(env.num_envs, dtype=bool)
    for step in walk(actor, env, td, steps, push=force):
        alive &= ~np.asarray(step["next", "terminated"][:, 0])
        td = next_start(step)
        bar.update(env.num_envs)
        if not alive.any():
            break
    return td, alive


# ---------------------------------------------------------------------------- gaits


def strides(library: GaitLibrary, speeds: Sequence[float]) -> np.ndarray:
    """(n,) durations of the library's strides straight ahead [s]."""
    command = torch.tensor([straight(library, speed) for speed in speeds], dtype=torch.float64)
    return library.stride(command)[:, 0].numpy()


def straight(library: GaitLibrary, speed: float) -> list[float]:
    """Command straight ahead, with a number for each axis of the library."""
    return [speed, *[0.0] * (library.command_size - 1)]


def nearest_gait(library: GaitLibrary, speed: float) -> Gait:
    """Gait whose speed is nearest to a speed [m/s]."""
    return min(library.gaits, key=lambda gait: abs(gait.speed - speed))


def shortest_swing(footholds: Footholds, command: float | Sequence[float]) -> float:
    """Shortest time without load that counts as a swing: half of the model's shorter swing [s].

    Shorter ones occur in mid-stance, where the model's leg force may be zero.
    """
    left, right = (footholds.touchdown_phase(side, command) % 1.0 for side in SIDES)
    # the left swing begins at phase 0, the right one half a stride later
    return min(left, (right - 0.5) % 1.0) * footholds.stride(command) / 2


# -------------------------------------------------------------------------- reports


def write_report(
    config: Common,
    policy: Policy | None,
    name: str,
    numbers: dict[str, Any],
    table: str,
    figure: Figure | None = None,
) -> None:
    """Write results, with policies and shared settings."""
    names = list(config.policy) if policy is None else [policy_name(policy)]
    about = {"policies": names, "seed": config.seed, "truth": config.truth}
    write_results(config.out, name, {**about, **numbers}, table, figure)


def write_results(
    out: Path, name: str, numbers: dict[str, Any], table: str, figure: Figure | None = None
) -> None:
    """Print the table, and write table, numbers and picture into a folder."""
    print(table)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / f"{name}.md", table + "\n")
    text = json.dumps(without_nan(numbers), indent=1, allow_nan=False)
    write_text(out / f"{name}.json", text + "\n")
    if figure is not None:
        save_figure(figure, out / f"{name}.png")


def without_nan(value: Any) -> Any:
    """Copy of nested numbers with None for NaN and infinity, which JSON lacks."""
    if isinstance(value, Mapping):
        return {key: without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def quiet() -> Iterator[list[str]]:
    """Silence output and progress bars; yields the list of TorchRL's log messages."""
    messages: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    handlers = torchrl_logger.handlers[:]
    torchrl_logger.handlers[:] = [Listener()]
    silence = io.StringIO()
    try:
        with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
            yield messages
    finally:
        torchrl_logger.handlers[:] = handlers


# ---------------------------------------------------------------------- checkpoints


class Holder:
    """Checkpoint component that accepts any state."""

    def __init__(self, state: Any = None) -> None:
        self.state = state

    def state_dict(self) -> Any:
        """Loaded state."""
        return self.state

    def load_state_dict(self, state: Any) -> None:
        """Keep a state."""
        self.state = state


def checkpoint_times(path: Path) -> dict[str, float]:
    """Size of a checkpoint [bytes], time to copy its states and time to write them [s]."""
    names = ("actor", "critic", "optimizer", "rng", "collector")
    components = {name: Holder() for name in names}
    metadata = load_checkpoint(path, components)
    start = time.perf_counter()
    states = snapshot(components)
    copied = time.perf_counter()
    save_checkpoint(path, states, metadata)
    written = time.perf_counter()
    times = {"copied_s": copied - start, "written_s": written - copied}
    return {"bytes": path.stat().st_size, **times}
