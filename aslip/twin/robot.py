"""Simulated robot that advances by single ticks of the robot's 2 kHz loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from aslip.estimation import StateEstimator, Tracking
from aslip.robot import CASSIE, Robot
from aslip.sim import true_state
from aslip.twin.drive import CommandedPD
from aslip.twin.engine import MakeEngine, mujoco_engine
from aslip.wire import ESTIMATE_ENTRIES, STATE_OUT, estimate_to_state_out, pd_in_to_command


class TwinRobot:
    """Simulated robot that takes `pd_in_t` and gives `state_out_t`, tick by tick.

    A tick is 0.5 ms: PD with the gains of the packet on the last readings, motor limits, torque
    delay, readings, physics, estimate. Physics, sensors and torque delay are those of
    `aslip.sim.Simulations`: sixty ticks equal one policy period bit for bit.

    The estimator takes a packet every sixth tick, in single precision and with the mean specific
    force of six ticks, as in training; `state_out_t` has the estimate of the last packet. Its world
    is the frame of the IMU's attitude, with the origin on the ground below the pelvis at the first
    tick.

    A simulation that diverges starts anew, standing; so does its estimate.

    Args:
        robot: robot that is simulated.
        make_engine: function of robot and drive that makes the simulation; by default MuJoCo's.
    """

    def __init__(self, robot: Robot = CASSIE, make_engine: MakeEngine = mujoco_engine) -> None:
        self.robot = robot
        """Robot that is simulated."""
        self.ticks = 0
        """Ticks since construction."""
        tick = replace(robot, substeps=1, packet_substeps=1)
        self._engine = make_engine(tick, CommandedPD)
        self._estimator = StateEstimator(robot)
        self._tracking: Tracking | None = None
        # estimate of the last packet
        self._state = STATE_OUT.zeros()
        # specific forces since the last packet of the estimator
        self._force: list[np.ndarray] = []

    @property
    def divergences(self) -> int:
        """Number of times that the simulation diverged and started anew."""
        return self._engine.divergences

    def packet(self) -> dict[str, np.ndarray]:
        """Readings of the last tick: entries of `Robot.packet_sizes`, (k,) in single precision."""
        return {name: value.astype(np.float32) for name, value in self._readings().items()}

    def states(self) -> np.ndarray:
        """(1, k) complete state of the simulation; see `aslip.sim.Simulations.states`."""
        return self._engine.states()

    def truth(self) -> dict[str, np.ndarray]:
        """True state (1, k) after the last tick; see `aslip.sim.true_state`."""
        return true_state(self._engine.snapshot(), self.robot.indices)

    def tick(self, command: np.ndarray) -> np.ndarray:
        """Advance by 0.5 ms.

        Args:
            command: record of `aslip.wire.PD_IN`, all numbers finite.

        Returns:
            Record of `aslip.wire.STATE_OUT`.
        """
        numbers = np.concatenate(pd_in_to_command(command))[None].astype(np.float64)
        diverged = self._engine.advance(numbers)
        self.ticks += 1
        if diverged[0]:
            self._tracking = None
        self._take(self._readings())
        state = self._state.copy()
        state["motor"]["torque"][:] = self._engine.motor_torque[0]
        return state

    def _readings(self) -> dict[str, np.ndarray]:
        """Live readings of the last tick in double precision."""
        return {name: value[0, 0] for name, value in self._engine.sensors.packets().items()}

    def _take(self, readings: dict[str, np.ndarray]) -> None:
        """Estimate the state from a tick's readings if they complete a packet of the estimator."""
        if self._tracking is None:
            self._force.clear()
            # heading zero: the frame of the IMU's attitude
            self._tracking, estimate = self._estimator.start(self.packet(), heading=0.0)
        else:
            self._force.append(readings["accelerometer"].copy())
            if len(self._force) < self.robot.packet_substeps:
                return
            mean = np.sum(self._force, axis=0) / len(self._force)
            self._force.clear()
            packet = {**self.packet(), "accelerometer": mean.astype(np.float32)}
            estimate = self._estimator.update(self._tracking, packet)
        self._state = estimate_to_state_out(
            {name: getattr(estimate, name)[0] for name in ESTIMATE_ENTRIES},
            position=estimate.position[0],
            feet=estimate.foot_position[0],
        )
