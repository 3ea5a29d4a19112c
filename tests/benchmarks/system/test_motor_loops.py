"""Motors come to rest with the robot's torque delay, and swing by themselves with a longer one."""

from __future__ import annotations

from pathlib import Path

import pytest

from aslip.robot import CASSIE
from benchmarks.system import motor_loops
from benchmarks.system.motor_loops import Config, left

FEET = [i for i, name in enumerate(CASSIE.motor_names) if name.endswith("foot")]


def test_the_loops_of_the_feet_swing_with_long_delays_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = Config(delays=(1.0, 3.0, 6.0), duration=1.5, picture=tmp_path / "loops.png")
    speeds = motor_loops.main(config)
    assert speeds.shape == (3, 50, len(CASSIE.motor_names))
    assert speeds[:, 0].max(axis=1).min() > 0.02  # the step moves all robots
    short, nominal, long = left(speeds)
    assert max(short.max(), nominal.max()) < 0.02
    assert long[FEET].min() > 1.0
    assert (tmp_path / "loops.png").stat().st_size > 10_000
    rows = [row for row in capsys.readouterr().out.splitlines() if row.startswith("| ")]
    assert len(rows) == 2 + 3
