"""Packets of the wire against sensor packets, estimates and motor targets: values and orders."""

from typing import Any

import numpy as np
import pytest

from aslip.errors import ShapeError, UnknownNameError
from aslip.estimation import StateEstimator
from aslip.network.wire import (
    CASSIE_OUT,
    PD_IN,
    STATE_OUT,
    cassie_out_to_sensors,
    command_to_pd_in,
    estimate_to_state_out,
    pd_in_to_command,
    sensors_to_cassie_out,
    state_out_to_estimate,
    torque_to_user_in,
    user_in_to_torque,
)
from aslip.robot import CASSIE
from aslip.robot.rotation import quaternion_to_matrix, rotate
from aslip.sim import Simulations
from aslip.transforms.estimate import ESTIMATE_SIZES

SHAPES = pytest.mark.parametrize("shape", [(), (3,), (2, 10)])


def _random(sizes: Any, shape: tuple[int, ...], dtype: type = np.float32) -> dict[str, np.ndarray]:
    """Random entries; orientations are unit quaternions with w >= 0."""
    rng = np.random.default_rng(5)
    entries = {name: rng.normal(size=(*shape, size)) for name, size in sizes.items()}
    turn = entries["orientation"]
    turn /= np.linalg.norm(turn, axis=-1, keepdims=True)
    turn[..., 0] = np.abs(turn[..., 0])
    return {name: value.astype(dtype) for name, value in entries.items()}


