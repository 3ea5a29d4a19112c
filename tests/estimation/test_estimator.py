"""Packets of a walking robot through the whole estimator, whole and broken."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp

import aslip
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.estimation import FAULTS, StateEstimator, Tracking, tracking_size
from aslip.estimation.estimator import _DOUBT, _standing
from aslip.estimation.filter import FilterNoise, P, V
from aslip.estimation.packets import join
from aslip.robot import CASSIE
from aslip.transforms import TrueState

AT = CASSIE.packet_slices
STEPS, ROBOTS = 50, 3
JUDGES = ["low_reward", "fall", "step_limit"]


class Walk:
    """Packets and truth of some robots that walk."""

    def __init__(self) -> None:
        env = aslip.make_env(
            num_envs=ROBOTS,
            num_threads=1,
            seed=1,
            drop=["noise", *JUDGES],
            replace={"estimator": TrueState},
        )
        policy = aslip.load_policy("aslip")
        td = cast("TensorDictBase", env.reset())
        packets, velocity, height = [], [], []
        with torch.no_grad():
            for _ in range(STEPS):
                entries = [
                    cast("torch.Tensor", td["sensors", name]) for name in CASSIE.packet_sizes
                ]
                packets.append(torch.cat(entries, -1).double().numpy())
                velocity.append(np.asarray(td["truth", "pelvis_velocity"]))
                height.append(np.asarray(td["truth", "pelvis_position"])[:, 2])
                td = step_mdp(env.step(policy(td)))
        self.packets = np.stack(packets, axis=1)  # (n, steps, W, 42); the first are of the reset
        self.velocity, self.height = np.stack(velocity, axis=1), np.stack(height, axis=1)


@pytest.fixture(scope="module")
def walk() -> Walk:
    return Walk()


Spoil = Callable[[int, np.ndarray], np.ndarray]


def _follow(walk: Walk, spoil: Spoil | None = None) -> list[dict[str, np.ndarray]]:
    """Estimates at each policy step, with what `spoil` makes of step and windows."""
    estimator = StateEstimator()
    tracking, first = estimator.start(walk.packets[:, 0])
    estimates = [first]
    for step in range(1, STEPS):
        windows = walk.packets[:, step].copy()
        estimates.append(estimator.update(tracking, spoil(step, windows) if spoil else windows))
    names = ("velocity", "height", "orientation", "joint_position", "acceleration", "faults")
    return [{name: np.array(getattr(e, name)) for name in names} for e in estimates]


@pytest.fixture(scope="module")
def sound(walk: Walk) -> list[dict[str, np.ndarray]]:
    return _follow(walk)


# ----------------------------------------------------------------------- accuracy


def test_it_knows_at_once_how_a_moving_robot_moves(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    """From the first packet: the lower foot is at rest, on the ground."""
    assert np.abs(walk.velocity[:, 0]).max() > 0.5
    np.testing.assert_allclose(sound[0]["velocity"], walk.velocity[:, 0], atol=0.06)
    np.testing.assert_allclose(sound[0]["height"][:, 0], walk.height[:, 0], atol=3e-3)


def test_it_stays_with_the_truth(walk: Walk, sound: list[dict[str, np.ndarray]]) -> None:
    errors = np.array([e["velocity"] - walk.velocity[:, k] for k, e in enumerate(sound)])[12:]
    assert (np.sqrt((errors**2).mean((0, 1))) < [0.03, 0.03, 0.02]).all()
    heights = np.array([e["height"][:, 0] - walk.height[:, k] for k, e in enumerate(sound)])[12:]
    assert np.sqrt((heights**2).mean()) < 2e-3
    assert not any(estimate["faults"].any() for estimate in sound)


# ------------------------------------------------------------------- alone, together


def test_a_stream_of_one_robot_gives_what_the_batch_does(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    """Packet by packet, as on a robot; equal but for the order of sums."""
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
def test_windows_with_lost_packets_give_what_their_packets_do(walk: Walk, lost: slice) -> None:
    """One by one or together, wherever in the window packets are lost."""
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


def test_what_is_remembered_can_be_handed_on(walk: Walk) -> None:
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
    np.testing.assert_array_equal(rows, before)  # it was copied


def test_estimates_do_not_change_afterwards(walk: Walk) -> None:
    """Nor does anything when the caller fills the buffer of packets again."""
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


# ----------------------------------------------------------------------------- faults

SPOILED = 20


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


GYRO, ACCELEROMETER = AT["gyro"], AT["accelerometer"]
ONE_GYRO = slice(GYRO.start + 1, GYRO.start + 2)
ONE_JOINT = slice(AT["joint_position"].start + 4, AT["joint_position"].start + 5)


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
def test_a_fault_is_told_survived_and_stays_with_its_robot(
    walk: Walk, sound: list[dict[str, np.ndarray]], fault: str, spoil: Spoil
) -> None:
    estimates = _follow(walk, spoil)
    for step, (ours, theirs) in enumerate(zip(sound, estimates, strict=True)):
        for name, value in theirs.items():
            assert np.isfinite(value).all(), (step, name)
            np.testing.assert_array_equal(value[[0, 2]], ours[name][[0, 2]], err_msg=name)
        told = [name for name, flag in zip(FAULTS, theirs["faults"][1], strict=True) if flag]
        assert told == ([fault] if step == SPOILED else [])
    # at worst as far off as a robot that has just begun, and as good as ever ten steps later
    off = np.array(
        [e["velocity"][1] - s["velocity"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(off[SPOILED:]).max() < 0.3
    assert np.abs(off[SPOILED + 10 :]).max() < 0.03
    rise = np.array(
        [e["height"][1] - s["height"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(rise[SPOILED + 10 :]).max() < 2e-3


def test_a_moderate_spike_that_looks_possible_does_little(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    """40 m/s^2 in one packet: it is taken for real, and the feet set it right."""
    estimates = _follow(walk, _set(ACCELEROMETER, 40.0, slice(5, 6), add=True))
    off = np.array(
        [e["velocity"][1] - s["velocity"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(off[SPOILED:]).max() < 0.4
    assert np.abs(off[SPOILED + 10 :]).max() < 0.03


def test_spikes_that_do_not_last_are_never_believed() -> None:
    """However many there are, with a good packet after each."""
    packet, estimator = _standing(CASSIE), StateEstimator()
    tracking, _ = estimator.start(packet)
    for k in range(40):
        packet[GYRO] = 10.0 * (k % 2) + 1e-6 * k
        estimate = estimator.update(tracking, packet)
        assert estimate.faults[0].tolist() == [False, False, k % 2 == 1, False]
        assert np.abs(estimate.angular_velocity).max() < 1e-3


def test_a_change_that_lasts_is_believed(walk: Walk) -> None:
    """An IMU whose readings stay where they jumped to is right in the end."""

    def spoil(step: int, windows: np.ndarray) -> np.ndarray:
        if step >= SPOILED:
            windows[1, :, ONE_GYRO] += 5.0
        return windows

    told = [estimate["faults"][1, FAULTS.index("jump")] for estimate in _follow(walk, spoil)]
    assert told[SPOILED]
    assert not any(told[SPOILED + 1 :])


def test_with_an_encoder_dead_for_good_the_other_leg_carries_on(
    walk: Walk, sound: list[dict[str, np.ndarray]]
) -> None:
    def spoil(step: int, windows: np.ndarray) -> np.ndarray:
        if step >= SPOILED:
            windows[1, :, ONE_JOINT] = np.nan
        return windows

    estimates = _follow(walk, spoil)
    held = [estimate["joint_position"][1, 4] for estimate in estimates[SPOILED:]]
    assert len(set(held)) == 1
    assert all(estimate["faults"][1].tolist() == [True, False, False, False]
               for estimate in estimates[SPOILED:])  # fmt: skip
    off = np.array(
        [e["velocity"][1] - s["velocity"][1] for e, s in zip(estimates, sound, strict=True)]
    )
    assert np.abs(off[SPOILED:]).max() < 0.3


def test_a_lost_packet_of_a_stream_is_none(walk: Walk) -> None:
    estimator = StateEstimator()
    packets = walk.packets[0].reshape(-1, CASSIE.packet_size)
    tracking, _ = estimator.start(packets[9])
    for packet in packets[10:200]:
        estimator.update(tracking, packet)
    estimate = estimator.update(tracking, None)
    assert estimate.faults[0].tolist() == [True, False, False, False]
    assert np.isfinite(estimate.velocity).all()


def test_a_robot_that_starts_blind_sees_later(walk: Walk) -> None:
    """Nothing but NaN at first: a standing robot is assumed, until packets come."""
    estimator = StateEstimator()
    tracking, first = estimator.start(np.full((ROBOTS, 1, CASSIE.packet_size), np.nan))
    assert np.isfinite(first.velocity).all()
    assert first.faults.tolist() == [[True, False, False, False]] * ROBOTS
    for step in range(1, 40):
        estimate = estimator.update(tracking, walk.packets[:, step])
    np.testing.assert_allclose(estimate.velocity, walk.velocity[:, 39], atol=0.1)


# ---------------------------------------------------------------- slow and frozen IMUs

IMU = slice(GYRO.start, CASSIE.packet_size)
ENCODERS = slice(0, AT["orientation"].start)


def _stream(walk: Walk) -> np.ndarray:
    """(k, 42) packets of robot 1 from its reset on."""
    return walk.packets[1].reshape(-1, CASSIE.packet_size)[CASSIE.sensor_window - 1 :].copy()


def test_a_frozen_imu_leaves_the_encoders_alone(walk: Walk) -> None:
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


def test_a_stream_that_is_stuck_gives_no_measurement_of_the_legs() -> None:
    """Encoders that moved with the IMU and stop with it say nothing new."""
    packet, estimator = _standing(CASSIE), StateEstimator()
    packet[AT["joint_position"]][[0, 3]] = -0.06
    tracking, _ = estimator.start(packet)
    for k in range(1, 20):
        packet[GYRO] = 1e-6 * (k % 2)
        assert estimator.update(tracking, packet).resting.all()
    resting = [estimator.update(tracking, packet).resting.any() for _ in range(10)]
    assert resting == [True] + [False] * 9


def test_an_imu_slower_than_the_packets_is_no_fault(walk: Walk) -> None:
    """A new value in every second packet, 167 Hz: feet rest as ever, and velocity is as good."""
    packets = _stream(walk)
    mean = (packets[1:-1:2, ACCELEROMETER] + packets[2::2, ACCELEROMETER]) / 2
    packets[2::2, ACCELEROMETER] = mean
    packets[1::2, AT["orientation"].start :] = packets[:-1:2, AT["orientation"].start :]
    packets[1, IMU.stop - 1] += 1e-3  # the first one's means something else
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


@pytest.mark.parametrize("lost", [0, 1, 3, 9])
def test_after_lost_packets_the_acceleration_is_right(lost: int) -> None:
    """The pelvis' origin rests, turning faster and faster; its IMU feels that beside it."""
    arm, alpha = np.array(CASSIE.skeleton.sites["imu"].position), np.array([0.0, 30.0, 0.0])

    def packet(k: int) -> np.ndarray:
        turn = Rotation.from_rotvec(alpha * (k * CASSIE.packet_period) ** 2 / 2)
        spin = alpha * k * CASSIE.packet_period
        middle = alpha * (k - 0.5) * CASSIE.packet_period
        felt = np.cross(alpha, arm) + np.cross(middle, np.cross(middle, arm))
        return _packet(turn, spin, felt + turn.inv().apply([0, 0, 9.81]))

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


