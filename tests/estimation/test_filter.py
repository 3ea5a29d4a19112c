"""Filter on motions in closed form, and against a textbook Kalman filter."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from aslip.estimation.filter import (
    LEFT,
    RIGHT,
    B,
    Belief,
    ContactFilter,
    FilterInput,
    FilterNoise,
    P,
    V,
)

PERIOD, RADIUS, HALF = 0.003, 0.02, 0.08
LOADED, FREE = 200.0, 0.0

Path = Callable[[float], np.ndarray]


def _filter(**noise: float) -> ContactFilter:
    return ContactFilter(PERIOD, RADIUS, HALF, replace(FilterNoise(), **noise))


def _body(t: float) -> np.ndarray:
    """Pelvis that moves at 0.7 m/s and sways in all directions."""
    return np.array(
        [0.7 * t + 0.02 * np.sin(9 * t), 0.03 * np.sin(7 * t), 0.9 + 0.03 * np.sin(13 * t)]
    )


def _derivative(path: Path, t: float, order: int = 1) -> np.ndarray:
    h = 1e-4
    if order == 1:
        return (path(t + h) - path(t - h)) / (2 * h)
    return (path(t + h) - 2 * path(t) + path(t - h)) / h**2


def _motion(
    t: float,
    feet: np.ndarray,
    load: tuple[float, float],
    path: Path = _body,
    bias: np.ndarray | float = 0.0,
    num: int = 1,
) -> FilterInput:
    """Packet of `num` robots at time t, with feet (2, 3) in the world."""
    # reading of an integrating accelerometer: the mean over the packet
    acceleration = (_derivative(path, t) - _derivative(path, t - PERIOD)) / PERIOD + bias
    rows = np.ones(num)
    half = np.zeros((num, 2, 3))
    half[..., 0] = HALF
    return FilterInput(
        acceleration=rows[:, None] * acceleration,
        doubt=np.zeros(num),
        sole=rows[:, None, None] * (feet - path(t)),
        half_sole=half,
        load=rows[:, None] * np.array(load),
        fresh=np.ones((num, 2), dtype=bool),
    )


STANDING = np.array([[0.0, 0.1, RADIUS], [0.0, -0.1, RADIUS]])


def _started(filter_: ContactFilter, velocity: np.ndarray | None = None, num: int = 1) -> Belief:
    """Start at time 0 on both feet, with the true velocity by default."""
    motion = _motion(0.0, STANDING, (LOADED, LOADED), num=num)
    velocity = _derivative(_body, 0.0) if velocity is None else velocity
    return filter_.start(motion, np.broadcast_to(-velocity, (num, 2, 3)))


def _run(filter_: ContactFilter, belief: Belief, packets: int, **settings: object) -> None:
    for k in range(1, packets + 1):
        filter_.step(belief, _motion(k * PERIOD, STANDING, (LOADED, LOADED), **settings))  # pyright: ignore[reportArgumentType]


# --------------------------------------------------------------- known answers


def test_start_puts_the_lower_foot_on_the_ground() -> None:
    motion = _motion(0.0, np.array([[0.3, 0.1, 0.25], [0.0, -0.1, RADIUS]]), (FREE, FREE))
    swinging = np.array([[[5.0, 0.0, 1.0], [-0.8, 0.1, 0.2]]])
    belief = _filter().start(motion, swinging)
    np.testing.assert_allclose(belief.mean[0, :, V], [0.8, -0.1, -0.2])
    np.testing.assert_allclose(belief.mean[0, 2, P], 0.9)
    np.testing.assert_allclose(belief.mean[0, :, RIGHT], [0.0, -0.1, RADIUS], atol=1e-12)


def test_estimates_without_noise_are_exact() -> None:
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 400)
    t = 400 * PERIOD
    np.testing.assert_allclose(belief.mean[0, :, V], _derivative(_body, t), atol=1e-3)
    np.testing.assert_allclose(belief.mean[0, :, P] + _body(0) * [1, 1, 0], _body(t), atol=1e-3)
    assert belief.resting.all()


@pytest.mark.parametrize("error", [[0.3, -0.3, 0.0], [-0.2, 0.2, 0.2]])
def test_wrong_velocity_is_corrected_within_ten_policy_steps(error: list[float]) -> None:
    filter_ = _filter()
    belief = _started(filter_, _derivative(_body, 0.0) + error)
    _run(filter_, belief, 100)
    error_left = belief.mean[0, :, V] - _derivative(_body, 100 * PERIOD)
    assert np.abs(error_left).max() < 0.02


def test_bias_of_the_accelerometer_is_estimated() -> None:
    """A tilt error of the attitude has the same effect."""
    bias = np.array([0.08, -0.05, 0.03])
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 4000, bias=bias)
    np.testing.assert_allclose(belief.mean[0, :, B], -bias, atol=0.01)


@pytest.mark.parametrize(("rise", "noise"), [(0.0, {}), (0.1, {"ground": math.inf})])
def test_odometry_of_alternating_stances_has_no_drift(rise: float, noise: dict[str, float]) -> None:
    """2 m in 100 alternating stances; on ground of any height the right foot stands higher."""
    filter_ = _filter(**noise)
    belief = _started(filter_)
    ground = RADIUS + np.array([0.0, rise])
    feet = STANDING.copy()
    stance = 40
    for k in range(1, 1001):
        side = (k // stance) % 2
        swing = 1 - side
        t = k * PERIOD
        # the swing foot moves above the ground towards its next foothold
        fraction = (k % stance + 1) / stance
        feet[swing] = [
            _body(t)[0] + 0.05,
            STANDING[swing, 1],
            ground[swing] + 0.1 * np.sin(np.pi * fraction),
        ]
        if fraction == 1:
            feet[swing, 2] = ground[swing]
        load = (LOADED, FREE) if side == 0 else (FREE, LOADED)
        filter_.step(belief, _motion(t, feet, load))
    np.testing.assert_allclose(belief.mean[0, :, V], _derivative(_body, 3.0), atol=5e-3)
    np.testing.assert_allclose(belief.mean[0, :, P] + _body(0) * [1, 1, 0], _body(3.0), atol=5e-3)


def test_skidding_foot_is_not_a_measurement() -> None:
    """The right foot slides at 1 m/s under load; the left foot gives the velocity."""
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 100)
    feet = STANDING.copy()
    for k in range(101, 150):
        feet[1, 0] += 1.0 * PERIOD
        filter_.step(belief, _motion(k * PERIOD, feet, (LOADED, LOADED)))
        assert belief.resting[0].tolist() == [True, False]
        error = belief.mean[0, :, V] - _derivative(_body, k * PERIOD)
        assert np.abs(error).max() < 0.01


def test_vibrating_spring_in_the_air_is_not_a_contact() -> None:
    """A foot at rest 15 cm above the ground, with a deflected spring, is not a measurement."""
    filter_ = _filter()
    feet = STANDING + np.array([[0, 0, 0], [0, 0, 0.15]])
    belief = _filter().start(_motion(0.0, feet, (FREE, FREE)), np.zeros((1, 2, 3)))
    for k in range(1, 20):
        filter_.step(belief, _motion(k * PERIOD, feet, (FREE, LOADED)))
        assert not belief.resting.any()


def test_variance_of_a_foot_in_the_air_is_that_of_pelvis_and_encoders() -> None:
    """Relative to the pelvis only the encoders' errors count."""
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 50)
    filter_.step(belief, _motion(51 * PERIOD, STANDING, (LOADED, FREE)))
    cov = belief.covariance[0]
    np.testing.assert_allclose(cov[:, RIGHT, P], cov[:, P, P], rtol=1e-12)
    apart = cov[:, RIGHT, RIGHT] - 2 * cov[:, RIGHT, P] + cov[:, P, P]
    np.testing.assert_allclose(apart, filter_.noise.leg**2, rtol=1e-6)


