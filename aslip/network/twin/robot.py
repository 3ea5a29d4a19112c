"""Simulated robot that advances by single ticks of the robot's 2 kHz loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from aslip.errors import ConfigurationError
from aslip.estimation import Estimate, StateEstimator, Tracking
from aslip.network.twin.drive import CommandedPD
from aslip.network.twin.engine import MakeEngine, mujoco_engine
from aslip.network.twin.guide import Guide
from aslip.network.wire import (
    CASSIE_OUT,
    ESTIMATE_ENTRIES,
    PD_IN,
    STATE_OUT,
    STOP_CHANNEL,
    USER_IN,
    MotorCommand,
    estimate_to_state_out,
    pd_in_to_command,
    sensors_to_cassie_out,
    user_in_to_torque,
)
from aslip.robot import CASSIE
from aslip.sim import true_state


class TwinRobot:
    """Simulated robot that exchanges packets of the network protocol, tick by tick.

    In PD mode it takes `pd_in_t` and returns `state_out_t`; in raw mode it takes joint torques,
    `cassie_user_in_t`, and returns all sensor readings, `cassie_out_t`.

    A tick is 0.5 ms: PD with the gains of the packet on the last readings, motor limits, torque
    delay, readings, physics, estimate. Physics, sensors and torque delay are those of
    `aslip.sim.Simulations`: sixty ticks in PD mode equal one policy period bit for bit.

    The estimator of PD mode takes a packet every sixth tick, in single precision and with the mean
    specific force of six ticks, as in training; `state_out_t` has the estimate of the last packet.
    Its world is the frame of the IMU's attitude, with the origin on the ground below the pelvis at
    the first tick. In raw mode each tick has its own readings.

    A simulation that diverges restarts from standing, and so does its estimate.

    Args:
        make_engine: function of robot and drive that makes the simulation; by default MuJoCo's.
        raw: raw mode, with torques and sensor readings instead of PD commands and estimates.
    """

    def __init__(self, make_engine: MakeEngine = mujoco_engine, *, raw: bool = False) -> None:
        self.ticks = 0
        """Ticks since the robot was set on its feet."""
        self.receives, self.sends = (USER_IN, CASSIE_OUT) if raw else (PD_IN, STATE_OUT)
        self.radio = np.zeros(16, np.float32)
        """(16,) channels of the operator's radio, -1 to 1. With channel 8 below 0, the emergency
        stop, the motors get no torque."""
        self.radio[STOP_CHANNEL] = 1.0
        self.guide: Guide | None = None
        """Guide that sends stones and commands to the runner before each of its policy steps."""
        self._raw = raw
        tick = replace(CASSIE, substeps=1, packet_substeps=1)
        self._engine = make_engine(tick, CommandedPD)
        self._estimator = StateEstimator()
        self._tracking: Tracking | None = None
        # estimate of the last packet
        self._state = self._first_state()
        # specific forces since the last packet of the estimator
        self._force: list[np.ndarray] = []
        self._command = np.zeros((1, len(MotorCommand._fields) * CASSIE.damping.size))
        self._push, self._push_ticks = np.zeros((1, 3)), 0

    @property
    def divergences(self) -> int:
        """Number of times that the simulation diverged and started anew."""
        return self._engine.divergences

    @property
    def standing(self) -> bool:
        """Whether the robot stands as it was set on its feet, before the first tick."""
        return self.ticks == 0

    @property
    def idle(self) -> bool:
        """Whether the present command has no effect: neither torques nor gains."""
        torque, _, _, stiffness, damping = np.split(self._command[0], len(MotorCommand._fields))
        return not (torque.any() or stiffness.any() or damping.any())

    @property
    def stopped(self) -> bool:
        """Whether the operator's emergency stop is pressed."""
        return bool(self.radio[STOP_CHANNEL] < 0)

    def packet(self) -> dict[str, np.ndarray]:
        """Readings of the last tick: entries of `Robot.packet_sizes`, (k,) in single precision."""
        return {name: value.astype(np.float32) for name, value in self._readings().items()}

    def states(self) -> np.ndarray:
        """(1, k) complete state of the simulation; see `aslip.sim.Simulations.states`."""
        return self._engine.states()

    def truth(self) -> dict[str, np.ndarray]:
        """True state (1, k) after the last tick; see `aslip.sim.true_state`."""
        return true_state(self._engine.snapshot(), CASSIE.indices)

    def reset(self) -> None:
        """Set the robot on its feet, at rest and without a command, where it first stood."""
        self._engine.stand()
        self._tracking, self._push_ticks, self.ticks = None, 0, 0
        self._command[:] = 0.0
        self._state = self._first_state()

    def push(self, force: Sequence[float] | np.ndarray, duration: float) -> None:
        """Push the pelvis from the next tick on; replaces the current push.

        Args:
            force: (3,) force [N, world].
            duration: duration [s], rounded to ticks.

        Raises:
            ConfigurationError: the force is not three finite numbers, or the duration not positive.
        """
        vector = np.asarray(force, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise ConfigurationError(f"a push needs three finite forces [N], got {force!r}")
        if not 0 < duration < math.inf:
            raise ConfigurationError(f"a push needs a positive duration [s], got {duration!r}")
        self._push[0] = vector
        self._push_ticks = max(round(duration / CASSIE.physics_timestep), 1)

    def take(self, command: np.ndarray) -> None:
        """Keep a command, a record of `receives`, for the next ticks."""
        if self._raw:
            self._command[0, : CASSIE.damping.size] = user_in_to_torque(command)
            self._command[0, CASSIE.damping.size :] = 0.0
        else:
            np.concatenate(pd_in_to_command(command), out=self._command[0])

    def damp(self) -> None:
        """Replace the command by the robot's damping gains alone."""
        self._command[:] = 0.0
        self._command[0, -CASSIE.damping.size :] = CASSIE.damping

    def tick(self, command: np.ndarray | None = None) -> np.ndarray:
        """Advance by 0.5 ms.

        Args:
            command: record of `receives`, all numbers finite; the last one by default.

        Returns:
            Record of `sends`.
        """
        if command is not None:
            self.take(command)
        numbers = np.zeros_like(self._command) if self.stopped else self._command
        push = self._push if self._push_ticks else None
        self._push_ticks = max(self._push_ticks - 1, 0)
        diverged = self._engine.advance(numbers, push)
        self.ticks += 1
        if self.guide is not None and self.ticks % CASSIE.substeps == 1:
            at, qpos = CASSIE.indices, self.truth()["qpos"][0]
            self.guide.send(qpos[at.pelvis_position], qpos[at.pelvis_orientation])
        if diverged[0]:
            self._tracking = None
        if not self._raw:
            self._track(self._readings())
        return self.answer()

    def answer(self) -> np.ndarray:
        """Record of `sends` after the last tick, or of the robot as it stands before the first."""
        torque = self._engine.motor_torque[0]
        if self._raw:
            record = sensors_to_cassie_out(self._readings(), torque)
            radio = record["pelvis"]["radio"]
        else:
            # a copy of the bytes: that of the record takes fifteen times as long
            record = STATE_OUT.unpack(STATE_OUT.pack(self._state))
            record["motor"]["torque"][:] = torque
            radio = record["radio"]
        radio["channel"][:] = self.radio
        return record

    def _first_state(self) -> np.ndarray:
        """`state_out_t` of the robot as it stands."""
        # heading zero: the frame of the IMU's attitude
        return _state_out(self._estimator.start(self.packet(), heading=0.0)[1])

    def _readings(self) -> dict[str, np.ndarray]:
        """Live readings of the last tick in double precision."""
        return {name: value[0, 0] for name, value in self._engine.sensors.packets().items()}

    def _track(self, readings: dict[str, np.ndarray]) -> None:
        """Estimate the state from a tick's readings if they complete a packet of the estimator."""
        if self._tracking is None:
            self._force.clear()
            self._tracking, estimate = self._estimator.start(self.packet(), heading=0.0)
        else:
            self._force.append(readings["accelerometer"].copy())
            if len(self._force) < CASSIE.packet_substeps:
                return
            mean = np.sum(self._force, axis=0) / len(self._force)
            self._force.clear()
            packet = {**self.packet(), "accelerometer": mean.astype(np.float32)}
            estimate = self._estimator.update(self._tracking, packet)
        self._state = _state_out(estimate)


def _state_out(estimate: Estimate) -> np.ndarray:
    """Record of an estimate of one robot."""
    return estimate_to_state_out(
        {name: getattr(estimate, name)[0] for name in ESTIMATE_ENTRIES},
        position=estimate.position[0],
        feet=estimate.foot_position[0],
    )
