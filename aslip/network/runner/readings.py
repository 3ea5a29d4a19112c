"""Conversion of a robot's packets to readings of `Supervisor`, and of motor commands to packets.

In PD mode the robot estimates its state, `state_out_t`, and closes the PD loop, `pd_in_t`. In raw
mode it sends sensor readings, `cassie_out_t`, and takes torques, `cassie_user_in_t`: estimator and
PD law run here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from aslip.control.estimates import POSITION
from aslip.network.runner.supervisor import Reading
from aslip.network.wire import (
    CASSIE_OUT,
    ESTIMATE_ENTRIES,
    PD_IN,
    STATE_OUT,
    USER_IN,
    MotorCommand,
    cassie_out_to_sensors,
    command_to_pd_in,
    state_out_to_estimate,
    torque_to_user_in,
)
from aslip.robot import CASSIE
from aslip.robot.robot import is_possible

if TYPE_CHECKING:
    from aslip.estimation import Estimate, Tracking

# longest gap that is filled with lost packets [packets of the estimator]
_LONGEST_GAP = 40
# readings of the IMU that are estimates under another name
_ESTIMATED = {"gyro": "angular_velocity", "accelerometer": "acceleration"}


class StateReadings:
    """Readings from packets `state_out_t` of robots that estimate their own state."""

    receives, sends = STATE_OUT, PD_IN
    newest_only = True
    """True if only the newest of several packets matters."""

    def __init__(self) -> None:
        self._newest: tuple[float, np.ndarray] | None = None

    def take(self, time: float, step: int, record: np.ndarray) -> None:
        """Take a packet.

        Args:
            time: time of arrival [s].
            step: difference of its sequence number from that of the last packet; 0 for the first.
            record: packet.
        """
        self._newest = time, record

    def newest(self) -> Reading | None:
        """Reading from the newest packet since the last call; None without any."""
        if self._newest is None:
            return None
        time, record = self._newest
        self._newest = None
        estimate = state_out_to_estimate(record)
        estimate[POSITION] = record["pelvis"]["position"].copy()
        return Reading(time, estimate, record["radio"]["channel"].copy())

    def answer(self, command: MotorCommand) -> np.ndarray:
        """Targets and gains for the PD loop of the robot."""
        return command_to_pd_in(
            command.position,
            command.stiffness,
            command.damping,
            torque=command.torque,
            velocity=command.velocity,
        )


class SensorReadings:
    """Readings from packets `cassie_out_t`, with the state estimator that training uses.

    A robot sends at 2 kHz; the estimator takes every sixth packet, with the mean specific force of
    the six. Lost packets are noticed by their sequence numbers. Until all readings of a packet are
    finite and possible, estimates from the others are NaN.

    """

    receives, sends, newest_only = CASSIE_OUT, USER_IN, False

    def __init__(self) -> None:
        # imported late: compiled by Numba, and not needed in PD mode
        from aslip.estimation import StateEstimator
        from aslip.estimation.packets import join

        self._joined = join
        self._estimator = StateEstimator()
        self._tracking: Tracking | None = None
        self._estimate: Estimate | None = None
        self._tick = 0
        self._force: list[np.ndarray] = []
        self._record: np.ndarray | None = None
        self._arrived: float | None = None
        self._lost: list[str] = []
        self._packets: list[np.ndarray] = []
        # compiled functions load at their first call, which takes seconds
        tracking, _ = self._estimator.start(np.full(CASSIE.packet_size, np.nan))
        self._estimator.update(tracking, None)

    def take(self, time: float, step: int, record: np.ndarray) -> None:
        """Take a packet; estimate the state if it completes a packet of the estimator."""
        every = CASSIE.packet_substeps
        self._arrived, self._record = time, record
        if self._tracking is None:
            self._start(cassie_out_to_sensors(record))
            return
        before, self._tick = self._tick // every, self._tick + max(step, 1)
        due = min(self._tick // every - before, _LONGEST_GAP)
        for _ in range(due - 1):
            self._update(None)
        self._force.append(record["pelvis"]["vector_nav"]["linear_acceleration"])
        if due:
            self._update(cassie_out_to_sensors(record))

    def newest(self) -> Reading | None:
        """Reading from the packets since the last call; None without any."""
        if self._arrived is None or self._estimate is None or self._record is None:
            return None
        time, self._arrived = self._arrived, None
        packets = np.array(self._packets).reshape(-1, CASSIE.packet_size)
        self._packets.clear()
        names = (*ESTIMATE_ENTRIES, POSITION)
        estimate = {name: getattr(self._estimate, name)[0] for name in names}
        estimate |= {name: estimate[name] * np.nan for name in self._lost}
        channels = self._record["pelvis"]["radio"]["channel"].copy()
        return Reading(time, estimate, channels, packets)

    def answer(self, command: MotorCommand) -> np.ndarray:
        """Torques of the PD law at the newest packet; zero before the first one."""
        if self._record is None:
            return torque_to_user_in(np.zeros(len(CASSIE.motor_names)))
        legs = [self._record[f"{side}_leg"]["drives"] for side in ("left", "right")]
        position, velocity = (
            np.concatenate([leg[kind] for leg in legs]) for kind in ("position", "velocity")
        )
        feedback = (command.position - position) * command.stiffness
        feedback += (command.velocity - velocity) * command.damping
        return torque_to_user_in(feedback + command.torque)

    def _start(self, sensors: dict[str, np.ndarray]) -> None:
        """Start to track the robot with its first packet without lost readings."""
        # heading zero: the frame of the IMU's attitude
        tracking, self._estimate = self._estimator.start(sensors, heading=0.0)
        lost = [name for name, values in sensors.items() if not is_possible(name, values)]
        self._lost = [_ESTIMATED.get(name, name) for name in lost]
        self._tracking = None if lost else tracking
        self._packets = [self._joined(sensors)]

    def _update(self, sensors: dict[str, np.ndarray] | None) -> None:
        """Update the estimate with a packet, or with a lost one."""
        assert self._tracking is not None
        if sensors is not None:
            mean = np.mean(self._force, axis=0, dtype=np.float64).astype(np.float32)
            # NaN marks a bad IMU
            sensors["accelerometer"] = mean + 0 * sensors["accelerometer"]
            self._force.clear()
            self._packets.append(self._joined(sensors))
        else:
            self._packets.append(np.full(CASSIE.packet_size, np.nan))
        self._estimate = self._estimator.update(self._tracking, sensors)


Readings = StateReadings | SensorReadings
"""Interpretation of a robot's packets in one mode."""