@pytest.mark.parametrize(("height", "rests"), [(0.006, True), (-0.006, True), (0.012, False)])
def test_feet_rest_on_ground_as_uneven_as_the_filter_assumes(height: float, rests: bool) -> None:
    """A foot rests 3 standard deviations above or below zero, but not 6 above."""
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 200)
    feet = STANDING + np.array([[0, 0, 0], [0, 0, height]])
    filter_.step(belief, _motion(201 * PERIOD, feet, (LOADED, FREE)))
    filter_.step(belief, _motion(202 * PERIOD, feet, (LOADED, LOADED)))
    assert belief.resting[0].tolist() == [True, rests]


@pytest.mark.parametrize(("end", "angle"), [(-1.0, 0.15), (1.0, 0.3)], ids=["heel", "toes"])
def test_rocking_over_an_end_of_the_soles_does_not_move_the_robot(end: float, angle: float) -> None:
    """The other end rises within 0.2 s; the end on the ground stays, and the feet keep resting."""
    filter_ = _filter()
    still: Path = lambda t: np.array([0.0, 0.0, 0.9])  # noqa: E731
    belief = filter_.start(_motion(0.0, STANDING, (LOADED, LOADED), still), np.zeros((1, 2, 3)))
    for k in range(1, 140):
        pitch = angle * min(max(k - 60, 0) / 66, 1)
        toward_toe = HALF * np.array([np.cos(pitch), 0, -end * np.sin(pitch)])
        feet = STANDING + np.array([end * HALF, 0, 0]) - end * toward_toe
        motion = _motion(k * PERIOD, feet, (LOADED, LOADED), still)
        half = np.broadcast_to(toward_toe, (1, 2, 3)).copy()
        filter_.step(belief, replace(motion, half_sole=half))
        assert belief.resting.all()
    assert np.abs(belief.mean[0, :, V]).max() < 0.01
    assert np.abs(belief.mean[0, :, P] - [0, 0, 0.9]).max() < 2e-3


