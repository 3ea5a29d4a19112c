r"""Kalman filter of the pelvis' position and velocity, with the feet as measurements.

The attitude comes from the IMU, whose own filter is accurate. The rest is linear, and the three
world axes are independent. Each axis has five states: position :math:`p` and velocity :math:`v` of
the pelvis, an error :math:`b` of the measured acceleration, and the positions :math:`l, r` of the
two soles.

.. math::

    \dot p = v, \quad \dot v = a + b, \quad \dot b = w_b, \quad
    \dot l, \dot r = w_\text{slip} \text{ at rest on the ground, unknown otherwise}

where :math:`a` is the accelerometer's reading in world axes without gravity. The measurements are
the positions of the soles relative to the pelvis from the legs' encoders, :math:`y_l = l - p`, and
on the vertical axis the height zero of the lowest point of a sole at rest, unless the ground may
have any height (`FilterNoise.ground`).

Process and measurement follow Bloesch et al., "State estimation for legged robots: consistent
fusion of leg kinematics and IMU" (RSS 2012). An external attitude, as in Bledt et al., "MIT Cheetah
3" (IROS 2018), makes them linear. Updates take one scalar measurement at a time. In addition:

- the leaf springs detect contact (`aslip.estimation.legs`), as Cassie has no foot force sensor;
- only a foot at rest is a measurement: a gate on the innovation rejects a foot that skids after
  touchdown or lifts before its springs have relaxed, a gate on the height rejects a foot whose
  springs vibrate in the air; the position of a rejected foot is reset from the leg kinematics;
- the centre of a sole that rocks over heel or toes moves with the lever arm.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from aslip.base.arrays import Array, copied, namespace, python_function, zeros
from aslip.base.compiled import compiled
from aslip.estimation.noise import FilterNoise

P, V, B, LEFT, RIGHT = range(5)
"""Position, velocity, acceleration error and soles in the state of an axis."""

_Z = 2


@dataclass
class Belief:
    """State of n filters."""

    mean: Array
    """(n, 3, 5) states of the axes x, y, z of the world."""
    covariance: Array
    """(n, 3, 5, 5) covariances of these states."""
    half_sole: Array
    """(n, 2, 3) vectors from the centre of each sole to its toe [m, world]."""
    loaded: Array
    """(n, 2) bool, contact by the springs of the leg."""
    resting: Array
    """(n, 2) bool, foot at rest: a measurement of the last update."""
    adrift: Array
    """(n,) packets since a loaded foot last rested."""
    innovation: Array
    """(n, 2, 3) normalised innovation squared of a loaded foot by axis, otherwise NaN."""


@dataclass(frozen=True)
class FilterInput:
    """Inputs and measurements of the filter at one packet, in world axes."""

    acceleration: Array
    """(n, 3) acceleration of the pelvis' origin, without gravity [m/s^2]."""
    doubt: Array
    """(n,) further standard deviation of the acceleration without a good reading [m/s^2]."""
    sole: Array
    """(n, 2, 3) centres of the soles' axes relative to the pelvis [m]."""
    half_sole: Array
    """(n, 2, 3) vectors from the centres to the toes [m]."""
    load: Array
    """(n, 2) vertical forces on the feet [N]."""
    fresh: Array
    """(n, 2) bool, all readings of the leg are new and good."""


class _Settings(NamedTuple):
    """Numbers of the compiled filter, with variances instead of standard deviations."""

    walk: np.ndarray
    """(3, 5) growth of the variances per packet, without `shock`."""
    timestep: float
    radius: float
    rock_height: float
    shock: float
    leg: float
    ground: float
    gate: float
    load: float
    unload: float
    patience: float
    surprise: float
    surprise_height: float
    half_square: float
    """Half the squared timestep."""
    zero: float = 0.0
    one: float = 1.0
    nothing: float = math.nan