def _assert_equal(ours: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert ours.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(ours[name], value, err_msg=name)


@SHAPES
def test_sensor_packets_in_single_precision_return_exactly(shape: tuple[int, ...]) -> None:
    sensors = _random(CASSIE.packet_sizes, shape)
    _assert_equal(cassie_out_to_sensors(sensors_to_cassie_out(sensors)), sensors)


def test_a_simulation_s_sensor_packets_return_rounded_once() -> None:
    simulation = Simulations(1, num_threads=1)
    simulation.advance(CASSIE.standing[CASSIE.indices.motor_qpos][None])
    sensors = simulation.sensors.packets()
    rounded = {name: value.astype(np.float32) for name, value in sensors.items()}
    _assert_equal(cassie_out_to_sensors(sensors_to_cassie_out(sensors)), rounded)


def test_readings_are_in_the_order_of_the_wire() -> None:
    sensors = {name: np.arange(float(size)) for name, size in CASSIE.packet_sizes.items()}
    out = sensors_to_cassie_out(sensors, np.arange(10.0) + 20)
    right = out["right_leg"]
    np.testing.assert_array_equal(out["left_leg"]["drives"]["position"], [0, 1, 2, 3, 4])
    np.testing.assert_array_equal(right["drives"]["velocity"], [5, 6, 7, 8, 9])
    np.testing.assert_array_equal(right["drives"]["torque"], [25, 26, 27, 28, 29])
    np.testing.assert_array_equal(right["joints"]["position"], [3, 4, 5])
    np.testing.assert_array_equal(right["drives"]["gear_ratio"], [25, 25, 16, 16, 50])
    np.testing.assert_allclose(right["drives"]["torque_limit"], [112.5, 112.5, 195.2, 195.2, 45])
    imu = out["pelvis"]["vector_nav"]
    np.testing.assert_array_equal(imu["orientation"], [0, 1, 2, 3])
    np.testing.assert_array_equal(imu["angular_velocity"], [0, 1, 2])
    assert imu["data_good"]
    assert out["is_calibrated"]


def test_orientations_come_with_w_positive() -> None:
    sensors = _random(CASSIE.packet_sizes, (3,))
    out = sensors_to_cassie_out(sensors)
    out["pelvis"]["vector_nav"]["orientation"] *= -1
    _assert_equal(cassie_out_to_sensors(out), sensors)


def test_readings_of_a_bad_imu_are_nan() -> None:
    sensors = _random(CASSIE.packet_sizes, (2,))
    out = sensors_to_cassie_out(sensors)
    out["pelvis"]["vector_nav"]["data_good"][1] = False
    read = cassie_out_to_sensors(out)
    for name in ("orientation", "gyro", "accelerometer"):
        np.testing.assert_array_equal(read[name][0], sensors[name][0])
        assert np.isnan(read[name][1]).all()
    assert np.isfinite(read["motor_position"]).all()


def test_read_sensors_have_their_own_memory() -> None:
    out = CASSIE_OUT.zeros(2)
    for value in cassie_out_to_sensors(out).values():
        value[...] = 1.0
    assert out.tobytes() == CASSIE_OUT.zeros(2).tobytes()


@SHAPES
def test_estimates_in_single_precision_return_exactly(shape: tuple[int, ...]) -> None:
    estimate = _random(ESTIMATE_SIZES, shape)
    _assert_equal(state_out_to_estimate(estimate_to_state_out(estimate)), estimate)


def test_heights_are_above_the_terrain() -> None:
    out = STATE_OUT.zeros()
    out["pelvis"]["position"][2], out["terrain"]["height"] = 1.25, 0.5
    np.testing.assert_array_equal(state_out_to_estimate(out)["height"], [0.75])


def test_feet_are_relative_to_the_pelvis_in_its_axes() -> None:
    estimator = StateEstimator()
    packet = _random(CASSIE.packet_sizes, (), np.float64)
    packet["motor_position"] = CASSIE.standing[CASSIE.indices.motor_qpos]
    packet["joint_position"] = CASSIE.standing[CASSIE.indices.joint_qpos]
    _, found = estimator.start(packet)
    estimate = {name: getattr(found, name) for name in ESTIMATE_SIZES}
    out = estimate_to_state_out(estimate, position=found.position, feet=found.foot_position)
    turn = quaternion_to_matrix(out["pelvis"]["orientation"])
    for i, side in enumerate(("left", "right")):
        foot = rotate(turn, out[f"{side}_foot"]["position"]) + out["pelvis"]["position"]
        np.testing.assert_allclose(foot, found.foot_position[:, i], atol=1e-6)


def test_states_release_the_emergency_stop() -> None:
    estimate, sensors = _random(ESTIMATE_SIZES, ()), _random(CASSIE.packet_sizes, ())
    radio = estimate_to_state_out(estimate)["radio"]
    raw = sensors_to_cassie_out(sensors)["pelvis"]["radio"]
    assert radio["channel"][8] == raw["channel"][8] == 1.0
    assert radio["signal_good"]
    assert raw["receiver_signal_good"]


@SHAPES
def test_commands_in_single_precision_return_exactly(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(6)
    torque, target, velocity, stiffness, damping = rng.normal(size=(5, *shape, 10)).astype("f4")
    out = command_to_pd_in(target, stiffness, damping, torque=torque, velocity=velocity)
    for ours, expected in zip(
        pd_in_to_command(out), (torque, target, velocity, stiffness, damping), strict=True
    ):
        np.testing.assert_array_equal(ours, expected)
    np.testing.assert_array_equal(user_in_to_torque(torque_to_user_in(torque)), torque)


def test_targets_are_in_the_order_of_the_wire() -> None:
    """Numbers of `pd_in_t`: a leg's motor part begins at 30, the right leg at 55."""
    numbers = np.frombuffer(PD_IN.pack(command_to_pd_in(np.arange(10.0) + 1)), "<f4")
    expected = np.zeros(119, np.float32)
    for start, first in ((30, 1), (85, 6)):
        expected[start + 5 : start + 10] = np.arange(first, first + 5)
        expected[start + 15 : start + 20] = [100, 100, 88, 96, 50]
        expected[start + 20 : start + 25] = [10, 10, 8, 9.6, 5]
    np.testing.assert_array_equal(numbers, expected)


def test_missing_entries_are_named() -> None:
    sensors = _random(CASSIE.packet_sizes, ())
    del sensors["gyro"]
    with pytest.raises(UnknownNameError, match="'gyro' is missing"):
        sensors_to_cassie_out(sensors)


def test_arrays_of_the_wrong_shape_are_refused() -> None:
    estimate = _random(ESTIMATE_SIZES, ())
    with pytest.raises(ShapeError, match="position must have 10 numbers"):
        command_to_pd_in(np.zeros(9))
    with pytest.raises(ShapeError, match="stiffness must fit"):
        command_to_pd_in(np.zeros(10), np.zeros(9))
    with pytest.raises(ShapeError, match="feet need the position"):
        estimate_to_state_out(estimate, feet=np.zeros((2, 3)))