def test_wrong_height_is_corrected_after_patience() -> None:
    """With the ground 15 cm below the estimate no foot rests until the variance grows."""
    filter_ = _filter()
    still: Path = lambda t: np.array([0.0, 0.0, 0.9])  # noqa: E731
    belief = filter_.start(_motion(0.0, STANDING, (LOADED, LOADED), still), np.zeros((1, 2, 3)))
    for k in range(1, 100):
        filter_.step(belief, _motion(k * PERIOD, STANDING, (LOADED, LOADED), still))
    belief.mean[0, 2, [P, LEFT, RIGHT]] += 0.15
    rested = []
    for k in range(100, 300):
        filter_.step(belief, _motion(k * PERIOD, STANDING, (LOADED, LOADED), still))
        rested.append(bool(belief.resting.any()))
    assert not any(rested[: round(filter_.noise.patience / PERIOD)])
    assert all(rested[-100:])
    assert abs(belief.mean[0, 2, P] - 0.9) < 5e-3


def test_wrong_velocity_of_small_variance_is_corrected_after_patience() -> None:
    """Feet at rest seem to move; after 0.1 s the filter increases its own variance."""
    filter_ = _filter()
    belief = _started(filter_)
    _run(filter_, belief, 200)
    belief.mean[0, 0, V] += 3.0
    for k in range(201, 301):
        filter_.step(belief, _motion(k * PERIOD, STANDING, (LOADED, LOADED)))
    error = belief.mean[0, :, V] - _derivative(_body, 300 * PERIOD)
    assert np.abs(error).max() < 0.05
    assert belief.resting.all()


def test_covariances_stay_symmetric_and_positive_definite() -> None:
    filter_, rng = _filter(), np.random.default_rng(0)
    belief = _started(filter_, num=8)
    for k in range(1, 3000):
        motion = _motion(k * PERIOD, STANDING, (LOADED, LOADED), num=8)
        load = np.where(rng.random((8, 2)) < 0.02, FREE, motion.load)
        filter_.step(belief, replace(motion, load=load))
    cov = belief.covariance
    np.testing.assert_allclose(cov, cov.swapaxes(-1, -2), atol=1e-14)
    assert np.linalg.eigvalsh(cov).min() > -1e-12


# --------------------------------------------------------------------- equations