def test_after_one_axis_of_the_gyro_was_lost_the_acceleration_is_right() -> None:
    arm, alpha = np.array(CASSIE.skeleton.sites["imu"].position), np.array([20.0, 30.0, -10.0])

    def packet(k: int) -> np.ndarray:
        spin, middle = alpha * k * CASSIE.packet_period, alpha * (k - 0.5) * CASSIE.packet_period
        felt = np.cross(alpha, arm) + np.cross(middle, np.cross(middle, arm))
        return _packet(Rotation.identity(), spin, felt + np.array([0, 0, 9.81]))

    estimator = StateEstimator()
    tracking, _ = estimator.start(packet(0))
    for k in range(1, 10):
        blind = packet(k)
        blind[GYRO.start] = np.nan if 4 < k < 9 else blind[GYRO.start]
        estimate = estimator.update(tracking, blind)
    np.testing.assert_allclose(estimate.acceleration[0], 0.0, atol=1e-9)


# ------------------------------------------------------------------------- orientation


def test_orientation_is_a_unit_quaternion_with_w_of_at_least_zero() -> None:
    turn = Rotation.from_euler("xyz", [0.1, -0.2, 0.5])
    expected = turn.as_quat(canonical=True, scalar_first=True)
    for factor in (1.0, -1.0, 1.009, -0.991):
        packet = _packet(turn, np.zeros(3), turn.inv().apply([0, 0, 9.81]))
        packet[AT["orientation"]] *= factor
        estimator = StateEstimator()
        tracking, first = estimator.start(packet, heading=0.0)
        packet[GYRO] += 1e-3
        later = estimator.update(tracking, packet)
        assert not later.faults.any()
        for estimate in (first, later):
            np.testing.assert_allclose(estimate.orientation[0], expected, atol=1e-15)


