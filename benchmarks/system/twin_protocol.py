"""Tests of the network protocol: packets, damaged datagrams, lockstep, cost of ticks.

    python -m benchmarks.system.twin_protocol  # minutes on an idle core
    python -m benchmarks.system.twin_protocol --packets 1000 --strings 1000 --duration 1
    python -m benchmarks.system.twin_protocol --packets 0 --strings 0 --duration 0  # cost of ticks

Random packets of each kind, of any bits, are unpacked and packed: bytes must be the same, each
field must hold the bytes at its offset, and one packet in a thousand is compared number by number
with Python's `struct`. Random strings of bytes, half of them as long as a datagram, must all be
counted. In the walk in lockstep, a controller receives only the states of the twin, over UDP on
loopback, and a second controller the sensor packets of a simulation in this process; targets and
states must be bit-equal.

The cost of a tick is the CPU time of the twin's thread, with both datagrams. Lost and late
datagrams are in `benchmarks.system.runner`.
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
    seed: int = 0
    """Seed of the random bytes."""


if __name__ == "__main__":
    # parsed before the slow imports below
    CONFIG = command_line(Config)

import re
import struct
import time
from dataclasses import replace
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase

from aslip.base.tables import markdown
from aslip.control import Controller
from aslip.envs import BatchEnv
from aslip.library import GaitLibrary
from aslip.network.twin import TwinRobot, serve_lockstep
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
