r"""A Kalman filter for the pelvis that feels its way with the feet.

The attitude comes from the IMU, which is good at it. What is left is linear, and its three world
axes do not mix. Each axis has five states: position :math:`p` and velocity :math:`v` of the pelvis,
an error :math:`b` of the measured acceleration, and the positions :math:`l, r` of the two soles.

.. math::

    \dot p = v, \quad \dot v = a + b, \quad \dot b = w_b, \quad
    \dot l, \dot r = w_\text{slip} \text{ at rest on the ground, unknown else}

with :math:`a` the accelerometer turned into the world, less gravity. The measurements are the soles
relative to the pelvis from the legs' encoders, :math:`y_l = l - p`, and, on the vertical axis, that
the lowest point of a sole at rest is on the ground, at height zero.

Process and measurement are those of Bloesch et al., "State estimation for legged robots: consistent
fusion of leg kinematics and IMU" (RSS 2012), with the attitude taken from elsewhere as in Bledt et
al., "MIT Cheetah 3" (IROS 2018), which makes it linear. Prediction and update are Kalman's
(1960), one scalar measurement at a time. Ours are:

- contact from the leaf springs (`aslip.estimation.legs`), as Cassie has no foot force sensor;
- a foot counts only while it rests on the ground: the innovation of a foot that skids after
  touchdown, or leaves the ground a moment before its springs have relaxed, is improbable, and so is
  the height of one that swings and shakes its springs; such a foot is planted anew;
- a sole that rocks over its heel or toes moves its centre by the arm of that lever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

P, V, B, LEFT, RIGHT = range(5)
"""Position, velocity, acceleration error, and soles, in the state of an axis."""

_FEET = (LEFT, RIGHT)
_Z = 2


@dataclass(frozen=True)
class FilterNoise:
    """What the filter assumes, as standard deviations; tuned on walks of the shipped policy."""

    acceleration: float = 0.2
    """Of the acceleration over one packet [m/s^2]."""
    shock: float = 0.05
    """Further error of the acceleration, as a share of it: impacts fall between samples."""
    acceleration_error: float = 0.02
    """Walk of the acceleration error in a second [m/s^2 / sqrt(s)]: tilt and bias."""
    slip: float = 0.012
    """Walk of a sole at rest in a second, along the ground [m / sqrt(s)]."""
    sink: float = 0.004
    """The same across it."""
    leg: float = 1.2e-4
    """Position of a sole from encoders [m]."""
    ground: float = 2e-3
    """Height of the lowest point of a sole at rest [m]: its compliance, and the ground's height."""
    gate: float = 16.0
    """Largest squared ratio, on any axis, of a resting foot's innovation to its deviation."""
    load: float = 60.0
    """Force on a foot from which it is in contact [N]."""
    unload: float = 45.0
    """Force below which it no longer is [N]."""
    rock: float = 0.05
    """Pitch of a sole from which it stands on one end alone [rad]."""
    initial_height: float = 0.02
    """Of the height at the start, the lower foot standing on the ground [m]."""
    initial_velocity: float = 0.2
    """Of the velocity at the start, the lower foot at rest [m/s]."""
    initial_acceleration_error: float = 0.1
    """Of the acceleration error at the start [m/s^2]."""
    patience: int = 30
    """Packets with load but no foot at rest, after which velocity and height are held to be
    wrong."""
    surprise: float = 0.5
    """What is added to the velocity's deviation then [m/s]."""
    surprise_height: float = 0.1
    """What is added to the height's [m]."""


@dataclass
class Belief:
    """What n filters know; everything that a packet changes."""

    mean: np.ndarray
    """(n, 3, 5) states of the axes x, y, z of the world."""
    covariance: np.ndarray
    """(n, 3, 5, 5)."""
    half_sole: np.ndarray
    """(n, 2, 3) from the centre of each sole to its toe [m, world]."""
    loaded: np.ndarray
    """(n, 2) bool, the springs of a leg say contact."""
    resting: np.ndarray
    """(n, 2) bool, and its foot did not move: it took part in the last update."""
    adrift: np.ndarray
    """(n,) packets since a loaded foot last rested."""
    innovation: np.ndarray
    """(n, 2, 3) squared ratio of a loaded foot's innovation to its deviation by axis; else NaN."""