# ------------------------------------------------------------------------------ period


@pytest.mark.parametrize("period", [5e-4, 1e-3, 6e-3])
def test_noise_is_the_same_robots_at_any_period(period: float) -> None:
    """Variances after 0.3 s on its feet, and after 0.3 s more in the air, as for 3 ms."""
    deviations = []
    for dt in (CASSIE.packet_period, period):
        estimator = StateEstimator(period=dt)
        packet = _standing(CASSIE)
        packet[ACCELEROMETER] += 1.0
        tracking, _ = estimator.start(packet)
        row = []
        for k in range(2 * round(0.3 / dt)):
            packet[GYRO] = 1e-6 * (k % 2)  # it is not frozen
            in_air = k >= round(0.3 / dt)
            packet[AT["joint_position"]][[0, 3]] = 0.0 if in_air else -0.06
            packet[ACCELEROMETER] = [0, 0, 9.81]
            estimator.update(tracking, packet)
            if k + 1 in (round(0.3 / dt), 2 * round(0.3 / dt)):
                assert tracking.belief.resting.any() != in_air
                row.append(np.diagonal(tracking.belief.covariance[0], axis1=1, axis2=2)[:, [P, V]])
        deviations.append(np.sqrt(row))
    np.testing.assert_allclose(deviations[1], deviations[0], rtol=0.06)


