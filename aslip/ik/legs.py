r"""Motor angles of both legs in closed form, for all robots at once, without Pinocchio.

From the hip pitch down a leg of Cassie is planar, see `aslip.estimation.legs`. Its plane holds the
sole's centre and the level direction of the toes, which determines the hips. With the centre
:math:`(x, y, z)` from where the axes of roll :math:`\varphi` and yaw :math:`\psi` meet, the heading
:math:`h` of the toes and the distance :math:`d` of the plane to the left of the hip

.. math:: \tan\psi = \cos\varphi \tan h, \qquad
          \cos\psi\,(y \cos\varphi + z \sin\varphi) - x \sin\psi = d,

which is quadratic in :math:`\tan\varphi`. In the plane, the squared distance from the hip pitch to
the foot's hinge determines knee and, through the Achilles rod, tarsus: smooth functions of one
variable, which are Chebyshev polynomials here.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev

from aslip.base.arrays import Array, is_numpy, namespace
from aslip.errors import ConfigurationError
from aslip.estimation.legs import Chain, leg_chains
from aslip.ik.inertia import Masses, inertial_torque, leg_masses, polynomials
from aslip.robot import CASSIE, SIDES, Robot
from aslip.robot.rotation import quaternion_to_matrix

DEGREE: Final = 24
"""Degree of the polynomials."""

# frames that the closed form is for, at angles of zero: axes of roll and yaw, plane of the leg
_ROLL, _YAW = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
_PLANE = ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))
# soles are at least as far below the hip [m], and toes point at most as far to the side [rad]
_LEAST_DEPTH, _LARGEST_HEADING = 0.2, 1.2
# largest sine and Chebyshev variable, whose arcus has finite derivatives
_ALMOST_ONE = 1 - 1e-6


class LegTable:
    """Inverse kinematics and statics of both legs, on NumPy's arrays and torch's tensors.

    Poses are those of `aslip.ik.solve` with a level pelvis, soles level along the toes and springs
    at rest. Targets out of reach give the nearest angles on the way: hips turn as far as their
    limits allow, and a leg too long or too short for its plane has the direction of its target.

    Args:
        robot: robot with Cassie's legs.

    Raises:
        ConfigurationError: the robot has other legs, see also `LegKinematics`.
    """

    def __init__(self, robot: Robot = CASSIE) -> None:
        legs = [_leg(robot, *leg) for leg in zip(SIDES, leg_chains(robot), strict=True)]
        chains, masses = (zip(*both, strict=True) for both in zip(*legs, strict=True))
        self._numbers = _Leg(*map(np.stack, chains)), Masses(*map(np.stack, masses))
        self._placed: dict[Any, tuple[_Leg, Masses]] = {}

    def motors(self, position: Array, heading: Array) -> tuple[Array, Array]:
        """Motor angles for feet relative to the pelvis.

        Args:
            position: (*b, 2, 3) centres of the soles from the pelvis' origin, left first, in the
                frame of a level pelvis [m].
            heading: (*b, 2) directions of the toes from that of the pelvis [rad].

        Returns:
            (*b, 10) motor angles [rad], motor order, within the joint limits, and (*b, 2, 5, 4)
            derivatives of each leg's by x, y, z and heading, zero for angles at a limit.
        """
        leg, _ = self._like(position)
        pose = _pose(leg, position, heading)
        inside = (pose.angle > leg.lower) & (pose.angle < leg.upper)
        jacobian = _jacobian(pose, heading) * inside[..., None]
        angle = pose.angle.clip(leg.lower, leg.upper)
        return angle.reshape(*angle.shape[:-2], 10), jacobian

    def torque(
        self, position: Array, heading: Array, force: Array, ahead: Array | float = 0.0
    ) -> Array:
        """Motor torques that balance ground forces on the soles, as `static_torque`'s.

        Args:
            position: (*b, 2, 3) as in `motors`.
            heading: (*b, 2) as in `motors`.
            force: (*b, 2, 3) force of the ground on each sole, in the same frame [N].
            ahead: (*b, 2) distance of the centre of pressure ahead of the sole's centre, along the
                toes [m].

        Returns:
            (*b, 10) torques at the joints [N m], motor order.
        """
        leg, _ = self._like(position)
        torque = _torque(leg, _pose(leg, position, heading), force, ahead)
        return torque.reshape(*torque.shape[:-2], 10)

    def inertial_torque(
        self, angle: Array, velocity: Array, acceleration: Array, pelvis_acceleration: Array
    ) -> Array:
        """Motor torques that carry and accelerate the legs, as `leg_torque`'s.

        Args:
            angle: (*b, 10) motor angles [rad], motor order.
            velocity: (*b, 10) their rates [rad/s].
            acceleration: (*b, 10) accelerations [rad/s^2].
            pelvis_acceleration: (*b, 3) of a level pelvis that does not turn, in its own axes
                [m/s^2].

        Returns:
            (*b, 10) torques at the joints [N m], motor order.
        """
        _, masses = self._like(angle)
        angle, velocity, acceleration = (
            x.reshape(*x.shape[:-1], 2, 5) for x in (angle, velocity, acceleration)
        )
        pelvis = pelvis_acceleration[..., None, :]
        torque = inertial_torque(masses, angle, velocity, acceleration, pelvis)
        return torque.reshape(*torque.shape[:-2], 10)

    def _like(self, array: Array) -> tuple[_Leg, Masses]:
        """Constants as arrays of the kind of another."""
        key = array.dtype, None if is_numpy(array) else array.device
        if key not in self._placed:
            leg, masses = ((_placed(x, array) for x in part) for part in self._numbers)
            self._placed[key] = _Leg(*leg), Masses(*masses)
        return self._placed[key]


class _Leg(NamedTuple):
    """Constants of a leg; those of both have a first axis (2,)."""

    hip: Array
    """(3,) where the axes of hip roll and yaw meet [m]."""
    depth: Array
    """Distance of the plane to the left of this point [m]."""
    drop: Array
    """Height of the hip pitch hinge above this point [m]."""
    sole: Array
    """(2,) sole's centre ahead of and above the foot's hinge when the toes are level [m]."""
    zero: Array
    """(5,) motor angles at which the angles of the closed form are zero [rad]."""
    lower: Array
    """(5,) lower limits of the motors [rad]."""
    upper: Array
    """(5,) upper limits of the motors [rad]."""
    reach: Array
    """(2,) least and greatest square of the distance between hip pitch and foot's hinge [m^2]."""
    table: Array
    """(DEGREE + 1, 6) coefficients of knee, direction of the foot's hinge and angle of the tarsus
    at a hip pitch of zero [rad], then of their derivatives by the squared distance [rad/m^2]."""


