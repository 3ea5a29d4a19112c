"""Pinocchio model of a biped, in MuJoCo's conventions.

Both libraries read the same MJCF. They differ in the order of quaternions (Pinocchio: xyzw) and in
the frame of the free joint's linear velocity (Pinocchio: pelvis, MuJoCo: world). Hinge angles are
equal, and angular velocities are in the body's frame in both.
"""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from aslip.robot import CASSIE, SIDES, Robot
from aslip.robot.rotation import cross

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
_HIP = 2  # depth of a leg's first joint: world, pelvis, hip


@dataclass(frozen=True)
class LegState:
    """Feet and loops of both legs in n configurations; the axis of 2 is left, right.

    Jacobians are with respect to the k velocities of the leg, `Kinematics.leg_v`.
    """

    position: np.ndarray
    """(n, 2, 3) centres of the soles [m]."""
    rotation: np.ndarray
    """(n, 2, 3, 3) sole to world."""
    jacobian: np.ndarray
    """(n, 2, 6, k) of the sole's linear and angular velocity, world axes."""
    closure: np.ndarray
    """(n, 2, c) residual of the loops: the three coordinates of each loop's gap [m], then for each
    rod on a ball joint the sine of half its spin angle, which is otherwise free."""
    closure_jacobian: np.ndarray
    """(n, 2, c, k)."""


@dataclass(frozen=True)
class _Rod:
    """Rod between a ball joint and a loop's end, free to spin about its axis."""

    quaternion: np.ndarray
    """(4,) indices of its orientation in a configuration, xyzw."""
    columns: np.ndarray
    """(3,) indices of its angular velocity among the velocities of its leg."""
    axis: np.ndarray
    """(3,) unit vector from end to end, in the frame of the rod."""


