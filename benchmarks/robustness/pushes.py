"""Robustness of a policy: pushes by direction and phase, changes of robot and floor.

    python -m benchmarks.robustness.pushes  # the policy `straight`
    python -m benchmarks.robustness.pushes --policy runs/seed0 runs/seed1 runs/seed2
    python -m benchmarks.robustness.pushes --policy runs/mine --library runs/directions/gaits.npz

A push is a horizontal force on the pelvis. Bisection finds the largest impulse survived, for all
directions and phases side by side, each from a state of the same steady walk. Survival need not be
monotonic in the impulse: the result is one boundary between survival and fall. Direction 0 is
forward, 90 degrees is left; phase 0 is left lift-off. By symmetry, a push to the left should act
like a push to the right half a stride later. Mean and range over phases describe all phases of the
grid; with several policies, intervals are over policies.

Sweeps change one parameter of robot or floor at a time, see `aslip.sim.DYNAMICS`, and count walks
without a fall at random commands, uniform over the region of the library. Intervals of one policy
are over its walks, of several over policies.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers
from benchmarks.robustness.parameters import SWEEPS, Sweeps

SIDES: Final = MappingProxyType({0.0: "forward", 90.0: "left", 180.0: "back", 270.0: "right"})
"""Names of directions of pushes [deg]."""


@dataclass(frozen=True)
class Config(Sweeps):
    """Settings of the benchmark."""

    speed: float = 1.0
    """Commanded speed of pushed walks [m/s]."""
    directions: int = 16
    """Number of push directions, evenly around the robot."""
    phases: int = 8
    """Number of stride phases at which a push begins; 0 skips pushes."""
    repeats: int = 2
    """Trials of each push, with different sensor noise."""
    bisections: int = 7
    """Number of halvings of the range of impulses."""
    largest: float = 96.0
    """Upper end of the range of impulses [N s]."""
    duration: float = 0.2
    """Duration of a push, rounded up to policy steps [s]."""
    settle: float = 3.0
    """Duration of the walk before a push [s]."""
    after: float = 3.0
    """Duration without a fall after which a push is survived [s]."""
    planned: bool = False
    """Whether pushed robots follow plans, and not the library; of stacks with a planner."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_numbers(
            self, "largest", "duration", "settle", "after",
            directions=1, phases=0, repeats=1, bisections=1,
        )  # fmt: skip


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Mapping
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from aslip.base.interval import Interval
from aslip.envs import StackEnv, library_of
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw
from aslip.transforms import RandomFootsteps
from aslip.walking import policy_steps, reset_walks
from benchmarks.common import (
    Policies,
    Report,
    Subject,
    benchmark,
    insert_before_plan,
    straight,
    table,
)
from benchmarks.robustness.push_picture import picture
from benchmarks.robustness.sweeps import (
    COLUMNS,
    measure_sweeps,
    sweep_rows,
    trials,
    walk_on,
)


@benchmark
def main(config: Config, policies: Policies) -> Report[dict[str, Any]]:
    """Measure and draw; the result is the numbers."""
    subjects = policies.load()
    total = len(subjects) * count_robot_steps(config)
    with tqdm(total=total, unit="step", unit_scale=True, leave=False) as bar:
        pushes = [measure_pushes(config, subject, bar) for subject in subjects]
        sweeps = [
            measure_sweeps(config, subject, config.seed + i, bar)
            for i, subject in enumerate(subjects)
        ]
    numbers = {
        "speed": config.speed,
        "planned": config.planned,
        "push_duration": push_steps(config) * CASSIE.policy_period,
        "resolution": config.largest * 0.5**config.bisections,
        "pushes": push_rows(config, pushes),
        "sweeps": sweep_rows(config, sweeps),
    }
    parts = [table(PUSH_COLUMNS, numbers["pushes"])] if numbers["pushes"] else []
    parts += [text] if (text := censored_text(config, np.array(pushes))) else []
    parts += [table(COLUMNS, numbers["sweeps"])] if numbers["sweeps"] else []
    return Report(numbers, "\n\n".join(parts), picture(numbers, SIDES, SWEEPS), numbers)


def censored_text(config: Config, survived: np.ndarray) -> str:
    """Sentence on impulses [N s] that no push exceeded; empty if there are none."""
    most = config.largest * (1 - 0.5**config.bisections)
    count = int(np.sum(survived > most - 1e-9)) if config.phases else 0
    if not count:
        return ""
    return (
        f"{count} of {survived.size} robots survived all pushes, up to {most:.1f} N s, so means are"
        f" too small; `--largest {2 * config.largest:g}` tries larger ones."
    )


