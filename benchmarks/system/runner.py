"""Tests of runner and twin: lost datagrams, walks in real time, killed runners, cost of a tick.

    python -m benchmarks.system.runner --part loss       # 21 speeds of a minute, simulated time
    python -m benchmarks.system.runner --part real-time  # ten minutes, two processes
    python -m benchmarks.system.runner --part kill       # fifty runners killed while they walk
    python -m benchmarks.system.runner --part tick --duration 3
    python -m benchmarks.system.runner --part real-time --policy aslip.onnx --priority 20

Loss and jitter are simulated without sockets and clocks: supervisor, sequence numbers and twin are
those of real runs, each datagram of either direction is lost or delayed at random, and the robot
drops its command after 0.1 s of silence. A walk survives if its motors are not damped.

Real time and kills start `aslip.network.twin --real-time` and `aslip.network.runner`, and need idle
cores: nothing else may run beside them. The twin says when it damps after a runner was killed;
then the next runner starts.

The cost of a tick is the CPU time of the twin's thread in lockstep over UDP on loopback, with both
datagrams, while the robot is held.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    part: Literal["loss", "real-time", "kill", "tick"] = "loss"
    """Measurement to make."""
    policy: str = "straight"
    """Name of a shipped policy, or policy file."""
    speeds: tuple[float, ...] = tuple(round(0.1 * k, 1) for k in range(21))
    """Commanded speeds of the walks with losses [m/s]."""
    duration: float = 60.0
    """Duration of each walk with losses, and of the ticks in each mode [s]."""
    loss: float = 0.2
    """Share of lost datagrams in each direction."""
    jitter: float = 0.01
    """Largest delay of a datagram [s]; delays are uniform from zero."""
    minutes: float = 10.0
    """Duration of the walk in real time [min]."""
    speed: float = 1.0
    """Commanded speed of the walk in real time, and of killed runners [m/s]."""
    priority: int = 0
    """Real-time priority of the runners, see `python -m aslip.network.runner --help`."""
    kills: int = 50
    """Number of runners to kill."""
    seed: int = 0
    """Seed of losses, delays and times of kills."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import heapq
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from aslip.base.tables import markdown
from aslip.library import Schedule
from aslip.log import read
from aslip.network.runner.commands import Scheduled
from aslip.network.runner.load import Loaded, load
from aslip.network.runner.loop import LATE, Run
from aslip.network.runner.readings import StateReadings
from aslip.network.runner.supervisor import Stage, Supervisor
from aslip.network.twin import TwinRobot, serve_lockstep
from aslip.network.wire import (
    LOOPBACK,
    PD_IN,
    STATE_OUT,
    Address,
    Arrival,
    Endpoint,
    Link,
    command_to_pd_in,
)
from aslip.robot import CASSIE

# silence after which a robot drops its command, and period of repeated commands [ticks]
_TIME_OUT, _REPEAT = 200, 4
_TICK_NS = 500_000


def main(config: Config) -> None:
    """Measure a part and print its result."""
    parts = {"loss": lossy_walks, "real-time": real_time, "kill": kill_runners, "tick": tick_costs}
    print(parts[config.part](config))


class LossyPath:
    """One direction of a network, with losses and delays.

    Args:
        sender: link of the sender.
        receiver: link of the receiver.
        loss: share of lost datagrams.
        jitter: largest delay [ticks of the robot].
        rng: source of losses and delays.
    """

    def __init__(
        self, sender: Link, receiver: Link, loss: float, jitter: float, rng: np.random.Generator
    ) -> None:
        self._sender, self._receiver, self._rng = sender, receiver, rng
        self._loss, self._jitter = loss, jitter
        self._queue: list[tuple[float, int, bytes]] = []
        self._sent = 0

    def send(self, tick: int, record: np.ndarray) -> None:
        """Send a packet at a tick."""
        datagram = self._sender.datagram(record)
        self._sent += 1
        lost, delay = self._rng.random(2)
        if lost >= self._loss:
            heapq.heappush(self._queue, (tick + delay * self._jitter, self._sent, datagram))

    def arrivals(self, tick: int) -> list[Arrival]:
        """Packets that have arrived by a tick, accepted and in order."""
        accepted = []
        while self._queue and self._queue[0][0] <= tick:
            record = self._receiver.open(heapq.heappop(self._queue)[2])
            if record is not None:
                accepted.append(Arrival(self._receiver.step or 0, record))
        return accepted


