"""The benchmark of the network protocol reports what it finds."""

from __future__ import annotations

import numpy as np
import pytest

from aslip.network.wire import PD_IN, Packet
from benchmarks.system import twin_protocol

SMALL = twin_protocol.Config(packets=30, strings=200, duration=0.09, ticks=20)


def test_the_report_has_a_row_per_packet_and_no_differences(
    capsys: pytest.CaptureFixture[str],
) -> None:
    twin_protocol.main(SMALL)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("|")[2:4] for line in lines[2:6]] == [[" 30 ", " 0 "]] * 4
    assert lines[6].startswith("lockstep, 3 policy steps: 0 different targets, 0 different states")
    assert [line.split(":")[0] for line in lines[7:9]] == ["tick in PD mode", "tick in raw mode"]


def test_wrong_packets_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(packet: Packet, records: np.ndarray) -> bytes:
        return b"\xff" + records.tobytes()[1:]

    monkeypatch.setattr(Packet, "pack", damaged)
    assert twin_protocol.wrong_packets(PD_IN, SMALL, np.random.default_rng(0)) == 1