@pytest.mark.parametrize(("period", "most"), [(1e-3, 3.0), (3e-3, 3.0), (6e-3, 6.0)])
def test_a_change_may_be_as_large_as_the_time_allows(period: float, most: float) -> None:
    """The gyro may change by 3 rad/s in 3 ms or less, in proportion over longer gaps."""
    for change, jumped in ((0.95 * most, False), (1.05 * most, True)):
        packet, estimator = _standing(CASSIE), StateEstimator(period=period)
        tracking, _ = estimator.start(packet)
        packet[GYRO.start] += change
        faults = estimator.update(tracking, packet).faults
        assert faults[0].tolist() == [False, False, jumped, False]


def test_faults_are_timed_in_seconds() -> None:
    """An IMU may repeat itself for 5 ms, and jumps are believed after 9 ms, at any period."""
    for period in (5e-4, 1e-3, 3e-3):
        packet, estimator = _standing(CASSIE), StateEstimator(period=period)
        tracking, _ = estimator.start(packet)
        frozen = [bool(estimator.update(tracking, packet).faults[0, 3]) for _ in range(20)]
        assert (frozen.index(True) + 1) * period == pytest.approx(0.0055, abs=period / 2 + 5e-4)
        jump = []
        for k in range(20):
            packet[GYRO] = 10.0 + 1e-3 * k
            jump.append(bool(estimator.update(tracking, packet).faults[0, 2]))
        assert jump.index(False) * period == pytest.approx(0.009)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("acceleration", "gate", "leg", "patience")
          for value in (-1.0, float("nan"), float("inf"), "0.1", None, True)),
        *((name, 0.0) for name in ("leg", "ground", "gate", "rock")),
    ],
)  # fmt: skip
def test_noise_that_cannot_be_is_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=rf"^{name} of FilterNoise .*{value!r}"):
        FilterNoise(**{name: value})


def test_a_foot_that_is_unloaded_above_its_load_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="unload"):
        FilterNoise(unload=70.0)


# ------------------------------------------------------------------------------ errors


def test_packets_of_a_wrong_shape_are_refused(walk: Walk) -> None:
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


def test_packets_lacking_an_entry_are_refused() -> None:
    packet = {name: np.zeros(size) for name, size in CASSIE.packet_sizes.items()}
    assert join(packet).shape == (CASSIE.packet_size,)
    with pytest.raises(UnknownNameError, match="'gyro' is missing"):
        join({name: value for name, value in packet.items() if name != "gyro"})
    with pytest.raises(ShapeError, match=r"orientation.*4 numbers.*\(3,\)"):
        join(packet | {"orientation": np.zeros(3)})
    with pytest.raises(ShapeError, match="leading shape"):
        join(packet | {"gyro": np.zeros((2, 3))})