class _Pose(NamedTuple):
    """Legs at their targets; numbers are (*b, 2), and complex ones are down + i ahead."""

    turns: tuple[Array, Array, Array, Array]
    """Cosine and sine of hip roll, then of hip yaw."""
    target: tuple[Array, Array, Array]
    """Target from `_Leg.hip`, in axes that roll and yaw with the leg [m]."""
    toes: Array
    """Complex direction of the toes."""
    sole: Array
    """Complex sole's centre from the foot's hinge [m]."""
    foot: Array
    """Complex target of the foot's hinge from the hip pitch [m]."""
    squared: Array
    """Squared distance of the foot's hinge from the hip pitch within the leg's reach [m^2]."""
    table: Array
    """(*b, 2, 6) values of the polynomials."""
    free: tuple[Array, Array, Array]
    """Whether hip roll, hip yaw and the length of the leg are within their limits."""
    angle: Array
    """(*b, 2, 5) motor angles, beyond the limits, too [rad]."""


def _pose(leg: _Leg, position: Array, heading: Array) -> _Pose:
    """Legs for targets (*b, 2, 3) and headings (*b, 2) of the soles."""
    xp = namespace(position)
    x, y, z = (position[..., i] - leg.hip[..., i] for i in range(3))
    z = z.clip(None, -_LEAST_DEPTH)
    wanted, hips = _hips(leg, (x, y, z), heading)
    roll, yaw = hips
    free = [turn == desired for turn, desired in zip(hips, wanted, strict=True)]
    cos_r, sin_r, cos_y, sin_y = xp.cos(roll), xp.sin(roll), xp.cos(yaw), xp.sin(yaw)
    across = y * cos_r + z * sin_r
    target = x * cos_y + across * sin_y, across * cos_y - x * sin_y, z * cos_r - y * sin_r
    # the level direction of the plane
    toes = sin_y * sin_r + 1j * cos_r
    toes = toes / abs(toes)
    sole = toes * (leg.sole[..., 0] + 1j * leg.sole[..., 1])
    foot = leg.drop - target[2] + 1j * target[0] - sole
    desired = foot.real**2 + foot.imag**2
    squared = desired.clip(leg.reach[..., 0], leg.reach[..., 1])
    table = polynomials(leg.reach, leg.table, squared)
    knee, direction, tarsus = (table[..., i] for i in range(3))
    pitch = xp.angle(foot) - direction
    angles = [*wanted, pitch, knee, xp.angle(toes) - pitch - tarsus]
    return _Pose(
        turns=(cos_r, sin_r, cos_y, sin_y),
        target=target,
        toes=toes,
        sole=sole,
        foot=foot,
        squared=squared,
        table=table,
        free=(*free, squared == desired),
        angle=xp.stack(angles, -1) + leg.zero,
    )