class ContactFilter:
    """Kalman filter that predicts with the IMU and corrects with the feet.

    Args:
        timestep: time between packets [s].
        sole_radius: radius of the soles' contact capsules [m].
        sole_half_length: half the length of their axes [m].
        noise: assumed noise.
    """

    def __init__(
        self, timestep: float, sole_radius: float, sole_half_length: float, noise: FilterNoise
    ) -> None:
        self.noise = noise
        self.compiled: Callable[..., None] = _step
        """Function that updates all robots' arrays in place."""
        steps = np.array([noise.slip, noise.slip, noise.sink])
        walk = np.zeros((3, 5))
        walk[:, V] = (timestep * noise.acceleration) ** 2
        walk[:, B] = timestep * noise.acceleration_error**2
        walk[:, LEFT:] = timestep * steps[:, None] ** 2
        self._settings = _Settings(
            walk=walk,
            timestep=timestep,
            radius=sole_radius,
            rock_height=noise.rock * sole_half_length,
            shock=noise.shock**2,
            leg=noise.leg**2,
            ground=noise.ground**2,
            gate=noise.gate,
            load=noise.load,
            unload=noise.unload,
            patience=float(round(noise.patience / timestep)),
            surprise=noise.surprise**2,
            surprise_height=noise.surprise_height**2,
            half_square=timestep * timestep / 2,
        )

    def start(self, motion: FilterInput, sole_velocity: Array) -> Belief:
        """Initial state of the filters, with the lower foot at rest on the ground.

        Args:
            motion: first packet.
            sole_velocity: (n, 2, 3) velocities of the soles relative to the pelvis [m/s, world].
        """
        num, noise, sole = len(motion.sole), self.noise, motion.sole
        xp = namespace(sole)
        lowest = sole[..., _Z] - abs(motion.half_sole[..., _Z])
        right = lowest[:, 1] < lowest[:, 0]
        mean = zeros((num, 3, 5), sole)
        mean[..., V] = -xp.where(right[:, None], sole_velocity[:, 1], sole_velocity[:, 0])
        mean[:, _Z, P] = self._settings.radius - xp.where(right, lowest[:, 1], lowest[:, 0])
        covariance = zeros((num, 3, 5, 5), sole)
        covariance[:, _Z, P, P] = noise.initial_height**2
        covariance[..., V, V] = noise.initial_velocity**2
        covariance[..., B, B] = noise.initial_acceleration_error**2
        # the code of one robot, with robots along the last axis
        views = [xp.moveaxis(array, 0, -1) for array in (mean, covariance, sole)]
        for foot in range(2):
            python_function(_plant)(*views[:2], LEFT + foot, views[2][foot], self._settings.leg)
        no_foot = zeros((num, 2), sole) != 0
        return Belief(
            mean=mean,
            covariance=covariance,
            half_sole=copied(motion.half_sole),
            loaded=no_foot,
            resting=copied(no_foot),
            adrift=zeros((num,), sole),
            innovation=sole * math.nan,
        )

    def step(self, belief: Belief, motion: FilterInput) -> None:
        """Update `belief` in place with one packet."""
        self.compiled(
            belief.mean, belief.covariance, belief.half_sole, belief.loaded, belief.resting,
            belief.adrift, belief.innovation, motion.acceleration, motion.doubt, motion.sole,
            motion.half_sole, motion.load, motion.fresh, self._settings,
        )  # fmt: skip


# Compiled loop over robots: NumPy calls on all robots take several times as long. Warp compiles the
# functions below, too, for GPUs (`aslip.transforms.device_estimator`), in double precision. So they
# have no decimal literals, which Warp would read as single, no powers and no arrays of their own.
@compiled
def _step(
    means: np.ndarray,
    covariances: np.ndarray,
    half_soles: np.ndarray,
    loaded: np.ndarray,
    resting: np.ndarray,
    adrift: np.ndarray,
    innovations: np.ndarray,
    accelerations: np.ndarray,
    doubts: np.ndarray,
    soles: np.ndarray,
    halves: np.ndarray,
    loads: np.ndarray,
    fresh: np.ndarray,
    settings: _Settings,
) -> None:
    gain = np.empty(5)
    for i in range(means.shape[0]):
        _step_robot(
            means[i], covariances[i], half_soles[i], loaded[i], resting[i], adrift[i : i + 1],
            innovations[i], accelerations[i], doubts[i], soles[i], halves[i], loads[i], fresh[i],
            settings, gain,
        )  # fmt: skip


@compiled
def _step_robot(
    mean: np.ndarray,
    cov: np.ndarray,
    half_sole: np.ndarray,
    loaded: np.ndarray,
    resting: np.ndarray,
    adrift: np.ndarray,
    innovation: np.ndarray,
    acceleration: np.ndarray,
    doubt: float,
    sole: np.ndarray,
    half: np.ndarray,
    load: np.ndarray,
    fresh: np.ndarray,
    settings: _Settings,
    gain: np.ndarray,
) -> None:
    """Update one robot with one packet; `adrift` (1,) and `gain` (5,), which is for scratch."""
    _predict(mean, cov, half_sole, acceleration, doubt, half, settings)
    for foot in range(2):
        column = LEFT + foot
        threshold = settings.load
        if loaded[foot]:
            threshold = settings.unload
        loaded[foot] = load[foot] > threshold
        lowest = settings.radius + abs(half[foot, _Z])
        for axis in range(3):
            innovation[foot, axis] = settings.nothing
        near = loaded[foot] and fresh[foot] and _near_ground(mean, cov, column, lowest, settings)
        resting[foot] = False
        if near:
            resting[foot] = _is_at_rest(mean, cov, column, sole[foot], innovation[foot], settings)
        if resting[foot]:
            _correct(mean, cov, column, sole[foot], settings, gain)
            _ground(mean[_Z], cov[_Z], column, lowest, settings, gain)
        else:
            _plant(mean, cov, column, sole[foot], settings.leg)
    lost = (loaded[0] or loaded[1]) and not (resting[0] or resting[1])
    if lost:
        adrift[0] += settings.one
    else:
        adrift[0] = settings.zero
    if adrift[0] > settings.patience:
        for axis in range(3):
            cov[axis, V, V] += settings.surprise
        cov[_Z, P, P] += settings.surprise_height
        adrift[0] = settings.zero