def count_robot_steps(config: Config) -> int:
    """Largest number of policy steps of all robots of one policy."""
    pushed = config.directions * config.phases * config.repeats
    once = push_steps(config) + round(config.after / CASSIE.policy_period)
    each = round(config.settle / CASSIE.policy_period) + config.bisections * once
    return pushed * each + len(trials(config)) * round(config.episode / CASSIE.policy_period)


# --------------------------------------------------------------------------- pushes


def push_steps(config: Config) -> int:
    """Policy steps of a push."""
    return policy_steps(config.duration)


def measure_pushes(config: Config, subject: Subject, bar: tqdm) -> np.ndarray:
    """(directions, phases, repeats) largest impulses that a policy survived [N s].

    Zero where the robot falls without a push.
    """
    shape = (config.directions, config.phases, config.repeats)
    if not config.phases:
        return np.zeros(shape)
    direction, phase, _ = (grid.ravel() for grid in np.indices(shape))
    with closing(subject.walking_env(config, len(phase))) as env:
        if config.planned:
            insert_before_plan(env, RandomFootsteps(0.0, 0.0))
        td, standing = settle(config, env, subject.policy, phase / config.phases, bar)
        states = env.base_env.states()
        orientation = np.asarray(td["truth", "pelvis_orientation"])
        toward = 2 * np.pi * direction / config.directions + yaw(orientation)
        unit = np.stack([np.cos(toward), np.sin(toward), np.zeros(len(phase))], axis=1)
        survived, fatal = np.zeros(len(phase)), np.full(len(phase), config.largest)
        for _ in range(config.bisections):
            impulse = (survived + fatal) / 2
            env.base_env.set_states(states)
            pushed = push_robots(config, env, subject.policy, td, impulse[:, None] * unit, bar)
            alive = standing & pushed
            survived, fatal = np.where(alive, impulse, survived), np.where(alive, fatal, impulse)
    return survived.reshape(shape)


def settle(
    config: Config, env: StackEnv, actor: TensorDictModuleBase, phase: np.ndarray, bar: tqdm
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk until the initial transient has decayed, all robots for the same time.

    Args:
        config: settings of the walk.
        env: environment of n robots.
        actor: policy that acts.
        phase: (n,) final phases.
        bar: progress bar.

    Returns:
        The tensordict at the end, and (n,) whether each robot has not fallen.
    """
    steps = round(config.settle / CASSIE.policy_period)
    library = library_of(env)
    command = torch.tensor([straight(library, config.speed)])
    start = phase - steps * CASSIE.policy_period / library.stride(command).item()
    td = reset_walks(env, command.double().numpy().repeat(len(phase), axis=0), start % 1.0)
    return walk_on(env, actor, td, steps, bar)


def push_robots(
    config: Config,
    env: StackEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    impulse: np.ndarray,
    bar: tqdm,
) -> np.ndarray:
    """Push robots by impulses (n, 3) [N s, world]; returns (n,) whether each stays up."""
    steps = push_steps(config)
    td, during = walk_on(env, actor, td, steps, bar, impulse / (steps * CASSIE.policy_period))
    _, after = walk_on(env, actor, td, round(config.after / CASSIE.policy_period), bar)
    return during & after


def push_rows(config: Config, pushes: list[np.ndarray]) -> list[dict[str, Any]]:
    """Rows of impulses, one for each direction: mean over all phases, and at each phase.

    Phases are a full grid and no sample, so that intervals are over policies only.
    """
    return [
        {
            "direction_deg": 360 * i / config.directions,
            **vars(Interval.of([found[i].mean(keepdims=True) for found in pushes])),
            "phases": [
                {"phase": j / config.phases, **vars(Interval.of([found[i, j] for found in pushes]))}
                for j in range(config.phases)
            ],
        }
        for i in range(config.directions if config.phases else 0)
    ]


def _extreme(pick: Any, row: Mapping[str, Any]) -> str:
    """Cell of the smallest or largest impulse over phases, and its phase."""
    cell = pick(row["phases"], key=lambda cell: cell["mean"])
    return f"{Interval.of_row(cell).text(1)} at {cell['phase']:.3g}"


PUSH_COLUMNS = {
    "push": lambda row: SIDES.get(row["direction_deg"], f"{row['direction_deg']:.0f}°"),
    "mean over phases [N s]": lambda row: Interval.of_row(row).text(1),
    "minimum, at phase": partial(_extreme, min),
    "maximum, at phase": partial(_extreme, max),
}


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
