"""Error of models of a step: the robot's body at the next touchdown, from that at the last one.

    python -m benchmarks.planning.models

Walks are at random commands, with true positions of pelvis and feet at policy steps, so that
touchdowns are known to 30 ms; models get the time between two of them. A step map is linear along
each axis alike: position and velocity at the next touchdown, relative to the stance foot, from
those now and from the last foothold. That of the actuated SLIP is fitted to the motions of the
library, a third one to the steps of every other walk; errors are those of the rest. Intervals are
over walks.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import Directions, check_numbers


@dataclass(frozen=True)
class Config(Directions):
    """Settings of the benchmark."""

    commands: int = 100
    """Number of random commands, each a walk."""
    settle: float = 2.0
    """Time at the start that is not measured [s]."""
    walk: float = 6.0
    """Duration of the measurement [s]."""

    def __post_init__(self) -> None:
        """Check the number of commands."""
        super().__post_init__()
        check_numbers(self, commands=4)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from aslip.base.interval import Interval
from aslip.library import GaitLibrary
from aslip.library.footholds import Footholds
from aslip.planning import Pendulum
from aslip.robot import CASSIE
from aslip.robot.rotation import rotate_level
from aslip.walking import Walks
from benchmarks.common import Policies, Report, benchmark, record_subject, table
from benchmarks.directions.random_commands import random_commands

# vertical force above which a foot is on the ground [N], and shortest swing before a touchdown [s]
_LOADED, _SWING = 30.0, 0.12
# commands whose motions the SLIP's map is fitted to
_COMMANDS = 150

COLUMNS = {
    "model": "{model}",
    **{
        header: lambda row, name=name: Interval.of_row(row[name]).text(1, 100.0)
        for header, name in (
            ("position, up to 1 m/s [cm]", "slow_position"),
            ("velocity, up to 1 m/s [cm/s]", "slow_velocity"),
            ("position, all [cm]", "position"),
            ("velocity, all [cm/s]", "velocity"),
        )
    },
}


@dataclass(frozen=True, eq=False)
class Steps:
    """s steps: the body relative to the foot that has just landed, and at the next touchdown."""

    walk: np.ndarray
    """(s,) index of the walk."""
    time: np.ndarray
    """(s,) time between the touchdowns [s]."""
    last: np.ndarray
    """(s, 2) last foothold, of the other foot [m]."""
    now: np.ndarray
    """(s, 2, 2) position [m] and velocity [m/s] of the body."""
    later: np.ndarray
    """(s, 2, 2) the same at the next touchdown."""

    def inputs(self) -> np.ndarray:
        """Position, velocity and last foothold (s, 2, 3), by axis."""
        return np.stack([self.now[:, 0], self.now[:, 1], self.last], axis=-1)

    def fitted(self, chosen: np.ndarray) -> np.ndarray:
        """Step map (3, 2) of chosen steps, least squares over both axes."""
        inputs, outputs = self.inputs()[chosen], self.later[chosen].transpose(0, 2, 1)
        return np.linalg.lstsq(inputs.reshape(-1, 3), outputs.reshape(-1, 2), rcond=None)[0]


def steps_of(walks: Walks, first: int) -> Steps:
    """Steps of walks from a policy step on; the frame is that of the first policy step."""
    loaded = walks.ground_force[..., 2] > _LOADED
    swing = round(_SWING / CASSIE.policy_period)
    yaw = walks.frame[..., 2]
    velocity = rotate_level(walks.pelvis_velocity[..., :2], yaw)
    rows: list[tuple[int, int, int, int]] = []
    for walk in np.flatnonzero(walks.survived).tolist():
        down = [
            (i, foot)
            for i in range(max(first, swing), len(loaded))
            for foot in (0, 1)
            if loaded[i, walk, foot] and not loaded[i - swing : i, walk, foot].any()
        ]
        rows += [
            (walk, foot, i, j)
            for (i, foot), (j, other) in itertools.pairwise(down)
            if foot != other and 0.2 < (j - i) * CASSIE.policy_period < 0.7
        ]
    walk, foot, i, j = np.array(rows).T
    stance = walks.foot_place[i, walk, foot]
    now, later = (
        np.stack([walks.pelvis_place[at, walk] - stance, velocity[at, walk]], axis=1)
        for at in (i, j)
    )
    last = walks.foot_place[i, walk, 1 - foot] - stance
    # in the heading of the first touchdown, as a planner is
    turn = -yaw[i, walk]
    now, later = (rotate_level(one, turn[:, None]) for one in (now, later))
    return Steps(walk, (j - i) * CASSIE.policy_period, rotate_level(last, turn), now, later)


def steps_of_library(library: GaitLibrary, seed: int) -> Steps:
    """Steps of the library's motions at random commands."""
    footholds, rows = Footholds(library), []
    for k, command in enumerate(random_commands(library, _COMMANDS, seed)):
        left = footholds.touchdown_phase("left", command)
        right = footholds.touchdown_phase("right", command)
        phases = torch.tensor([[left], [right], [left + 1.0]])
        found = library.lookup(phases, torch.tensor(command).float().expand(3, -1))
        velocity = found.body_velocity[:, :2].double().numpy()
        feet = torch.stack([found.left_foot_position, found.right_foot_position], 1)
        feet = feet[..., :2].double().numpy()
        for i, (begin, end) in enumerate(((left, right), (right, left + 1.0))):
            time = (end - begin) % 1.0 * footholds.stride(command)
            turn = command[2] * time
            later = rotate_level(np.stack([-feet[i + 1, i], velocity[i + 1]]), np.full(2, turn))
            now = np.stack([-feet[i, i], velocity[i]])
            rows.append((k, time, feet[i, 1 - i] - feet[i, i], now, later))
    return Steps(*(np.array(column) for column in zip(*rows, strict=True)))


