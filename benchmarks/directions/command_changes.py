"""Falls in sudden random changes of the command in all directions.

    python -m benchmarks.directions.command_changes --policy runs/ppo_directions
    python -m benchmarks.directions.command_changes --policy runs/ppo_directions --changes 10000

Each command is uniform over the region of the library, and held for a random time; the command that
the robot follows changes at limited rates, and may not reach it in that time. Robots that fall
start again at a random command, so that every change counts. A change counts as one fall at most.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from benchmarks.flags import Directions


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    changes: int = 1000
    """Number of changes, over all robots."""
    robots: int = 50
    """Number of robots that walk side by side."""
    hold: tuple[float, float] = (0.75, 2.25)
    """Shortest and longest time for which a command is held [s]."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        if not 1 <= self.robots <= self.changes:
            raise ConfigurationError(
                f"robots must be from 1 to the number of changes, {self.changes}, got {self.robots}"
            )


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import contextlib
import math
from typing import Any, cast

import numpy as np
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase
from tqdm import tqdm

from aslip.envs import StackEnv
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.show.palette import ROBOT
from aslip.walking import next_start, reset_walks, take_step
from aslip.walking.record import commands_kept
from benchmarks.common import Policies, Report, Subject, benchmark, table
from benchmarks.directions.random_commands import AXES, random_commands

COLUMNS = {
    "policy": "{policy}",
    "changes": "{changes}",
    "falls": lambda row: str(len(row["falls"])),
    "falls in 10 000 changes": "{rate:.0f}",
}


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure and draw; the result is a row for each policy."""
    subjects = policies.load()
    rows = [fall_row(config, subject, subjects[0].library) for subject in subjects]
    return Report(rows, table(COLUMNS, rows), picture(rows[0]))


def fall_row(config: Config, subject: Subject, library: GaitLibrary) -> dict[str, Any]:
    """Number of changes, and for each fall the commands before and after the change."""
    each = math.ceil(config.changes / config.robots)
    drawn = random_commands(library, (each + 1) * config.robots, config.seed)
    commands = drawn.reshape(each + 1, config.robots, library.command_size)
    env = subject.walking_env(config, config.robots)
    with contextlib.closing(env), commands_kept(env):
        fallen = walk_changes(subject, env, commands, hold_steps(config, each))
    falls = [[commands[i, robot].tolist(), commands[i + 1, robot].tolist()] for i, robot in fallen]
    changes = each * config.robots
    rate = 1e4 * len(falls) / changes
    return {"policy": subject.name, "changes": changes, "falls": falls, "rate": rate}


def hold_steps(config: Config, changes: int) -> np.ndarray:
    """(changes + 1, n) random policy steps for which robots hold each command."""
    low, high = (round(time / CASSIE.policy_period) for time in config.hold)
    random = np.random.default_rng(config.seed)
    return random.integers(low, high + 1, (changes + 1, config.robots))


def walk_changes(
    subject: Subject, env: StackEnv, commands: np.ndarray, hold: np.ndarray
) -> list[tuple[int, int]]:
    """Walk through commands (k + 1, n, 3), and return (change, robot) of each fall.

    A fall before the first change counts for the first change, and the first of several falls after
    a change counts, as the next ones follow other starts.
    """
    robots = np.arange(env.num_envs)
    due = hold.cumsum(axis=0)
    fallen: dict[tuple[int, int], None] = {}
    td: TensorDictBase = reset_walks(env, commands[0])
    for step in tqdm(range(int(due[-1].max())), unit="step", leave=False):
        at = (due <= step).sum(axis=0)
        walking = at < len(commands)
        now = commands[np.minimum(at, len(commands) - 1), robots]
        td["command"] = torch.from_numpy(now).float()
        td = take_step(subject.policy, env, td)
        fell = cast("torch.Tensor", td["next", "terminated"])
        down = fell[:, 0].numpy() & walking
        fallen |= {(max(int(at[i]) - 1, 0), int(i)): None for i in np.flatnonzero(down)}
        td = next_start(td)
        if fell.any():
            td = env.reset(td.set("_reset", fell))
    return [*fallen]


def picture(row: dict[str, Any]) -> Figure:
    """Changes that ended in falls: arrows from the old to the new command."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    for axes, other in zip(figure.subplots(1, 2), (2, 1), strict=True):
        for old, new in row["falls"]:
            axes.annotate(
                "",
                (new[other], new[0]),
                (old[other], old[0]),
                arrowprops={"arrowstyle": "->", "color": ROBOT},
            )
            axes.plot([old[other], new[other]], [old[0], new[0]], ".", color=ROBOT, ms=3)
        axes.set(xlabel=AXES[other], ylabel=AXES[0])
        axes.grid(alpha=0.3)
    figure.suptitle(f"{len(row['falls'])} falls in {row['changes']} changes of the command")
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
