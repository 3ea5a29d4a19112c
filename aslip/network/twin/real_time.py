"""Real time: the twin advances at 2 kHz and holds the last command, as the robot does."""

from __future__ import annotations

import contextlib
import gc
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from aslip.base.command_line import Reports
from aslip.errors import NetworkError
from aslip.network.twin.robot import TwinRobot
from aslip.network.wire import Address, Endpoint
from aslip.network.wire.endpoint import SILENCE
from aslip.robot import CASSIE

PATIENCE: Final = {"pd_in_t": 0.1, "cassie_user_in_t": 0.01}
"""Longest silence of a client [s] after which the robot drops its command, by kind of command."""

MOST_BEHIND: Final = {"pd_in_t": 0.1, "cassie_user_in_t": 0.005}
"""Longest delay [s] that the loop catches up, by kind of command; it leaves out the ticks of a
longer one. In raw mode the loop must not hold torques through many ticks at once, because the
client cannot answer meanwhile."""


@dataclass
class Load:
    """Timing of a loop in real time."""

    ticks: int = 0
    """Ticks since the start."""
    late: int = 0
    """Ticks that began more than a period after they were due."""
    skipped: int = 0
    """Ticks left out because the loop was further behind than `MOST_BEHIND`."""
    latest: float = 0.0
    """Largest delay of a tick [s]."""
    busy: float = 0.0
    """CPU time [s]."""
    elapsed: float = 0.0
    """Time since the start [s]."""
    silences: int = 0
    """Number of times that a command was dropped because the client was silent."""

    def __str__(self) -> str:
        each, share = self.busy / max(self.ticks, 1), self.busy / max(self.elapsed, 1e-9)
        return (
            f"{self.ticks} ticks, {1e3 * each:.3f} ms of CPU each, load {share:.0%},"
            f" {self.late} late by up to {1e3 * self.latest:.1f} ms, {self.skipped} left out,"
            f" {self.silences} silences"
        )


class RealTimeServer:
    """Server of a twin at 2 kHz, for one client at a time.

    The robot stands still until a command has torques or gains. Every tick is answered, whether a
    command has come or not. After a silence of 0.1 s, in raw mode 10 ms, the command is replaced;
    the robot itself replaces it by zeros. A client that begins with zeros after another one has
    gone finds the robot on its feet again.

    Ticks are due at whole multiples of the period since the start. A loop that is behind ticks
    without pauses until it has caught up.

    Args:
        robot: robot to advance; it is set on its feet.
        endpoint: socket at which commands arrive.
        say: function that is called with a line of text when a client comes or goes, of each kind
            once a second at most; it must not wait.
        clock: monotonic clock [s].
        sleep: function that waits for a time [s].
    """

    def __init__(
        self,
        robot: TwinRobot,
        endpoint: Endpoint,
        *,
        say: Callable[[str], object] = lambda text: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self.robot, self.load = robot, Load()
        self._endpoint = endpoint
        self._reports = Reports(say, clock)
        self._clock, self._sleep = clock, sleep
        self._period = CASSIE.physics_timestep
        self._patience = round(PATIENCE[robot.receives.name] / self._period)
        self._most_behind = MOST_BEHIND[robot.receives.name]
        self._gone = round(SILENCE / self._period)
        # ticks since the last command, and its time
        self._silent, self._heard = 0, clock()
        self._dropped = self._said = False
        self._client: Address | None = None
        # compiled functions load at their first call
        for _ in range(CASSIE.packet_substeps + 1):
            robot.tick()
        robot.reset()

    def run(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Advance in real time until `stop`, which is called at every tick, returns True."""
        gc.freeze()
        load, start, busy = self.load, self._clock(), time.thread_time()
        due = start
        while not stop():
            now = self._clock()
            if now < due:
                self._sleep(due - now)
                now = self._clock()
            elif now - due > self._most_behind:
                missed = int((now - due) / self._period)
                load.skipped += missed
                due += missed * self._period
            load.late += now - due > self._period
            load.latest = max(load.latest, now - due)
            self.tick()
            due += self._period
            load.busy, load.elapsed = time.thread_time() - busy, now - start

    def tick(self) -> None:
        """Take the newest command, advance by a tick, and answer."""
        robot, endpoint = self.robot, self._endpoint
        command = endpoint.receive()
        if command is None:
            self._wait()
        else:
            robot.take(command)
            self._greet()
        held = robot.standing and robot.idle
        record = robot.answer() if held else robot.tick()
        self.load.ticks += 1
        if endpoint.peer is not None:
            with contextlib.suppress(NetworkError):  # no route for now
                endpoint.send(record)
        self._reports.say()

    def _wait(self) -> None:
        """Count a tick without a command; drop the last one after too many."""
        self._silent += 1
        # a loop that catches up ticks faster than a client can answer
        silent = min(self._silent, round((self._clock() - self._heard) / self._period))
        if silent >= self._patience and not self._dropped:
            self._dropped = not self.robot.idle
            self.load.silences += self._dropped
            if self._dropped:
                self.robot.damp()
        if silent >= self._gone and self._dropped and not self._said:
            self._said = True
            silence = f"{1e3 * SILENCE:.0f} ms: damping"
            self._reports.add("silence", f"no command from {self._client} for {silence}")

    def _greet(self) -> None:
        """Set the robot on its feet for a client that begins after another one has gone."""
        peer, silent = self._endpoint.peer, self._silent
        self._silent, self._heard = 0, self._clock()
        self._dropped = self._said = False
        if peer != self._client:
            self._reports.add("client", f"client {peer}")
        if (peer != self._client or silent >= self._gone) and self.robot.idle:
            self.robot.reset()
        self._client = peer
