"""Simulated Cassie behind the robot's network protocol, until Ctrl-C.

    python -m aslip.twin                                 # at 127.0.0.1:25000
    python -m aslip.twin --engine drake                  # in Drake instead of MuJoCo

Every `pd_in_t` is one tick of 0.5 ms, answered by `state_out_t`. At the end the numbers of ticks
and of datagrams are printed.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line
from aslip.wire import PD_IN, SIMULATOR, STATE_OUT, Address, Endpoint, Link


@dataclass(frozen=True)
class Config:
    """Settings of the twin."""

    address: str = SIMULATOR.host
    """IPv4 address to listen at."""
    port: int = SIMULATOR.port
    """Port to listen at; 0 lets the system choose one."""
    engine: Literal["mujoco", "drake"] = "mujoco"
    """Physics engine; Drake needs the package's extra of that name."""
    beyond_loopback: bool = False
    """Allow an address that other machines reach: they can move the robot."""


def main(config: Config) -> None:
    """Serve clients in lockstep."""
    link = Link(STATE_OUT, PD_IN, refuse_not_finite=True)
    local = Address(config.address, config.port)
    with Endpoint(link, local, beyond_loopback=config.beyond_loopback) as endpoint:
        # imported late: a port in use is reported at once
        from aslip.twin import ENGINES, TwinRobot, serve_lockstep

        robot = TwinRobot(make_engine=ENGINES[config.engine])
        print(f"waiting for commands at {endpoint.local}; Ctrl-C ends", flush=True)
        try:
            serve_lockstep(robot, endpoint)
        except KeyboardInterrupt:
            counts = {name: number for name, number in asdict(link.counters).items() if number}
            print(f"{robot.ticks} ticks, {robot.divergences} divergences, datagrams: {counts}")


if __name__ == "__main__":
    with one_line_errors():
        main(command_line(Config))
