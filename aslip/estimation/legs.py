r"""Forward kinematics and spring forces of both legs, from encoder readings alone.

From the hip pitch joint down a leg of Cassie is planar: all hinges are parallel. A point of the
plane is a complex number, a rotation is a factor :math:`e^{i\varphi}`, and the whole leg is one sum

.. math:: z = \sum_j e^{i \varphi_j} c_j, \qquad \varphi_j = \sum_{k \le j} (\beta_k + q_k)

of links :math:`c_j`; hip yaw and hip roll turn the plane in the pelvis. That makes a batch of legs
cheap enough for a filter that runs at every packet of sensors.

Forces follow from the leaf springs by virtual work. With the motors held, a leg gives way in two
coordinates only: the shin spring :math:`s`, and the tarsus :math:`t`, which bends the heel spring
:math:`h(s, t)` through the Achilles rod. A force :math:`F` on the foot balances both:

.. math:: J_s^T F = k_s s + k_h h\,\partial h/\partial s, \qquad
          J_t^T F = k_h h\,\partial h/\partial t.

The heel spring has no encoder: the rod is rigid, which determines its deflection to first order.
Weight and inertia below the springs (1.6 kg) are neglected.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from aslip.cassie import SIDES, Side, foot_site

HEEL, TOE, LATERAL, FORCE = range(4)
"""Rows of what `LegKinematics` returns: the ends of the axis of the sole's contact capsule [m], the
unit vector to the left across the plane of the leg, and the force of the ground on the foot within
that plane [N]."""

# hinges whose angles add up in the plane of a leg, and those above it
_PLANAR = ("hip_pitch", "knee", "shin", "tarsus", "foot")
_HIPS = ("hip_roll", "hip_yaw", "hip_pitch")
_PARALLEL = 1e-4


class LegKinematics:
    """Both legs of a compiled model, for readings of any leading shape.

    Args:
        model: the robot.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        chains = [_chain(model, side) for side in SIDES]
        # (..., leg, 1) arrays
        self._at = {
            name: np.stack([chain[name] for chain in chains], axis=-1)[..., None]
            for name in chains[0]
        }
        hips = [model.body_quat[model.joint(f"left_{name}").bodyid[0]] for name in _HIPS]
        self._hip_axes = [_signed_axes(_matrix(quaternion))[0] for quaternion in hips]
        self.sole_radius = float(model.geom("left_foot").size[0])
        """Radius of the soles' contact capsules [m]."""
        self.half_length = float(model.geom("left_foot").size[1])
        """Half the length of their axes [m]."""

    def __call__(self, motor_position: np.ndarray, joint_position: np.ndarray) -> np.ndarray:
        """Feet and forces from readings.

        Args:
            motor_position: (*b, 10) [rad], in motor order.
            joint_position: (*b, 6) [rad], in joint order.

        Returns:
            (*b, 2, 4, 3) in the pelvis frame; left leg first, then `HEEL`, `TOE`, `LATERAL`,
            `FORCE`. In memory b comes last, so that NumPy's loops are long ones; so it does here.
        """
        at, shape = self._at, motor_position.shape[:-1]
        # (joint, leg, b)
        motors = motor_position.reshape(-1, 2, 5).transpose(2, 1, 0)
        joints = joint_position.reshape(-1, 2, 3).transpose(2, 1, 0)
        angles = np.empty((5, *motors.shape[1:]))
        # the foot's motor encoder resolves its angle a thousand times finer than the joint's own
        angles[:2], angles[2:4], angles[4] = motors[2:4], joints[:2], motors[4]
        turn = _unit((angles + at["offset"]).cumsum(0))
        # from the hip pitch joint to knee, shin, tarsus, foot
        origins = (turn[:4] * at["links"]).cumsum(0)
        ends = origins[3] + turn[4] * at["ends"]
        force = self._force(turn[3], joints[0], origins, (ends[HEEL] + ends[TOE]) / 2)

        # (coordinate, vector, leg, b)
        vectors = np.zeros((3, 4, *motors.shape[1:]))
        vectors[0, : TOE + 1], vectors[1, : TOE + 1] = ends.real, ends.imag
        vectors[2, : TOE + 1] = at["depth"]
        vectors[2, LATERAL] = at["left"]
        vectors[0, FORCE], vectors[1, FORCE] = force.real, force.imag
        vectors = self._to_pelvis(vectors, _unit(motors[:2] - at["hip_zero"]))
        return vectors.reshape(3, 4, 2, *shape).transpose(*range(3, 3 + len(shape)), 2, 1, 0)

    def _to_pelvis(self, vectors: np.ndarray, hips: np.ndarray) -> np.ndarray:
        """From the plane of the leg through hip pitch, yaw and roll to the pelvis."""
        for hinge in (2, 1, 0):
            if hinge < 2:
                plane = (vectors[0] + 1j * vectors[1]) * hips[hinge]
                vectors[0], vectors[1] = plane.real, plane.imag
            vectors = self._at["hip_sign"][hinge][:, None] * vectors[self._hip_axes[hinge]]
            vectors[:, : TOE + 1] += self._at["hip_position"][hinge][:, None]
        return vectors

    def _force(
        self, turn: np.ndarray, shin: np.ndarray, origins: np.ndarray, foot: np.ndarray
    ) -> np.ndarray:
        """(2, b) force on the foot in the plane of the leg, a complex number [N]."""
        at = self._at
        # the end of the Achilles rod at the heel spring, relative to its end at the hip
        tip, height = origins[2] + turn * at["tip"], at["tip_height"]
        arms = 1j * (foot - origins[1:3])
        # half the change of the rod's squared length with the heel spring, and with shin and tarsus
        by_heel = _dot(tip, turn * at["tip_slope"]) + height * at["tip_height_slope"]
        by_hinges = _dot(tip, 1j * (tip - origins[1:3]))
        excess = (at["rod_squared"] - (_dot(tip, tip) + height**2)) / 2
        heel_torque = at["heel_stiffness"] * excess / by_heel
        torques = -(heel_torque / by_heel) * by_hinges
        torques[0] += at["shin_stiffness"] * shin
        area = _dot(1j * arms[0], arms[1])
        return 1j * (arms[0] * torques[1] - arms[1] * torques[0]) / area


