"""The swing's demand on the motors follows from speed, and the limit from the drive."""

from pathlib import Path

import numpy as np
import pytest

from aslip.robot import CASSIE
from benchmarks.gaits import motor_demand
from benchmarks.gaits.motor_demand import Config, motor_limit


def test_limit_is_full_up_to_half_the_no_load_speed_and_zero_beyond_it() -> None:
    no_load = CASSIE.no_load_speed / CASSIE.gear
    full = CASSIE.torque_limit * CASSIE.gear
    speeds = np.multiply.outer([0.0, 0.5, 0.75, 1.0, 1.5], no_load)
    expected = np.multiply.outer([1.0, 1.0, 0.5, 0.0, 0.0], full)
    np.testing.assert_allclose(motor_limit(speeds), expected, atol=1e-9)
    np.testing.assert_allclose(motor_limit(-speeds), expected, atol=1e-9)


def test_the_published_swing_is_faster_than_the_hip_at_2_metres_per_second(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = Config(speeds=(0.0, 2.0), picture=tmp_path / "demand.png")
    found = motor_demand.main(config)
    hip = CASSIE.motor_names.index("left_hip_pitch")
    limit = (CASSIE.no_load_speed / CASSIE.gear)[hip]
    slow, fast = (np.abs(velocity[:, hip]).max() for velocity, _ in found["gaits"])
    assert slow < 0.5 * limit and fast > 1.5 * limit
    assert np.abs(found["directions"][1][0][:, hip]).max() < fast
    torque = np.abs(found["gaits"][1][1])
    assert 100 < torque[:, hip].max() < 150
    # the other leg stands: its torques are small beside those of the swing
    assert torque[:, :5].max() > 3 * torque[:, 5:].max()
    assert (tmp_path / "demand.png").stat().st_size > 10_000
    rows = [row for row in capsys.readouterr().out.splitlines() if row.startswith("| ")]
    assert len(rows) == 2 + 4
