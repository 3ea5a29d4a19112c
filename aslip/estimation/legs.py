r"""Forward kinematics and spring forces of both legs, from encoder readings alone.

From the hip pitch joint down a leg of Cassie is planar: all hinges are parallel. A point of the
plane is a complex number, a rotation is a factor :math:`e^{i\varphi}`, and the whole leg is one sum

.. math:: z = \sum_j e^{i \varphi_j} c_j, \qquad \varphi_j = \sum_{k \le j} (\beta_k + q_k)

of links :math:`c_j`; hip yaw and hip roll turn the plane in the pelvis. This form is
cheap enough to evaluate at every sensor packet.

Forces follow from the leaf springs by virtual work. With the motors held, a leg yields in two
coordinates only: the shin spring :math:`s`, and the tarsus :math:`t`, which bends the heel spring
:math:`h(s, t)` through the Achilles rod. A force :math:`F` on the foot balances both:

.. math:: J_s^T F = k_s s + k_h h\,\partial h/\partial s, \qquad
          J_t^T F = k_h h\,\partial h/\partial t.

The heel spring has no encoder: the rod is rigid, which determines its deflection to first order.
Weight and inertia below the springs (1.6 kg) are neglected.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from aslip.base.arrays import Array, is_numpy, namespace, python_function
from aslip.base.compiled import compiled
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, SIDES, Robot, Side
from aslip.robot.rotation import quaternion_to_matrix
from aslip.robot.skeleton import Body, Skeleton

HEEL, TOE, LATERAL, FORCE = range(4)
"""Rows of the result of `LegKinematics`: heel and toe ends of the sole's axis [m], unit vector to
the left, normal to the leg's plane, and ground force on the foot within that plane [N]."""

# parallel hinges of a leg's plane, and hinges at the hip
_PLANAR = ("hip_pitch", "knee", "shin", "tarsus", "foot")
_HIPS = ("hip_roll", "hip_yaw", "hip_pitch")
# required motors and encoders of a leg
_MOTORS = (*_HIPS, "knee", "foot")
_JOINTS = ("shin", "tarsus", "foot")
_PARALLEL = 1e-4


class LegKinematics:
    """Forward kinematics and forces of both legs, for readings of any leading shape.

    Args:
        robot: robot with the motors hip roll, yaw and pitch, knee and foot, encoders at shin,
            tarsus and foot, and an Achilles rod.
        place: what makes constants arrays of the readings' kind.

    Raises:
        ConfigurationError: the robot has other motors or encoders, hinges that are not parallel, or
            a rod that closes no loop.
    """

    def __init__(
        self, robot: Robot = CASSIE, place: Callable[[np.ndarray], Array] = np.asarray
    ) -> None:
        self._left, self._right = (_placed(chain, place) for chain in leg_chains(robot))
        self.sole_radius, self.half_length, *_ = robot.skeleton.geoms["left_foot"].size
        """Radius of the soles' contact capsules, and half the length of their axes [m]."""

    def __call__(self, motor_position: Array, joint_position: Array) -> Array:
        """Compute feet and forces.

        Args:
            motor_position: (*b, 10) readings in motor order [rad].
            joint_position: (*b, 6) readings in joint order [rad].

        Returns:
            (*b, 2, 4, 3) in the pelvis frame; left leg first, then `HEEL`, `TOE`, `LATERAL`,
            `FORCE`.
        """
        if not is_numpy(motor_position):
            return self._of_tensors(motor_position, joint_position)
        vectors = np.empty((*motor_position.shape[:-1], 2, 4, 3))
        # the legs are compiled for contiguous arrays
        motors = np.ascontiguousarray(motor_position).reshape(-1, 2, 5)
        joints = np.ascontiguousarray(joint_position).reshape(-1, 2, 3)
        _legs(motors, joints, self._left, self._right, vectors.reshape(-1, 2, 4, 3))
        return vectors

    def _of_tensors(self, motor_position: Any, joint_position: Any) -> Any:
        """Compute all robots at once by the code of one leg, with robots along the last axis."""
        leg, batch = _leg_of_tensors(namespace(motor_position)), motor_position.shape[:-1]
        motors = motor_position.reshape(-1, 2, 5).permute(1, 2, 0)
        joints = joint_position.reshape(-1, 2, 3).permute(1, 2, 0)
        vectors = motors.new_empty(2, 4, 3, motors.shape[-1])
        for i, chain in enumerate((self._left, self._right)):
            leg(motors[i], joints[i], chain, vectors[i])
        return vectors.permute(3, 0, 1, 2).reshape(*batch, 2, 4, 3)


