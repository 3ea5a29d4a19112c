"""Lockstep: the twin waits for a command at each tick, and answers with the state after it."""

from __future__ import annotations

from collections.abc import Callable

from aslip.network.twin.robot import TwinRobot
from aslip.network.wire import Endpoint

# longest time between two calls of `stop` [s]
_PATIENCE = 0.1


def serve_lockstep(
    robot: TwinRobot, endpoint: Endpoint, stop: Callable[[], bool] = lambda: False
) -> None:
    """Answer commands until `stop` returns True.

    Each new command causes one tick and one answer; of several queued commands only the newest
    acts. A repeated datagram gets the last answer again, without a tick: a client that got no
    answer sends its datagram again, and the simulation does not depend on lost datagrams.

    Args:
        robot: robot to advance.
        endpoint: socket at which commands arrive.
        stop: function that is called at least every 0.1 s.
    """
    while not stop():
        if endpoint.wait(_PATIENCE):
            _answer(robot, endpoint)


def _answer(robot: TwinRobot, endpoint: Endpoint) -> None:
    """Answer the newest queued command."""
    repeated = endpoint.link.counters.repeated
    command = endpoint.receive()
    if command is not None:
        endpoint.send(robot.tick(command))
    elif endpoint.link.counters.repeated > repeated:
        endpoint.resend()