class Kinematics:
    """Pinocchio's model of a biped whose legs may hold closed loops and springs.

    Attributes:
        robot: the robot.
        model: the Pinocchio model.
        start: (nq,) configuration of the standing robot, pelvis at the origin.
        leg_q: (2, k) indices in `qpos` of the angles of each leg, without springs; three entries
            of its quaternion represent a ball joint.
        leg_v: (2, k) indices in `qvel` of the velocities of each leg.
        leg_motors: (2, m) indices of the motors among the k, in motor order.
        leg_joints: (2, k) names of the joints.
        subtrees: numbers of the joints of each leg in `model`, springs included.
        loop_rows: number of first rows of `LegState.closure` that are gaps of loops.
        lower: (2, k) lower limits of the angles, -inf for none.
        upper: (2, k) upper limits of the angles, inf for none.
    """

    def __init__(self, robot: Robot = CASSIE) -> None:
        """Read the robot's MJCF.

        Raises:
            AssetError: the shipped file is missing.
        """
        self.robot = robot
        self.model, loops, _ = pin.buildModelAndConstraintsFromMJCF(str(robot.mjcf))
        self._data = self.model.createData()
        self._feet = [
            self.model.getFrameId(site, pin.FrameType.OP_FRAME) for site in robot.foot_sites
        ]
        self._index_joints()
        self._read_limits()
        self._read_loops(loops)
        self.start = self.at_origin(self.to_pinocchio(robot.standing))

    def _index_joints(self) -> None:
        """Resolve every index once, by name."""
        model, indices = self.model, self.robot.indices
        q, v, width = (list(x) for x in (model.idx_qs, model.idx_vs, model.nvs))
        self._wxyz_to_xyzw = np.arange(model.nq)
        for quaternion in indices.quaternions:
            self._wxyz_to_xyzw[quaternion] = np.roll(self._wxyz_to_xyzw[quaternion], -1)
        self._xyzw_to_wxyz = np.argsort(self._wxyz_to_xyzw)
        hips = [model.supports[model.frames[foot].parentJoint][_HIP] for foot in self._feet]
        self.subtrees = [frozenset(model.subtrees[hip]) for hip in hips]
        springs = [model.getJointId(name) for name in self.robot.spring_names]
        self._joints = [[j for j in model.subtrees[hip] if j not in springs] for hip in hips]
        self.leg_joints = [
            [model.names[j] for j in leg for _ in range(width[j])] for leg in self._joints
        ]
        self.leg_q, self.leg_v = (
            np.array(
                [np.concatenate([first[j] + np.arange(width[j]) for j in leg]) for leg in legs]
            )
            for first, legs in ((q, self._joints), (v, self._joints))
        )
        self.leg_motors = np.array(
            [
                [names.index(motor) for motor in self.robot.motor_names if motor in names]
                for names in self.leg_joints
            ]
        )

    def _read_limits(self) -> None:
        """Read the limits of the legs' hinges."""
        joints, free = self.robot.skeleton.joints, (-np.inf, np.inf)
        ranges = [[joints[name].range or free for name in leg] for leg in self.leg_joints]
        self.lower, self.upper = np.moveaxis(np.array(ranges), -1, 0)

    def _read_loops(self, loops: Sequence[pin.PointAnchorConstraintModel]) -> None:
        """Assign the loops to legs, and find the rods that are free to spin."""
        self.loop_rows = 3 * len(loops) // len(SIDES)
        self._loops = [
            [(loop, loop.createData()) for loop in loops if loop.joint1_id in leg]
            for leg in self._joints
        ]
        self._rods = [
            [self._rod(leg_v, loop) for loop, _ in leg if self.model.nvs[loop.joint1_id] == 3]
            for leg_v, leg in zip(self.leg_v, self._loops, strict=True)
        ]

    def _rod(self, leg_v: np.ndarray, loop: pin.PointAnchorConstraintModel) -> _Rod:
        ball, end = loop.joint1_id, np.array(loop.joint1_placement.translation)
        velocity = self.model.idx_vs[ball] + np.arange(3)
        return _Rod(
            quaternion=self.model.idx_qs[ball] + np.arange(4),
            columns=np.flatnonzero(np.isin(leg_v, velocity)),
            axis=end / np.linalg.norm(end),
        )

    def to_pinocchio(self, qpos: np.ndarray) -> np.ndarray:
        """Pinocchio's configuration (..., nq) of MuJoCo's `qpos` (..., nq)."""
        return qpos[..., self._wxyz_to_xyzw]

    def to_mujoco(self, configuration: np.ndarray) -> np.ndarray:
        """MuJoCo's `qpos` (..., nq) of Pinocchio's configuration (..., nq)."""
        return configuration[..., self._xyzw_to_wxyz]

    def at_origin(self, configuration: np.ndarray) -> np.ndarray:
        """Move configurations (..., nq) to the origin of the world, with an upright pelvis."""
        moved = configuration.copy()
        moved[..., self.robot.indices.pelvis_position] = 0
        moved[..., self.robot.indices.pelvis_orientation] = (0, 0, 0, 1)
        return moved

    def legs(self, configuration: np.ndarray) -> LegState:
        """Feet and loops of Pinocchio's configurations (n, nq).

        A configuration takes a dozen calls of Pinocchio, 15 microseconds in all. That is less than
        the algebra that follows, so there is no compiled path.
        """
        n, sides = len(configuration), len(SIDES)
        position, rotation = np.empty((n, sides, 3)), np.empty((n, sides, 3, 3))
        jacobian = np.empty((n, sides, 6, self.model.nv))
        gap = np.empty((n, sides, self.loop_rows))
        gap_jacobian = np.empty((n, sides, self.loop_rows, self.model.nv))
        model, data = self.model, self._data
        for i, q in enumerate(configuration):
            pin.computeJointJacobians(model, data, q)
            for side, foot in enumerate(self._feet):
                placement = pin.updateFramePlacement(model, data, foot)
                position[i, side], rotation[i, side] = placement.translation, placement.rotation
                jacobian[i, side] = pin.getFrameJacobian(model, data, foot, _AXES)
                for j, (loop, loop_data) in enumerate(self._loops[side]):
                    loop.calc(model, data, loop_data)
                    rows = slice(3 * j, 3 * j + 3)
                    gap[i, side, rows] = loop_data.constraint_position_error
                    gap_jacobian[i, side, rows] = loop.jacobian(model, data, loop_data)
        spin, spin_jacobian = self._spin(configuration)
        return LegState(
            position,
            rotation,
            self._own(jacobian),
            np.concatenate((gap, spin), axis=-1),
            np.concatenate((self._own(gap_jacobian), spin_jacobian), axis=-2),
        )

    def _own(self, jacobian: np.ndarray) -> np.ndarray:
        """Select the columns of each leg's velocities, (n, 2, r, nv) -> (n, 2, r, k)."""
        return np.stack([jacobian[:, i][..., v] for i, v in enumerate(self.leg_v)], axis=1)

    def _spin(self, configuration: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Spin of the rods about their axes (n, 2, b) and its Jacobian (n, 2, b, k)."""
        shape = len(configuration), len(SIDES), len(self._rods[0])
        spin, jacobian = np.empty(shape), np.zeros((*shape, self.leg_v.shape[1]))
        for side, rods in enumerate(self._rods):
            for j, rod in enumerate(rods):
                quaternion = configuration[:, rod.quaternion]
                vector, scalar = quaternion[:, :3], quaternion[:, 3:]
                spin[:, side, j] = vector @ rod.axis
                rate = (scalar * rod.axis + cross(rod.axis, vector)) / 2
                jacobian[:, side, j, rod.columns] = rate
        return spin, jacobian

    def integrate(self, configuration: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Integrate configurations (n, nq) with leg velocities (n, 2, k) for 1 s."""
        velocity = np.zeros((len(configuration), self.model.nv))
        velocity[:, self.leg_v] = step
        pairs = zip(configuration, velocity, strict=True)
        return np.array([pin.integrate(self.model, q, v) for q, v in pairs])
