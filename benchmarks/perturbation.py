"""Robustness of a policy: pushes by direction and phase, changes of robot and floor.

    python -m benchmarks.perturbation                                       # the shipped policy
    python -m benchmarks.perturbation --policy runs/seed0 runs/seed1 runs/seed2

A push is a horizontal force on the pelvis. Bisection finds the largest impulse survived, for all
directions and phases side by side, each from a state of the same steady walk. Survival need not be
monotonic in the impulse: the result is one boundary between survival and fall. Direction 0 is
forward, 90 degrees is left; phase 0 is left lift-off. By symmetry, a push to the left should act
like a push to the right half a stride later. Mean and range over phases describe all phases of the
grid; with several policies, intervals are over policies.

Sweeps change one parameter of robot or floor at a time, see `aslip.sim.DYNAMICS`, and count walks
without a fall over commanded speeds. Wilson's interval assumes that speeds are random draws and
that policies are independent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from aslip.errors import ConfigurationError, one_line_errors
from aslip.training.command_line import command_line
from benchmarks.flags import Common

SIDES: Final = MappingProxyType({0.0: "forward", 90.0: "left", 180.0: "back", 270.0: "right"})
"""Names of directions of pushes [deg]."""


@dataclass(frozen=True)
class Sweep:
    """Display of a parameter of `aslip.sim.DYNAMICS`."""

    label: str
    """Name and unit."""
    flag: str
    """Field of `Config` with its values."""
    scale: float = 1.0
    """Displayed value over the value in SI units."""
    nominal: float = 1.0
    """Displayed value of the unchanged robot."""


SWEEPS: Final = MappingProxyType(
    {
        "floor_friction": Sweep("floor friction", "floor_friction"),
        "payload": Sweep("payload [kg]", "payload", nominal=0.0),
        "slope": Sweep("slope [deg]", "slope_deg", 180 / math.pi, nominal=0.0),
        "torque_delay": Sweep("torque delay [ms]", "torque_delay_ms", 1e3, nominal=3.0),
        "motor_strength": Sweep("motor strength", "motor_strength"),
    }
)
"""Parameters that are swept, by name."""


@dataclass(frozen=True)
class Config(Common):
    """Settings of the benchmark; a sweep without values is skipped."""

    speed: float = 1.0
    """Commanded speed of pushed walks [m/s]."""
    directions: int = 8
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
    floor_friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
    """Coefficients of sliding friction."""
    payload: tuple[float, ...] = (0.0, 4.0, 8.0, 12.0, 16.0, 20.0)
    """Payloads at the pelvis [kg]."""
    slope_deg: tuple[float, ...] = (-9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0)
    """Slopes of the floor, rising forward [deg]."""
    torque_delay_ms: tuple[float, ...] = (0.0, 3.0, 5.0, 7.0, 9.0, 12.0)
    """Delays from command to torque [ms]."""
    motor_strength: tuple[float, ...] = (0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.4)
    """Ratios of delivered to commanded torque."""
    speeds: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
    """Commanded speeds of sweeps [m/s]."""
    episodes: int = 1
    """Walks at each value and speed, with different initial phases."""
    episode: float = 12.0
    """Duration of a walk of a sweep [s]."""

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        least = {"directions": 1, "phases": 0, "repeats": 1, "bisections": 1, "episodes": 1}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise ConfigurationError(f"{name} must be {low} or more, got {getattr(self, name)}")
        for name in ("largest", "duration", "settle", "after", "episode"):
            if not 0 < getattr(self, name) < math.inf:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from aslip.envs import StackEnv
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw
from aslip.transforms import PhaseClock
from aslip.walking import Interval, markdown, next_start, policy_steps, reset_walks, walk
from benchmarks.common import MakeEnv, Policy, Subject, load_subjects, write_report
from benchmarks.perturbation_picture import picture


def main(
    config: Config, policy: Policy | None = None, make_env: MakeEnv | None = None
) -> dict[str, Any]:
    """Measure, print and draw; returns the numbers.

    Args:
        config: the settings.
        policy: policy to measure; by default as in the settings.
        make_env: function that makes the environment, see `benchmarks.common`.
    """
    subjects = load_subjects(config, policy, make_env)
    total = len(subjects) * count_robot_steps(config)
    with tqdm(total=total, unit="step", unit_scale=True, leave=False) as bar:
        pushes = [measure_pushes(config, subject, bar) for subject in subjects]
        sweeps = [measure_sweeps(config, subject, bar) for subject in subjects]
    numbers = {
        "speed": config.speed,
        "push_duration": push_steps(config) * CASSIE.policy_period,
        "resolution": config.largest * 0.5**config.bisections,
        "pushes": push_rows(config, pushes),
        "sweeps": sweep_rows(config, sweeps),
    }
    tables = [make(numbers) for make in (push_table, sweep_table)]
    text = "\n\n".join(table for table in tables if table)
    figure = picture(numbers, SIDES, SWEEPS)
    write_report(config, policy, "perturbation", numbers, text, figure)
    return numbers


def count_robot_steps(config: Config) -> int:
    """Largest number of policy steps of all robots of one policy."""
    pushed = config.directions * config.phases * config.repeats
    once = push_steps(config) + round(config.after / CASSIE.policy_period)
    each = round(config.settle / CASSIE.policy_period) + config.bisections * once
    return pushed * each + len(trials(config)) * round(config.episode / CASSIE.policy_period)


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
    start = phase - steps * CASSIE.policy_period / stride_of(env, config.speed)
    td = reset_walks(env, np.full(len(phase), config.speed), start % 1.0)
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


def stride_of(env: StackEnv, speed: float) -> float:
    """Duration of a stride of the environment's reference [s]."""
    clock = next(t for t in env.transforms if isinstance(t, PhaseClock))
    return float(clock.library.stride(torch.full((1, 1), speed)))


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


