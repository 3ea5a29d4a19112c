r"""Motor torques that carry and accelerate planar legs in closed form.

The bodies of a leg are point masses. In the leg's plane each is a sum over the unit vectors of its
links, :math:`w_p = \sum_k c_{pk} u_k` with :math:`u_k = e^{i \varphi_k}`, down + i ahead from where
the axes of hip roll and yaw meet. So constant matrices of the links have all the masses in them:
forces of inertia along the links' turns are

.. math::
    Q_k = \mathrm{Re}\Big(\overline{i u_k} \big(\bar s_k a + \sum_j G_{kj} \ddot u_j\big)\Big),
    \quad s_k = \sum_p m_p c_{pk}, \quad G_{kj} = \sum_p m_p \bar c_{pk} c_{pj}

with the acceleration a of the hip, gravity included. Motors turn the links by virtual work.
Distances from the plane are constant, so the turns of roll and yaw need no other sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from aslip.base.arrays import Array, namespace
from aslip.robot.robot import STANDARD_GRAVITY, Robot
from aslip.robot.rotation import quaternion_to_matrix
from aslip.robot.skeleton import Skeleton

# link of each body; others are part of their parent's, and the first holds what only yaws
_LINKS: Final = {
    "hip_yaw": 0,
    "hip_pitch": 1,
    "knee": 2,
    "tarsus": 3,
    "foot_crank": 4,
    "plantar_rod": 3,
    "foot": 4,
    "achilles_rod": 5,
}
# largest Chebyshev variable, whose arcus has a finite derivative
_ALMOST_ONE = 1 - 1e-6


class Masses(NamedTuple):
    """Masses of the links of a leg; those of both have a first axis (2,)."""

    zero: Array
    """(5,) motor angles at which the angles of the links are zero [rad]."""
    armature: Array
    """(5,) reflected inertia of the motors [kg m^2]."""
    knees: Array
    """(2,) least and greatest angle of the knee [rad]."""
    bends: Array
    """(n, 6) coefficients, by the knee, of the angles of tarsus and Achilles rod at a hip pitch of
    zero [rad], of their first and of their second derivatives."""
    moment: Array
    """(6,) complex first moments s of the links [kg m]."""
    gram: Array
    """(6, 6) complex second moments G [kg m^2]."""
    square: Array
    """(6, 6) the same without conjugation [kg m^2]."""
    aside: Array
    """(6,) complex second moments with the distance to the left of the hip [kg m^2]."""
    left: Array
    """First moment of this distance [kg m]."""
    width: Array
    """Its second moment [kg m^2]."""


def leg_masses(
    robot: Robot, side: str, zero: np.ndarray, knees: np.ndarray, bends: np.ndarray
) -> Masses:
    """Masses of a leg, from the standing robot; see `Masses`."""
    skeleton = robot.skeleton
    joints = [skeleton.joints[name] for name in robot.motor_names if name.startswith(side)]
    angle = np.array([skeleton.standing[joint.qpos] for joint in joints]) - zero
    bend = polynomials(knees, bends, angle[3])
    mass, arm, left = _points(skeleton, side, _unit(_links(list(angle[2:]), bend[0], bend[1])))
    return Masses(
        zero=zero,
        armature=np.array([joint.armature for joint in joints]),
        knees=knees,
        bends=bends,
        moment=mass @ arm,
        gram=arm.conj().T @ (mass[:, None] * arm),
        square=arm.T @ (mass[:, None] * arm),
        aside=(mass * left) @ arm,
        left=mass @ left,
        width=mass @ left**2,
    )


def _points(
    skeleton: Skeleton, side: str, unit: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point masses (p,), their coefficients (p, 6) and distances to the left (p,).

    Six points on the principal axes have the inertia of a body. The body that only rolls is left
    out, its centre is 2 cm from the axis.
    """
    placed: dict[str, tuple[np.ndarray, np.ndarray, int, np.ndarray]] = {}
    found, links = [], np.eye(len(unit))
    for name, body in skeleton.bodies.items():
        part = name.removeprefix(f"{side}_")
        if part == "hip_yaw":
            rotation, origin, link, base = np.eye(3), np.zeros(3), 0, 0 * unit
        elif body.parent in placed:
            turn, before, link, base = placed[body.parent]
            origin = before + turn @ body.position
            base = base + links[link] * _plane(origin - before) / unit[link]
            rotation = turn @ quaternion_to_matrix(np.array(body.quaternion))
            rotation = rotation @ _turn(skeleton, name)
            link = _LINKS.get(part, link)
        else:
            continue
        placed[name] = rotation, origin, link, base
        inertia = np.array(body.inertia)
        size = np.sqrt(3 * (inertia.sum() / 2 - inertia).clip(0.0) / body.mass)
        ends = rotation @ quaternion_to_matrix(np.array(body.axes)) * size
        arm = np.concatenate([ends.T, -ends.T]) + rotation @ body.centre
        own = base + links[link] * _plane(arm)[:, None] / unit[link]
        found.append((np.full(6, body.mass / 6), own, origin[1] + arm[:, 1]))
    mass, arm, left = (np.concatenate(values) for values in zip(*found, strict=True))
    return mass, arm, left