def test_filter_equals_the_textbook_kalman_filter() -> None:
    """Matrices written out, both feet at rest: equal to rounding, mean and covariance.

    The covariance is predicted with F = 1 + dt N, the mean with its second-order term.
    """
    filter_ = _filter()
    noise = filter_.noise
    belief = _started(filter_)
    mean, cov = belief.mean[0].copy(), belief.covariance[0].copy()
    dynamics = np.eye(5)
    dynamics[P, V] = dynamics[V, B] = PERIOD
    push = np.array([PERIOD**2 / 2, PERIOD, 0, 0, 0])
    second_order = np.zeros((5, 5))
    second_order[P, B] = PERIOD**2 / 2
    for k in range(1, 40):
        motion = _motion(k * PERIOD, STANDING, (LOADED, LOADED))
        filter_.step(belief, motion)
        for axis in range(3):
            a = motion.acceleration[0, axis]
            x = (dynamics + second_order) @ mean[axis] + push * a
            walk = noise.slip if axis < 2 else noise.sink
            shaken = noise.acceleration**2 + noise.shock**2 * (motion.acceleration[0] ** 2).sum()
            added = [0, PERIOD**2 * shaken, PERIOD * noise.acceleration_error**2]
            q = np.diag([*added, PERIOD * walk**2, PERIOD * walk**2])
            p = dynamics @ cov[axis] @ dynamics.T + q
            for foot, column in enumerate((LEFT, RIGHT)):
                rows = [
                    (np.eye(5)[column] - np.eye(5)[P], noise.leg**2, motion.sole[0, foot, axis])
                ]
                if axis == 2:
                    rows.append((np.eye(5)[column], noise.ground**2, RADIUS))
                for h, r, y in rows:
                    gain = p @ h / (h @ p @ h + r)
                    x = x + gain * (y - h @ x)
                    p = (np.eye(5) - np.outer(gain, h)) @ p
            mean[axis], cov[axis] = x, p
        assert belief.resting.all()
        np.testing.assert_allclose(belief.mean[0], mean, atol=1e-10)
        np.testing.assert_allclose(belief.covariance[0], cov, atol=1e-12)


def test_errors_have_the_predicted_variance() -> None:
    """For 300 standing robots with the assumed noise, NIS and NEES are one per axis.

    Tolerances are five standard errors of means of squared normal numbers. Velocity errors are
    from one instant and independent, innovations from many instants.
    """
    num, rng = 300, np.random.default_rng(1)
    filter_ = _filter(shock=0.0, gate=1e9)
    noise = filter_.noise
    belief = _started(filter_, num=num)
    belief.mean[..., V] += noise.initial_velocity * rng.normal(size=(num, 3))
    bias = noise.initial_acceleration_error * rng.normal(size=(num, 3))
    feet = np.broadcast_to(STANDING, (num, 2, 3)).copy()
    nis = []
    for k in range(1, 300):
        motion = _motion(k * PERIOD, STANDING, (LOADED, LOADED), num=num)
        bias += noise.acceleration_error * np.sqrt(PERIOD) * rng.normal(size=(num, 3))
        feet[..., :2] += noise.slip * np.sqrt(PERIOD) * rng.normal(size=(num, 2, 2))
        measured = motion.acceleration - bias + noise.acceleration * rng.normal(size=(num, 3))
        sole = feet - _body(k * PERIOD) + noise.leg * rng.normal(size=(num, 2, 3))
        filter_.step(belief, replace(motion, acceleration=measured, sole=sole))
        nis.append(belief.innovation[..., :2].mean())
    error = belief.mean[..., V] - _derivative(_body, 299 * PERIOD)
    nees = (error**2 / belief.covariance[..., V, V])[:, :2].mean()
    assert nees == pytest.approx(1.0, abs=5 * np.sqrt(2 / (2 * num)))
    assert np.mean(nis) == pytest.approx(1.0, abs=0.05)


def test_contact_ends_at_a_lower_force_than_it_begins() -> None:
    filter_ = _filter()
    belief = _started(filter_)
    forces = [(52.0, False), (61.0, True), (52.0, True), (44.0, False), (52.0, False)]
    for k, (force, loaded) in enumerate(forces, 1):
        filter_.step(belief, _motion(k * PERIOD, STANDING, (force, force)))
        assert belief.loaded[0].tolist() == [loaded] * 2