@compiled
def _predict(
    mean: np.ndarray,
    cov: np.ndarray,
    half_sole: np.ndarray,
    acceleration: np.ndarray,
    doubt: float,
    half: np.ndarray,
    settings: _Settings,
) -> None:
    dt = settings.timestep
    x, y, z = acceleration[0], acceleration[1], acceleration[2]
    shock = settings.shock * (x * x + y * y + z * z) + doubt * doubt
    for axis in range(3):
        push = acceleration[axis] + mean[axis, B]
        mean[axis, P] += dt * mean[axis, V] + settings.half_square * push
        mean[axis, V] += dt * push
        # lever arm of a sole that rocks over its end
        for foot in range(2):
            arm = min(max(half[foot, _Z] / settings.rock_height, -settings.one), settings.one)
            mean[axis, LEFT + foot] += arm * (half[foot, axis] - half_sole[foot, axis])
            half_sole[foot, axis] = half[foot, axis]
        # F P F^T with F = 1 + dt in (p, v) and (v, b)
        for k in range(5):
            cov[axis, P, k] += dt * cov[axis, V, k]
            cov[axis, V, k] += dt * cov[axis, B, k]
        for k in range(5):
            cov[axis, k, P] += dt * cov[axis, k, V]
            cov[axis, k, V] += dt * cov[axis, k, B]
            cov[axis, k, k] += settings.walk[axis, k]
        cov[axis, V, V] += dt * dt * shock


@compiled
def _near_ground(
    mean: np.ndarray, cov: np.ndarray, column: int, lowest: float, settings: _Settings
) -> bool:
    """True if a foot's lowest point can be on the ground."""
    variance = cov[_Z, column, column] + settings.ground
    above = lowest - mean[_Z, column]
    return above * above < settings.gate * variance


@compiled
def _is_at_rest(
    mean: np.ndarray,
    cov: np.ndarray,
    column: int,
    sole: np.ndarray,
    squared: np.ndarray,
    settings: _Settings,
) -> bool:
    """Compare sole - pelvis with its prediction, and write normalised squares to `squared`."""
    rests = True
    for axis in range(3):
        across = cov[axis, column, column] - cov[axis, P, column]
        variance = across - (cov[axis, column, P] - cov[axis, P, P]) + settings.leg
        innovation = sole[axis] - (mean[axis, column] - mean[axis, P])
        squared[axis] = innovation * innovation / variance
        rests = rests and squared[axis] < settings.gate
    return rests


@compiled
def _correct(
    mean: np.ndarray,
    cov: np.ndarray,
    column: int,
    sole: np.ndarray,
    settings: _Settings,
    gain: np.ndarray,
) -> None:
    """Measure sole - pelvis of a foot at rest."""
    for axis in range(3):
        for k in range(5):
            gain[k] = cov[axis, column, k] - cov[axis, P, k]  # P H^T
        variance = gain[column] - gain[P] + settings.leg
        innovation = sole[axis] - (mean[axis, column] - mean[axis, P])
        _update(mean[axis], cov[axis], gain, variance, innovation)


@compiled
def _ground(
    x: np.ndarray,
    p: np.ndarray,
    column: int,
    lowest: float,
    settings: _Settings,
    gain: np.ndarray,
) -> None:
    """Measure the centre height of a sole whose lowest point is on the ground."""
    for k in range(5):
        gain[k] = p[column, k]
    _update(x, p, gain, gain[column] + settings.ground, lowest - x[column])


@compiled
def _update(
    x: np.ndarray, p: np.ndarray, gain: np.ndarray, variance: float, innovation: float
) -> None:
    """Update one axis with one scalar measurement."""
    for j in range(5):
        scaled = gain[j] / variance
        x[j] += scaled * innovation
        for k in range(5):
            p[j, k] -= scaled * gain[k]


@compiled
def _plant(mean: np.ndarray, cov: np.ndarray, column: int, sole: np.ndarray, leg: float) -> None:
    """Set a foot's position from the leg kinematics; pelvis and encoders give its variance."""
    for axis in range(3):
        mean[axis, column] = mean[axis, P] + sole[axis]
        for k in range(5):
            cov[axis, column, k] = cov[axis, P, k]
        for k in range(5):
            cov[axis, k, column] = cov[axis, k, P]
        cov[axis, column, column] += leg
