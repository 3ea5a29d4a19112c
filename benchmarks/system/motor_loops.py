"""Decay of motor velocities under the PD loops, by torque delay: a delay may make a loop unstable.

    python -m benchmarks.system.motor_loops
    python -m benchmarks.system.motor_loops --delays 3 4 5 --picture loops.png

The robot floats in its standing pose, without gravity and contact, and all motor targets step by
0.02 rad and back. No policy acts, so what is left later are oscillations of the PD loops alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import AslipError, ConfigurationError, one_line_errors


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    delays: tuple[float, ...] = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 9.0)
    """Torque delays [ms]; the robot's is 3 ms."""
    duration: float = 3.0
    """Time after the step [s]; the last half second counts."""
    picture: Path | None = None
    """Picture to write."""

    def __post_init__(self) -> None:
        """Check that there is a delay, and that something is left to count."""
        super().__post_init__()
        if not self.delays:
            raise ConfigurationError("name at least one delay in ms")
        if not self.duration > _COUNTED:
            raise ConfigurationError(f"duration must exceed {_COUNTED} s, got {self.duration}")


_COUNTED = 0.5  # last part of the time that counts [s]

if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import math
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from aslip.base.tables import markdown
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.plots import save_figure
from aslip.sim import Simulations
from aslip.sim.dynamics import Dynamics, with_longer_memory

_STEP: Final = 0.02  # change of the motor targets [rad]
_HEIGHT: Final = 1.0  # of the robot above its standing pose, so that nothing touches [m]


def main(config: Config) -> np.ndarray:
    """Measure, print and draw; returns motor speeds (delays, policy steps, motors) [rad/s]."""
    speeds = swing(np.array(config.delays) / 1e3, round(config.duration / CASSIE.policy_period))
    print(table(config, speeds))
    if config.picture is not None:
        save_figure(picture(config, speeds), config.picture)
    return speeds


def swing(delays: np.ndarray, steps: int) -> np.ndarray:
    """Speed of each motor at the end of each policy step (delays, steps, motors) [rad/s].

    Args:
        delays: (n,) torque delays [s].
        steps: policy steps after the targets have stepped back.

    Raises:
        AslipError: a simulation diverged.
    """
    ids, num = np.arange(len(delays)), len(delays)
    model = with_longer_memory(load_model(visual=False), float(delays.max()), visual=False)
    model.opt.gravity[:] = 0.0
    simulations = Simulations(num, model=model)
    simulations.write_fields(ids, Dynamics(num, model).update(ids, {"torque_delay": delays}))
    qpos = np.tile(CASSIE.standing, (num, 1))
    qpos[:, 2] += _HEIGHT
    simulations.reset(ids, qpos)
    at = CASSIE.indices
    standing = qpos[:, at.motor_qpos]
    simulations.advance(standing + _STEP)
    found = np.empty((num, steps, len(CASSIE.motor_names)))
    for step in range(steps):
        if (diverged := simulations.advance(standing)).any():
            raise AslipError(f"the simulation diverged with delays of {delays[diverged]} s")
        found[:, step] = np.abs(simulations.qvel[:, at.motor_qvel])
    return found


def left(speeds: np.ndarray) -> np.ndarray:
    """Largest speeds (delays, motors) in the last part of the time [rad/s]."""
    return speeds[:, -math.ceil(_COUNTED / CASSIE.policy_period) :].max(axis=1)


def table(config: Config, speeds: np.ndarray) -> str:
    """Speed that is left of each kind of motor, larger of left and right [rad/s]."""
    kinds = [name.removeprefix("left_") for name in CASSIE.motor_names if "left" in name]
    rows = []
    for delay, of in zip(config.delays, left(speeds), strict=True):
        rows.append([f"{delay:g}", *(f"{v:.3f}" for v in of.reshape(2, -1).max(axis=0))])
    return markdown(("torque delay [ms]", *(f"{kind} [rad/s]" for kind in kinds)), rows)


def picture(config: Config, speeds: np.ndarray) -> Figure:
    """Largest speed of any motor over time, a line for each delay."""
    figure = Figure(figsize=(6.8, 3.2), layout="constrained")
    axes = figure.subplots()
    time = np.arange(1, speeds.shape[1] + 1) * CASSIE.policy_period
    for k, (delay, of) in enumerate(zip(config.delays, speeds.max(axis=2), strict=True)):
        shade = str(0.75 * (1 - k / len(config.delays)))
        nominal = math.isclose(delay, 1e3 * CASSIE.torque_delay)
        axes.plot(
            time,
            of,
            color="C0" if nominal else shade,
            linewidth=2.2 if nominal else 1.0,
            label=f"{delay:g} ms" + (", Cassie" if nominal else ""),
        )
    axes.set_yscale("log")
    axes.set_xlabel("time after the step [s]")
    axes.set_ylabel("fastest motor [rad/s]")
    figure.legend(fontsize=8, title="torque delay", loc="outside right upper")
    return figure


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
