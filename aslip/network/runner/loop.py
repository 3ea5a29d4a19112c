"""Loop of the runner: real time with absolute deadlines, or lockstep with a simulated robot."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from aslip.base.command_line import say
from aslip.errors import ConfigurationError, NetworkError
from aslip.network.runner.commands import Source
from aslip.network.runner.readings import Readings
from aslip.network.runner.supervisor import Reading, Request, Stage, Supervisor
from aslip.network.wire import Arrival, Endpoint, MotorCommand
from aslip.robot import CASSIE

if TYPE_CHECKING:
    from aslip.network.runner.record import RunLog

LATE: Final = 2e-3
"""Lateness above which a policy step counts as late [s]."""

# period of zeroed commands until the first answer [s]
_KNOCK = 1e-3
# time between repetitions of a command in PD mode [s]: robots stop after 0.1 s of silence
_REPEAT = 2e-3
# damping commands that a run sends when it ends at once
_LAST_WORDS = 5
_NS = 10**9


@dataclass
class Tally:
    """Timing of the policy steps."""

    lateness: list[float] = field(default_factory=list)
    """Time from each deadline to the beginning of its policy step [s]."""
    reply: list[float] = field(default_factory=list)
    """Time from the beginning of each policy step until its command was sent [s]."""
    work: list[float] = field(default_factory=list)
    """Time from the beginning of each policy step until it was logged [s]."""
    skipped: int = 0
    """Deadlines that passed during an earlier policy step."""

    def late(self) -> int:
        """Number of policy steps that began more than 2 ms late, or not at all."""
        return self.skipped + sum(value > LATE for value in self.lateness)

    def lines(self) -> list[str]:
        """Summary as lines of text."""
        if not self.work:
            return ["no policy steps"]
        steps = len(self.work)
        part = 100 * self.late() / (steps + self.skipped)
        return [
            f"{steps} policy steps, {self.skipped} skipped, {self.late()} late by more than"
            f" {1e3 * LATE:g} ms ({part:.2f} %)",
            *(
                f"{name:9} p50 {p50:6.2f}, p99 {p99:6.2f}, largest {largest:6.2f} ms"
                for name, values in (
                    ("lateness", self.lateness),
                    ("reply", self.reply),
                    ("work", self.work),
                )
                for p50, p99, largest in [1e3 * np.percentile(values, [50, 99, 100])]
            ),
        ]


class Run:
    """Supervisor with its inputs and its log.

    Args:
        supervisor: supervisor of the robot.
        readings: interpretation of the robot's packets.
        source: source of the operator's requests.
        log: log to write; None for no log.
        say: function that prints a line without waiting.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        readings: Readings,
        source: Source,
        *,
        log: RunLog | None = None,
        say: Callable[[str], object] = say,
    ) -> None:
        self.supervisor, self.readings, self.source = supervisor, readings, source
        self.tally = Tally()
        """Timing."""
        self.interrupted = ""
        """Reason from outside to damp the motors, such as a signal; empty for none."""
        self.walked = 0.0
        """Time in which the policy has acted [s]."""
        self._log, self._say = log, say
        self._walk_began = float("inf")
        self._newest: tuple[int, Arrival] | None = None
        self._request, self._reading = Request(), None
        self.command = MotorCommand(*np.zeros((5, len(CASSIE.motor_names))))
        """Command of the last policy step."""
        self._next_line = 1.0

    def take(self, time_ns: int, arrivals: list[Arrival]) -> None:
        """Take the packets that were read at a time [ns], oldest first."""
        for arrival in arrivals[-1:] if self.readings.newest_only else arrivals:
            self.readings.take(time_ns / _NS, arrival.step, arrival.record)
            if self.readings.newest_only:
                # one packet per policy step is logged
                self._newest = time_ns, arrival
            elif self._log is not None:
                self._log.packet(time_ns, *arrival)

    def tick(self, time_ns: int) -> MotorCommand:
        """Advance by a policy step that begins at a time [ns]; return its motor command."""
        now, before, request = time_ns / _NS, self.supervisor.stage, self._request
        try:
            request = self.source.request(now, now - self._walk_began)
        except Exception as error:  # whatever fails in a source, the robot must be damped
            no_commands = f"no commands: {type(error).__name__}: {error}"
            self.interrupted = self.interrupted or no_commands
        if self.interrupted:
            request = request._replace(damp=self.interrupted)
        self._request, self._reading = request, self.readings.newest()
        self.command = self.supervisor.tick(now, self._reading, request)
        if self.supervisor.stage is not before:
            self._enter(time_ns)
        if self.supervisor.stage in (Stage.WALK, Stage.STOP):
            self.walked += CASSIE.policy_period
        return self.command

    def finish_tick(self, time_ns: int, lateness: float, reply: float) -> None:
        """Log and print a policy step after its command was sent.

        Args:
            time_ns: beginning of the policy step [ns].
            lateness: time from its deadline to its beginning [s].
            reply: time from its beginning until the command was sent [s].
        """
        if self._log is not None:
            if self._newest is not None:
                self._log.packet(self._newest[0], *self._newest[1])
                self._newest = None
            self._log.tick(
                time_ns,
                self._request,
                self.supervisor.stage,
                self.command,
                self._reading,
                (lateness, reply),
            )
        if time_ns / _NS >= self._next_line:
            self._next_line += 1.0
            self._say(self._line(time_ns / _NS))

    def close(self) -> None:
        """Finish the log."""
        if self._log is not None:
            self._log.finish({"reason": self.supervisor.reason})
            self._log = None

    def is_over(self, time_ns: int) -> bool:
        """Whether the run has ended at a time [ns]."""
        return self.supervisor.is_over(time_ns / _NS)

    def _enter(self, time_ns: int) -> None:
        """Print and log the beginning of a stage."""
        stage, now = self.supervisor.stage, time_ns / _NS
        text = f"{stage.value}: {self.supervisor.reason}"
        if stage is not Stage.STOP:
            self._walk_began = now if stage is Stage.WALK else float("inf")
        self._say(f"{now:7.2f} s  {text}")
        if self._log is not None:
            self._log.note(time_ns, text)

    def _line(self, now: float) -> str:
        """State of the robot as a line of text."""
        line = f"{now:7.2f} s  {self.supervisor.stage.value}"
        reading: Reading | None = self.supervisor.reading
        if reading is None or self.supervisor.stage is Stage.CONNECT:
            return f"{line}: {self.supervisor.reason}"
        speed = float(np.hypot(*reading.estimate["velocity"][:2]))
        return f"{line}, commanded {self._request.forward:.2f} m/s, moves at {speed:.2f} m/s"


