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


def test_an_unknown_sensor_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="no sensor 'gyros', did you mean 'gyro'"):
        ObservationNoise({"gyros": NoiseLevel()})
    with pytest.raises(UnknownNameError, match=r"no sensor 'sonar'; there are.*'accelerometer'"):
        ObservationNoise({"sonar": NoiseLevel()})
    with pytest.raises(ConfigurationError, match="bias of 'gyro' must be one number or 3"):
        ObservationNoise({"gyro": NoiseLevel(bias=[0.1] * 4)})