def _hips(
    leg: _Leg, target: tuple[Array, Array, Array], heading: Array
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Hip roll and yaw (*b, 2) as the target needs them, and within their limits [rad]."""
    xp, (x, y, z) = namespace(heading), target
    low, high = leg.lower - leg.zero, leg.upper - leg.zero
    tangent = xp.tan(heading.clip(-_LARGEST_HEADING, _LARGEST_HEADING))
    aside, d = y - x * tangent, leg.depth
    root = (aside**2 + (1 + tangent**2) * (z**2 - d**2)) ** 0.5
    roll = xp.arctan((-aside * z - d * root) / (z**2 - d**2))
    roll = roll.clip(low[..., 0], high[..., 0])
    desired = xp.arctan(xp.cos(roll) * tangent)
    yaw = desired.clip(low[..., 1], high[..., 1])
    # the sole keeps its place where the yaw has a limit
    sine = (d + x * xp.sin(yaw)) / (xp.cos(yaw) * (y**2 + z**2) ** 0.5)
    roll = xp.arctan2(y, -z) - xp.arcsin(sine.clip(-_ALMOST_ONE, _ALMOST_ONE))
    return (roll, desired), (roll.clip(low[..., 0], high[..., 0]), yaw)


def _jacobian(pose: _Pose, heading: Array) -> Array:
    """(*b, 2, 5, 4) derivatives of the motor angles by position and heading."""
    xp = namespace(heading)
    cos_r, sin_r, cos_y, sin_y = (turn[..., None] for turn in pose.turns)
    x, y, z = (value[..., None] for value in pose.target)
    free_r, free_y, free_l = (value[..., None] for value in pose.free)
    toes, sole, foot = (value[..., None] for value in (pose.toes, pose.sole, pose.foot))
    none, ahead, up = 0 * x, toes.imag, -toes.real
    # derivatives of the target, and of the toes normal to the plane, with hips held
    dx, dy, dz = (xp.concatenate([*row, none], -1) for row in _rows(pose.turns))
    turn = sin_y[..., 0] * xp.sin(heading) + (cos_y * cos_r)[..., 0] * xp.cos(heading)
    aside = xp.concatenate([none, none, none, turn[..., None]], -1)
    yaw = xp.where(free_r, (z * aside - up * dy) / (ahead * z - up * x), aside / ahead) * free_y
    roll = (x * yaw - dy) / (cos_y * z) * free_r
    level = -(ahead**2) * (cos_y * sin_r / cos_r * yaw + sin_y / cos_r**2 * roll)
    dx = dx + sin_y * z * roll + y * yaw
    dz = dz - (cos_y * y + sin_y * x) * roll
    product = foot.conj() * (-dz + 1j * dx - 1j * sole * level)
    squared = 2 * product.real * free_l
    knee, direction, tarsus = (pose.table[..., i : i + 1] * squared for i in (3, 4, 5))
    pitch = product.imag / (foot.real**2 + foot.imag**2) - direction
    return xp.stack([roll, yaw, pitch, knee, level - pitch - tarsus], -2)


def _rows(turns: tuple[Array, Array, Array, Array]) -> list[list[Array]]:
    """Rows of the rotation from the pelvis to axes that roll and yaw with the leg, (*b, 2, 1)."""
    cos_r, sin_r, cos_y, sin_y = (turn[..., None] for turn in turns)
    ahead = [cos_y, sin_y * cos_r, sin_y * sin_r]
    return [ahead, [-sin_y, cos_y * cos_r, cos_y * sin_r], [0 * cos_y, -sin_r, cos_r]]


def _torque(leg: _Leg, pose: _Pose, force: Array, pressed: Array | float) -> Array:
    """(*b, 2, 5) torques that balance forces (*b, 2, 3), at (*b, 2) ahead of the centres."""
    xp, (_, _, cos_y, sin_y) = namespace(force), pose.turns
    ahead, left, up = (
        sum(row[i][..., 0] * force[..., i] for i in range(3)) for row in _rows(pose.turns)
    )
    desired = pose.foot.real**2 + pose.foot.imag**2
    foot = pose.foot * (pose.squared / desired) ** 0.5
    sole = pose.sole + pressed * pose.toes
    centre = foot + sole
    x, y, z = centre.imag, leg.depth, leg.drop - centre.real
    knee, direction, tarsus = (pose.table[..., i] for i in (3, 4, 5))
    by_knee = (foot * (0.5 / pose.squared + 1j * direction) + 1j * tarsus * sole) / knee
    pull = 1j * ahead - up
    moments = [
        sin_y * z * ahead + cos_y * z * left - (cos_y * y + sin_y * x) * up,
        y * ahead - x * left,
        *(-(arm.conj() * pull).real for arm in (1j * centre, by_knee, 1j * sole)),
    ]
    return xp.stack(moments, -1)


def _placed(number: np.ndarray, like: Array) -> Array:
    """Constants as an array of the kind of another, complex ones of the same precision."""
    if np.iscomplexobj(number):
        return _placed(number.real, like) + 1j * _placed(number.imag, like)
    if is_numpy(like):
        return number.astype(like.dtype)
    return namespace(like).tensor(number, dtype=like.dtype, device=like.device)


def _leg(robot: Robot, side: str, chain: Chain) -> tuple[_Leg, Masses]:
    """Constants of one leg.

    Raises:
        ConfigurationError: the hips differ from Cassie's.
    """
    first, second, third = chain.hip_frame
    found = first[:, 2], (first @ second)[:, 2], first @ second @ third
    gaps = [np.abs(a - b).max() for a, b in zip(found, (_ROLL, _YAW, _PLANE), strict=True)]
    apart = np.abs(chain.hip_position[1:, :2]).max()
    if max(*gaps, apart) > 1e-6:
        raise ConfigurationError(
            f"the {side} hip of {robot} must roll about x, yaw about z and pitch about -y, the"
            " first two about axes that meet, and the others about axes that meet"
        )
    skeleton = robot.skeleton
    site = skeleton.sites[robot.foot_sites[SIDES.index(side)]]
    toes = quaternion_to_matrix(np.array(site.quaternion))[:, 0]
    direction = complex(*toes[:2])
    centre = complex(*site.position[:2]) / direction
    motors = [name for name in robot.motor_names if name.startswith(side)]
    limits = np.array([skeleton.joints[name].range for name in motors])
    tarsi = np.array(skeleton.joints[f"{side}_tarsus"].range)
    (reach, table), bends = _planar(chain, limits[3], tarsi)
    ankle = -np.angle(direction) - chain.offset[4]
    _, back, drop = chain.hip_position[:, 2]
    zero = np.array([*chain.hip_zero, -chain.offset[0], 0.0, ankle])
    leg = _Leg(
        hip=chain.hip_position[0] + (back, 0.0, 0.0),
        depth=-chain.depth.mean(),
        drop=drop,
        sole=np.array([centre.real, centre.imag]),
        zero=zero,
        lower=limits[:, 0],
        upper=limits[:, 1],
        reach=reach,
        table=table,
    )
    return leg, leg_masses(robot, side, zero, *bends)


def _planar(chain: Chain, knees: np.ndarray, tarsi: np.ndarray) -> list[tuple[Any, np.ndarray]]:
    """Domains and polynomials of `_Leg` and `Masses`, for limits of knee and tarsus [rad]."""
    knee = np.linspace(knees[0], knees[1], 2001)
    first, shin, spring, last = chain.links
    elbow = first + _unit(knee + chain.offset[1]) * (shin + _unit(chain.offset[2]) * spring)
    # the rod's end on the tarsus is on a circle about the elbow and on one about the hip
    tip, rod = chain.tip, chain.rod_squared - chain.tip_height**2
    cosine = (rod - abs(elbow) ** 2 - abs(tip) ** 2) / (2 * abs(elbow) * abs(tip))
    turn = np.unwrap(np.angle(elbow)) - np.angle(tip) - np.arccos(np.clip(cosine, -1, 1))
    tarsus = turn - knee - chain.offset[1:4].sum()
    turn -= 2 * np.pi * np.round((tarsus.mean() - tarsi.mean()) / (2 * np.pi))
    tarsus = turn - knee - chain.offset[1:4].sum()
    foot = elbow + _unit(turn) * last
    good = (abs(cosine) < 1) & (tarsi[0] <= tarsus) & (tarsus <= tarsi[1])
    squared, direction = abs(foot[good]) ** 2, np.unwrap(np.angle(foot[good]))
    rod = np.unwrap(np.angle(elbow + _unit(turn) * tip)[good])
    knee, turn = knee[good], turn[good]
    found = []
    for variable, values in ((squared, (knee, direction, turn)), (knee, (turn, rod))):
        domain = np.array([variable.min(), variable.max()])
        fits = [Chebyshev.fit(variable, value, DEGREE, domain=domain) for value in values]
        orders = range(6 // len(fits))
        columns = [np.append(fit.deriv(k).coef, np.zeros(k)) for k in orders for fit in fits]
        found.append((domain, np.stack(columns, -1)))
    return found


def _unit(angle: Any) -> Any:
    """Complex numbers of length one."""
    return np.exp(1j * angle)
