"""The benchmark of the network protocol reports what it finds."""

from __future__ import annotations

import time

import numpy as np
import pytest

from aslip.network.wire import (
    PD_IN,
    Counters,
    Packet,
)
from benchmarks.system import twin_protocol
from tests.network.twin.sockets import robot_socket, socket_to

SMALL = twin_protocol.Config(packets=30, strings=200, duration=0.09, ticks=20, lossy=0.2)


def test_the_report_has_a_row_per_packet_and_no_differences(
    capsys: pytest.CaptureFixture[str],
) -> None:
    twin_protocol.main(SMALL)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("|")[2:4] for line in lines[2:6]] == [[" 30 ", " 0 "]] * 4
    assert lines[6].startswith("lockstep, 3 policy steps: 0 different targets, 0 different states")
    assert [line.split(":")[0] for line in lines[7:9]] == ["tick in PD mode", "tick in raw mode"]
    assert lines[9].startswith("loss of 20%, delays up to 10 ms, ")
    assert " 0 restarts" in lines[9]


def _arrived(loss: float, jitter: float, number: int) -> tuple[Counters, int]:
    """Counts of commands that a robot receives through a relay, and number of dropped ones."""
    with (
        robot_socket() as robot,
        twin_protocol.LossyRelay(robot.local, loss, jitter) as relay,
        socket_to(relay.address) as client,
    ):
        command = PD_IN.zeros()
        for i in range(number):
            command["telemetry"][0] = i
            client.send(command)
            time.sleep(5e-4)
        counts, end = robot.link.counters, time.monotonic() + 10
        while time.monotonic() < end and counts.accepted + counts.late + relay.dropped < number:
            robot.wait(0.01)
            robot.receive_all()
        return counts, relay.dropped


def test_a_relay_without_losses_passes_all_in_order() -> None:
    counts, dropped = _arrived(0.0, 0.0, 100)
    assert (counts.accepted, counts.late, dropped) == (100, 0, 0)


def test_a_relay_drops_and_reorders() -> None:
    counts, dropped = _arrived(0.2, 0.01, 200)
    rng = np.random.default_rng(0)
    assert dropped == sum(rng.random(2)[0] < 0.2 for _ in range(200))
    assert counts.late > 5
    assert counts.restarts == 0


def test_wrong_packets_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(packet: Packet, records: np.ndarray) -> bytes:
        return b"\xff" + records.tobytes()[1:]

    monkeypatch.setattr(Packet, "pack", damaged)
    assert twin_protocol.wrong_packets(PD_IN, SMALL, np.random.default_rng(0)) == 1
