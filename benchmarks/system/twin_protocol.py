"""Tests of the network protocol: packets, damaged datagrams, lockstep, cost of ticks, losses.

    python -m benchmarks.system.twin_protocol  # minutes on an idle core
    python -m benchmarks.system.twin_protocol --packets 1000 --strings 1000 --duration 1
    python -m benchmarks.system.twin_protocol --packets 0 --strings 0 --duration 0  # cost, losses

Random packets of each kind, of any bits, are unpacked and packed: bytes must be the same, each
field must hold the bytes at its offset, and one packet in a thousand is compared number by number
with Python's `struct`. Random strings of bytes, half of them as long as a datagram, must all be
counted. In the walk in lockstep, a controller receives only the states of the twin, over UDP on
loopback, and a second controller the sensor packets of a simulation in this process; targets and
states must be bit-equal.

The cost of a tick is the CPU time of the twin's thread, with both datagrams. Behind a relay that
drops and delays datagrams, a client in real time counts the answers that reach it in order.
"""

from __future__ import annotations

from dataclasses import dataclass

from aslip.base.command_line import command_line
from aslip.errors import one_line_errors


@dataclass(frozen=True)
class Config:
    """Settings of the benchmark."""

    packets: int = 1_000_000
    """Number of random packets of each kind."""
    strings: int = 250_000
    """Number of random byte strings for the link of each kind, a million in all."""
    duration: float = 60.0
    """Duration of the walk [s]."""
    speed: float = 1.0
    """Commanded speed of the walk [m/s]."""
    ticks: int = 6000
    """Number of ticks in lockstep whose CPU time is measured, in each mode."""
    lossy: float = 10.0
    """Duration behind a relay that loses and delays datagrams [s]."""
    loss: float = 0.2
    """Share of datagrams that the relay drops."""
    jitter: float = 0.01
    """Largest delay of a datagram in the relay [s]; delays are uniform from zero."""
    seed: int = 0
    """Seed of the random bytes and of the relay."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import heapq
import re
import select
import socket
import struct
import threading
import time
from dataclasses import replace
from types import TracebackType
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase

from aslip.base.tables import markdown
from aslip.control import Controller
from aslip.envs import BatchEnv
from aslip.library import GaitLibrary
from aslip.network.twin import RealTimeServer, TwinRobot, serve_lockstep
from aslip.network.wire import (
    LOOPBACK,
    PACKETS,
    PD_IN,
    STATE_OUT,
    Address,
    Endpoint,
    Link,
    Packet,
    command_to_pd_in,
    state_out_to_estimate,
)
from aslip.robot import CASSIE

_CHUNK = 20_000
_COMPARED = 1000
_HEADER = 2


def main(config: Config) -> None:
    """Run all tests and print their results."""
    rng = np.random.default_rng(config.seed)
    rows = []
    for packet in PACKETS:
        wrong, counts = wrong_packets(packet, config, rng), string_counts(packet, config, rng)
        rows.append([f"`{packet.name}`", *map(str, (config.packets, wrong, *counts))])
    header = ("packet", "packets", "wrong", "strings", "wrong size", "not finite", "late")
    print(markdown([*header, "accepted"], rows), flush=True)
    steps = round(config.duration / CASSIE.policy_period)
    targets, states, forward = walk(steps, config.speed)
    print(
        f"lockstep, {steps} policy steps: {targets} different targets, {states} different states,"
        f" {forward:.1f} m forward"
    )
    for raw in (False, True):
        mode = "raw" if raw else "PD"
        print(f"tick in {mode} mode: {1e3 * tick_cost(config.ticks, raw=raw):.3f} ms of CPU")
    print(lossy_network(config))


def wrong_packets(packet: Packet, config: Config, rng: np.random.Generator) -> int:
    """Number of random packets that unpacking and packing changes."""
    wrong, left = 0, config.packets
    while left > 0:
        raw = rng.integers(256, size=(min(_CHUNK, left), packet.size), dtype=np.uint8)
        for place in packet.places:
            if place.kind == "?":
                raw[:, place.offset] &= 1
        records = np.stack([packet.unpack(row.tobytes()) for row in raw])
        packed = np.frombuffer(packet.pack(records), np.uint8).reshape(raw.shape)
        good = (packed == raw).all(axis=1)
        for place in packet.places:
            value = np.ascontiguousarray(_field(records, place.path)).view(np.uint8)
            value = value.reshape(len(raw), -1)
            good &= (value == raw[:, place.offset : place.offset + value.shape[1]]).all(axis=1)
        for i in range(0, len(raw), _COMPARED):
            good[i] &= _as_struct_reads(packet, raw[i].tobytes(), records[i])
        wrong += int((~good).sum())
        left -= len(raw)
    return wrong


def string_counts(packet: Packet, config: Config, rng: np.random.Generator) -> tuple[int, ...]:
    """Number of random byte strings, and their counts by a robot's link.

    Raises:
        AssertionError: the counts do not add up.
    """
    link = Link(STATE_OUT, packet, refuse_not_finite=True)
    sizes = np.where(
        rng.random(config.strings) < 0.5,
        link.size,
        rng.integers(2 * link.size, size=config.strings),
    )
    for size in sizes:
        link.open(rng.bytes(size))
    c = link.counters
    counts = (c.wrong_size, c.not_finite, c.late, c.accepted)
    assert sum(counts) + c.repeated == len(sizes)
    return len(sizes), *counts


def walk(steps: int, speed: float) -> tuple[int, int, float]:
    """Numbers of policy steps with different targets and states, and the distance walked [m]."""
    controller = Controller("straight", GaitLibrary.load())
    # gains reach the twin in single precision
    gains = {name: getattr(CASSIE, name).astype(np.float32) for name in ("stiffness", "damping")}
    robot = replace(CASSIE, **{name: gain.astype(np.float64) for name, gain in gains.items()})
    twin, env = TwinRobot(), BatchEnv(1, num_threads=1, robot=robot)
    now, targets, states = env.reset(), 0, 0
    with robot_endpoint(twin) as server, client_endpoint(twin, server.local) as client:
        state = answer(twin, server, client, PD_IN.zeros())
        env.set_states(twin.states())
        wired = controller.start(state_out_to_estimate(state), speed, heading=0.0)
        local = controller.start(twin.packet(), speed, heading=0.0)
        for _ in range(steps):
            targets += not torch.equal(wired.motor_target, local.motor_target)
            for _ in range(CASSIE.substeps):
                command = command_to_pd_in(wired.motor_target[0].numpy())
                state = answer(twin, server, client, command)
            now = env.step(now.set("motor_target", local.motor_target))["next"]
            states += not np.array_equal(twin.states(), env.states())
            wired, _ = controller.step(wired, state_out_to_estimate(state))
            local, _ = controller.step(local, cast("TensorDictBase", now["sensors"]))
    return targets, states, float(now["truth", "pelvis_position"][0, 0])


def answer(twin: TwinRobot, server: Endpoint, client: Endpoint, command: np.ndarray) -> np.ndarray:
    """Answer of the twin to a command, with both sides in this thread."""
    ticks = twin.ticks
    client.send(command)
    serve_lockstep(twin, server, lambda: twin.ticks > ticks)
    client.wait()
    answer = client.receive()
    assert answer is not None
    return answer


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
    return busy / max(ticks, 1)


def lossy_network(config: Config) -> str:
    """Hold a twin in real time by a client behind a lossy relay; return the result as text."""
    twin, ended = TwinRobot(), threading.Event()
    hold = command_to_pd_in(CASSIE.standing[CASSIE.indices.motor_qpos])
    with (
        robot_endpoint(twin) as endpoint,
        LossyRelay(endpoint.local, config.loss, config.jitter, config.seed) as relay,
        client_endpoint(twin, relay.address) as client,
    ):
        server = RealTimeServer(twin, endpoint)
        thread = threading.Thread(target=server.run, args=(ended.is_set,))
        thread.start()
        end = time.monotonic() + config.lossy
        heard, longest = time.monotonic(), 0.0
        while (now := time.monotonic()) < end:
            client.send(hold)
            if client.receive() is not None:
                longest, heard = max(longest, now - heard), now
            time.sleep(CASSIE.packet_period)
        ended.set()
        thread.join()
    counts, ticks = client.link.counters, max(server.load.ticks, 1)
    return (
        f"loss of {config.loss:.0%}, delays up to {1e3 * config.jitter:g} ms, {ticks} ticks:"
        f" {counts.accepted / ticks:.0%} of the answers in order, {counts.late / ticks:.0%} late,"
        f" {counts.restarts} restarts, longest gap {1e3 * longest:.0f} ms,"
        f" {server.load.silences} silences of the client; {server.load}"
    )


class LossyRelay:
    """UDP relay on loopback that drops, delays and so reorders datagrams of both directions.

    Datagrams from the robot go to the client that has sent last.

    Args:
        robot: address of the robot.
        loss: share of datagrams that are dropped.
        jitter: largest delay [s]; delays are uniform from zero.
        seed: seed of drops and delays.
    """

    def __init__(
        self, robot: Address, loss: float = 0.2, jitter: float = 0.01, seed: int = 0
    ) -> None:
        self.dropped = 0
        """Number of datagrams dropped so far."""
        self._robot, self._client = robot, None
        self._loss, self._jitter, self._rng = loss, jitter, np.random.default_rng(seed)
        self._front, self._back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "fb")
        for side in (self._front, self._back):
            side.setblocking(False)
            side.bind((LOOPBACK, 0))
        self._queue: list[tuple[float, int, bool, bytes]] = []
        self._taken = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)

    @property
    def address(self) -> Address:
        """Address to which a client sends instead of the robot's."""
        return Address(*self._front.getsockname())

    def __enter__(self) -> LossyRelay:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._front.close()
        self._back.close()

    def _run(self) -> None:
        while not self._ended.is_set():
            due = self._queue[0][0] - time.monotonic() if self._queue else 0.05
            ready, _, _ = select.select([self._front, self._back], [], [], max(due, 0.0))
            for side in ready:
                self._take(side)
            while self._queue and self._queue[0][0] <= time.monotonic():
                _, _, to_robot, datagram = heapq.heappop(self._queue)
                if to_robot:
                    self._back.sendto(datagram, self._robot)
                elif self._client is not None:
                    self._front.sendto(datagram, self._client)

    def _take(self, side: socket.socket) -> None:
        """Drop or delay the datagrams that have arrived at a side."""
        while True:
            try:
                datagram, sender = side.recvfrom(2048)
            except BlockingIOError:
                return
            if side is self._front:
                self._client = sender
            lost, delay = self._rng.random(2)
            self._taken += 1
            if lost < self._loss:
                self.dropped += 1
                continue
            due = time.monotonic() + delay * self._jitter
            heapq.heappush(self._queue, (due, self._taken, side is self._front, datagram))