def take_priority(priority: int) -> None:
    """Give this process a real-time priority, and spare it collections of what is loaded now.

    Other processes then interrupt it only with a higher priority.

    Args:
        priority: priority of SCHED_FIFO, 1 to 99; 0 leaves the process as it is.

    Raises:
        ConfigurationError: the system does not permit it, or the number is out of range.
    """
    gc.collect()
    gc.freeze()
    if priority == 0:
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, OSError) as error:  # no such call, out of range, or not permitted
        raise ConfigurationError(
            f"the system does not give this process the real-time priority {priority}: {error};"
            " Linux takes 1 to 99 from users whose `ulimit -r` allows it, 0 needs no permission"
        ) from error


def run_real_time(run: Run, endpoint: Endpoint, *, patience: float = 10.0) -> None:
    """Run against a robot that does not wait, until the motors have been damped.

    In PD mode the command is repeated every 2 ms, because robots stop after 0.1 s of silence. In
    raw mode each arrival of packets is answered with torques.

    Args:
        run: supervisor with its inputs.
        endpoint: socket to the robot.
        patience: longest wait for the first packet with a possible estimate [s].

    Raises:
        NetworkError: the robot does not answer, or not with such estimates.
    """
    origin = time.monotonic_ns()

    def clock() -> int:
        return time.monotonic_ns() - origin

    def drain() -> None:
        arrivals = endpoint.receive_all()
        # stamped after they were read, before the policy step that uses them
        run.take(clock(), arrivals)

    _connect(run, endpoint, patience, clock)
    try:
        _keep_time(run, endpoint, patience, clock, drain)
    except BaseException:
        # a second signal, or a fault of the loop itself
        for _ in range(_LAST_WORDS):
            _send(run, endpoint, run.supervisor.damping())
        raise


