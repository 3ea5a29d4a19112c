"""Controllers of robots that estimate their own state."""

from collections.abc import Callable
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from aslip.control import Controller, ControllerState
from aslip.envs import BatchEnv
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.estimation import Estimate, StateEstimator
from aslip.robot import CASSIE
from aslip.robot.rotation import orientation_to_heading, vector_to_heading
from aslip.transforms import DIRECTION_TABLE
from aslip.transforms.estimate import ESTIMATE_SIZES
from tests.helpers import limp
from tests.library.bent import symmetric_library

Estimates = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def walk(controller: Controller) -> list[ControllerState]:
    """States of a controller that walks three robots on their packets for 0.6 s."""
    env = BatchEnv(3, num_threads=1)
    now = env.reset()
    states = [controller.start(cast("TensorDictBase", now["sensors"]), 0.5)]
    for _ in range(20):
        now = env.step(now.set("motor_target", states[-1].motor_target))["next"]
        states.append(controller.step(states[-1], cast("TensorDictBase", now["sensors"]))[0])
    return states


def estimates(state: ControllerState) -> Estimates:
    return {name: state.tensordict["estimate", name].numpy().copy() for name in ESTIMATE_SIZES}


def follow(
    controller: Controller,
    walk: list[ControllerState],
    seen: Callable[[Estimates], Estimates],
    heading: float | None,
) -> list[ControllerState]:
    """States of a controller that gets the estimates of a walk."""
    first, *rest = (seen(estimates(state)) for state in walk)
    states = [controller.start(first, 0.5, heading=heading)]
    for estimate in rest:
        states.append(controller.step(states[-1], estimate)[0])
    return states


def test_motor_targets_are_those_of_packets_that_give_the_same_estimates(
    controller: Controller, walk: list[ControllerState]
) -> None:
    for ours, theirs in zip(follow(controller, walk, dict, 0.0), walk, strict=True):
        assert torch.equal(ours.motor_target, theirs.motor_target)


def test_estimates_are_turned_to_the_heading(
    controller: Controller, walk: list[ControllerState]
) -> None:
    """The world of the estimates is turned by 2 rad against the robots' straight ahead."""

    def turned(estimate: Estimates) -> Estimates:
        back = np.full(3, -2.0)
        return {
            **estimate,
            "orientation": orientation_to_heading(back, estimate["orientation"]),
            "velocity": vector_to_heading(back, estimate["velocity"]),
        }

    for ours, theirs in zip(follow(controller, walk, turned, 2.0), walk, strict=True):
        torch.testing.assert_close(ours.motor_target, theirs.motor_target, atol=1e-5, rtol=0)


def test_the_first_estimate_s_yaw_is_straight_ahead_by_default(
    controller: Controller, walk: list[ControllerState]
) -> None:
    estimate = estimates(walk[0])
    turned = orientation_to_heading(np.array([0.3, -1.0, 3.0]), estimate["orientation"])
    state = controller.start({**estimate, "orientation": turned}, 0.5)
    np.testing.assert_allclose(state.tensordict["heading"][:, 0], [-0.3, 1.0, -3.0], atol=1e-6)


def test_a_new_heading_turns_the_following_estimates(
    controller: Controller, walk: list[ControllerState]
) -> None:
    state = controller.start(estimates(walk[0]), 0.5, heading=0.0)
    state, _ = controller.step(state, estimates(walk[1]), heading=0.5)
    state, _ = controller.step(state, estimates(walk[2]))
    expected = vector_to_heading(np.full(3, 0.5), estimates(walk[2])["velocity"])
    np.testing.assert_allclose(state.tensordict["estimate", "velocity"], expected, atol=1e-6)


IMPOSSIBLE = {
    "velocity": np.nan,
    "orientation": 0.0,
    "height": 30.0,
    "motor_position": 20.0,
    "joint_velocity": -1e30,
    "angular_velocity": np.inf,
}


