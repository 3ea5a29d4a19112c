"""Twin in another physics engine than MuJoCo."""

import numpy as np
import pytest

from aslip.control import Controller
from aslip.library import GaitLibrary
from aslip.network.twin import ENGINES, TwinRobot
from aslip.network.wire import PD_IN, command_to_pd_in, state_out_to_estimate
from aslip.robot import CASSIE


def test_the_controller_walks_in_drake() -> None:
    """Nine tenths of a second end within 5 cm of the place in MuJoCo."""
    pytest.importorskip("pydrake", exc_type=ImportError)
    controller = Controller("straight", GaitLibrary.load())
    places = []
    for make_engine in ENGINES.values():
        twin = TwinRobot(make_engine=make_engine)
        walking = controller.start(state_out_to_estimate(twin.tick(PD_IN.zeros())), 0.5, heading=0)
        for _ in range(30):
            command = command_to_pd_in(walking.motor_target[0].numpy())
            for _ in range(CASSIE.substeps):
                state = twin.tick(command)
            walking, _ = controller.step(walking, state_out_to_estimate(state))
        assert twin.divergences == 0
        truth = twin.truth()
        torque = truth["motor_torque"][0]
        np.testing.assert_allclose(state["motor"]["torque"], torque, rtol=1e-6)
        estimate = state_out_to_estimate(state)
        np.testing.assert_allclose(estimate["velocity"], truth["pelvis_velocity"][0], atol=0.1)
        places.append(truth["pelvis_position"][0])
    assert places[0][0] > 0.2
    np.testing.assert_allclose(places[1], places[0], atol=0.05)
