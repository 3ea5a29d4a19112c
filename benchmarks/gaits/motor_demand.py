"""Speed and torque that the swing of a library asks of hip and knee, against the motors' limits.

    python -m benchmarks.gaits.motor_demand
    python -m benchmarks.gaits.motor_demand --library runs/directions/gaits.npz --picture demand.png

Straight gaits. Torques are those of inverse dynamics of the swinging leg, reflected inertia of the
motors included, while the pelvis follows its reference. The motor's limit is that of the simulated
drive: full torque up to half the no-load speed, none from the no-load speed on.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    library: tuple[str, ...] = ("gaits", "directions")
    """Libraries: shipped ones by name, or files."""
    speeds: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5, 2.0)
    """Forward speeds [m/s]."""
    picture: Path | None = None
    """Picture to write."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from typing import Final

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure

from aslip.base.tables import markdown
from aslip.ik import Kinematics, leg_torque, pelvis_axes
from aslip.library import GaitLibrary
from aslip.library.interpolation import periodic_slopes
from aslip.robot import CASSIE
from aslip.show.plots import save_figure
from aslip.sim import PD
from benchmarks.common import straight

_PHASES: Final = 400
_STILL = 0.1  # speed of a foot below which it stands [m/s]
_ENOUGH = 1e9  # command that asks for more than any motor gives [rad]
_MOTORS: Final = {"hip": "left_hip_pitch", "knee": "left_knee"}

Demand = tuple[np.ndarray, np.ndarray]
"""Velocities (n, motors) [rad/s] and torques (n, motors) [N m] at the joints, in left swing."""


def main(config: Config) -> dict[str, list[Demand]]:
    """Compute, print and draw; returns the demand at each speed, by library."""
    kinematics, found = Kinematics(), {}
    for name in config.library:
        library = GaitLibrary.load(name)
        found[name] = [demand(kinematics, library, speed) for speed in config.speeds]
    print(table(config, found))
    if config.picture is not None:
        save_figure(picture(config, found), config.picture)
    return found


def demand(kinematics: Kinematics, library: GaitLibrary, speed: float) -> Demand:
    """Velocities and torques of the motors while the left leg swings.

    Args:
        kinematics: the robot.
        library: gaits.
        speed: forward speed [m/s].
    """
    phase = torch.arange(_PHASES, dtype=torch.float64)[:, None] / _PHASES
    command = torch.tensor(straight(library, speed), dtype=torch.float64).expand(_PHASES, -1)
    qpos, qvel = (state.numpy() for state in library.initial_state(phase, command))
    velocity = pelvis_axes(kinematics, qpos, qvel)
    stride = library.stride(command[:1]).item()
    acceleration = periodic_slopes(velocity[None])[0] * _PHASES / stride
    torque = leg_torque(kinematics, qpos, velocity, acceleration)
    foot = library.lookup(phase, command).left_foot_velocity
    swings = foot.norm(dim=-1).numpy() > _STILL
    return qvel[swings][:, CASSIE.indices.motor_qvel], torque[swings]


def motor_limit(velocity: np.ndarray) -> np.ndarray:
    """Largest torques (n, motors) of the simulated drive at joint velocities [N m]."""
    everything = np.full_like(velocity, _ENOUGH)
    shaft = PD(len(velocity)).torque(everything, np.zeros_like(velocity), velocity)
    return np.abs(shaft) * CASSIE.gear


def table(config: Config, found: dict[str, list[Demand]]) -> str:
    """Largest speeds and torques, and the share of the swing beyond the limit."""
    rows = []
    for name, demands in found.items():
        for speed, (velocity, torque) in zip(config.speeds, demands, strict=True):
            beyond = np.abs(torque) > motor_limit(velocity)
            cells = []
            for motor in _MOTORS.values():
                i = CASSIE.motor_names.index(motor)
                cells += [
                    f"{np.abs(velocity[:, i]).max():.1f}",
                    f"{np.abs(torque[:, i]).max():.0f}",
                    f"{100 * beyond[:, i].mean():.0f}",
                ]
            rows.append([name, f"{speed:g}", *cells])
    names = [
        f"{joint} {what}"
        for joint in _MOTORS
        for what in ("[rad/s]", "[N m]", "beyond its motor [% of swing]")
    ]
    return markdown(("library", "speed [m/s]", *names), rows)


def picture(config: Config, found: dict[str, list[Demand]]) -> Figure:
    """Torque over speed of hip and knee through the swing, with the limits of the motors."""
    figure = Figure(figsize=(4.2 * len(_MOTORS), 3.1 * len(found)), layout="constrained")
    panels = figure.subplots(len(found), len(_MOTORS), sharex=True, sharey=True, squeeze=False)
    for row, (name, demands) in zip(panels, found.items(), strict=True):
        for axes, (joint, motor) in zip(row, _MOTORS.items(), strict=True):
            i = CASSIE.motor_names.index(motor)
            shades = mpl.colormaps["viridis"](np.linspace(0, 0.9, len(demands)))
            for speed, (velocity, torque), shade in zip(
                config.speeds, demands, shades, strict=True
            ):
                axes.plot(velocity[:, i], torque[:, i], color=shade, label=f"{speed:g} m/s")
            rate = np.linspace(-18.0, 18.0, 361)
            limit = motor_limit(np.repeat(rate[:, None], len(CASSIE.motor_names), axis=1))[:, i]
            axes.fill_between(rate, -limit, limit, color="0.9", label="motor", zorder=0)
            axes.set_title(f"{joint}, {name}")
    for axes in panels[-1]:
        axes.set_xlabel("speed of the joint [rad/s]")
    for axes in panels[:, 0]:
        axes.set_ylabel("torque [N m]")
    panels[0, 0].legend(fontsize=8)
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
