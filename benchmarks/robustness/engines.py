"""Walks of one controller in two physics engines, through the network protocol.

    python -m benchmarks.robustness.engines  # two policies: an hour on a busy core
    python -m benchmarks.robustness.engines --policy straight --speeds 0.5 --duration 3
    python -m benchmarks.robustness.engines --engine drake --contact.approximation sap

The controller sees only the twin's `state_out_t`, over UDP on loopback. The robot stands, and
the command rises to its speed. Needs the package's extra `drake`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from aslip.base.assets import UserPaths
from aslip.base.command_line import command_line
from aslip.errors import ConfigurationError, one_line_errors
from aslip.sim.drake import Contact
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config(UserPaths):
    """Settings of the benchmark."""

    policy: tuple[str, ...] = ("straight", "robust")
    """Policies: shipped names, files or run folders."""
    engine: tuple[Literal["mujoco", "stiff", "drake"], ...] = ("mujoco", "drake")
    """Engines of the twin; `stiff` is MuJoCo with almost rigid leg loops."""
    speeds: tuple[float, ...] = tuple(np.linspace(0, 2, 21).round(1).tolist())
    """Commanded speeds [m/s]."""
    duration: float = 12.0
    """Length of a walk [s]."""
    acceleration: float = 1.0
    """Rise of the command from zero to its speed [m/s^2]."""
    contact: Contact = field(default_factory=Contact)
    """Contact of the soles with the floor in Drake."""
    out: Path = Path("runs/benchmarks")
    """Folder for table and results."""

    def __post_init__(self) -> None:
        """Check the numbers, and that there is something to walk."""
        super().__post_init__()
        for name in ("policy", "engine", "speeds"):
            if not getattr(self, name):
                raise ConfigurationError(f"{name} must name at least one")
        check_numbers(self, "duration", "acceleration")


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

from dataclasses import asdict
from functools import partial

from aslip.base.tables import markdown
from aslip.control import Controller
from aslip.network.twin import TwinRobot, drake_engine, mujoco_engine, serve_lockstep
from aslip.network.wire import (
    LOOPBACK,
    PD_IN,
    STATE_OUT,
    Address,
    Endpoint,
    Link,
    command_to_pd_in,
    state_out_to_estimate,
)
from aslip.robot import CASSIE, Robot
from aslip.robot.model import load_model
from aslip.sim import MakeDrive, Simulations
from benchmarks.common import write_results


@dataclass(frozen=True)
class EngineWalk:
    """Numbers of a walk; means are over its second half."""

    policy: str
    engine: str
    command: float
    """Commanded speed [m/s]."""
    duration: float
    """Time until the fall, or the whole walk [s]."""
    fell: bool
    speed: float
    """Mean forward velocity of the pelvis [m/s]."""
    height: float
    """Mean height of the pelvis [m]."""
    estimate_error: float
    """Root mean square error of the pelvis' estimated forward velocity [m/s]."""

    def __str__(self) -> str:
        """Mean speed, or the time of the fall."""
        return f"fell at {self.duration:.1f} s" if self.fell else f"{self.speed:.2f}"


def main(config: Config) -> None:
    """Print the mean speeds of all walks, and the differences between the engines."""
    subjects = [(policy, engine) for policy in config.policy for engine in config.engine]
    walks: list[EngineWalk] = []
    rows: list[list[str]] = []
    for speed in config.speeds:
        row = [f"{speed:.1f}"]
        for policy, engine in subjects:
            walks.append(walk(Controller(policy), policy, engine, speed, config))
            row.append(str(walks[-1]))
        rows.append(row)
        print(" | ".join(row), flush=True)
    header = ["command [m/s]", *(f"`{policy}`, {engine}" for policy, engine in subjects)]
    summaries = [summary(policy, engine, walks) for policy, engine in subjects]
    table = markdown(header, rows) + "\n\n" + markdown(_SUMMARY, summaries)
    numbers = {"contact": asdict(config.contact), "walks": [asdict(walk) for walk in walks]}
    write_results(config.out, "engines", numbers, table)


