"""Faults of packets are found, reported and bridged."""

import numpy as np
import pytest

from aslip.errors import ShapeError, UnknownNameError
from aslip.estimation import FAULTS, StateEstimator
from aslip.estimation.estimator import _standing
from aslip.estimation.packets import join
from aslip.robot import CASSIE
from tests.estimation.walks import ACCELEROMETER, AT, GYRO, ROBOTS, SPOILED, Spoil, Walk, follow


def _set(channels: slice, value: float, packets: slice, *, add: bool = False) -> Spoil:
    def spoil(step: int, windows: np.ndarray) -> np.ndarray:
        if step == SPOILED:
            window = windows[1, packets]
            window[..., channels] = value + (window[..., channels] if add else 0.0)
        return windows

    return spoil


def _freeze(step: int, windows: np.ndarray) -> np.ndarray:
    if step == SPOILED:
        windows[1, 3:6] = windows[1, 2]
    return windows


IMU = slice(GYRO.start, CASSIE.packet_size)
ENCODERS = slice(0, AT["orientation"].start)
ONE_GYRO = slice(GYRO.start + 1, GYRO.start + 2)
ONE_JOINT = slice(AT["joint_position"].start + 4, AT["joint_position"].start + 5)


def _stream(walk: Walk) -> np.ndarray:
    """(k, 42) packets of robot 1 from its reset on."""
    return walk.packets[1].reshape(-1, CASSIE.packet_size)[CASSIE.sensor_window - 1 :].copy()


