"""Supervisor of a robot under a controller: start-up, walk, stop and damping.

The supervisor is a state machine without sockets and clocks: time is an argument, so that a log
can be replayed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np

from aslip.control.base import ControllerBase, Packets
from aslip.control.estimates import lost_entries
from aslip.errors import ConfigurationError
from aslip.network.wire import STOP_CHANNEL, MotorCommand
from aslip.robot import CASSIE
from aslip.robot.rotation import yaw

SWITCH_CHANNEL: Final = 9
"""Radio channel of the switch: below -0.5 damping, above 0.5 no torque, between them the policy."""

# value of the switch's channel beyond which it is thrown
_THROWN = 0.5
_STOPPED = "stopped by the operator"
# tolerance of durations [s]: policy steps add up to 0.8999999 s
_ROUNDING = 1e-9


class Stage(Enum):
    """Stage of a run."""

    CONNECT = "connect"
    """No torque until the robot answers with estimates that are finite and possible."""
    HOLD = "hold"
    """Joints stay where they are while the position gains rise."""
    POSE = "pose"
    """Joints move to the pose in which the walk begins."""
    READY = "ready"
    """Joints stay in that pose until the operator starts the walk."""
    WALK = "walk"
    """The policy follows the operator's command."""
    STOP = "stop"
    """The policy stands, or steps in place if it cannot, before the motors are damped."""
    RELEASED = "released"
    """No torque, because the operator threw the switch."""
    DAMPING = "damping"
    """Velocity gains only; the end of a run."""


class Reading(NamedTuple):
    """State of the robot from its last packet."""

    time: float
    """Arrival of the packet [s]."""
    estimate: Mapping[str, np.ndarray]
    """Entries (k,) of `("estimate", ...)`, in a frame with z up against gravity."""
    channels: np.ndarray
    """(16,) channels of the operator's radio, -1 to 1."""
    packets: np.ndarray | None = None
    """(w, p) packets of the sensors since the last reading, oldest first and NaN where one is lost;
    None from robots that send estimates."""


class Request(NamedTuple):
    """Request of the operator."""

    forward: float = 0.0
    """Speed forward [m/s]."""
    sideways: float = 0.0
    """Speed to the left [m/s]; only for policies that walk sideways."""
    yaw_rate: float = 0.0
    """Rate at which the heading turns left [rad/s]."""
    walk: bool = True
    """Start the walk as soon as the robot is ready."""
    stop: bool = False
    """Stand, or step in place if the policy cannot, then damp."""
    damp: str = ""
    """Reason to damp at once; empty for none."""
    stand: bool = False
    """Stand on both feet; policies that cannot step in place."""
    stones: np.ndarray | None = None
    """(m, e, 3) corners of new stones for policies with a planner, see `Controller.start` [m]."""


@dataclass(frozen=True)
class Limits:
    """Durations of the start-up, and limits beyond which the motors are damped.

    Raises:
        ConfigurationError: a number is negative or not finite, or `patience` or `tilt` is zero.
    """

    ramp: float = 0.0
    """Duration of the rise of the position gains, and then of the motion of the joints to the first
    pose [s]. With zero the walk begins at once: Cassie cannot stand on its feet without a policy,
    so a slower start needs a gantry."""
    patience: float = 0.1
    """Longest time without a packet [s]."""
    tilt: float = 0.8
    """Largest angle between the pelvis and the vertical [rad]."""
    settle: float = 3.0
    """Time of slowing down, and of standing or stepping in place, before the damping of a stop [s].
    From any command of the shipped gaits, robots stand after 2.4 s at most."""
    damping: float = 1.0
    """Time of damping before the end of a run [s]."""

    def __post_init__(self) -> None:
        for name in ("ramp", "patience", "tilt", "settle", "damping"):
            value, least = getattr(self, name), 0.0
            wrong = value <= least if name in ("patience", "tilt") else value < least
            if not math.isfinite(value) or wrong:
                kind = "positive" if name in ("patience", "tilt") else "zero or more"
                raise ConfigurationError(f"{name} must be finite and {kind}, got {value!r}")


