"""Cost of the network protocol."""

from __future__ import annotations

import pytest

from benchmarks.system import twin_protocol


def test_the_cost_of_a_tick_is_a_part_of_its_time(capsys: pytest.CaptureFixture[str]) -> None:
    twin_protocol.main(twin_protocol.Config(ticks=20))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["tick in PD mode", "tick in raw mode"]
    assert all(0.01 < float(line.split()[-4]) < 50 for line in lines)
