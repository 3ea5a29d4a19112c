"""Packets, torques and divergence of the twin, tick by tick."""

import numpy as np
import pytest

from aslip.network.twin import TwinRobot
from aslip.network.wire import STATE_OUT, command_to_pd_in
from aslip.robot import CASSIE

STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]


@pytest.fixture
def twin() -> TwinRobot:
    return TwinRobot()


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