def _keep_time(
    run: Run,
    endpoint: Endpoint,
    patience: float,
    clock: Callable[[], int],
    drain: Callable[[], None],
) -> None:
    """Take policy steps at their deadlines until the run is over."""
    deadline, period = clock(), round(CASSIE.policy_period * _NS)
    while not run.is_over(clock()):
        drain()
        now = clock()
        command = run.tick(now)
        if run.readings.newest_only:
            _send(run, endpoint, command)
        reply, lateness = clock() - now, now - deadline
        run.finish_tick(now, lateness / _NS, reply / _NS)
        _check_connected(run, endpoint, patience, now)
        run.tally.lateness.append(lateness / _NS)
        run.tally.reply.append(reply / _NS)
        run.tally.work.append((clock() - now) / _NS)
        missed = max((clock() - deadline) // period, 0)
        run.tally.skipped += missed
        deadline += (missed + 1) * period
        _wait(run, endpoint, deadline, clock, drain)


def run_lockstep(run: Run, endpoint: Endpoint, *, patience: float = 10.0) -> None:
    """Run against a simulated robot that waits for a command at each tick.

    Time is counted in ticks of the robot, so that a run does not depend on the machine's speed.

    Args:
        run: supervisor with its inputs.
        endpoint: socket to the robot.
        patience: longest wait for an answer [s], and for the first possible estimate [s of the
            robot].

    Raises:
        NetworkError: the robot does not answer, or not with such estimates.
    """
    link = endpoint.link
    tick_ns, ticks = round(CASSIE.physics_timestep * _NS), 0
    command = run.command

    def advance() -> None:
        nonlocal ticks
        record = endpoint.request(run.readings.answer(command), timeout=patience)
        ticks += 1
        run.take(ticks * tick_ns, [Arrival(link.step or 0, record)])

    advance()
    while not run.is_over(ticks * tick_ns):
        now, began = ticks * tick_ns, time.monotonic()
        command = run.tick(now)
        reply = time.monotonic() - began
        run.finish_tick(now, 0.0, reply)
        _check_connected(run, endpoint, patience, now)
        run.tally.lateness.append(0.0)
        run.tally.reply.append(reply)
        run.tally.work.append(time.monotonic() - began)
        for _ in range(CASSIE.substeps):
            advance()


def _connect(run: Run, endpoint: Endpoint, patience: float, clock: Callable[[], int]) -> None:
    """Send commands of zeros until the robot answers."""
    end, nothing = clock() + round(patience * _NS), run.readings.answer(run.command)
    while clock() < end and not run.interrupted:
        endpoint.send(nothing)
        if endpoint.wait(_KNOCK) and (arrivals := endpoint.receive_all()):
            run.take(clock(), arrivals)
            return
    if run.interrupted:
        raise KeyboardInterrupt
    raise NetworkError(
        f"no answer from {endpoint.peer} within {patience:g} s; check that the robot, or python -m"
        f" aslip.network.twin, runs at this address and port, that it sends to {endpoint.local} in"
        " this mode, and that no other runner holds it"
    )


def _check_connected(run: Run, endpoint: Endpoint, patience: float, time_ns: int) -> None:
    """Give up on a robot whose estimates have not been possible for so long [s]."""
    if run.supervisor.stage is Stage.CONNECT and time_ns > patience * _NS:
        raise NetworkError(
            f"{endpoint.peer} answers, but no walk could begin within {patience:g} s:"
            f" {run.supervisor.reason}; restart the robot's estimator, or python -m"
            " aslip.network.twin"
        )


def _wait(
    run: Run,
    endpoint: Endpoint,
    deadline: int,
    clock: Callable[[], int],
    drain: Callable[[], None],
) -> None:
    """Wait for a deadline; meanwhile repeat the command, or answer each packet with torques."""
    while (left := (deadline - clock()) / _NS) > 0:
        if run.readings.newest_only:
            time.sleep(min(left, _REPEAT))
            drain()
            if left > _REPEAT:
                _send(run, endpoint, run.command)
        elif endpoint.wait(left):
            drain()
            _send(run, endpoint, run.command)


def _send(run: Run, endpoint: Endpoint, command: MotorCommand) -> None:
    """Send a command; a robot that cannot be reached stops by itself after a silence."""
    with contextlib.suppress(NetworkError):
        endpoint.send(run.readings.answer(command))