@pytest.mark.parametrize(
    ("fault", "spoil"),
    [
        pytest.param("missing", _set(slice(None), np.nan, slice(4, 5)), id="packet lost"),
        pytest.param("missing", _set(slice(None), np.nan, slice(0, 10)), id="ten packets lost"),
        pytest.param("missing", _set(ONE_JOINT, np.nan, slice(2, 6)), id="NaN of an encoder"),
        pytest.param("missing", _set(ONE_GYRO, np.nan, slice(2, 3)), id="NaN of the gyro"),
        pytest.param(
            "missing", _set(AT["orientation"], np.nan, slice(2, 4)), id="NaN of the attitude"
        ),
        pytest.param("frozen", _freeze, id="frozen packets"),
        pytest.param(
            "implausible", _set(ACCELEROMETER, 500.0, slice(5, 6)), id="spike beyond the range"
        ),
        pytest.param(
            "jump", _set(ACCELEROMETER, 70.0, slice(5, 6), add=True), id="spike within the range"
        ),
        pytest.param("jump", _set(ONE_GYRO, 10.0, slice(5, 6), add=True), id="spike of the gyro"),
        pytest.param("implausible", _set(ONE_JOINT, 40.0, slice(5, 6)), id="encoder out of range"),
        pytest.param(
            "implausible", _set(AT["orientation"], 0.1, slice(5, 6)), id="no unit quaternion"
        ),
    ],
)
def test_faults_are_reported_bridged_and_affect_one_robot_only(
    walk: Walk, sound: list[dict[str, np.ndarray]], fault: str, spoil: Spoil
) -> None:
    estimates = follow(walk, spoil)
    for step, (ours, theirs) in enumerate(zip(sound, estimates, strict=True)):
        for name, value in theirs.items():
            assert np.isfinite(value).all(), (step, name)
            np.testing.assert_array_equal(value[[0, 2]], ours[name][[0, 2]], err_msg=name)
        found = [name for name, flag in zip(FAULTS, theirs["faults"][1], strict=True) if flag]
        assert found == ([fault] if step == SPOILED else [])
    # errors are at most those after a start, and vanish within ten policy steps
    off = np.array(
        [e["velocity"][1] - s["velocity"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(off[SPOILED:]).max() < 0.3
    assert np.abs(off[SPOILED + 10 :]).max() < 0.03
    rise = np.array(
        [e["height"][1] - s["height"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(rise[SPOILED + 10 :]).max() < 2e-3


def test_short_spikes_are_always_rejected() -> None:
    """Any number of spikes, each followed by a good packet."""
    packet, estimator = _standing(CASSIE), StateEstimator()
    tracking, _ = estimator.start(packet)
    for k in range(40):
        packet[GYRO] = 10.0 * (k % 2) + 1e-6 * k
        estimate = estimator.update(tracking, packet)
        assert estimate.faults[0].tolist() == [False, False, k % 2 == 1, False]
        assert np.abs(estimate.angular_velocity).max() < 1e-3


def test_one_leg_suffices_when_an_encoder_of_the_other_fails(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    def spoil(step: int, windows: np.ndarray) -> np.ndarray:
        if step >= SPOILED:
            windows[1, :, ONE_JOINT] = np.nan
        return windows

    estimates = follow(walk, spoil)
    held = [estimate["joint_position"][1, 4] for estimate in estimates[SPOILED:]]
    assert len(set(held)) == 1
    assert all(estimate["faults"][1].tolist() == [True, False, False, False]
               for estimate in estimates[SPOILED:])  # fmt: skip
    off = np.array(
        [e["velocity"][1] - s["velocity"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(off[SPOILED:]).max() < 0.3


def test_estimates_converge_after_a_start_without_readings(walk: Walk) -> None:
    """The estimator assumes a standing robot until good packets come."""
    estimator = StateEstimator()
    tracking, first = estimator.start(np.full((ROBOTS, 1, CASSIE.packet_size), np.nan))
    assert np.isfinite(first.velocity).all()
    assert first.faults.tolist() == [[True, False, False, False]] * ROBOTS
    for step in range(1, 40):
        estimate = estimator.update(tracking, walk.packets[:, step])
    np.testing.assert_allclose(estimate.velocity, walk.velocity[:, 39], atol=0.1)


def test_frozen_imu_does_not_affect_encoder_readings(walk: Walk) -> None:
    packets = _stream(walk)
    packets[100:, IMU] = packets[99, IMU]
    estimator = StateEstimator()
    tracking, _ = estimator.start(packets[0])
    for packet in packets[1:160]:
        estimate = estimator.update(tracking, packet)
    assert estimate.faults[0].tolist() == [False, False, False, True]
    encoders = np.concatenate([
        estimate.motor_position, estimate.motor_velocity,
        estimate.joint_position, estimate.joint_velocity,
    ], axis=1)  # fmt: skip
    np.testing.assert_array_equal(encoders[0], packets[159, ENCODERS])
    np.testing.assert_array_equal(estimate.angular_velocity[0], packets[99, GYRO])


def test_frozen_packets_give_no_measurement_of_the_legs() -> None:
    """Encoders that freeze together with the IMU have no new readings."""
    packet, estimator = _standing(CASSIE), StateEstimator()
    packet[AT["joint_position"]][[0, 3]] = -0.06
    tracking, _ = estimator.start(packet)
    for k in range(1, 20):
        packet[GYRO] = 1e-6 * (k % 2)
        assert estimator.update(tracking, packet).resting.all()
    resting = [estimator.update(tracking, packet).resting.any() for _ in range(10)]
    assert resting == [True] + [False] * 9


def test_imu_slower_than_the_packets_is_not_a_fault(walk: Walk) -> None:
    """With a new value in every second packet, 167 Hz, contacts and velocity stay accurate."""
    packets = _stream(walk)
    mean = (packets[1:-1:2, ACCELEROMETER] + packets[2::2, ACCELEROMETER]) / 2
    packets[2::2, ACCELEROMETER] = mean
    packets[1::2, AT["orientation"].start :] = packets[:-1:2, AT["orientation"].start :]
    packets[1, IMU.stop - 1] += 1e-3  # the accelerometer of the first packet is no mean
    estimator = StateEstimator()
    tracking, _ = estimator.start(packets[0])
    resting, errors = [], []
    for k, packet in enumerate(packets[1:], 1):
        estimate = estimator.update(tracking, packet)
        assert not estimate.faults.any()
        resting.append(estimate.resting.any())
        if k % CASSIE.sensor_window == 0:
            errors.append(estimate.velocity[0] - walk.velocity[1, k // CASSIE.sensor_window])
    assert np.mean(resting) > 0.8
    assert (np.sqrt(np.mean(np.square(errors[12:]), 0)) < [0.06, 0.06, 0.04]).all()


def test_faults_are_timed_in_seconds() -> None:
    """An IMU may repeat itself for 5 ms, and jumps are accepted after 9 ms."""
    packet, estimator = _standing(CASSIE), StateEstimator()
    tracking, _ = estimator.start(packet)
    frozen = [bool(estimator.update(tracking, packet).faults[0, 3]) for _ in range(5)]
    assert frozen == [False, True, True, True, True]
    jump = []
    for k in range(5):
        packet[GYRO] = 10.0 + 1e-3 * k
        jump.append(bool(estimator.update(tracking, packet).faults[0, 2]))
    assert jump == [True, True, True, False, False]


def test_packets_without_an_entry_are_refused() -> None:
    packet = {name: np.zeros(size) for name, size in CASSIE.packet_sizes.items()}
    assert join(packet).shape == (CASSIE.packet_size,)
    with pytest.raises(UnknownNameError, match="'gyro' is missing"):
        join({name: value for name, value in packet.items() if name != "gyro"})
    with pytest.raises(ShapeError, match=r"orientation.*4 numbers.*\(3,\)"):
        join(packet | {"orientation": np.zeros(3)})