class Supervisor:
    """Decide at each policy step which motor command the robot gets.

    A policy with a forward speed only walks turns because the supervisor turns its heading. The
    first step of a policy that stands is to stand.

    Args:
        controller: controller such as `aslip.Controller`; the walk begins in its pose after a slow
            start-up.
        limits: durations and limits.
    """

    def __init__(self, controller: ControllerBase[Any], limits: Limits | None = None) -> None:
        self.limits = limits or Limits()
        self.stage = Stage.CONNECT
        """Present stage."""
        self.reason = "no packet yet"
        """Reason of the present stage."""
        self.since = 0.0
        """Time at which the present stage began [s]."""
        self.reading: Reading | None = None
        """Last reading."""
        self._controller, self._pose = controller, np.array(controller.pose)
        self._hold = self._pose
        self._state: Any = None
        self._heading = 0.0

    def tick(self, now: float, reading: Reading | None, request: Request) -> MotorCommand:
        """Advance by a policy step; if controller or reading fail, damp instead of raising.

        Args:
            now: time, from any origin [s].
            reading: state by the newest packet since the last tick; None if none has arrived.
            request: present request of the operator.

        Returns:
            Command of the motors until the next tick, arrays (10,).
        """
        self.reading = reading or self.reading
        if self.stage is not Stage.DAMPING and (why := self._danger(now, request)):
            self._enter(Stage.DAMPING, now, why)
        self._advance(now, request)
        if self.stage in (Stage.WALK, Stage.STOP):
            try:
                return self._pd(self._walked(reading, request))
            except Exception as error:  # whatever fails in a policy, the robot must be damped
                why = f"the policy failed: {type(error).__name__}: {error}"
                self._enter(Stage.DAMPING, now, why)
        return self._still(now)

    @property
    def by_operator(self) -> bool:
        """Whether the operator is the reason of the present stage."""
        return self.reason == _STOPPED or self.reason.startswith("operator: ")

    def is_over(self, now: float) -> bool:
        """Whether the motors have been damped for the time that ends a run."""
        return self.stage is Stage.DAMPING and now - self.since >= self.limits.damping

    def damping(self) -> MotorCommand:
        """Command with velocity gains only, arrays (10,)."""
        return self._pd(0 * self._pose, 0.0)

    def _danger(self, now: float, request: Request) -> str:
        """Reason to damp the motors; empty for none."""
        if request.damp:
            return request.damp
        if self.reading is None:
            return ""
        time, estimate, channels, _ = self.reading
        if channels[STOP_CHANNEL] < 0:
            return f"emergency stop: radio channel {STOP_CHANNEL} is {channels[STOP_CHANNEL]:g}"
        if channels[SWITCH_CHANNEL] < -_THROWN:
            return f"operator: radio channel {SWITCH_CHANNEL} is {channels[SWITCH_CHANNEL]:g}"
        if now - time > self.limits.patience:
            return f"no packet for {now - time:.3f} s"
        if lost := _lost(estimate):
            # at first the robot's estimator may not be ready
            return "" if self.stage is Stage.CONNECT and not request.stop else lost
        angle = tilt(estimate["orientation"])
        if angle > self.limits.tilt:
            return f"tilt of {angle:.2f} rad, beyond {self.limits.tilt:g} rad"
        return ""

    def _advance(self, now: float, request: Request) -> None:
        """Enter the stage that is due."""
        reading = self.reading
        if self.stage is Stage.DAMPING or reading is None:
            return
        if self.stage is Stage.CONNECT and (lost := _lost(reading.estimate)):
            self.reason = f"waits, because {lost}"
            return
        released = reading.channels[SWITCH_CHANNEL] > _THROWN
        if released and self.stage is not Stage.RELEASED:
            self._enter(Stage.RELEASED, now, f"radio channel {SWITCH_CHANNEL}")
        elif request.stop and self.stage is Stage.RELEASED:
            self._enter(Stage.DAMPING, now, _STOPPED)
        elif not released and self.stage in (Stage.CONNECT, Stage.RELEASED):
            self._hold = np.array(reading.estimate["motor_position"], dtype=np.float64)
            self._enter(Stage.HOLD if self.limits.ramp else Stage.WALK, now, "packets arrive")
        elif not released and (due := self._due(now - self.since + _ROUNDING, request)):
            self._enter(due[0], now, due[1])

    def _due(self, elapsed: float, request: Request) -> tuple[Stage, str] | None:
        """Stage after the present one and its reason, if it is due."""
        stage, ramped = self.stage, elapsed >= self.limits.ramp
        if stage is Stage.STOP:
            over = elapsed >= self.limits.settle
            return (Stage.DAMPING, _STOPPED) if over else None
        if request.stop:
            walking = stage is Stage.WALK
            return (Stage.STOP if walking else Stage.DAMPING, _STOPPED)
        if stage is Stage.HOLD and ramped:
            return Stage.POSE, "gains are full"
        if stage is Stage.POSE and ramped:
            return Stage.READY, "joints are in place"
        if stage is Stage.READY and request.walk:
            return Stage.WALK, "started by the operator"
        return None

    def _enter(self, stage: Stage, now: float, reason: str) -> None:
        """Begin a stage."""
        self.stage, self.since, self.reason = stage, now, reason
        if stage is not Stage.STOP:
            self._state = None

    def _walked(self, reading: Reading | None, request: Request) -> np.ndarray:
        """Motor targets (10,) of the policy's next step."""
        in_place = self.stage is Stage.STOP or request.stand
        controller, forward_only = self._controller, self._controller.command_size == 1
        more: dict[str, Any] = {}
        if controller.stands:
            more["stand"] = in_place or self._state is None
        if controller.plans and request.stones is not None:
            more["stones"] = request.stones[None]
        command = (0.0,) * 3 if in_place else (request.forward, request.sideways, request.yaw_rate)
        wanted = command[0] if forward_only else command
        if self._state is None:
            assert self.reading is not None
            self._heading = float(yaw(self.reading.estimate["orientation"]))
            self._state = controller.start(
                self._given(self.reading), wanted, heading=self._heading, **more
            )
        else:
            given = None if reading is None else self._given(reading)
            turns = forward_only and command[2] != 0
            self._heading += command[2] * CASSIE.policy_period if turns else 0.0
            heading = self._heading if turns else None
            self._state, _ = controller.step(self._state, given, wanted, heading=heading, **more)
        target = np.asarray(self._state.motor_target, dtype=np.float64).reshape(-1)
        if target.shape != self._pose.shape or not np.isfinite(target).all():
            raise ValueError(f"motor targets must be {self._pose.size} finite angles, got {target}")
        return target

    def _given(self, reading: Reading) -> Packets:
        """Packets of a reading for a controller with a planner, its estimate for others."""
        if not self._controller.plans:
            return reading.estimate
        assert reading.packets is not None
        return reading.packets[None]

    def _still(self, now: float) -> MotorCommand:
        """Command of a stage without the policy."""
        if self.stage in (Stage.CONNECT, Stage.RELEASED):
            return self._pd(0 * self._pose, 0.0, 0.0)
        if self.stage is Stage.DAMPING:
            return self.damping()
        part = min((now - self.since) / self.limits.ramp, 1.0) if self.limits.ramp else 1.0
        if self.stage is Stage.HOLD:
            return self._pd(self._hold, part)
        part = part if self.stage is Stage.POSE else 1.0
        return self._pd(self._hold + part * (self._pose - self._hold))

    def _pd(self, target: np.ndarray, stiffness: float = 1.0, damping: float = 1.0) -> MotorCommand:
        """Command of target angles (10,), with fractions of the robot's gains."""
        zero = np.zeros(len(target))
        return MotorCommand(
            zero, target, zero, stiffness * CASSIE.stiffness, damping * CASSIE.damping
        )


def _lost(estimate: Mapping[str, np.ndarray]) -> str:
    """Entries of an estimate that no robot can have, as text; empty for none."""
    lost = {
        name: np.round(estimate[name].astype(np.float64), 3).tolist()
        for name in lost_entries(estimate)
    }
    return f"estimates are lost or impossible: {lost}" if lost else ""


def tilt(orientation: np.ndarray) -> float:
    """Angle between the z axis of a frame and the vertical [rad].

    Args:
        orientation: frame to world, (4,) wxyz, of any length.
    """
    w, x, y, z = orientation.astype(np.float64) / max(float(np.linalg.norm(orientation)), 1e-12)
    return math.acos(min(max(w * w - x * x - y * y + z * z, -1.0), 1.0))