def lossy_walks(config: Config) -> str:
    """Walk with losses at each speed; return a table."""
    loaded, rows, survived = load(config.policy), [], 0
    for k, speed in enumerate(config.speeds):
        walked, reason, counts = lossy_walk(loaded, speed, config, config.seed + k)
        survived += not reason
        rows.append([f"{speed:g}", f"{walked:.2f}", *map(str, counts), reason or "survived"])
        print(f"{speed:g} m/s: {rows[-1][-1]} after {walked:.2f} s", flush=True)
    counted = [f"{kind} {what}" for kind in ("states", "commands") for what in ("lost", "late")]
    table = markdown(["m/s", "walked s", *counted, "end"], rows)
    said = f"{survived} of {len(rows)} walks survived"
    return f"{table}\n\n{said}: {config.loss:.0%} lost, 0 to {config.jitter:g} s late"


def lossy_walk(
    loaded: Loaded, speed: float, config: Config, seed: int
) -> tuple[float, str, list[int]]:
    """Walk with losses at a speed [m/s].

    Returns:
        Time walked [s]; reason of damping, empty for none; and numbers of lost and late datagrams,
        states first.
    """
    rng, jitter = np.random.default_rng(seed), config.jitter / CASSIE.physics_timestep
    client = Link(PD_IN, STATE_OUT, refuse_not_finite=False)
    robot = Link(STATE_OUT, PD_IN, refuse_not_finite=True)
    states = LossyPath(robot, client, config.loss, jitter, rng)
    commands = LossyPath(client, robot, config.loss, jitter, rng)
    supervisor = Supervisor(loaded.controller)
    source, twin = Scheduled(Schedule.parse(str(speed))), TwinRobot()
    run = Run(supervisor, StateReadings(), source, say=lambda _: None)
    held, heard = PD_IN.zeros(), 0
    for tick in range(round(config.duration / CASSIE.physics_timestep)):
        run.take(tick * _TICK_NS, states.arrivals(tick))
        if tick % CASSIE.substeps == 0:
            run.tick(tick * _TICK_NS)
            if supervisor.stage is Stage.DAMPING:
                break
        if tick % _REPEAT == 0:
            commands.send(tick, run.readings.answer(run.command))
        if arrived := commands.arrivals(tick):
            held, heard = arrived[-1].record, tick
        elif tick - heard > _TIME_OUT:
            held = PD_IN.zeros()
        states.send(tick, twin.tick(held))
    damped = supervisor.stage is Stage.DAMPING
    counts = [getattr(link.counters, kind) for link in (client, robot) for kind in ("lost", "late")]
    return run.walked, supervisor.reason if damped else "", counts


class Program:
    """Program in a process of its own, whose lines are read with their times.

    Args:
        words: module and options.
    """

    def __init__(self, *words: str) -> None:
        command, errors = [sys.executable, "-m", *words], subprocess.STDOUT
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
        self.said: list[str] = []
        """Lines so far."""
        self._lines: queue.Queue[tuple[float, str]] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def line(self, words: str, timeout: float = 60.0) -> tuple[float, str]:
        """Wait for a line with these words; return its time and the line.

        Raises:
            RuntimeError: no such line arrives in time.
        """
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0:
            try:
                at, line = self._lines.get(timeout=left)
            except queue.Empty:
                break
            self.said.append(line)
            if words in line:
                return at, line
        raise RuntimeError(f"no line with {words!r} within {timeout:g} s; it said {self.said}")

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put((time.monotonic(), line.rstrip()))


