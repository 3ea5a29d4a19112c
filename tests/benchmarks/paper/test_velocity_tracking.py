"""Velocity tracking of policies and logs."""

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.robot import CASSIE
from aslip.walking import Walks
from benchmarks.paper import velocity_tracking
from benchmarks.paper.velocity_tracking import Config

Written = Callable[[str], dict[str, Any]]


def test_a_policy_tracks_its_command(tmp_path: Path, written: Written) -> None:
    config = Config(
        policy=("directions",), out=tmp_path, speeds=(0.5,), hold=0.5, settle=1.0, walk=3.0
    )
    numbers = velocity_tracking.main(config)
    commands = [row["command"] for row in numbers["schedule"]]
    assert commands == pytest.approx(velocity_tracking.SCHEDULE)
    assert abs(numbers["map"][0]["mean"] - 0.5) < 0.2
    assert [numbers["map"][0][key] for key in ("survived", "on_feet", "tracked")] == [[True]] * 3
    assert len(numbers["steps"]) == len(velocity_tracking.STEPS)
    assert numbers["spike"]["model"] > 0
    written("velocity_tracking")


def test_mean_velocity_of_uniform_motion() -> None:
    time = CASSIE.policy_period * np.arange(1, 268)
    position = np.stack([1.5 * time, 2.0 - 0.1 * time], axis=1)
    np.testing.assert_allclose(velocity_tracking.mean_velocity(position), [1.5, -0.1], rtol=1e-12)


def test_a_fallen_robot_has_no_spikes() -> None:
    """Which would otherwise pass for a smooth walk."""
    arrays: dict[str, Any] = {field.name: np.zeros((20, 1, 3)) for field in fields(Walks)}
    arrays |= {"command": np.ones((20, 1)), "alive": np.arange(20)[:, None] < 12}
    spikes = velocity_tracking.spike_numbers([Walks(**arrays)])
    assert np.isnan([spikes["robot"], spikes["model"]]).all()
