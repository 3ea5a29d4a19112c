"""Stages of a run, and each reason to damp, without sockets or clocks."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.network.runner.supervisor import Limits, Reading, Request, Stage, Supervisor, tilt
from aslip.robot import CASSIE

PERIOD = CASSIE.policy_period
STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]
POSE = STANDING + 0.1
SLOW = Limits(ramp=10 * PERIOD, settle=4 * PERIOD)


@dataclass
class Recorder:
    """Controller that records how it is called; its targets count its steps."""

    calls: list[tuple[Any, ...]] = field(default_factory=list)
    stand: list[dict[str, Any]] = field(default_factory=list)
    fails: str = ""
    command_size: int = 1
    stands: bool = False
    plans: bool = False
    pose: np.ndarray = field(default_factory=lambda: POSE)

    def start(self, packets: Any, command: Any = 0.0, *, heading: Any = None, **stand: Any) -> Any:
        self.calls.append(("start", packets, command, heading))
        self.stand.append(stand)
        return SimpleNamespace(motor_target=np.ones((1, 10)))

    def step(
        self, state: Any, packets: Any, command: Any = None, *, heading: Any = None, **stand: Any
    ) -> tuple[Any, Any]:
        self.stand.append(stand)
        if self.fails == "raises":
            raise RuntimeError("no session")
        self.calls.append(("step", packets, command, heading))
        target = math.nan if self.fails else state.motor_target + 1
        return SimpleNamespace(motor_target=np.broadcast_to(target, (1, 10))), target


def standing(time: float, *, channels: dict[int, float] | None = None, **entries: Any) -> Reading:
    """Reading of a robot that stands, with other entries and radio channels."""
    estimate = {name: np.zeros(size) for name, size in CASSIE.estimate_sizes.items()}
    estimate |= {"orientation": np.array([1.0, 0, 0, 0]), "motor_position": STANDING.copy()}
    radio = np.zeros(16)
    radio[8] = 1.0
    for channel, value in (channels or {}).items():
        radio[channel] = value
    return Reading(time, {**estimate, **entries}, radio)


def make(limits: Limits | None = None, **settings: Any) -> tuple[Supervisor, Recorder]:
    controller = Recorder(**settings)
    return Supervisor(cast("Any", controller), limits), controller


def walking() -> tuple[Supervisor, Recorder]:
    """Supervisor in its second tick of the walk, at 30 ms."""
    supervisor, controller = make()
    for k in range(2):
        supervisor.tick(k * PERIOD, standing(k * PERIOD), Request(0.5))
    assert supervisor.stage is Stage.WALK
    return supervisor, controller


def test_there_is_no_torque_before_the_first_packet() -> None:
    supervisor, controller = make()
    for k in range(100):
        command = supervisor.tick(k * PERIOD, None, Request(0.5))
    assert supervisor.stage is Stage.CONNECT
    assert not np.any(command)
    assert controller.calls == []


def test_there_is_no_torque_before_the_first_possible_estimate() -> None:
    supervisor, controller = make()
    cases: list[dict[str, Any]] = [{"orientation": np.zeros(4)}, {"height": np.array([np.nan])}]
    for k, lost in enumerate(cases):
        assert not np.any(supervisor.tick(k * PERIOD, standing(k * PERIOD, **lost), Request(0.5)))
        assert supervisor.stage is Stage.CONNECT
        assert next(iter(lost)) in supervisor.reason
    supervisor.tick(2 * PERIOD, standing(2 * PERIOD), Request(0.5))
    assert [call[0] for call in controller.calls] == ["start"]


def test_a_slow_start_holds_the_joints_then_moves_them_to_the_pose() -> None:
    supervisor, _ = make(SLOW)
    stages, last = [], None
    for k in range(30):
        walk = Request(walk=k >= 25)
        command = supervisor.tick(k * PERIOD, standing(k * PERIOD), walk)
        stages.append(supervisor.stage)
        if supervisor.stage is Stage.HOLD:
            np.testing.assert_allclose(command.position, STANDING)
            np.testing.assert_allclose(command.stiffness, k / 10 * CASSIE.stiffness)
        if supervisor.stage is Stage.POSE:
            part = (k - 10) / 10
            np.testing.assert_allclose(command.position, STANDING + 0.1 * part)
        if supervisor.stage is Stage.READY:
            np.testing.assert_allclose(command.position, POSE)
        if supervisor.stage is not Stage.WALK:
            last = command
        np.testing.assert_array_equal(command.damping, CASSIE.damping)
    assert last is not None
    np.testing.assert_array_equal(last.stiffness, CASSIE.stiffness)
    names = [stages.index(stage) for stage in (Stage.HOLD, Stage.POSE, Stage.READY, Stage.WALK)]
    assert names == [0, 10, 20, 25]


def test_a_walk_starts_at_once_with_the_present_heading() -> None:
    supervisor, controller = make()
    quarter = np.array([math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4)])
    command = supervisor.tick(0.0, standing(0.0, orientation=quarter), Request(0.5))
    name, _, speed, heading = controller.calls[0]
    assert (name, speed) == ("start", 0.5)
    assert heading == pytest.approx(math.pi / 2)
    np.testing.assert_array_equal(command.position, np.ones(10))
    np.testing.assert_array_equal(command.stiffness, CASSIE.stiffness)


def test_a_tick_without_a_packet_is_a_step_without_an_estimate() -> None:
    supervisor, controller = walking()
    supervisor.tick(2 * PERIOD, None, Request(0.7))
    assert controller.calls[-1] == ("step", None, 0.7, None)


def test_a_yaw_rate_turns_the_heading_of_a_policy_that_walks_straight_ahead() -> None:
    supervisor, controller = walking()
    for k in (2, 3):
        supervisor.tick(k * PERIOD, standing(k * PERIOD), Request(0.5, yaw_rate=1.0))
    assert controller.calls[-1][2:] == (0.5, pytest.approx(2 * PERIOD))


def test_a_policy_for_all_directions_gets_the_whole_command() -> None:
    supervisor, controller = make(command_size=3)
    for k in range(2):
        supervisor.tick(k * PERIOD, standing(k * PERIOD), Request(0.5, 0.1, 0.2))
    assert controller.calls[-1][2:] == ((0.5, 0.1, 0.2), None)


def test_only_policies_that_stand_get_the_stand_command_and_others_step_in_place() -> None:
    for stands in (True, False):
        supervisor, controller = make(command_size=3, stands=stands)
        for k in range(4):
            request = Request(0.5, stand=k == 2, stop=k == 3)
            supervisor.tick(k * PERIOD, standing(k * PERIOD), request)
        assert supervisor.stage is Stage.STOP
        assert [call[2][0] for call in controller.calls] == [0.5, 0.5, 0.0, 0.0]
        # a walk begins with standing, as the robot stands then
        expected = [{"stand": stand} for stand in (True, False, True, True)]
        assert controller.stand == (expected if stands else [{}] * 4)


TILTED = np.array([math.cos(0.5), math.sin(0.5), 0, 0])


@pytest.mark.parametrize(
    ("reading", "request_", "reason"),
    [
        (None, Request(damp="key x"), "key x"),
        (standing(0.06, channels={8: -0.5}), Request(), "emergency stop: radio channel 8 is -0.5"),
        (standing(0.06, channels={9: -1.0}), Request(), "operator: radio channel 9 is -1"),
        (
            standing(0.06, velocity=np.array([0, np.nan, 0])),
            Request(),
            "estimates are lost or impossible: {'velocity': [0.0, nan, 0.0]}",
        ),
        (
            standing(0.06, orientation=np.zeros(4)),
            Request(),
            "estimates are lost or impossible: {'orientation': [0.0, 0.0, 0.0, 0.0]}",
        ),
        (standing(0.06, orientation=TILTED), Request(), "tilt of 1.00 rad, beyond 0.8 rad"),
    ],
)
def test_the_motors_damp_at_once(reading: Reading | None, request_: Request, reason: str) -> None:
    supervisor, _ = walking()
    command = supervisor.tick(0.06, reading, request_)
    assert (supervisor.stage, supervisor.reason) == (Stage.DAMPING, reason)
    assert not command.stiffness.any()
    np.testing.assert_array_equal(command.damping, CASSIE.damping)


def test_a_tenth_of_a_second_without_packets_damps() -> None:
    supervisor, _ = walking()
    stages = []
    for k in range(2, 8):
        supervisor.tick(k * PERIOD, None, Request())
        stages.append(supervisor.stage)
    # the last packet arrived at 0.03 s
    assert [stage is Stage.DAMPING for stage in stages] == [k * PERIOD > 0.131 for k in range(2, 8)]
    assert supervisor.reason == "no packet for 0.120 s"


@pytest.mark.parametrize(
    ("fails", "reason"), [("raises", "RuntimeError: no session"), ("nan", "10 finite angles")]
)
def test_a_policy_that_fails_damps(fails: str, reason: str) -> None:
    supervisor, controller = walking()
    controller.fails = fails
    command = supervisor.tick(0.06, standing(0.06), Request())
    assert supervisor.stage is Stage.DAMPING
    assert reason in supervisor.reason
    assert not command.stiffness.any()


def test_damping_lasts_whatever_arrives_and_ends_the_run() -> None:
    supervisor, controller = walking()
    supervisor.tick(0.06, None, Request(damp="key x"))
    calls = len(controller.calls)
    for k in range(3, 40):
        assert supervisor.is_over(k * PERIOD) == (k * PERIOD >= 1.06)
        command = supervisor.tick(k * PERIOD, standing(k * PERIOD), Request(1.0))
        assert not command.stiffness.any()
    assert (supervisor.reason, len(controller.calls)) == ("key x", calls)


def test_a_stop_steps_in_place_before_damping() -> None:
    supervisor, controller = walking()
    supervisor.limits = replace(SLOW, ramp=0.0)
    stages = []
    for k in range(2, 8):
        supervisor.tick(k * PERIOD, standing(k * PERIOD), Request(0.5, stop=True))
        stages.append(supervisor.stage)
    assert stages == [Stage.STOP] * 4 + [Stage.DAMPING] * 2
    assert [call[2] for call in controller.calls[-4:]] == [0.0] * 4


def test_the_switch_releases_the_motors_and_starts_anew() -> None:
    supervisor, controller = walking()
    command = supervisor.tick(0.06, standing(0.06, channels={9: 1.0}), Request(0.5))
    assert supervisor.stage is Stage.RELEASED
    assert not np.any(command)
    supervisor.tick(0.09, standing(0.09), Request(0.5))
    assert supervisor.stage is Stage.WALK
    assert controller.calls[-1][0] == "start"


def test_a_stop_counts_while_the_motors_are_released() -> None:
    supervisor, _ = walking()
    supervisor.tick(0.06, standing(0.06, channels={9: 1.0}), Request(0.5))
    supervisor.tick(0.09, standing(0.09, channels={9: 1.0}), Request(0.5, stop=True))
    assert (supervisor.stage, supervisor.by_operator) == (Stage.DAMPING, True)


def test_the_operator_is_distinguished_from_other_reasons() -> None:
    for reason in ("operator: red button", "the policy failed: no operator aten::x"):
        supervisor, _ = walking()
        supervisor.tick(0.06, standing(0.06), Request(damp=reason))
        assert supervisor.by_operator == reason.startswith("operator")


def test_tilt_is_the_angle_to_the_vertical_in_any_direction() -> None:
    assert tilt(np.array([1.0, 0, 0, 0])) == 0.0
    assert tilt(TILTED) == pytest.approx(1.0)
    assert tilt(np.array([0.0, 0, 1, 0])) == pytest.approx(math.pi)
    assert tilt(np.array([math.cos(0.3), 0, 0, math.sin(0.3)])) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("limits", [{"ramp": -1.0}, {"tilt": 0.0}, {"patience": math.nan}])
def test_wrong_limits_are_refused(limits: dict[str, float]) -> None:
    (name, value) = next(iter(limits.items()))
    with pytest.raises(ConfigurationError, match=f"{name} must be finite.*got {value}"):
        Limits(**limits)