@contextmanager
def real_time_twin() -> Iterator[tuple[Program, str]]:
    """Start a twin in real time; yield it and its port."""
    program = Program("aslip.network.twin", "--real-time", "--port", "0")
    try:
        _, line = program.line("waiting for commands")
        yield program, line.split(":")[1].split(";")[0]
    finally:
        program.process.terminate()
        program.process.wait()


def runner(config: Config, port: str, *options: str) -> Program:
    """Start a runner that walks the twin at a port."""
    words = ("--policy", config.policy, "--port", port, "--local-port", "0")
    words += ("--command", str(config.speed), "--priority", str(config.priority))
    return Program("aslip.network.runner", *words, *options)


def real_time(config: Config) -> str:
    """Walk for a long time in two processes; return the last lines and the lateness in the log."""
    with tempfile.TemporaryDirectory() as folder, real_time_twin() as (_, port):
        log = Path(folder) / "run.mcap"
        length = f"{60 * config.minutes:g}"
        program = runner(config, port, "--duration", length, "--log", str(log), "--patience", "60")
        program.line("datagrams:", timeout=60 * config.minutes + 120)
        status = program.process.wait()
        tick = read(log)["/tick"]
    late = 100 * float(np.mean(tick["lateness"] > LATE))
    ends = [line for line in program.said if "damping: " in line]
    lines = [f"status {status}, 0 without a fall", *ends, *program.said[-5:]]
    return "\n".join([*lines, f"log: {late:.3f} % of {len(tick)} policy steps late"])


def kill_runners(config: Config) -> str:
    """Kill runners; return the delays from kills to damping.

    Each runner but the first walks a twin that was damped after a kill.
    """
    rng, delays = np.random.default_rng(config.seed), []
    with real_time_twin() as (robot, port):
        for _ in range(config.kills):
            program = runner(config, port, "--patience", "60")
            program.line("walk: packets arrive")
            time.sleep(rng.uniform(0.2, 3.0))
            program.process.kill()
            killed = time.monotonic()
            delays.append(1e3 * (robot.line("no command", timeout=5.0)[0] - killed))
        last = runner(config, port, "--duration", "3", "--patience", "60").process
        status = last.wait()
    middle, largest = np.percentile(delays, [50, 100])
    return (
        f"{len(delays)} runners killed, the next one walked each time; damping after"
        f" {middle:.0f} ms (median), {largest:.0f} ms (largest); status of the last one: {status}"
    )


def tick_costs(config: Config) -> str:
    """Mean CPU time of the twin's side of a tick, in PD and in raw mode."""
    ticks, lines = round(config.duration / CASSIE.physics_timestep), []
    for mode in ("PD", "raw"):
        twin = TwinRobot(raw=mode == "raw")
        command = twin.receives.zeros()
        if mode == "PD":
            command = command_to_pd_in(CASSIE.standing[CASSIE.indices.motor_qpos])
        lines.append(f"tick in {mode} mode: {1e3 * _tick_cost(twin, command, ticks):.3f} ms of CPU")
    return "\n".join(lines)


def _tick_cost(twin: TwinRobot, command: np.ndarray, ticks: int) -> float:
    """Mean CPU time of the twin's side of a tick, after a first one [s]."""
    server = Endpoint(Link(twin.sends, twin.receives, refuse_not_finite=True), Address(LOOPBACK, 0))
    link, seconds = Link(twin.receives, twin.sends, refuse_not_finite=False), []
    with server, Endpoint(link, Address(LOOPBACK, 0), server.local) as client:
        for tick in range(ticks + 1):
            client.send(command)
            start = time.thread_time()
            serve_lockstep(twin, server, lambda tick=tick: twin.ticks > tick)
            seconds.append(time.thread_time() - start)
            client.wait()
            client.receive()
    return float(np.mean(seconds[1:]))


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