def robot_endpoint(twin: TwinRobot) -> Endpoint:
    """Socket of a twin on any free port."""
    link = Link(twin.sends, twin.receives, refuse_not_finite=True)
    return Endpoint(link, Address(LOOPBACK, 0))


def client_endpoint(twin: TwinRobot, robot: Address) -> Endpoint:
    """Socket of a client of a twin, on any free port."""
    link = Link(twin.receives, twin.sends, refuse_not_finite=False)
    return Endpoint(link, Address(LOOPBACK, 0), robot)


def _field(records: np.ndarray, path: str) -> np.ndarray:
    """Field of records by a path such as "left_leg.drives[3].position"."""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?\.?", path):
        records = records[name]
        if index:
            records = records[..., int(index)]
    return records


def _as_struct_reads(packet: Packet, payload: bytes, record: np.ndarray) -> bool:
    """Check that the numbers of a record are those that `struct` reads."""
    codes = {"<f4": "f", "<i4": "i", "<u4": "I", "<i2": "h", "<u2": "H", "u1": "B", "?": "?"}
    form = "<" + "".join(codes[place.kind] * place.count for place in packet.places)
    numbers = [np.ravel(_field(record, place.path)) for place in packet.places]
    # conversion of signalling NaN warns
    with np.errstate(invalid="ignore"):
        ours = np.concatenate(numbers, dtype=float)
        theirs = np.array(struct.unpack(form, payload), float)
    return np.array_equal(ours, theirs, equal_nan=True)


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