@pytest.mark.parametrize("period", [0.0, -0.003, float("nan"), 3.0])
def test_a_period_that_is_none_is_refused(period: float) -> None:
    with pytest.raises(ConfigurationError, match="period"):
        StateEstimator(period=period)


def _packet(turn: Rotation, gyro: np.ndarray, force: Any) -> np.ndarray:
    """Of the standing robot at an attitude, turning [rad/s], and feeling a force [m/s^2]."""
    at = CASSIE.indices
    qpos = CASSIE.standing
    packet = np.zeros(CASSIE.packet_size)
    packet[AT["motor_position"]] = qpos[at.motor_qpos]
    packet[AT["joint_position"]] = qpos[at.joint_qpos]
    packet[AT["orientation"]] = turn.as_quat(canonical=True, scalar_first=True)
    packet[AT["gyro"]], packet[AT["accelerometer"]] = gyro, force
    return packet


def test_the_acceleration_is_the_pelvis_origins_in_its_frame() -> None:
    """Of a robot that turns faster and faster, from what an IMU beside the origin feels."""
    arm = np.array(CASSIE.skeleton.sites["imu"].position)
    turns = [
        Rotation.from_euler("xyz", angles) for angles in ([0.4, -0.3, 1.0], [0.41, -0.32, 1.01])
    ]
    before, after, world = (
        np.array([2.0, -2.0, 1.5]),
        np.array([2.3, -2.2, 1.9]),
        np.array([1.0, 2.0, -0.5]),
    )
    alpha, spin = (after - before) / 0.003, (before + after) / 2
    own = turns[1].inv().apply(world)
    force = (
        own
        + turns[1].inv().apply([0, 0, 9.81])
        + np.cross(alpha, arm)
        + np.cross(spin, np.cross(spin, arm))
    )
    estimator = StateEstimator()
    tracking, _ = estimator.start(_packet(turns[0], before, turns[0].inv().apply([0, 0, 9.81])))
    estimate = estimator.update(tracking, _packet(turns[1], after, force))
    assert not estimate.faults.any()
    np.testing.assert_allclose(estimate.acceleration[0], own, atol=1e-9)
    np.testing.assert_array_equal(estimate.angular_velocity[0], after)


def test_a_turning_robot_starts_with_the_velocity_of_its_resting_foot() -> None:
    turn, gyro = Rotation.from_euler("xyz", [0.1, -0.2, 0.5]), np.array([1.0, -2.0, 0.5])
    _, first = StateEstimator().start(_packet(turn, gyro, turn.inv().apply([0, 0, 9.81])), 0.0)
    lower = int(first.sole[0, :, 2].argmin())
    expected = -np.cross(turn.apply(gyro), first.sole[0, lower])
    np.testing.assert_allclose(first.velocity[0], expected, atol=1e-6)


def test_acceleration_is_turned_by_the_mean_attitude_of_its_time() -> None:
    rate = 3.0
    estimator = StateEstimator()

    def turn(k: float) -> Rotation:
        return Rotation.from_euler("y", rate * 0.003 * k)

    spin = np.array([0.0, rate, 0.0])
    arm = np.array(CASSIE.skeleton.sites["imu"].position)

    def force(k: int) -> np.ndarray:  # mean over the packet before
        felt = [turn(k - 1 + s).inv().apply([0, 0, 9.81]) for s in np.linspace(0, 1, 11)]
        return np.mean(felt, 0) + np.cross(spin, np.cross(spin, arm))

    free = _packet(turn(0), spin, force(0))
    tracking, first = estimator.start(free)
    before = first.velocity[0].copy()
    for k in range(1, 51):
        packet = _packet(turn(k), spin, force(k))
        packet[AT["joint_position"]][[0, 3]] = 0.0  # springs at rest: no contact
        estimate = estimator.update(tracking, packet)
    np.testing.assert_allclose(estimate.velocity[0], before, atol=2e-3)


def test_a_lost_packet_leaves_the_velocity_in_doubt() -> None:
    packet = _standing(CASSIE)
    growth = []
    for lost in (False, True):
        estimator = StateEstimator()
        tracking, _ = estimator.start(packet)
        before = tracking.belief.covariance[0, 0, V, V]
        estimator.update(tracking, None if lost else packet + np.eye(42)[-1] * 1e-6)
        growth.append(tracking.belief.covariance[0, 0, V, V] - before)
    assert growth[1] - growth[0] == pytest.approx((_DOUBT * CASSIE.packet_period) ** 2, rel=1e-6)