class Chain(NamedTuple):
    """Constants of one leg."""

    offset: np.ndarray
    """(5,) angles of the planar hinges to the previous link at readings of zero [rad]."""
    links: np.ndarray
    """(4,) complex vectors from each planar hinge to the next [m]."""
    ends: np.ndarray
    """(2,) complex vectors from the foot's hinge to heel and toe ends of the sole [m]."""
    depth: np.ndarray
    """(2,) distances of these ends from the plane [m]."""
    left: float
    """1 if the plane's normal points to the left of the foot, else -1."""
    hip_zero: np.ndarray
    """(2,) readings of hip roll and yaw at `hip_frame` [rad]."""
    hip_frame: np.ndarray
    """(3, 3, 3) frames of hip roll, yaw and pitch in the parent body."""
    hip_position: np.ndarray
    """(3, 3) origins of these frames [m]."""
    tip: complex
    """End of the rod at the heel spring, in the tarsus frame [m]."""
    tip_slope: complex
    """Derivative of `tip` by the heel spring's angle [m/rad]."""
    tip_height: float
    """Distance of this end, normal to the plane, from the rod's other end [m]."""
    tip_height_slope: float
    """Derivative of `tip_height` by the heel spring's angle [m/rad]."""
    rod_squared: float
    """Squared length of the rod [m^2]."""
    shin_stiffness: float
    """Stiffness of the shin spring [N m/rad]."""
    heel_stiffness: float
    """Stiffness of the heel spring [N m/rad]."""


@compiled
def _legs(
    motors: np.ndarray, joints: np.ndarray, left: Chain, right: Chain, out: np.ndarray
) -> None:
    for i in range(motors.shape[0]):
        _leg(motors[i, 0], joints[i, 0], left, out[i, 0])
        _leg(motors[i, 1], joints[i, 1], right, out[i, 1])


@compiled
def _leg(motors: np.ndarray, joints: np.ndarray, at: Chain, out: np.ndarray) -> None:
    angle = motors[2] + at.offset[0]
    knee = _unit(angle) * at.links[0]
    angle += motors[3] + at.offset[1]
    shin = knee + _unit(angle) * at.links[1]
    angle += joints[0] + at.offset[2]
    tarsus = shin + _unit(angle) * at.links[2]
    angle += joints[1] + at.offset[3]
    turn = _unit(angle)
    foot = tarsus + turn * at.links[3]
    # the foot's motor encoder resolves its angle a thousand times finer than the joint's own
    angle += motors[4] + at.offset[4]
    heel, toe = foot + _unit(angle) * at.ends[0], foot + _unit(angle) * at.ends[1]
    force = _force(at, joints[0], turn, shin, tarsus, (heel + toe) / 2)

    roll, yaw = _unit(motors[0] - at.hip_zero[0]), _unit(motors[1] - at.hip_zero[1])
    _to_pelvis(at, roll, yaw, heel, at.depth[HEEL], True, out[HEEL])
    _to_pelvis(at, roll, yaw, toe, at.depth[TOE], True, out[TOE])
    _to_pelvis(at, roll, yaw, 0j, at.left, False, out[LATERAL])
    _to_pelvis(at, roll, yaw, force, 0.0, False, out[FORCE])


@compiled
def _to_pelvis(
    at: Chain,
    roll: complex,
    yaw: complex,
    plane: complex,
    depth: float,
    point: bool,
    out: np.ndarray,
) -> None:
    """Write a point or direction of the leg's plane in the pelvis frame, through the hips."""
    for hinge in (2, 1, 0):
        if hinge == 1:
            plane *= yaw
        elif hinge == 0:
            plane *= roll
        frame = at.hip_frame[hinge]
        for k in range(3):
            out[k] = frame[k, 0] * plane.real + frame[k, 1] * plane.imag + frame[k, 2] * depth
            if point:
                out[k] += at.hip_position[hinge, k]
        plane, depth = complex(out[0], out[1]), out[2]


@compiled
def _force(
    at: Chain, spring: float, turn: complex, shin: complex, tarsus: complex, sole: complex
) -> complex:
    """Force on the foot in the plane of the leg [N]."""
    # the end of the Achilles rod at the heel spring, relative to its end at the hip
    tip, height = tarsus + turn * at.tip, at.tip_height
    # derivatives of half the squared rod length by heel spring, shin and tarsus
    by_heel = _dot(tip, turn * at.tip_slope) + height * at.tip_height_slope
    by_shin, by_tarsus = _dot(tip, 1j * (tip - shin)), _dot(tip, 1j * (tip - tarsus))
    excess = (at.rod_squared - (_dot(tip, tip) + height**2)) / 2
    heel_torque = at.heel_stiffness * excess / by_heel
    shin_torque = at.shin_stiffness * spring - heel_torque / by_heel * by_shin
    tarsus_torque = -heel_torque / by_heel * by_tarsus
    shin_arm, tarsus_arm = 1j * (sole - shin), 1j * (sole - tarsus)
    area = _dot(1j * shin_arm, tarsus_arm)
    return 1j * (shin_arm * tarsus_torque - tarsus_arm * shin_torque) / area


@compiled
def _unit(angle: float) -> complex:
    """Unit vector of an angle."""
    return complex(np.cos(angle), np.sin(angle))