def _unit(angle: np.ndarray) -> np.ndarray:
    """Unit vectors of the plane; the complex exponential takes three times as long."""
    unit = np.empty(angle.shape, dtype=np.complex128)
    np.cos(angle, out=unit.real)
    np.sin(angle, out=unit.imag)
    return unit


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product of vectors of the plane."""
    return a.real * b.real + a.imag * b.imag


def _plane(vector: np.ndarray) -> np.ndarray:
    """First two components as a complex number."""
    return vector[..., 0] + 1j * vector[..., 1]


def _chain(model: mujoco.MjModel, side: Side) -> dict[str, Any]:
    """Constants of one leg."""
    joints = {name: model.joint(f"{side}_{name}") for name in {*_PLANAR, *_HIPS, "heel_spring"}}
    bodies = {name: int(joint.bodyid[0]) for name, joint in joints.items()}
    zero = {name: float(model.qpos0[joint.qposadr[0]]) for name, joint in joints.items()}

    rotations = {name: _matrix(model.body_quat[body]) for name, body in bodies.items()}
    positions = {name: model.body_pos[body].copy() for name, body in bodies.items()}
    for name in _PLANAR[1:]:
        if abs(rotations[name][2, 2] - 1) > _PARALLEL:
            raise ValueError(f"the hinge {side}_{name} is not parallel to the hip pitch hinge")
    # the hip pitch body's own rotation is one of the hips'
    turned = [0.0, *(np.angle(_plane(rotations[name][:, 0])) for name in _PLANAR[1:])]
    links = np.array([positions[name] for name in _PLANAR[1:]])

    sole, site = model.geom(f"{side}_foot"), model.site(foot_site(side))
    to_foot = _matrix(site.quat)
    half = _matrix(sole.quat)[:, 2] * sole.size[1]
    half *= np.sign(half @ to_foot[:, 0])  # toes are where the site's x axis points
    ends = sole.pos + np.outer([-1.0, 1.0], half)

    rod, rod_end, tip_end = _rod(model, side)
    heel = rotations["heel_spring"]
    tip = positions["heel_spring"] + heel @ tip_end
    slope = np.cross(heel[:, 2], heel @ tip_end)
    return {
        "offset": np.array(turned) - [zero[name] for name in _PLANAR],
        "links": _plane(links),
        "ends": _plane(ends),
        "depth": links[:, 2].sum() + ends[:, 2],
        "left": np.sign(to_foot[2, 1]),
        "hip_zero": np.array([zero[name] for name in _HIPS[:2]]),
        "hip_sign": np.array([_signed_axes(rotations[name])[1] for name in _HIPS]),
        "hip_position": np.array([positions[name] for name in _HIPS]),
        "tip": _plane(tip),
        "tip_slope": _plane(slope),
        "tip_height": links[:3, 2].sum() + tip[2] - model.body_pos[rod][2],
        "tip_height_slope": slope[2],
        "rod_squared": rod_end @ rod_end,
        "shin_stiffness": model.jnt_stiffness[joints["shin"].id],
        "heel_stiffness": model.jnt_stiffness[joints["heel_spring"].id],
    }


def _rod(model: mujoco.MjModel, side: Side) -> tuple[int, np.ndarray, np.ndarray]:
    """Body of the Achilles rod, and the points it ties together: of the rod, of the heel spring."""
    rod, spring = (model.body(f"{side}_{name}").id for name in ("achilles_rod", "heel_spring"))
    for first, second, data in zip(model.eq_obj1id, model.eq_obj2id, model.eq_data, strict=True):
        if {int(first), int(second)} == {rod, spring}:
            points = (data[:3], data[3:6]) if first == rod else (data[3:6], data[:3])
            return rod, points[0].copy(), points[1].copy()
    raise ValueError(f"the model does not close the loop of the {side} Achilles rod")


def _signed_axes(rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation by right angles: which coordinate goes where (3,), and its sign (3,)."""
    axes = np.abs(rotation).argmax(1)
    signs = np.sign(rotation[np.arange(3), axes])
    if np.abs(np.eye(3)[axes] * signs[:, None] - rotation).max() > _PARALLEL:
        raise ValueError("the hips' hinges are not at right angles to each other")
    return axes, signs


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of a wxyz quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
