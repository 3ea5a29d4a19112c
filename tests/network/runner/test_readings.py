"""Packets of both modes to the same readings, and commands to packets."""

import numpy as np
import pytest

from aslip.control.estimates import standing_estimate
from aslip.estimation import StateEstimator
from aslip.network.runner.readings import Readings, SensorReadings, StateReadings
from aslip.network.twin import TwinRobot
from aslip.network.wire import (
    MotorCommand,
    command_to_pd_in,
    estimate_to_state_out,
    sensors_to_cassie_out,
    user_in_to_torque,
)
from aslip.robot import CASSIE
from aslip.sim import PD

RNG = np.random.default_rng(0)
STANDING = CASSIE.standing[CASSIE.indices.motor_qpos]


def sensors(**entries: np.ndarray) -> dict[str, np.ndarray]:
    """Packet of a robot that stands, with other entries."""
    estimate = standing_estimate()
    packet = {name: np.zeros(size) for name, size in CASSIE.packet_sizes.items()}
    packet |= {name: estimate[name] for name in ("motor_position", "joint_position", "orientation")}
    return {**packet, "accelerometer": np.array([0, 0, 9.81]), **entries}


@pytest.mark.parametrize("make", [StateReadings, SensorReadings])
def test_there_is_a_reading_per_new_packet(make: type[Readings]) -> None:
    readings = make()
    records = {
        StateReadings: estimate_to_state_out(standing_estimate()),
        SensorReadings: sensors_to_cassie_out(sensors()),
    }
    assert readings.newest() is None
    readings.take(0.5, 0, records[make])
    reading = readings.newest()
    assert reading is not None
    assert (reading.time, reading.channels[8]) == (0.5, 1.0)
    np.testing.assert_allclose(reading.estimate["motor_position"], STANDING, rtol=1e-6)
    assert readings.newest() is None


def test_sensors_give_the_estimates_of_the_robot_itself() -> None:
    """The twin's own estimate, of the same readings, every sixth tick."""
    twin, readings, states = TwinRobot(), SensorReadings(), StateReadings()
    for tick in range(25):
        states.take(0.0, 1, twin.tick(command_to_pd_in(STANDING)))
        readings.take(0.0, int(tick > 0), sensors_to_cassie_out(twin.packet()))
        ours, theirs = readings.newest(), states.newest()
        assert ours is not None
        assert theirs is not None
        for name, value in theirs.estimate.items():
            np.testing.assert_allclose(
                ours.estimate[name].astype(np.float32), value, rtol=0, atol=1e-6, err_msg=name
            )


def test_lost_packets_of_sensors_are_lost_packets_of_the_estimator() -> None:
    estimator, readings = StateEstimator(), SensorReadings()
    packets = [sensors(gyro=RNG.normal(size=3) * 0.01) for _ in range(3)]
    single = [{name: value.astype(np.float32) for name, value in p.items()} for p in packets]
    tracking, _ = estimator.start(single[0], heading=0.0)
    for packet in (single[1], None, None, single[2]):
        expected = estimator.update(tracking, packet)
    for step, packet in zip((0, 6, 18), packets, strict=True):
        readings.take(0.0, step, sensors_to_cassie_out(packet))
    reading = readings.newest()
    assert reading is not None
    np.testing.assert_array_equal(reading.estimate["velocity"], expected.velocity[0])


def test_a_bad_imu_is_a_fault_of_its_readings() -> None:
    readings = SensorReadings()
    for k in range(7):
        record = sensors_to_cassie_out(sensors())
        record["pelvis"]["vector_nav"]["data_good"] = k == 0
        readings.take(0.0, int(k > 0), record)
    reading = readings.newest()
    assert reading is not None
    assert all(np.isfinite(value).all() for value in reading.estimate.values())
    assert readings._estimate is not None
    assert readings._estimate.faults[0, 0]


def test_a_robot_is_tracked_from_its_first_packet_without_lost_readings() -> None:
    readings, seen = SensorReadings(), []
    for orientation in (np.zeros(4), np.array([1.0, 0.0, 0.0, 0.0])):
        readings.take(0.0, 1, sensors_to_cassie_out(sensors(orientation=orientation)))
        reading = readings.newest()
        assert reading is not None
        seen.append([name for name, x in reading.estimate.items() if not np.isfinite(x).all()])
    assert seen == [["orientation"], []]


def test_torques_of_raw_mode_are_those_of_the_robot_s_pd_loop() -> None:
    """Feedforward and the damping of a target velocity are added."""
    rows = RNG.normal(size=(5, 10)).astype(np.float32).astype(np.float64)
    position, velocity, target, feedforward, speed = rows
    readings = SensorReadings()
    command = MotorCommand(feedforward, target, speed, CASSIE.stiffness, CASSIE.damping)
    assert not user_in_to_torque(readings.answer(command)).any()
    packet = sensors(motor_position=position, motor_velocity=velocity)
    readings.take(0.0, 0, sensors_to_cassie_out(packet))
    torque = user_in_to_torque(readings.answer(command))
    expected = PD(1).joint_torque(target[None], position[None], velocity[None])[0]
    expected += feedforward + CASSIE.damping * speed
    np.testing.assert_allclose(torque, expected, rtol=1e-6)
