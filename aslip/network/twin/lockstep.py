"""Lockstep: the twin waits for a command at each tick, and answers with the state after it."""

from __future__ import annotations

import time
from collections.abc import Callable

from aslip.base.command_line import Reports
from aslip.network.twin.robot import TwinRobot
from aslip.network.wire import Endpoint
from aslip.network.wire.endpoint import SILENCE

# longest time between two calls of `stop` [s]
_PATIENCE = 0.1
# silence after which a client counts as gone [s]: one that computes may pause for a while
_GONE = 1.0


def serve_lockstep(
    robot: TwinRobot,
    endpoint: Endpoint,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], object] = lambda text: None,
) -> None:
    """Answer commands until `stop` returns True.

    Each new command causes one tick and one answer; of several queued commands only the newest
    acts. A repeated datagram gets the last answer again, without a tick: a client that got no
    answer sends its datagram again, and the simulation does not depend on lost datagrams.

    A client that begins with zeros after another one has gone finds the robot on its feet again. A
    client is new if its numbers do not go on from the last ones, after 0.1 s of silence.

    Args:
        robot: robot to advance.
        endpoint: socket at which commands arrive.
        stop: function that is called at least every 0.1 s.
        say: function that is called with a line of text when a client comes or goes, of each kind
            once a second at most.
    """
    reports, heard, client = Reports(say), 0.0, None
    while not stop():
        arrived, now = endpoint.wait(_PATIENCE), time.monotonic()
        if arrived and _answer(robot, endpoint, now - heard > SILENCE):
            heard = now
            if endpoint.peer != client:
                client = endpoint.peer
                reports.add("client", f"client {client}")
        elif client is not None and now - heard > _GONE:
            reports.add("silence", f"no command from {client} for {_GONE:g} s: waiting")
            client = None
        reports.say()


def _answer(robot: TwinRobot, endpoint: Endpoint, silent: bool) -> bool:
    """Answer the newest queued command; False if no datagram of the client has arrived."""
    counters = endpoint.link.counters
    repeated = counters.repeated
    command = endpoint.receive()
    if command is not None:
        robot.take(command)
        if silent and endpoint.link.step != 1 and robot.idle and not robot.standing:
            robot.reset()
        endpoint.send(robot.tick())
    elif counters.repeated > repeated:
        endpoint.resend()
    return command is not None or counters.repeated > repeated
