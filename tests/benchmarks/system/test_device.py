"""Throughput on a device, on MuJoCo Warp's CPU device."""

import pytest

from benchmarks.system import device


def test_shares_of_the_bound_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    config = device.Config("cpu", (2,), steps=1, policy="straight", training=False)
    device.main(config)
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines() if "|" in line]
    rates = {row[2].strip(): float(row[4]) for row in rows[2:]}
    assert len(rates) == 5 and min(rates.values()) > 0