def walk(
    controller: Controller, policy: str, engine: str, speed: float, config: Config
) -> EngineWalk:
    """Walk of a controller at one commanded speed until a fall or the end."""
    drake = partial(drake_engine, contact=config.contact)
    makers = {"mujoco": mujoco_engine, "stiff": stiff_engine, "drake": drake}
    twin, steps = TwinRobot(make_engine=makers[engine]), round(config.duration / _PERIOD)
    ramp = np.minimum(speed, config.acceleration * _PERIOD * np.arange(steps + 1)).tolist()
    server = Endpoint(Link(STATE_OUT, PD_IN, refuse_not_finite=True), Address(LOOPBACK, 0))
    link = Link(PD_IN, STATE_OUT, refuse_not_finite=False)
    records, fell = [], False
    with server, Endpoint(link, Address(LOOPBACK, 0), server.local) as client:
        state = answer(twin, server, client, PD_IN.zeros())
        walking = controller.start(state_out_to_estimate(state), ramp[0], heading=0.0)
        for command in ramp[1:]:
            target = command_to_pd_in(walking.motor_target[0].numpy())
            for _ in range(CASSIE.substeps):
                state = answer(twin, server, client, target)
            truth, estimate = twin.truth(), state_out_to_estimate(state)
            velocity, height = truth["pelvis_velocity"][0, 0], truth["pelvis_position"][0, 2]
            records.append((velocity, height, estimate["velocity"][0] - velocity))
            fell = bool(height < CASSIE.fall_height or twin.divergences)
            if fell:
                break
            walking, _ = controller.step(walking, estimate, command)
    velocity, height, error = np.array(records[len(records) // 2 :], dtype=np.float64).T
    return EngineWalk(
        policy,
        engine,
        speed,
        duration=len(records) * _PERIOD,
        fell=fell,
        speed=float(velocity.mean()),
        height=float(height.mean()),
        estimate_error=float(np.sqrt((error**2).mean())),
    )


def answer(twin: TwinRobot, server: Endpoint, client: Endpoint, command: np.ndarray) -> np.ndarray:
    """Answer of the twin to a command, with both sides in this thread."""
    ticks = twin.ticks
    client.send(command)
    serve_lockstep(twin, server, lambda: twin.ticks > ticks)
    client.wait()
    answer = client.receive()
    assert answer is not None
    return answer


def stiff_engine(robot: Robot, drive: MakeDrive) -> Simulations:
    """Robot in MuJoCo with loops more than a thousand times as stiff as the MJCF's."""
    model = load_model(visual=False, robot=robot)
    model.eq_solref[:, 0], model.eq_solimp[:, :2] = 0.001, 0.999
    return Simulations(1, model=model, num_threads=1, robot=robot, drive=drive)


def summary(policy: str, engine: str, walks: list[EngineWalk]) -> list[str]:
    """Row of a policy in an engine: number of walks without a fall, and means over these."""
    ours = [one for one in walks if (one.policy, one.engine) == (policy, engine)]
    good = [one for one in ours if not one.fell]
    row = [f"`{policy}`", engine, f"{len(good)} of {len(ours)}"]
    if not good:
        return [*row, *["-"] * 3]
    worst = max(abs(one.speed - one.command) for one in good)
    height, error = (
        np.mean([getattr(one, name) for one in good]) for name in ("height", "estimate_error")
    )
    return [*row, f"{worst:.3f}", f"{height:.3f}", f"{error:.3f}"]


_PERIOD = CASSIE.policy_period
_SUMMARY = (
    "policy",
    "engine",
    "walked",
    "largest error of the mean speed [m/s]",
    "height of the pelvis [m]",
    "error of the estimated velocity [m/s]",
)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