@pytest.mark.parametrize("lost", ["all", *IMPOSSIBLE])
def test_the_last_estimate_holds_while_no_possible_one_comes(
    controller: Controller, walk: list[ControllerState], lost: str
) -> None:
    state = controller.start(estimates(walk[0]), 0.5, heading=0.0)
    damaged = estimates(walk[1])
    if lost != "all":
        damaged[lost][1] = IMPOSSIBLE[lost]
        with pytest.raises(ConfigurationError, match=f"finite and possible: {lost} is"):
            controller.start(damaged)
    after, target = controller.step(state, None if lost == "all" else damaged)
    held, kept = after.tensordict["estimate"], state.tensordict["estimate"]
    for name in ESTIMATE_SIZES:
        assert torch.equal(held[name][1], kept[name][1])
    assert torch.equal(held["height"][0], kept["height"][0]) == (lost == "all")
    assert target.isfinite().all()


def test_packets_and_estimates_do_not_mix(
    controller: Controller, walk: list[ControllerState]
) -> None:
    with pytest.raises(ConfigurationError, match="got estimates, but the robots started with pack"):
        controller.step(walk[0], estimates(walk[1]))
    own = controller.start(estimates(walk[0]))
    with pytest.raises(ConfigurationError, match="got packets, but the robots started with est"):
        controller.step(own, np.zeros((3, 1, CASSIE.packet_size)))


def test_wrong_estimates_are_named(controller: Controller, walk: list[ControllerState]) -> None:
    good = estimates(walk[0])
    missing = {name: value for name, value in good.items() if name != "velocity"}
    with pytest.raises(UnknownNameError, match="'velocity' is missing"):
        controller.start(missing)
    with pytest.raises(ShapeError, match=r"velocity of an estimate must have shape \(n, 3\)"):
        controller.start({**good, "velocity": np.zeros((3, 2))})
    with pytest.raises(ShapeError, match="differ in length"):
        controller.start({**good, "velocity": np.zeros((2, 3))})
    with pytest.raises(ShapeError, match="packets must have shape"):
        controller.start(np.zeros((2, 42)))
    with pytest.raises(ShapeError, match="must come from 3 robots, got 2"):
        controller.step(controller.start(good), {name: v[:2] for name, v in good.items()})


def test_positions_give_the_distance_from_the_path_that_packets_give() -> None:
    """On a turn that begins with a heading of 0.7 rad, estimated in a frame without heading."""
    controller = Controller(limp(), symmetric_library(), observation=DIRECTION_TABLE)
    estimator, env = StateEstimator(), BatchEnv(2, num_threads=1)

    def own(estimate: Estimate) -> Estimates:
        return {name: getattr(estimate, name) for name in (*ESTIMATE_SIZES, "position")}

    # slow, so that no robot reaches the end of its leash: the lost one would not pull on it
    now, command = env.reset(), [0.1, 0.03, 0.8]
    packets = {name: value.numpy() for name, value in now["sensors"].items()}
    theirs = controller.start(packets, command, heading=0.7)
    tracking, estimate = estimator.start(packets, heading=0.0)
    ours = controller.start(own(estimate), command, heading=0.7)
    for step in range(14):
        now = env.step(now.set("motor_target", theirs.motor_target))["next"]
        packets = {name: value.numpy() for name, value in now["sensors"].items()}
        theirs, _ = controller.step(theirs, packets, heading=0.9 if step == 4 else None)
        seen = own(estimator.update(tracking, packets))
        held = ours.tensordict["odometry", "path_error"]
        lost = None if step == 9 else seen
        ours, _ = controller.step(ours, lost, heading=0.9 if step == 4 else None)
        found = ours.tensordict["odometry", "path_error"]
        expected = held if lost is None else theirs.tensordict["odometry", "path_error"]
        # the origin of a lost robot swings about the place where it was last seen
        torch.testing.assert_close(found, expected, atol=2e-6 if step < 10 else 5e-4, rtol=0)
    assert (found.abs() > 0.01).all()
