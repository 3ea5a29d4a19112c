"""Estimates against the truth of a walk and against motions in closed form."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aslip.errors import ShapeError
from aslip.estimation import FilterNoise, StateEstimator, Tracking, tracking_size
from aslip.estimation.estimator import _DOUBT, _standing
from aslip.estimation.filter import LEFT, RIGHT, P, V
from aslip.robot import CASSIE
from tests.estimation.walks import AT, GYRO, ROBOTS, SPOILED, Walk, standing_packet


def test_first_estimate_has_height_and_velocity_of_a_moving_robot(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    """The estimator assumes that the lower foot rests on the ground."""
    assert np.abs(walk.velocity[:, 0]).max() > 0.5
    np.testing.assert_allclose(sound[0]["velocity"], walk.velocity[:, 0], atol=0.06)
    np.testing.assert_allclose(sound[0]["height"][:, 0], walk.height[:, 0], atol=3e-3)


def test_errors_stay_small_over_a_walk(walk: Walk, sound: list[dict[str, np.ndarray]]) -> None:
    errors = np.array([e["velocity"] - walk.velocity[:, k] for k, e in enumerate(sound)])[12:]
    assert (np.sqrt((errors**2).mean((0, 1))) < [0.03, 0.03, 0.02]).all()
    heights = np.array([e["height"][:, 0] - walk.height[:, k] for k, e in enumerate(sound)])[12:]
    assert np.sqrt((heights**2).mean()) < 2e-3
    assert not any(estimate["faults"].any() for estimate in sound)


def test_on_ground_of_any_height_the_height_counts_from_the_loaded_feet(walk: Walk) -> None:
    """Wherever the origin has drifted to."""
    estimator = StateEstimator(noise=FilterNoise(ground=math.inf))
    tracking, _ = estimator.start(walk.packets[:, 0])
    tracking.belief.mean[:, 2, [P, LEFT, RIGHT]] += 0.3
    for step in range(1, 40):
        estimate = estimator.update(tracking, walk.packets[:, step])
        np.testing.assert_allclose(estimate.height[:, 0], walk.height[:, step], atol=0.01)
    np.testing.assert_allclose(estimate.position[:, 2], 0.3 + walk.height[:, step], atol=0.02)
    np.testing.assert_allclose(estimate.velocity[:, 2], walk.velocity[:, step, 2], atol=0.02)


def test_stream_of_one_robot_equals_the_batch(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    """Packets come one by one, as on a robot; results differ by the order of sums only."""
    estimator = StateEstimator()
    packets = [
        {name: packet[AT[name]] for name in CASSIE.packet_sizes}
        for packet in walk.packets[1].reshape(-1, CASSIE.packet_size)
    ]
    tracking, estimate = estimator.start(packets[CASSIE.sensor_window - 1])
    for packet in packets[CASSIE.sensor_window :]:
        estimate = estimator.update(tracking, packet)
    for name in ("velocity", "height", "orientation", "acceleration"):
        np.testing.assert_allclose(getattr(estimate, name)[0], sound[-1][name][1], atol=1e-9)


@pytest.mark.parametrize("lost", [slice(0, 2), slice(4, 6), slice(7, 10)])
def test_windows_with_lost_packets_equal_single_packets(walk: Walk, lost: slice) -> None:
    """At any place of the lost packets in the window."""
    windows = walk.packets[1:2, :SPOILED].copy()
    windows[:, -1, lost] = np.nan
    estimator = StateEstimator()
    together, _ = estimator.start(windows[:, 0])
    alone, _ = estimator.start(windows[:, 0])
    for step in range(1, SPOILED):
        whole = estimator.update(together, windows[:, step])
        for packet in windows[0, step]:
            last = estimator.update(alone, packet)
    for name in ("velocity", "height", "acceleration"):
        np.testing.assert_allclose(getattr(whole, name), getattr(last, name), atol=1e-9)


def test_tracking_survives_conversion_to_rows(walk: Walk) -> None:
    estimator = StateEstimator()
    tracking, _ = estimator.start(walk.packets[:, 0])
    for step in range(1, 20):
        estimator.update(tracking, walk.packets[:, step])
    rows = tracking.to_rows()
    assert rows.shape == (ROBOTS, tracking_size())
    copy = Tracking.from_rows(rows)
    np.testing.assert_array_equal(copy.to_rows(), rows)
    before = rows.copy()
    ours = estimator.update(tracking, walk.packets[:, 20])
    theirs = StateEstimator().update(copy, walk.packets[:, 20])
    np.testing.assert_array_equal(ours.velocity, theirs.velocity)
    np.testing.assert_array_equal(tracking.to_rows(), copy.to_rows())
    np.testing.assert_array_equal(rows, before)  # the rows were copied


def test_later_packets_do_not_change_earlier_estimates(walk: Walk) -> None:
    """A caller that reuses the buffer of packets does not change them either."""
    estimator, buffer = StateEstimator(), walk.packets[:, 0].copy()
    tracking, first = estimator.start(buffer)
    kept = [(first, {name: np.array(value) for name, value in vars(first).items()})]
    for step in range(1, 6):
        buffer[:] = walk.packets[:, step]
        estimate = estimator.update(tracking, buffer)
        kept.append((estimate, {name: np.array(value) for name, value in vars(estimate).items()}))
    buffer[:] = np.nan
    for estimate, values in kept:
        for name, value in values.items():
            np.testing.assert_array_equal(getattr(estimate, name), value, err_msg=name)
    assert np.isfinite(tracking.to_rows()).all()


@pytest.mark.parametrize("lost", [0, 1, 3, 9])
def test_acceleration_is_right_after_lost_packets(lost: int) -> None:
    """The pelvis turns about its origin with constant acceleration, which the IMU feels."""
    arm, alpha = np.array(CASSIE.skeleton.sites["imu"].position), np.array([0.0, 30.0, 0.0])

    def packet(k: int) -> np.ndarray:
        turn = Rotation.from_rotvec(alpha * (k * CASSIE.packet_period) ** 2 / 2)
        spin = alpha * k * CASSIE.packet_period
        middle = alpha * (k - 0.5) * CASSIE.packet_period
        felt = np.cross(alpha, arm) + np.cross(middle, np.cross(middle, arm))
        return standing_packet(turn, spin, felt + turn.inv().apply([0, 0, 9.81]))

    estimator = StateEstimator()
    tracking, _ = estimator.start(packet(0))
    for k in range(1, 10):
        estimator.update(tracking, packet(k))
    for _ in range(lost):
        estimate = estimator.update(tracking, None)
        assert np.abs(estimate.acceleration).max() < 0.5
    for k in range(10 + lost, 13 + lost):
        estimate = estimator.update(tracking, packet(k))
        np.testing.assert_allclose(estimate.acceleration[0], 0.0, atol=1e-9)


def test_acceleration_is_right_after_loss_of_a_gyro_axis() -> None:
    arm, alpha = np.array(CASSIE.skeleton.sites["imu"].position), np.array([20.0, 30.0, -10.0])

    def packet(k: int) -> np.ndarray:
        spin, middle = alpha * k * CASSIE.packet_period, alpha * (k - 0.5) * CASSIE.packet_period
        felt = np.cross(alpha, arm) + np.cross(middle, np.cross(middle, arm))
        return standing_packet(Rotation.identity(), spin, felt + np.array([0, 0, 9.81]))

    estimator = StateEstimator()
    tracking, _ = estimator.start(packet(0))
    for k in range(1, 10):
        blind = packet(k)
        blind[GYRO.start] = np.nan if 4 < k < 9 else blind[GYRO.start]
        estimate = estimator.update(tracking, blind)
    np.testing.assert_allclose(estimate.acceleration[0], 0.0, atol=1e-9)


def test_orientation_is_a_unit_quaternion_with_nonnegative_w() -> None:
    turn = Rotation.from_euler("xyz", [0.1, -0.2, 0.5])
    expected = turn.as_quat(canonical=True, scalar_first=True)
    for factor in (1.0, -1.0, 1.009, -0.991):
        packet = standing_packet(turn, np.zeros(3), turn.inv().apply([0, 0, 9.81]))
        packet[AT["orientation"]] *= factor
        estimator = StateEstimator()
        tracking, first = estimator.start(packet, heading=0.0)
        packet[GYRO] += 1e-3
        later = estimator.update(tracking, packet)
        assert not later.faults.any()
        for estimate in (first, later):
            np.testing.assert_allclose(estimate.orientation[0], expected, atol=1e-15)


def test_packets_of_wrong_shape_are_refused(walk: Walk) -> None:
    estimator = StateEstimator()
    with pytest.raises(ShapeError, match=r"\(41,\)"):
        estimator.start(np.zeros(41))
    with pytest.raises(ShapeError, match=r"\(3, 42\)"):
        estimator.start(np.zeros((3, 42)))
    tracking, _ = estimator.start(walk.packets[:, 0])
    with pytest.raises(ShapeError, match="3 robots, got 2"):
        estimator.update(tracking, walk.packets[:2, 1])
    with pytest.raises(ShapeError, match=str(tracking_size())):
        Tracking.from_rows(np.zeros((2, 7)))


def test_acceleration_is_turned_by_the_mean_attitude_between_packets() -> None:
    rate = 3.0
    estimator = StateEstimator()

    def turn(k: float) -> Rotation:
        return Rotation.from_euler("y", rate * 0.003 * k)

    spin = np.array([0.0, rate, 0.0])
    arm = np.array(CASSIE.skeleton.sites["imu"].position)

    def force(k: int) -> np.ndarray:  # mean over the previous period
        felt = [turn(k - 1 + s).inv().apply([0, 0, 9.81]) for s in np.linspace(0, 1, 11)]
        return np.mean(felt, 0) + np.cross(spin, np.cross(spin, arm))

    free = standing_packet(turn(0), spin, force(0))
    tracking, first = estimator.start(free)
    before = first.velocity[0].copy()
    for k in range(1, 51):
        packet = standing_packet(turn(k), spin, force(k))
        packet[AT["joint_position"]][[0, 3]] = 0.0  # springs at rest: no contact
        estimate = estimator.update(tracking, packet)
    np.testing.assert_allclose(estimate.velocity[0], before, atol=2e-3)


def test_lost_packets_increase_the_variance_of_the_velocity() -> None:
    packet = _standing(CASSIE)
    growth = []
    for lost in (False, True):
        estimator = StateEstimator()
        tracking, _ = estimator.start(packet)
        before = tracking.belief.covariance[0, 0, V, V]
        estimator.update(tracking, None if lost else packet + np.eye(42)[-1] * 1e-6)
        growth.append(tracking.belief.covariance[0, 0, V, V] - before)
    assert growth[1] - growth[0] == pytest.approx((_DOUBT * CASSIE.packet_period) ** 2, rel=1e-6)