def push_table(numbers: dict[str, Any]) -> str:
    """Table of impulses, a row for each direction: mean and range over phases."""
    rows = []
    for row in numbers["pushes"]:
        extremes = [pick(row["phases"], key=lambda cell: cell["mean"]) for pick in (min, max)]
        rows.append(
            [
                SIDES.get(row["direction_deg"], f"{row['direction_deg']:.0f}°"),
                Interval.of_row(row).text(1),
                *(f"{Interval.of_row(cell).text(1)} at {cell['phase']:.3g}" for cell in extremes),
            ]
        )
    header = ["push", "mean over phases [N s]", "minimum, at phase", "maximum, at phase"]
    return markdown(header, rows) if rows else ""


# --------------------------------------------------------------------------- sweeps


@dataclass(frozen=True)
class Trial:
    """Walk of a robot with one changed parameter."""

    parameter: str
    """Name in `aslip.sim.DYNAMICS`."""
    shown: float
    """Displayed value of the parameter."""
    speed: float
    """Commanded speed [m/s]."""
    phase: float
    """Phase at the start."""


def trials(config: Config) -> list[Trial]:
    """Walks of all sweeps."""
    return [
        Trial(name, shown, speed, (i / len(config.speeds) + k / config.episodes) % 1.0)
        for name, sweep in SWEEPS.items()
        for shown in getattr(config, sweep.flag)
        for i, speed in enumerate(config.speeds)
        for k in range(config.episodes)
    ]


def measure_sweeps(config: Config, subject: Subject, bar: tqdm) -> np.ndarray:
    """(n,) whether a policy survived each of the `trials`."""
    all_trials = trials(config)
    if not all_trials:
        return np.zeros(0, dtype=bool)
    with closing(subject.walking_env(config, len(all_trials))) as env:
        for i, trial in enumerate(all_trials):
            value = trial.shown / SWEEPS[trial.parameter].scale
            env.base_env.set_dynamics({trial.parameter: value}, np.array([i]))
        speed, phase = (
            np.array([getattr(t, name) for t in all_trials]) for name in ("speed", "phase")
        )
        steps = round(config.episode / CASSIE.policy_period)
        return walk_on(env, subject.policy, reset_walks(env, speed, phase), steps, bar)[1]


def sweep_rows(config: Config, sweeps: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """Rows of survival over all policies, one for each parameter and value."""
    all_trials, survived = trials(config), np.array(sweeps)
    rows = []
    for name, shown in dict.fromkeys((t.parameter, t.shown) for t in all_trials):
        columns = [(t.parameter, t.shown) == (name, shown) for t in all_trials]
        found = survived[:, columns]
        at = np.array([t.speed for t in all_trials])[columns]
        rows.append(
            {
                "parameter": name,
                "value": shown,
                **vars(Interval.of_share(int(found.sum()), found.size)),
                "trials": found.size,
                "by_speed": {str(v): float(found[:, at == v].mean()) for v in config.speeds},
            }
        )
    return rows


def sweep_table(numbers: dict[str, Any]) -> str:
    """Table of survival, a row for each parameter and value."""
    rows = [
        [
            SWEEPS[row["parameter"]].label,
            f"{row['value']:g}",
            Interval.of_row(row).text(0, 100),
            ", ".join(speed for speed, share in row["by_speed"].items() if share < 1),
        ]
        for row in numbers["sweeps"]
    ]
    header = ["parameter", "value", "survived [%]", "falls at commands [m/s]"]
    return markdown(header, rows) if rows else ""


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
