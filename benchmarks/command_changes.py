"""What changes of the command ask of the legs: sliding feet of the reference, torque of the motors.

    python -m benchmarks.command_changes
    python -m benchmarks.command_changes --rates 2 1.5 2

The reference of a walk changes with its command. While the command moves from one random command
to another, as fast as the filter of commands lets it, planted feet of the reference slide, and legs
accelerate more than at a constant command. Torques are those of inverse dynamics of the legs
without ground forces, as in `benchmarks.motor_demand`.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.errors import ConfigurationError, one_line_errors
from aslip.training.command_line import command_line
from aslip.transforms import COMMAND_RATES


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    library: str = "directions"
    """Library over three commands, shipped or a file."""
    changes: int = 200
    """Number of changes between random commands."""
    rates: tuple[float, float, float] = COMMAND_RATES
    """Largest rates of forward speed, sideways speed [m/s^2] and yaw rate [rad/s^2]."""
    seed: int = 0
    """Seed of commands and phases."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.changes < 1:
            raise ConfigurationError(f"changes must be 1 or more, got {self.changes}")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Final, NamedTuple

import numpy as np
import pinocchio as pin
import torch
from torch import Tensor

from aslip.ik import Kinematics, leg_torque, pelvis_axes
from aslip.library import GaitLibrary
from aslip.robot import CASSIE, SIDES
from aslip.transforms.clock import advance_phase
from aslip.transforms.command import approach_command
from aslip.walking import markdown
from benchmarks.directions import random_commands
from benchmarks.motor_demand import motor_limit

_PERIOD: Final = 0.01  # time between samples [s]
_PLANTED: Final = 1e-2  # speed below which a foot of the gait stands [m/s]
_ROWS: Final = {"hip roll": 0, "hip yaw": 1, "hip pitch": 2, "knee": 3, "foot": 4}


class Asked(NamedTuple):
    """What n instants ask of the legs."""

    slide: np.ndarray
    """(k,) speeds of the planted feet over ground [m/s]."""
    torque: np.ndarray
    """(n, motors) torques of the motors [N m]."""
    beyond: np.ndarray
    """(n, motors) True where a motor cannot give its torque."""


def main(config: Config) -> tuple[Asked, Asked]:
    """Compute and print; returns what constant and changing commands ask."""
    library, kinematics = GaitLibrary.load(config.library), Kinematics()
    ends = torch.tensor(random_commands(library, 2 * config.changes, config.seed)).reshape(2, -1, 3)
    phase = torch.rand(
        config.changes, 1, generator=torch.Generator().manual_seed(config.seed), dtype=ends.dtype
    )
    parts = [
        asked(library, kinematics, *walk_over(library, config, start, end, at))
        for start, end, at in zip(*ends, phase, strict=True)
    ]
    constant, changing = (
        Asked(*(np.concatenate(arrays) for arrays in zip(*part, strict=True)))
        for part in zip(*parts, strict=True)
    )
    print(table(constant, changing), _summary(changing.slide), sep="\n\n")
    return constant, changing


def walk_over(
    library: GaitLibrary, config: Config, start: Tensor, end: Tensor, phase: Tensor
) -> tuple[Tensor, Tensor]:
    """Phases (n, 1) and commands (n, 3) from the first instant of a change to the last one."""
    commands, phases = [start], [phase]
    while not torch.equal(commands[-1], end):
        commands.append(approach_command(commands[-1], end, config.rates, _PERIOD))
        phases.append(advance_phase(library, phases[-1], commands[-1], _PERIOD))
    return torch.stack(phases), torch.stack(commands)


def asked(
    library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor
) -> tuple[Asked, Asked]:
    """What the inner instants of a change ask at their commands, constant and changing."""
    before, after = slice(None, -2), slice(2, None)
    at, here = phase[1:-1], command[1:-1]
    qpos, qvel = (state.numpy() for state in library.initial_state(at, here))
    steady = _velocity(library, kinematics, at, here)
    ahead = _PERIOD / library.stride(here)
    gone = [_velocity(library, kinematics, at + s * ahead, here) for s in (1, -1)]
    constant = leg_torque(kinematics, qpos, steady, (gone[0] - gone[1]) / (2 * _PERIOD))

    # the change moves joints and feet beyond the motion at a constant command
    moved = _moved(library, kinematics, phase, command)
    velocity = steady + moved
    acceleration = np.gradient(velocity, _PERIOD, axis=0) if len(at) > 1 else np.zeros_like(moved)
    changing = leg_torque(kinematics, qpos, velocity, acceleration)
    motors = CASSIE.indices.motor_qvel
    return (
        Asked(_slide(library, at, here, here), constant, _beyond(constant, qvel[:, motors])),
        Asked(
            _slide(library, at, command[before], command[after]),
            changing,
            _beyond(changing, velocity[:, motors]),
        ),
    )


def _velocity(
    library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor
) -> np.ndarray:
    """Velocities (n, nv) of the gaits at constant commands, all of the pelvis in its own axes."""
    qpos, qvel = (state.numpy() for state in library.initial_state(phase % 1.0, command))
    return pelvis_axes(kinematics, qpos, qvel)


def _moved(
    library: GaitLibrary, kinematics: Kinematics, phase: Tensor, command: Tensor
) -> np.ndarray:
    """Velocities (n - 2, nv) of the joints that only the change of the command causes."""
    first, last = (
        kinematics.to_pinocchio(library.initial_state(phase[1:-1], ends)[0].numpy())
        for ends in (command[:-2], command[2:])
    )
    rates = np.array(
        [pin.difference(kinematics.model, *pair) for pair in zip(first, last, strict=True)]
    )
    rates[:, :6] = 0.0  # the pelvis
    return rates / (2 * _PERIOD)


def _slide(library: GaitLibrary, phase: Tensor, before: Tensor, after: Tensor) -> np.ndarray:
    """Speeds (k,) of planted feet while the command goes from `before` to `after`."""
    first, middle, last = (library.lookup(phase, c) for c in (before, (before + after) / 2, after))
    speeds = []
    for side in SIDES:
        places = [m.body_position + getattr(m, f"{side}_foot_position") for m in (first, last)]
        rate = (places[1] - places[0]) / (2 * _PERIOD)
        planted = getattr(middle, f"{side}_foot_velocity").norm(dim=-1) < _PLANTED
        speeds.append(rate[planted][:, :2].norm(dim=-1).numpy())
    return np.concatenate(speeds)


def _beyond(torque: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(n, motors) True where a motor cannot give a torque at its velocity."""
    return np.abs(torque) > motor_limit(velocity)


def table(constant: Asked, changing: Asked) -> str:
    """Largest torques of both legs' motors, and the share of time beyond the motor's limit."""
    rows = []
    count = len(_ROWS)
    for name, i in _ROWS.items():
        cells = [name]
        for part in (constant, changing):
            both = [i, i + count]
            cells += [
                f"{np.quantile(np.abs(part.torque[:, both]), 0.99):.0f}",
                f"{100 * part.beyond[:, both].mean():.1f}",
            ]
        rows.append(cells)
    names = [f"{when}: {what}" for when in ("constant", "changing") for what in _WHAT]
    return markdown(("motor", *names), rows)


_WHAT: Final = ("99 % of torques below [N m]", "beyond the motor [% of time]")


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
