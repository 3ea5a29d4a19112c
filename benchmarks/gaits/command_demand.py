"""Demand of command changes on the legs: sliding feet of the reference, torques of the motors.

    python -m benchmarks.gaits.command_demand
    python -m benchmarks.gaits.command_demand --faster 2

The reference of a walk changes with its command. While the command moves from one random command
to another, step by step as the filter of commands lets it, planted feet of the reference slide, and
legs accelerate more than at a constant command. Torques are those of inverse dynamics of the legs
without ground forces, as in `benchmarks.gaits.motor_demand`; velocities jump where a change begins
and ends, and the jump takes a policy step.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    library: str = "directions"
    """Library over three commands, shipped or a file."""
    changes: int = 200
    """Number of changes between random commands."""
    faster: float = 1.0
    """Factor of the largest rates of a command, `aslip.transforms.COMMAND_RATES`."""
    seed: int = 0
    """Seed of commands and phases."""

    def __post_init__(self) -> None:
        """Check number and factor."""
        check_numbers(self, "faster", changes=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin
import torch
from torch import Tensor

from aslip.base.tables import markdown
from aslip.ik import Kinematics, leg_torque, pelvis_axes
from aslip.library import GaitLibrary
from aslip.robot import CASSIE, SIDES
from aslip.transforms import COMMAND_RATES
from aslip.transforms.clock import advance_phase
from aslip.transforms.command import approach_command
from benchmarks.directions.random_commands import random_commands
from benchmarks.gaits.motor_demand import motor_limit

_PERIOD: Final = CASSIE.policy_period
_PLANTED: Final = 1e-2  # speed below which a foot of the gait stands [m/s]
_MOTORS: Final = ("hip_roll", "hip_yaw", "hip_pitch", "knee", "foot")
_COLUMNS: Final = ("99 % of torques below [N m]", "largest", "beyond the motor [% of time]")


class Demand(NamedTuple):
    """Demand on the motors at n instants."""

    velocity: np.ndarray
    """(n, motors) velocities at the joints [rad/s]."""
    torque: np.ndarray
    """(n, motors) torques at the joints [N m]."""


class Found(NamedTuple):
    """Demand at the commands of changes, held and changing, and how fast planted feet slide."""

    held: Demand
    changing: Demand
    slide: np.ndarray
    """(k,) speeds of the planted feet of the reference over ground [m/s]."""


def main(config: Config) -> Found:
    """Compute and print."""
    library, kinematics = GaitLibrary.load(config.library), Kinematics()
    drawn = random_commands(library, 2 * config.changes, config.seed)
    starts, ends = torch.tensor(drawn).reshape(2, -1, 3)
    random = torch.Generator().manual_seed(config.seed)
    phases = torch.rand(config.changes, 1, generator=random, dtype=ends.dtype)
    parts = [
        change(library, kinematics, *steps(library, config, *each))
        for each in zip(starts, ends, phases, strict=True)
    ]
    held, changing, slide = zip(*parts, strict=True)
    found = Found(_joined(held), _joined(changing), np.concatenate(slide))
    print(table(found), _summary(found.slide), sep="\n\n")
    return found


def _joined(parts: tuple[Demand, ...]) -> Demand:
    """Demand at the instants of all changes."""
    return Demand(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def steps(
    library: GaitLibrary, config: Config, start: Tensor, end: Tensor, phase: Tensor
) -> tuple[Tensor, Tensor]:
    """Phases (n, 1) and commands (n, 3), from a policy step before a change to two after it."""
    rates = [config.faster * rate for rate in COMMAND_RATES]
    commands, phases = [start, start], [phase]
    while not torch.equal(commands[-1], end):
        commands.append(approach_command(commands[-1], end, rates))
    commands += [end, end]
    for command in commands[1:]:
        phases.append(advance_phase(library, phases[-1], command))
    return torch.stack(phases), torch.stack(commands)


def change(library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor) -> Found:
    """Demand and sliding feet of all policy steps but the first and the last one.

    Args:
        library: gaits.
        kinematics: the robot.
        phase: (n, 1) stride fractions.
        command: (n, 3) commands.
    """
    at, here, before = phase[1:-1], command[1:-1], command[:-2]
    qpos, velocity = _state(library, kinematics, at, here)
    step = 0.01 * _PERIOD / library.stride(here)  # short, as velocities change fast in a swing
    later, sooner = (
        _state(library, kinematics, (at + sign * step) % 1.0, here)[1] for sign in (1, -1)
    )
    acceleration = (later - sooner) / (0.02 * _PERIOD)
    motors = CASSIE.indices.motor_qvel
    held = Demand(velocity[:, motors], leg_torque(kinematics, qpos, velocity, acceleration))

    # what the change of the command adds to velocity and acceleration
    moved = _moved(library, kinematics, phase[1:], command)
    changed = (velocity - _state(library, kinematics, at, before)[1]) / _PERIOD
    acceleration = acceleration + changed + np.diff(moved, axis=0) / _PERIOD
    velocity = velocity + moved[:-1]
    torque = leg_torque(kinematics, qpos, velocity, acceleration)
    return Found(held, Demand(velocity[:, motors], torque), _slide(library, at, before, here))


def _state(
    library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor
) -> tuple[np.ndarray, np.ndarray]:
    """Configurations (n, nq) and velocities (n, nv) of gaits, all of the pelvis in its own axes."""
    qpos, qvel = (state.numpy() for state in library.initial_state(phase, command))
    return qpos, pelvis_axes(kinematics, qpos, qvel)


def _moved(
    library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor
) -> np.ndarray:
    """Velocities (n, nv) at phases (n, 1) that only the steps between commands (n + 1, 3) cause."""
    pairs = (
        kinematics.to_pinocchio(library.initial_state(phase, ends)[0].numpy())
        for ends in (command[:-1], command[1:])
    )
    moved = [pin.difference(kinematics.model, *pair) for pair in zip(*pairs, strict=True)]
    return np.array(moved) / _PERIOD


def _slide(library: GaitLibrary, phase: Tensor, before: Tensor, here: Tensor) -> np.ndarray:
    """Speeds (k,) over ground of planted feet in policy steps that change the command."""
    changes = (before != here).any(dim=-1)
    phase, before, here = phase[changes], before[changes], here[changes]
    first, last = (library.lookup(phase, command) for command in (before, here))
    speeds = []
    for side in SIDES:
        start, end = (m.body_position + getattr(m, f"{side}_foot_position") for m in (first, last))
        planted = getattr(last, f"{side}_foot_velocity").norm(dim=-1) < _PLANTED
        speeds.append((end - start)[planted, :2].norm(dim=-1).numpy() / _PERIOD)
    return np.concatenate(speeds)


def table(found: Found) -> str:
    """Torques of both legs' motors, and the share of time beyond the motors' limits."""
    rows = []
    for name in _MOTORS:
        both = [CASSIE.motor_names.index(f"{side}_{name}") for side in SIDES]
        cells = [name.replace("_", " ")]
        for part in (found.held, found.changing):
            torque = np.abs(part.torque[:, both])
            beyond = (np.abs(part.torque) > motor_limit(part.velocity))[:, both]
            cells += [f"{np.quantile(torque, 0.99):.0f}", f"{torque.max():.0f}"]
            cells.append(f"{100 * beyond.mean():.1f}")
        rows.append(cells)
    names = [f"{when}: {what}" for when in ("held", "changing") for what in _COLUMNS]
    return markdown(("motor", *names), rows)


def _summary(slide: np.ndarray) -> str:
    """Sentence on the feet."""
    return (
        f"planted feet of the reference slide by {slide.mean():.3f} m/s in the mean while the"
        f" command changes, 95 % below {np.quantile(slide, 0.95):.3f} m/s, at most"
        f" {slide.max():.2f} m/s"
    )


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