def pendulum_model(rate: float) -> Callable[[Steps], np.ndarray]:
    """Predictions (s, 2, 2) of the linear pendulum."""
    pendulum = Pendulum(rate=rate)

    def predict(steps: Steps) -> np.ndarray:
        shift = np.full(len(steps.time), pendulum.double_stance)
        flown = pendulum.flow(
            steps.now[:, 0], steps.now[:, 1], steps.last, 0 * steps.last, shift, steps.time
        )
        return np.stack(flown, axis=1)

    return predict


def map_model(matrix: np.ndarray) -> Callable[[Steps], np.ndarray]:
    """Predictions (s, 2, 2) of a step map (3, 2)."""
    return lambda steps: (steps.inputs() @ matrix).transpose(0, 2, 1)


@benchmark
def main(config: Config, policies: Policies) -> Report[list[dict[str, Any]]]:
    """Measure; the result is a row for each model."""
    subject = policies.load()[0]
    command = random_commands(subject.library, config.commands, config.seed)
    first, count = (
        round(time / CASSIE.policy_period) for time in (config.settle, config.settle + config.walk)
    )
    walks = record_subject(config, subject, np.tile(command, (count, 1, 1)))
    steps = steps_of(walks, first)
    fit = steps.walk % 2 == 0
    slow = np.linalg.norm(command[steps.walk, :2], axis=1) <= 1.0
    slip = steps_of_library(subject.library, config.seed)
    models = {
        "velocity kept": lambda s: np.stack(
            [s.now[:, 0] + s.time[:, None] * s.now[:, 1], s.now[:, 1]], axis=1
        ),
        **{
            f"pendulum, rate {rate:g} 1/s": pendulum_model(rate)
            for rate in (2.0, 2.5, Pendulum().rate, 3.3)
        },
        "step map of the SLIP's motions": map_model(slip.fitted(slip.walk >= 0)),
        "step map of the robot's walks": map_model(steps.fitted(fit)),
    }
    rows: list[dict[str, Any]] = []
    for name, model in models.items():
        error = np.linalg.norm(model(steps) - steps.later, axis=-1)
        row = {"model": name, "steps": int((~fit).sum())}
        for prefix, chosen in (("slow_", ~fit & slow), ("", ~fit)):
            walk = steps.walk[chosen]
            means = np.array([error[chosen][walk == one].mean(axis=0) for one in np.unique(walk)])
            row[f"{prefix}position"], row[f"{prefix}velocity"] = (
                vars(Interval.of([values])) for values in means.T
            )
        rows.append(row)
    return Report(rows, table(COLUMNS, rows))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
