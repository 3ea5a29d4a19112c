"""Noise levels of sensors: the robot's, and those that a caller gives."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.robot import CASSIE
from aslip.sim.sensors import JOINT_VELOCITY_FILTER
from aslip.transforms import NoiseLevel, ObservationNoise


def test_default_white_noise_is_that_of_the_public_simulator() -> None:
    """White noise from the model file of the public simulator, where it declares any."""
    assert CASSIE.sensor_noise["joint_position"].white == (2e-4, 2e-4, 0.0, 2e-4, 2e-4, 0.0)
    assert CASSIE.sensor_noise["gyro"] == NoiseLevel(white=5e-4, bias=1e-3)
    assert CASSIE.sensor_noise["accelerometer"] == NoiseLevel(white=1e-2, bias=2e-2)
    assert CASSIE.sensor_noise["orientation"] == NoiseLevel(white=5e-4, bias=1.5e-3)
    silent = {name for name, level in CASSIE.sensor_noise.items() if level == NoiseLevel()}
    assert silent == {"motor_position", "motor_velocity"}
    assert set(CASSIE.sensor_noise) == set(CASSIE.noise_channels)


def test_noise_of_joint_velocities_is_that_of_the_filtered_encoders() -> None:
    angle, rate = (
        np.asarray(CASSIE.sensor_noise[f"joint_{name}"].white) for name in ("position", "velocity")
    )
    noise = np.random.default_rng(0).normal(size=(400_000, len(angle))) * angle
    filtered = np.asarray(lfilter(*JOINT_VELOCITY_FILTER, noise, axis=0))[1000:]
    np.testing.assert_allclose(rate, filtered.std(0), rtol=0.01)
    packets = filtered[:: CASSIE.packet_substeps, 0]
    # white enough for independent draws per packet
    assert abs(np.corrcoef(packets[1:], packets[:-1])[0, 1]) < 0.1


def test_given_levels_replace_only_those_of_their_sensors() -> None:
    noise = ObservationNoise({"gyro": NoiseLevel(0.1)})
    assert noise.levels == {**CASSIE.sensor_noise, "gyro": NoiseLevel(0.1)}


def test_a_level_cannot_be_altered() -> None:
    values = np.array([1.0, 2.0, 3.0])
    level = NoiseLevel(white=values)
    values[0] = 9.0
    assert level == NoiseLevel(white=(1.0, 2.0, 3.0))
    assert replace(level, bias=1).bias == 1.0
    with pytest.raises(FrozenInstanceError):
        level.white = 0.0  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("value", [math.nan, [0.1, -0.1], "0.1", [[0.1], [0.1, 0.2]]])
def test_a_negative_or_infinite_standard_deviation_is_refused(value: Any) -> None:
    with pytest.raises(ConfigurationError, match="bias must be finite and 0 or more, got"):
        NoiseLevel(bias=value)


@pytest.mark.parametrize(("sensor", "channels"), [("gyro", 3), ("orientation", 3), ("gyro", 1)])
def test_a_wrong_number_of_channels_is_refused(sensor: str, channels: int) -> None:
    level = NoiseLevel(bias=[0.1] * (4 if channels == 3 else channels))
    with pytest.raises(ConfigurationError, match=f"bias of '{sensor}' must be one number or 3"):
        ObservationNoise({sensor: level})


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="no sensor 'gyros', did you mean 'gyro'"):
        ObservationNoise({"gyros": NoiseLevel()})
    with pytest.raises(UnknownNameError, match=r"no sensor 'sonar'; there are.*'accelerometer'"):
        ObservationNoise({"sonar": NoiseLevel()})
