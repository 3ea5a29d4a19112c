"""Simulate Cassie behind the robot's network protocol, until Ctrl-C or SIGTERM.

    python -m aslip.network.twin                     # PD mode in lockstep, 127.0.0.1:25000
    python -m aslip.network.twin --real-time         # at 2 kHz, as the robot
    python -m aslip.network.twin --real-time --raw   # torques in, sensors out
    python -m aslip.network.twin --real-time --live  # with a page to watch, push and stop it
    python -m aslip.network.twin --engine drake      # in Drake instead of MuJoCo
    python -m aslip.network.twin --raw --course 7    # over stones, for policies with a planner

In lockstep each command advances the simulation by a tick of 0.5 ms, and is answered by the state
after the tick. A client that begins with zeros after another one has gone finds the robot on its
feet. In real time the robot stands still until a command has torques or gains, holds the
last command, and is damped after a silence of 0.1 s, in raw mode 10 ms. At the end the numbers of
ticks and datagrams are printed.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

from aslip.base.command_line import command_line, say
from aslip.base.processes import signals_exit
from aslip.errors import ConfigurationError, one_line_errors
from aslip.network.wire import (
    CASSIE_OUT,
    PD_IN,
    SIMULATOR,
    STATE_OUT,
    USER_IN,
    Address,
    Endpoint,
    Link,
)

if TYPE_CHECKING:
    from aslip.network.twin import TwinRobot


@dataclass(frozen=True)
class Config:
    """Settings of the twin."""

    address: str = SIMULATOR.host
    """IPv4 address to listen at."""
    port: int = SIMULATOR.port
    """Port to listen at; 0 lets the system choose one."""
    engine: Literal["mujoco", "drake"] = "mujoco"
    """Physics engine; Drake needs the extra aslip[drake]."""
    beyond_loopback: bool = False
    """Allow an address that other machines reach, which can then move the robot."""
    raw: bool = False
    """Use raw mode: take torques, not PD targets, and send sensor readings, not the robot's own
    estimate."""
    real_time: bool = False
    """Advance at 2 kHz, whether commands come or not; otherwise in lockstep with the client."""
    course: str | None = None
    """Stones to stand on instead of the floor: a JSON file, a pattern of
    `aslip.sim.course.PATTERNS`, or the seed of a random course. The twin then tells a runner with
    --listen 25005 where they are, and leads it along them."""
    guide_port: int = 25005
    """Port of loopback at which the runner listens to that."""
    guide_speed: float = 0.5
    """Speed at which the robot is led over a course [m/s]."""
    live: bool = False
    """Serve a page to watch, push and stop the robot; needs the extra aslip[live]."""
    page_port: int = 8080
    """Port of the page, at the address of the twin; 0 lets the system choose one."""


def main(config: Config) -> None:
    """Serve clients until Ctrl-C."""
    sends, receives = (CASSIE_OUT, USER_IN) if config.raw else (STATE_OUT, PD_IN)
    link = Link(sends, receives, refuse_not_finite=True)
    local = Address(config.address, config.port)
    with Endpoint(link, local, beyond_loopback=config.beyond_loopback) as endpoint:
        # imported late: a port in use is reported at once
        from aslip.network.twin import ENGINES, RealTimeServer, TwinRobot, serve_lockstep
        from aslip.network.twin.page import TwinPage

        robot = (
            _robot_on_course(config)
            if config.course
            else TwinRobot(ENGINES[config.engine], raw=config.raw)
        )
        server = RealTimeServer(robot, endpoint, say=say) if config.real_time else None
        page = TwinPage(robot, config.address, config.page_port) if config.live else None

        def stop() -> bool:
            if page is not None:
                page.update({"client": str(endpoint.peer or "none yet")})
            return False

        seen = f", page at {page.url}" if page else ""
        say(f"waiting for commands at {endpoint.local}{seen}; Ctrl-C ends")
        try:
            with contextlib.suppress(KeyboardInterrupt), signals_exit():
                if server is None:
                    serve_lockstep(robot, endpoint, stop, say)
                else:
                    server.run(stop)
        finally:
            ticks = f"{robot.ticks} ticks of the last client" if server is None else server.load
            counts = {name: number for name, number in asdict(link.counters).items() if number}
            say(f"{ticks}\n{robot.divergences} divergences, datagrams: {counts}")
            if page is not None:
                page.close()
            if robot.guide is not None:
                robot.guide.close()


def _robot_on_course(config: Config) -> TwinRobot:
    """Robot on the stones of `--course`, with its guide.

    Raises:
        ConfigurationError: these stones are not for the engine, the mode or the page.
    """
    from aslip.network.twin import Guide, TwinRobot, mujoco_engine
    from aslip.sim.course import find_course

    if not config.raw or config.engine != "mujoco" or config.live:
        raise ConfigurationError(
            "--course needs --raw, as policies with a planner do, and MuJoCo, and no --live, whose"
            " page does not show stones"
        )
    course = find_course(str(config.course))
    robot = TwinRobot(partial(mujoco_engine, course=course), raw=True)
    robot.guide = Guide(course, config.guide_port, config.guide_speed)
    return robot


if __name__ == "__main__":
    with one_line_errors():
        main(command_line(Config))
