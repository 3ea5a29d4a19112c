"""Policies, walks and reports, which the benchmarks share.

A subject is a policy and a way to make its environment. On the command line a policy is the name of
a shipped one, a file or a run folder, and its environment follows from its card. In Python `main`
of a benchmark also takes any TensorDict module, and a function that makes environments:

    def my_env(**settings):                    # num_envs, seed, drop, ... of `aslip.make_env`
        return aslip.make_env(stack=my_stack(), **settings)

    foot_placement.main(foot_placement.Config(), policy=my_actor, make_env=my_env)
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from matplotlib.figure import Figure
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.transforms import Transform

import aslip
from aslip.base.tables import markdown
from aslip.envs import EPISODE_ENDS, ON_TRUTH, StackEnv, shipped_library
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds
from aslip.library.library import SHIPPED
from aslip.policy import (
    add_memory,
    check_policy_fits,
    policy_environment,
    policy_library,
    read_card,
)
from aslip.robot import CASSIE, SIDES
from aslip.rom import Motion
from aslip.show.plots import save_figure
from aslip.training.run import write_text
from aslip.walking import Walks, command_library, record_walks
from benchmarks.flags import Common, Directions, WithLibrary

Result = TypeVar("Result")
Settings = TypeVar("Settings", bound=Common)

Policy = TensorDictModuleBase | str | Path
"""Policy module, or what `aslip.load_policy` takes."""

MakeEnv = Callable[..., StackEnv]
"""Function that makes an environment, with the keywords of `aslip.make_env`."""

# a method's name before its policy
_NAMED = re.compile(r"([\w '.,-]+)=(.+)")

Columns = Mapping[str, str | Callable[[Any], str]]
"""Columns of a table: header -> format of a row's fields, or function from a row to a cell."""


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
    library: GaitLibrary
    """Library of its gaits."""

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
            make_env: function that makes its environment; by default `aslip.make_env` with
                `aslip.policy.policy_environment`. For a module it is the default stack, or the one
                for all directions if the library has several axes.
            library: library of the default environment; by default the one that
                `aslip.policy.policy_library` finds.

        Raises:
            AssetError: no such policy exists.
            ConfigurationError: the card names no stack, and `make_env` is not given; or the policy
                follows other gaits.
        """
        if not isinstance(policy, str | Path):
            several = library is not None and library.command_size > 1
            stack = "walking" if several else "straight"
            make_env = make_env or partial(aslip.make_env, stack=stack, library=library)
            library = command_library(policy, library)
            return cls(policy_name(policy), policy, make_env, False, library)
        if make_env is None:
            make_env = partial(aslip.make_env, **policy_environment(policy, library))
        module, library = aslip.load_policy(policy), command_library(policy, library)
        return cls(policy_name(policy), module, make_env, True, library)

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


@dataclass(frozen=True)
class Policies:
    """Policies that a benchmark measures: those of its settings, or one that is given in Python."""

    config: Common
    given: Policy | None = None
    make_env: MakeEnv | None = None
    """Function that makes the environments, in place of what the policies' cards name."""

    @property
    def names(self) -> list[str]:
        """Names in reports."""
        return [*self.config.policy] if self.given is None else [policy_name(self.given)]

    def load(self, stack: str | None = None) -> list[Subject]:
        """Load the subjects, which follow the same gaits.

        Args:
            stack: name of the stack of policies that did not learn to stand in their own, unless
                the caller gives a function that makes environments; by default that of each policy.

        Raises:
            ConfigurationError: they follow different gaits.
        """
        policies = self.config.policy if self.given is None else [self.given]
        subjects = [self._subject(one, stack) for one in policies]
        for subject in subjects[1:]:
            if subject.library.sha256 != subjects[0].library.sha256:
                raise ConfigurationError(
                    f"policies that count as seeds of one method must follow the same gaits;"
                    f" {subjects[0].name!r} and {subject.name!r} do not"
                )
        return subjects

    def _subject(self, policy: Policy, stack: str | None = None) -> Subject:
        library, make_env = chosen_library(self.config, policy), self.make_env
        own = isinstance(policy, str | Path) and read_card(policy)["stands"]
        if stack is not None and make_env is None and not own:
            make_env = partial(aslip.make_env, stack=stack, library=library)
        subject = Subject.load(policy, make_env, library)
        if isinstance(self.config, Directions) and subject.library.command_size == 1:
            raise ConfigurationError(
                f"the benchmark is of walks in all directions, and {subject.name!r} walks straight"
            )
        return subject

    def methods(self) -> dict[str, list[Subject]]:
        """Load the seeds of each method: `method=policy`, or policies that are methods each."""
        if self.given is not None:
            return {self.names[0]: self.load()}
        methods: dict[str, list[Subject]] = {}
        for text in self.config.policy:
            named = _NAMED.fullmatch(text)
            name, path = named.groups() if named else (text, text)
            methods.setdefault(name, []).append(self._subject(path))
        return methods


