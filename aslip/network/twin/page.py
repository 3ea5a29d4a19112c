"""Live page of the twin, in a process of its own: the loop at 2 kHz must not wait for browsers."""

from __future__ import annotations

import contextlib
import json
import signal
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection

import numpy as np

from aslip.base.processes import Spawned
from aslip.errors import ConfigurationError
from aslip.network.twin.robot import TwinRobot
from aslip.network.wire import STOP_CHANNEL
from aslip.robot import CASSIE

# shortest time between two pictures [s]
_PERIOD = CASSIE.policy_period
# longest time for the page to start [s]
_PATIENCE = 60.0


class TwinPage:
    """Page to watch, push and stop a twin.

    The page shows its last picture until the program that moves the twin calls `update` again.

    Args:
        robot: robot to show.
        host: name or address of this machine to listen on.
        port: port to listen on; 0 for any free one.

    Raises:
        ConfigurationError: the host is not this machine, the port is taken, or viser is not
            installed.
    """

    def __init__(self, robot: TwinRobot, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._robot = robot
        # spawned: a forked process would share the twin's socket
        context = Spawned()
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, host, port), daemon=True)
        self._process.start()
        other.close()
        if not self._pipe.poll(_PATIENCE):
            raise ConfigurationError(f"the live page did not start within {_PATIENCE:g} s")
        try:
            answer = json.loads(self._pipe.recv_bytes())
        except EOFError:
            raise ConfigurationError("the process of the live page ended at its start") from None
        if "error" in answer:
            raise ConfigurationError(answer["error"])
        self.url: str = answer["url"]
        """Address of the page on this machine."""
        self._stopped = False
        self._waiting = False
        self._next = 0.0

    def update(self, lines: Mapping[str, str]) -> None:
        """Apply clicks and show the robot, if the last picture is 30 ms old and has been drawn.

        Args:
            lines: lines to show below the time, name -> text.
        """
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + _PERIOD
        with contextlib.suppress(EOFError, OSError):
            if self._waiting:
                if not self._pipe.poll():
                    return
                self._apply(json.loads(self._pipe.recv_bytes()))
            qpos = self._robot.truth()["qpos"][0]
            time_line = f"{self._robot.ticks * CASSIE.physics_timestep:.2f} s since the start"
            shown = {"time": time_line, **lines}
            self._pipe.send_bytes(json.dumps([qpos.tolist(), shown]).encode())
            self._waiting = True

    def close(self) -> None:
        """Close the page."""
        self._pipe.close()
        self._process.join(_PATIENCE)

    def _apply(self, answer: Mapping[str, list[list[float]] | float | bool]) -> None:
        """Push and stop the robot as visitors of the page request."""
        pushes, duration, stopped = (answer[name] for name in ("pushes", "duration", "stopped"))
        assert isinstance(pushes, list)
        for force in pushes:
            self._robot.push(force, float(duration))  # pyright: ignore[reportArgumentType]
        # a change only: the operator may have another radio
        if stopped != self._stopped:
            self._stopped = bool(stopped)
            self._robot.radio[STOP_CHANNEL] = -1.0 if stopped else 1.0


def _serve(pipe: Connection, host: str, port: int) -> None:
    """Serve the page until the other end of the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        from aslip.show.live import RobotPage
        from aslip.show.live.pushes import PUSH_DURATION

        page = RobotPage(host, port)
    except ConfigurationError as error:
        pipe.send_bytes(json.dumps({"error": str(error)}).encode())
        return
    pipe.send_bytes(json.dumps({"url": page.url}).encode())
    with contextlib.suppress(EOFError, OSError):
        while True:
            qpos, lines = json.loads(pipe.recv_bytes())
            page.show(np.array(qpos), lines)
            clicks = {
                "pushes": [force.tolist() for force in page.forces()],
                "duration": PUSH_DURATION,
                "stopped": bool(page.stop.value),
            }
            pipe.send_bytes(json.dumps(clicks).encode())
    page.close()