@compiled
def _dot(a: complex, b: complex) -> float:
    """Scalar product of planar vectors."""
    return a.real * b.real + a.imag * b.imag


def _placed(chain: Chain, place: Callable[[np.ndarray], Array]) -> Chain:
    arrays = {name: place(x) for name, x in chain._asdict().items() if isinstance(x, np.ndarray)}
    return chain._replace(**arrays)


@functools.cache
def _leg_of_tensors(torch: Any) -> Any:
    """`_leg` on tensors of torch, the module, whose last axis counts robots."""
    uses: dict[str, Any] = {"np": torch, "complex": torch.complex}
    for function in (_unit, _dot, _to_pelvis, _force):
        uses[function.__name__] = python_function(function, **uses)
    return python_function(_leg, **uses)


def _plane(vector: np.ndarray) -> np.ndarray:
    """First two components as a complex number."""
    return vector[..., 0] + 1j * vector[..., 1]


def leg_chains(robot: Robot) -> tuple[Chain, Chain]:
    """Constants of the left and the right leg.

    Raises:
        ConfigurationError: see `LegKinematics`.
    """
    for names, parts in ((robot.motor_names, _MOTORS), (robot.joint_names, _JOINTS)):
        if names != tuple(f"{side}_{part}" for side in SIDES for part in parts):
            raise ConfigurationError(
                f"legs need {parts} on both sides in this order, but {robot} has {names}"
            )
    return _chain(robot, "left"), _chain(robot, "right")


def _chain(robot: Robot, side: Side) -> Chain:
    skeleton = robot.skeleton
    joints = {name: skeleton.joints[f"{side}_{name}"] for name in (*_PLANAR, *_HIPS, "heel_spring")}
    bodies = {name: skeleton.bodies[joint.body] for name, joint in joints.items()}
    zero = {name: joint.zero for name, joint in joints.items()}

    rotations = {
        name: quaternion_to_matrix(np.array(body.quaternion)) for name, body in bodies.items()
    }
    positions = {name: np.array(body.position) for name, body in bodies.items()}
    for name in _PLANAR[1:]:
        if abs(rotations[name][2, 2] - 1) > _PARALLEL:
            raise ConfigurationError(
                f"the hinge {side}_{name} is not parallel to the hip pitch hinge"
            )
    # the rotation of the hip pitch body belongs to hip_frame
    turned = [0.0, *(np.angle(_plane(rotations[name][:, 0])) for name in _PLANAR[1:])]
    links = np.array([positions[name] for name in _PLANAR[1:]])
    ends, left = _sole(robot, side)

    rod, rod_end, tip_end = _rod(skeleton, side)
    heel = rotations["heel_spring"]
    tip = positions["heel_spring"] + heel @ tip_end
    slope = np.cross(heel[:, 2], heel @ tip_end)
    return Chain(
        offset=np.array(turned) - [zero[name] for name in _PLANAR],
        links=_plane(links),
        ends=_plane(ends),
        depth=links[:, 2].sum() + ends[:, 2],
        left=left,
        hip_zero=np.array([zero[name] for name in _HIPS[:2]]),
        hip_frame=np.array([rotations[name] for name in _HIPS]),
        hip_position=np.array([positions[name] for name in _HIPS]),
        tip=complex(*tip[:2]),
        tip_slope=complex(*slope[:2]),
        tip_height=links[:3, 2].sum() + tip[2] - rod.position[2],
        tip_height_slope=slope[2],
        rod_squared=float(rod_end @ rod_end),
        shin_stiffness=joints["shin"].stiffness,
        heel_stiffness=joints["heel_spring"].stiffness,
    )


def _sole(robot: Robot, side: Side) -> tuple[np.ndarray, float]:
    """(2, 3) heel and toe ends of the sole's axis in the foot [m], and `Chain.left`."""
    capsule = robot.skeleton.geoms[f"{side}_foot"]
    site = robot.skeleton.sites[robot.foot_sites[SIDES.index(side)]]
    to_foot = quaternion_to_matrix(np.array(site.quaternion))
    half = quaternion_to_matrix(np.array(capsule.quaternion))[:, 2] * capsule.size[1]
    half *= np.sign(half @ to_foot[:, 0])  # toes are where the site's x axis points
    return capsule.position + np.outer([-1.0, 1.0], half), np.sign(to_foot[2, 1])


def _rod(skeleton: Skeleton, side: Side) -> tuple[Body, np.ndarray, np.ndarray]:
    """Body of the Achilles rod, and the tied points: on the rod, on the heel spring."""
    rod, spring = f"{side}_achilles_rod", f"{side}_heel_spring"
    for loop in skeleton.connections.values():
        if {loop.first, loop.second} == {rod, spring}:
            points = np.array([loop.first_point, loop.second_point])
            own, others = points if loop.first == rod else points[::-1]
            return skeleton.bodies[rod], own, others
    raise ConfigurationError(f"the model does not close the loop of the {side} Achilles rod")