def chosen_library(config: Common, policy: Policy) -> GaitLibrary | None:
    """Library that a policy follows, by the flag or its file; None for the default of a module."""
    name = config.library if isinstance(config, WithLibrary) else None
    if isinstance(policy, str | Path):
        return policy_library(policy, name)
    if name is None:
        return shipped_library("directions") if isinstance(config, Directions) else None
    # a shipped one is read once
    return shipped_library(name) if name in SHIPPED else GaitLibrary.load(name)


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


# ---------------------------------------------------------------------------- gaits


def straight(library: GaitLibrary, speed: float) -> list[float]:
    """Command straight ahead, with a number for each axis of the library."""
    return [speed, *[0.0] * (library.command_size - 1)]


def nearest_motion(library: GaitLibrary, speed: float) -> Motion:
    """Motion whose forward speed is nearest to a speed [m/s]."""
    return min(library.motions, key=lambda motion: abs(motion.command[0] - speed))


def shortest_swing(footholds: Footholds, command: float | Sequence[float]) -> float:
    """Shortest time without load that counts as a swing: half of the model's shorter swing [s].

    Shorter ones occur in mid-stance, where the model's leg force may be zero.
    """
    left, right = (footholds.touchdown_phase(side, command) % 1.0 for side in SIDES)
    # the left swing begins at phase 0, the right one half a stride later
    return min(left, (right - 0.5) % 1.0) * footholds.stride(command) / 2


def insert_before_plan(env: StackEnv, *transforms: Transform) -> None:
    """Insert transforms before the planner of an environment.

    Raises:
        ConfigurationError: it has none.
    """
    at = next((i for i, t in enumerate(env.transforms) if "plan" in t.out_keys), None)
    if at is None:
        raise ConfigurationError("the policy's stack has no planner, as that of `stones` has")
    for transform in reversed(transforms):
        env.insert_transform(at, transform)


# -------------------------------------------------------------------------- reports


@dataclass(frozen=True)
class Report(Generic[Result]):
    """Result of a benchmark, and what is written of it."""

    result: Result
    text: str
    """Table, or tables."""
    figure: Figure | None = None
    numbers: Mapping[str, Any] | None = None
    """Numbers to write; by default the result, under "rows"."""


def benchmark(measure: Callable[[Settings, Policies], Report[Result]]) -> Callable[..., Result]:
    """Make the `main` of a benchmark from a function that measures policies.

    `main(config, policy=None, make_env=None)` measures the policies of the settings or the one that
    is given, in environments of `make_env` if it is given. It prints the text, writes text, numbers
    and picture to `config.out` under the name of the benchmark's module, and returns the result.
    """
    name = Path(inspect.getfile(measure)).stem

    @functools.wraps(measure)
    def main(
        config: Settings, policy: Policy | None = None, make_env: MakeEnv | None = None
    ) -> Result:
        policies = Policies(config, policy, make_env)
        report = measure(config, policies)
        about = {"policies": policies.names, "seed": config.seed, "truth": config.truth}
        numbers = {"rows": report.result} if report.numbers is None else report.numbers
        write_results(config.out, name, {**about, **numbers}, report.text, report.figure)
        return report.result

    return main


def table(
    columns: Columns, rows: Sequence[Mapping[str, Any]], align: str | Sequence[str] = "---:"
) -> str:
    """Write a Markdown table, a line for each row; `align` as in `aslip.base.tables.markdown`."""
    cells = [
        [cell.format_map(row) if isinstance(cell, str) else cell(row) for cell in columns.values()]
        for row in rows
    ]
    return markdown([*columns], cells, align)


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