@dataclass(frozen=True)
class Motion:
    """What one packet says, in the axes of the world."""

    acceleration: np.ndarray
    """(n, 3) of the pelvis' origin, without gravity [m/s^2]."""
    doubt: np.ndarray
    """(n,) further deviation of that, for readings that had to be made up [m/s^2]."""
    sole: np.ndarray
    """(n, 2, 3) centres of the soles' axes from the pelvis [m]."""
    half_sole: np.ndarray
    """(n, 2, 3) from there to the toes [m]."""
    load: np.ndarray
    """(n, 2) vertical force on the feet [N]."""
    fresh: np.ndarray
    """(n, 2) bool, the leg's readings are this packet's and plausible."""


class ContactFilter:
    """Predict with the IMU, correct with the feet.

    Args:
        timestep: between packets [s].
        sole_radius: of the soles' contact capsules [m].
        sole_half_length: of their axes [m].
        noise: what to assume.
    """

    def __init__(
        self, timestep: float, sole_radius: float, sole_half_length: float, noise: FilterNoise
    ) -> None:
        self.noise = noise
        self._dt = timestep
        self._radius = sole_radius
        self._rock_height = noise.rock * sole_half_length
        self._leg = noise.leg**2
        walk = np.array([noise.slip, noise.slip, noise.sink])
        # (3, 5) what a packet adds to the variances, but for the acceleration's share
        self._walk = np.zeros((3, 5))
        self._walk[:, V] = (timestep * noise.acceleration) ** 2
        self._walk[:, B] = timestep * noise.acceleration_error**2
        self._walk[:, LEFT:] = timestep * walk[:, None] ** 2

    def start(self, motion: Motion, sole_velocity: np.ndarray) -> Belief:
        """Beliefs about robots whose lower foot rests on the ground.

        Args:
            motion: a first packet.
            sole_velocity: (n, 2, 3) velocities of the soles relative to the pelvis [m/s, world].
        """
        num, noise = len(motion.sole), self.noise
        lowest = motion.sole[..., _Z] - np.abs(motion.half_sole[..., _Z])
        rows, stance = np.arange(num), lowest.argmin(1)
        # robots last in memory, so that NumPy's loops are long ones
        mean = np.zeros((num, 3, 5), order="F")
        mean[..., V] = -sole_velocity[rows, stance]
        mean[:, _Z, P] = self._radius - lowest[rows, stance]
        covariance = np.zeros((num, 3, 5, 5), order="F")
        covariance[:, _Z, P, P] = noise.initial_height**2
        covariance[..., V, V] = noise.initial_velocity**2
        covariance[..., B, B] = noise.initial_acceleration_error**2
        belief = Belief(
            mean=mean,
            covariance=covariance,
            half_sole=motion.half_sole.copy(),
            loaded=np.zeros((num, 2), dtype=bool),
            resting=np.zeros((num, 2), dtype=bool),
            adrift=np.zeros(num),
            innovation=np.full((num, 2, 3), np.nan),
        )
        for foot, column in enumerate(_FEET):
            self._plant(belief, column, motion.sole[:, foot], np.ones((num, 1), dtype=bool))
        return belief

    def step(self, belief: Belief, motion: Motion) -> None:
        """Take one packet into account, in place."""
        self._predict(belief, motion)
        threshold = np.where(belief.loaded, self.noise.unload, self.noise.load)
        belief.loaded = motion.load > threshold
        candidates = belief.loaded & motion.fresh
        belief.resting = np.zeros(candidates.shape, dtype=bool)
        belief.innovation = np.empty(belief.innovation.shape)
        belief.innovation.fill(np.nan)
        for foot, column in enumerate(_FEET):
            sole, candidate = motion.sole[:, foot], candidates[:, foot]
            if candidate.any():
                lowest = self._radius + np.abs(motion.half_sole[:, foot, _Z])
                candidate = candidate & self._near_ground(belief, column, lowest)
                rests = self._correct(belief, foot, column, sole, candidate)
                self._ground(belief, column, lowest, rests)
                belief.resting[:, foot] = rests
            moves = ~belief.resting[:, foot, None]
            if moves.any():
                self._plant(belief, column, sole, moves)
        self._recover(belief)

    def _predict(self, belief: Belief, motion: Motion) -> None:
        dt, mean, cov = self._dt, belief.mean, belief.covariance
        acceleration = motion.acceleration + mean[..., B]
        mean[..., P] += dt * mean[..., V] + (dt * dt / 2) * acceleration
        mean[..., V] += dt * acceleration
        # a sole that rocks over its end moves its centre
        arm = (motion.half_sole[..., _Z] / self._rock_height).clip(-1.0, 1.0)
        rocked = arm[..., None] * (motion.half_sole - belief.half_sole)
        mean[..., LEFT:] += rocked.swapaxes(1, 2)
        belief.half_sole = motion.half_sole
        # F P F^T with F = 1 + dt in (p, v) and (v, b); the right-hand sides are evaluated first
        cov[..., :B, :] += dt * cov[..., V:LEFT, :]
        cov[..., :B] += dt * cov[..., V:LEFT]
        variances = np.einsum("...ii->...i", cov)  # a view
        variances += self._walk
        shock = self.noise.shock**2 * (motion.acceleration**2).sum(-1) + motion.doubt**2
        variances[..., V] += (dt * dt) * shock[:, None]

    def _near_ground(self, belief: Belief, column: int, lowest: np.ndarray) -> np.ndarray:
        """(n,) bool, that a foot's lowest point is on the ground is not improbable."""
        variance = belief.covariance[:, _Z, column, column] + self.noise.ground**2
        innovation = lowest - belief.mean[:, _Z, column]
        return innovation**2 < self.noise.gate * variance

    def _correct(
        self, belief: Belief, foot: int, column: int, sole: np.ndarray, candidate: np.ndarray
    ) -> np.ndarray:
        """Measure sole - pelvis where a foot rests; (n,) bool, where it did."""
        mean, cov = belief.mean, belief.covariance
        gain = cov[..., column] - cov[..., P]  # P H^T
        variance = gain[..., column] - gain[..., P] + self._leg
        innovation = sole - (mean[..., column] - mean[..., P])
        squared = innovation**2 / variance
        rests = candidate & (squared.max(1) < self.noise.gate)
        belief.innovation[candidate, foot] = squared[candidate]
        scaled = gain * (rests[:, None] / variance)[..., None]
        mean += scaled * innovation[..., None]
        cov -= scaled[..., None] * gain[..., None, :]
        return rests

    def _ground(self, belief: Belief, column: int, lowest: np.ndarray, rests: np.ndarray) -> None:
        """Put the lowest point of soles at rest on the ground: their centres are so high."""
        mean, cov = belief.mean[:, _Z], belief.covariance[:, _Z]
        gain = cov[..., column].copy()
        variance = gain[..., column] + self.noise.ground**2
        innovation = lowest - mean[:, column]
        scaled = gain * (rests / variance)[:, None]
        mean += scaled * innovation[:, None]
        cov -= scaled[..., None] * gain[..., None, :]

    def _plant(self, belief: Belief, column: int, sole: np.ndarray, rows: np.ndarray) -> None:
        """Put a foot where its leg says, as uncertain as the pelvis; rows (n, 1) bool."""
        mean, cov = belief.mean, belief.covariance
        mean[..., column] = np.where(rows, mean[..., P] + sole, mean[..., column])
        where = rows[..., None]
        cov[..., column, :] = np.where(where, cov[..., P, :], cov[..., column, :])
        cov[..., column] = np.where(where, cov[..., P], cov[..., column])
        cov[..., column, column] += self._leg * rows

    def _recover(self, belief: Belief) -> None:
        """Doubt velocity and height where no loaded foot has rested for long."""
        loaded, resting = belief.loaded, belief.resting
        lost = (loaded[:, 0] | loaded[:, 1]) & ~(resting[:, 0] | resting[:, 1])
        belief.adrift = (belief.adrift + 1) * lost
        surprised = belief.adrift > self.noise.patience
        if surprised.any():
            belief.covariance[surprised, :, V, V] += self.noise.surprise**2
            belief.covariance[surprised, _Z, P, P] += self.noise.surprise_height**2
            belief.adrift[surprised] = 0
