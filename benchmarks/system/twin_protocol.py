"""Cost of a tick of the simulated robot behind the network protocol.

    python -m benchmarks.system.twin_protocol

It is the CPU time of the twin's thread in lockstep over UDP on loopback, with both datagrams, while
the robot is held. Lost and late datagrams are in `benchmarks.system.runner`.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors
from benchmarks.flags import check_numbers


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    ticks: int = 6000
    """Number of ticks in each mode."""

    def __post_init__(self) -> None:
        """Check the number."""
        check_numbers(self, ticks=1)


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import time

import numpy as np

from aslip.network.twin import TwinRobot, serve_lockstep
from aslip.network.wire import LOOPBACK, Address, Endpoint, Link, command_to_pd_in
from aslip.robot import CASSIE


def main(config: Config) -> None:
    """Measure and print."""
    for raw in (False, True):
        mode = "raw" if raw else "PD"
        print(f"tick in {mode} mode: {1e3 * tick_cost(config.ticks, raw=raw):.3f} ms of CPU")


def tick_cost(ticks: int, *, raw: bool) -> float:
    """Mean CPU time of the twin's side per tick in lockstep [s], while the robot is held."""
    twin, busy = TwinRobot(raw=raw), 0.0
    command = twin.receives.zeros()
    if not raw:
        command = command_to_pd_in(CASSIE.standing[CASSIE.indices.motor_qpos])
    with robot_endpoint(twin) as server, client_endpoint(twin, server.local) as client:
        answer(twin, server, client, command)
        for _ in range(ticks):
            before = twin.ticks
            client.send(command)
            start = time.thread_time()
            serve_lockstep(twin, server, lambda before=before: twin.ticks > before)
            busy += time.thread_time() - start
            client.wait()
            client.receive()
    return busy / ticks


def answer(twin: TwinRobot, server: Endpoint, client: Endpoint, command: np.ndarray) -> np.ndarray:
    """Answer of the twin to a command, with both sides in this thread."""
    ticks = twin.ticks
    client.send(command)
    serve_lockstep(twin, server, lambda: twin.ticks > ticks)
    client.wait()
    answer = client.receive()
    assert answer is not None
    return answer


def robot_endpoint(twin: TwinRobot) -> Endpoint:
    """Socket of a twin on any free port."""
    link = Link(twin.sends, twin.receives, refuse_not_finite=True)
    return Endpoint(link, Address(LOOPBACK, 0))


def client_endpoint(twin: TwinRobot, robot: Address) -> Endpoint:
    """Socket of a client of a twin, on any free port."""
    link = Link(twin.receives, twin.sends, refuse_not_finite=False)
    return Endpoint(link, Address(LOOPBACK, 0), robot)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
