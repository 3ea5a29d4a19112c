"""Stops, standing and starts."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.walking import Substeps
from benchmarks.directions import stops
from tests.helpers import limp
from tests.library.standing import standing_library


def test_stops_standing_and_starts_are_measured(
    gaits: str, standing_gaits: str, tmp_path: Path, written: Callable[[str], Any]
) -> None:
    """Feet at rest stay planted; a robot without a policy falls later."""
    config = stops.Config(
        library=standing_gaits, speeds=(0.0,), walks=1, duration=0.5, out=tmp_path,
        before=0.03, rest=0.6, after=1.5,
    )  # fmt: skip
    (row,) = stops.main(config, limp())
    assert sum(row["falls"].values()) == 1
    assert row["falls"]["walk"] == row["falls"]["stop"] == 0
    numbers = written("stops")["rows"][0]
    (walk,) = numbers["walks"]
    assert walk["command"] == [0.0, 0.0, 0.0]
    assert walk["fell"] in ("stand", "start")
    with pytest.raises(ConfigurationError, match="standing needs a library with stop and start"):
        stops.main(stops.Config(library=gaits, out=tmp_path), limp())


def test_walks_that_stop_have_sensor_noise_of_their_own() -> None:
    first, again, other = (stops.seeds(stops.Config(walks=2, seed=seed)) for seed in (0, 0, 1))
    assert first == again
    assert len({*first, *other}) == 4


def test_stand_commands_come_at_all_phases_of_a_stride() -> None:
    library = standing_library()
    command = np.zeros((4, library.command_size))
    stride = library.stride(torch.zeros(1, library.command_size)).item()
    expected = stride * np.arange(4) / 4
    assert stops.delays(library, command) == pytest.approx(expected, rel=1e-6)
    with pytest.raises(ConfigurationError, match="speeds must be finite"):
        stops.Config(speeds=(0.0, math.nan))


def test_a_robot_that_stands_is_measured_after_it_came_to_rest() -> None:
    """It drifts 2 cm and turns 0.1 rad in the last second, and lifts a foot for 0.1 s."""
    ticks = 2000
    time = np.arange(4 * ticks) / ticks
    force = np.full((len(time), 2, 3), 160.0)
    force[1 * ticks + 400 : 1 * ticks + 600, 0] = 0.0
    force[2 * ticks + 100 : 2 * ticks + 300, 1] = 0.0
    along = np.clip(time - 2, 0, 1)[:, None]
    half = 0.05 * along[:, 0]
    orientation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    torque = velocity = np.tile([2.0, *[0.0] * 9], (len(time), 1))
    walk = Substeps(
        along * [0.02, 0.0, 0.5], orientation, np.zeros((len(time), 2, 3)), force, torque,
        velocity, fell=False,
    )  # fmt: skip
    found = stops.quantities(walk, np.zeros(3), np.array([1, 2, 3, 4]) * ticks)
    assert found["fell"] is None
    assert found["planted"] == pytest.approx(0.3)
    assert found["drift"] == pytest.approx(0.02, rel=1e-3)
    assert found["turn"] == pytest.approx(0.1, rel=1e-3)
    assert (found["lifted"], found["power"]) == (1, pytest.approx(4.0))
    short = replace(walk.since(0.0), fell=True, ground_force=force[: 2 * ticks + 5])
    assert stops.quantities(short, np.zeros(3), np.array([1, 2, 3, 4]) * ticks)["fell"] == "stand"