def _turn(skeleton: Skeleton, name: str) -> np.ndarray:
    """Rotation of a joint of the standing robot."""
    joint = skeleton.joints.get(name)
    if joint is None:
        return np.eye(3)
    if joint.kind == "ball":
        return quaternion_to_matrix(np.array(skeleton.standing[joint.qpos : joint.qpos + 4]))
    half = (skeleton.standing[joint.qpos] - joint.zero) / 2
    return quaternion_to_matrix(np.array([np.cos(half), 0.0, 0.0, np.sin(half)]))


def inertial_torque(
    masses: Masses, angle: Array, velocity: Array, acceleration: Array, pelvis: Array
) -> Array:
    """Torques (*b, 2, 5) at motor angles, rates and accelerations (*b, 2, 5), pelvis (*b, 1, 3).

    Products of the rates of hip roll and yaw with each other are left out.
    """
    xp, m = namespace(angle), masses
    roll, yaw, pitch, knee, foot = ((angle - m.zero)[..., i] for i in range(5))
    cos_r, sin_r, cos_y, sin_y = xp.cos(roll), xp.sin(roll), xp.cos(yaw), xp.sin(yaw)
    tarsus, rod, *slopes = (polynomials(m.knees, m.bends, knee)[..., i] for i in range(6))
    v, a = ([rates[..., i] for i in range(5)] for rates in (velocity, acceleration))
    # all links turn with the pitch of their plane, which rolls about an axis that yaw turns
    rate = (sin_y * v[0])[..., None] + _links(v[2:], slopes[0] * v[3], slopes[1] * v[3])
    bent, swung = (slopes[i] * a[3] + slopes[i + 2] * v[3] ** 2 for i in range(2))
    gain = (sin_y * a[0])[..., None] + _links(a[2:], bent, swung)
    unit = _unit(_links((pitch, knee, foot), tarsus, rod))
    faster = (1j * gain - rate**2) * unit
    # rates of roll and yaw in the plane, and accelerations
    turn, turned = (cos_y * x[0] + 1j * x[1] for x in (v, a))
    x, y, z = (pelvis[..., i] + (i == 2) * STANDARD_GRAVITY for i in range(3))
    across, up = y * cos_r + z * sin_r, z * cos_r - y * sin_r
    plane = 1j * (x * cos_y + across * sin_y) - up
    force = m.moment.conj() * plane[..., None] + _times(m.gram, faster)
    force = force - m.aside.conj() * turned[..., None]
    along = ((1j * unit).conj() * force).real
    half = turned.conj()[..., None] / 2 * unit + turn.conj()[..., None] * (1j * rate * unit)
    pull = (across * cos_y - x * sin_y)[..., None] * m.moment * unit - m.aside * faster
    pull = pull + half * _times(m.square, unit) + half.conj() * _times(m.gram, unit)
    hips = pull.sum(-1) - m.left * plane + m.width * turned
    thigh, shank, ankle, toes, bar = (along[..., i] for i in range(1, 6))
    torques = [
        cos_y * hips.real + sin_y * along.sum(-1),
        hips.imag,
        thigh + shank + ankle + toes + bar,
        shank + slopes[0] * (ankle + toes) + slopes[1] * bar,
        toes,
    ]
    return xp.stack(torques, -1) + m.armature * acceleration


def polynomials(domain: Array, table: Array, value: Array) -> Array:
    """(*b, j) values of Chebyshev polynomials with coefficients (*b, k, j) at values (*b,)."""
    xp, (low, high) = namespace(value), (domain[..., 0], domain[..., 1])
    variable = (2 * value - low - high) / (high - low)
    angle = xp.arccos(variable.clip(-_ALMOST_ONE, _ALMOST_ONE))
    order = xp.arange(table.shape[-2], dtype=value.dtype, device=value.device)
    return xp.einsum("...k,...kj->...j", xp.cos(angle[..., None] * order), table)


def _links(motors: Sequence[Array], tarsus: Array, rod: Array) -> Array:
    """(*b, 6) angles of the links for those of hip pitch, knee and foot, or their derivatives."""
    pitch, knee, foot = motors
    ankle = pitch + tarsus
    turns = [0 * pitch, pitch, pitch + knee, ankle, ankle + foot, pitch + rod]
    return namespace(pitch).stack(turns, -1)


def _times(matrix: Array, vector: Array) -> Array:
    """Products of matrices (2, 6, 6) and vectors (*b, 2, 6)."""
    return (matrix @ vector[..., None])[..., 0]


def _plane(vector: np.ndarray) -> Any:
    """Vectors (..., 3) seen in the plane of the leg, down + i ahead."""
    return 1j * vector[..., 0] - vector[..., 2]


def _unit(angle: Array) -> Array:
    """Complex numbers of length one."""
    xp = namespace(angle)
    return xp.cos(angle) + 1j * xp.sin(angle)
