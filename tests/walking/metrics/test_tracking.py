"""Velocity, tracking and effort of made-up motions."""

import math

import numpy as np
import pytest

from aslip.errors import ShapeError
from aslip.walking.metrics import (
    action_roughness,
    cost_of_transport,
    leg_length_correlation,
    mechanical_power,
    root_mean_square,
    step_response,
    stride_average,
    touchdown_spike,
)

PERIOD = 0.03
STRIDE = 0.8
TIME = np.arange(0, 4, PERIOD)


def test_stride_average_removes_oscillation() -> None:
    swing = 0.9 + 0.1 * np.sin(2 * np.pi * TIME / (27 * PERIOD))
    averaged = stride_average(swing, 27 * PERIOD, PERIOD)
    np.testing.assert_allclose(averaged[20:-20], 0.9, atol=1e-12)


@pytest.mark.parametrize("constant", [0.2, 0.4])
def test_settling_time_of_first_order_lag(constant: float) -> None:
    """After ln 10 time constants, it is within 0.1 m/s of a step of 1 m/s."""
    speed = 1 - np.exp(-(TIME + PERIOD) / constant)
    answer = step_response(speed, 0.0, 1.0, PERIOD, PERIOD)
    assert answer.settling_time == pytest.approx(constant * math.log(10), abs=0.1 * PERIOD)
    assert answer.overshoot == 0.0
    assert answer.steady_error == pytest.approx(0.0, abs=1e-3)
    # a step down gives the same
    down = step_response(2 - speed, 2.0, 1.0, PERIOD, PERIOD)
    assert down.settling_time == answer.settling_time
    assert down.overshoot == 0.0


def test_overshoot_is_in_direction_of_change() -> None:
    speed = 1 + 0.3 * np.exp(-TIME) * np.sin(5 * TIME)
    up = step_response(speed, 0.0, 1.0, PERIOD, PERIOD)
    assert up.overshoot == pytest.approx((speed - 1).max(), abs=1e-9)
    down = step_response(speed, 2.0, 1.0, PERIOD, PERIOD)
    assert down.overshoot == pytest.approx((1 - speed).max(), abs=1e-9)


def test_stride_oscillation_does_not_prevent_settling() -> None:
    speed = 1 + 0.3 * np.sin(2 * np.pi * TIME / STRIDE)
    assert step_response(speed, 1.0, 1.0, STRIDE, PERIOD).settling_time == 0.0
    assert step_response(speed, 1.0, 1.0, PERIOD, PERIOD).settling_time > 3.0


def test_speed_off_command_never_settles() -> None:
    answer = step_response(np.full(100, 0.7), 0.0, 1.0, STRIDE, PERIOD)
    assert answer.settling_time == math.inf
    assert answer.steady_error == pytest.approx(-0.3)


def test_settling_needs_a_whole_stride() -> None:
    """Otherwise an oscillation that crosses the command would count."""
    length = 27
    # the mean over 27 samples is within 0.1 m/s once 25 of them are at the command
    for within, settled in ((length - 1, False), (length, True)):
        speed = np.concatenate([np.zeros(50), np.ones(24 + within)])
        answer = step_response(speed, 0.0, 1.0, length * PERIOD, PERIOD)
        assert math.isfinite(answer.settling_time) == settled


def test_root_mean_square_is_over_time() -> None:
    np.testing.assert_allclose(root_mean_square(np.array([[3.0, 0], [4, 0]])), [np.sqrt(12.5), 0])


def test_leg_length_correlation() -> None:
    model = 0.9 + 0.05 * np.stack([np.sin(8 * TIME), np.cos(8 * TIME)], axis=1)
    assert leg_length_correlation(2 * model + 0.1, model) == pytest.approx(1.0)
    assert leg_length_correlation(-model, model) == pytest.approx(-1.0)
    assert abs(leg_length_correlation(model[:, ::-1], model)) < 0.05
    assert math.isnan(leg_length_correlation(np.ones_like(model), model))


def test_touchdown_spike_is_range_around_touchdowns() -> None:
    speed = np.ones(100)
    speed[30:32] += 0.2
    speed[60] -= 0.4
    assert touchdown_spike(speed, np.array([30, 60]), 2) == pytest.approx(0.3)
    assert touchdown_spike(speed, np.array([10]), 2) == 0.0
    assert math.isnan(touchdown_spike(speed, np.array([1, 99]), 2))  # not in the record


def test_mechanical_power_is_positive_work_over_time() -> None:
    """Braking neither costs nor pays, also while another motor works."""
    torque, velocity = np.zeros((100, 10)), np.zeros((100, 10))
    torque[:50, 3], velocity[:50, 3] = -50.0, -2.0
    torque[:, 8], velocity[:, 8] = 10.0, -1.0
    assert mechanical_power(torque, velocity) == pytest.approx(50.0)
    torque[50:, 0], velocity[50:, 0] = 4.0, 5.0
    assert mechanical_power(torque, velocity) == pytest.approx(60.0)
    with pytest.raises(ShapeError, match=r"\(100, 10\), \(100, 9\)"):
        mechanical_power(torque, velocity[:, :9])


def test_cost_of_transport_is_power_over_weight_and_speed() -> None:
    assert cost_of_transport(120.0, 300.0, 0.5) == pytest.approx(0.8)
    assert math.isnan(cost_of_transport(120.0, 300.0, 0.0))
    assert math.isnan(cost_of_transport(120.0, 300.0, -0.1))


def test_action_roughness() -> None:
    action = np.zeros((5, 10))
    action[1::2, :4] = 0.5
    assert action_roughness(action) == pytest.approx(1.0)
    assert action_roughness(np.ones((5, 10))) == 0.0
