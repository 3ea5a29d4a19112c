"""Ticks of the twin against whole policy periods of the simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from aslip.estimation import StateEstimator
from aslip.network.twin import TwinRobot
from aslip.network.wire import PD_IN, STATE_OUT, command_to_pd_in, state_out_to_estimate
from aslip.robot import CASSIE
from aslip.sim import Simulations

STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]
# the robot whose gains are those that reach the twin in single precision
ROUNDED = replace(CASSIE, damping=CASSIE.damping.astype(np.float32).astype(np.float64))


@pytest.fixture
def twin() -> TwinRobot:
    return TwinRobot()


def test_sixty_ticks_are_one_policy_period_bit_for_bit(twin: TwinRobot) -> None:
    simulation, estimator = Simulations(1, num_threads=1, robot=ROUNDED), StateEstimator()
    rng = np.random.default_rng(0)
    state = twin.tick(PD_IN.zeros())
    simulation.set_states(twin.states())
    tracking, _ = estimator.start(twin.packet(), heading=0.0)
    for _ in range(8):
        target = (STANDING + 0.05 * rng.normal(size=10)).astype(np.float32)
        simulation.advance(target[None].astype(np.float64))
        packets = simulation.sensors.packets().items()
        single = {name: entry.astype(np.float32) for name, entry in packets}
        expected = estimator.update(tracking, single)
        for _ in range(60):
            state = twin.tick(command_to_pd_in(target))
        np.testing.assert_array_equal(twin.states(), simulation.states())
        for name, value in state_out_to_estimate(state).items():
            np.testing.assert_array_equal(value, getattr(expected, name)[0].astype(np.float32))


def test_states_have_the_motors_torques_after_limits_and_delay(twin: TwinRobot) -> None:
    """20 N m at the left knee arrive after six ticks."""
    torque = np.zeros(10)
    torque[3] = 20.0
    command = command_to_pd_in(np.zeros(10), 0.0, 0.0, torque=torque)
    sent = [twin.tick(command)["motor"]["torque"].copy() for _ in range(8)]
    assert not np.any(sent[:6])
    np.testing.assert_allclose(sent[7], torque, rtol=1e-6)


def test_states_place_the_feet_below_the_pelvis(twin: TwinRobot) -> None:
    state = twin.tick(command_to_pd_in(STANDING))
    assert state.dtype == STATE_OUT.dtype
    np.testing.assert_array_equal(state["pelvis"]["position"][:2], [0, 0])
    assert 0.7 < state["pelvis"]["position"][2] < 1.1
    for side, sign in (("left", 1), ("right", -1)):
        foot = state[f"{side}_foot"]["position"]
        assert 0.05 < sign * foot[1] < 0.25
        np.testing.assert_allclose(foot[2], -state["pelvis"]["position"][2], atol=0.03)


def test_a_returned_state_does_not_change_with_the_next_tick(twin: TwinRobot) -> None:
    first = twin.tick(command_to_pd_in(STANDING))
    before = first.tobytes()
    for _ in range(10):
        twin.tick(command_to_pd_in(STANDING))
    assert first.tobytes() == before


def test_a_simulation_that_diverges_starts_anew(twin: TwinRobot) -> None:
    for _ in range(7):
        state = twin.tick(command_to_pd_in(np.full(10, np.nan)))
    assert twin.divergences >= 1
    assert STATE_OUT.is_finite(state)
    assert abs(state["pelvis"]["position"][2] - 1.0) < 0.1
