"""Distance between the legs of a biped."""

# pyright: reportAttributeAccessIssue=false
# Pinocchio is a compiled module without type stubs

from __future__ import annotations

import numpy as np
import pinocchio as pin

from aslip.errors import AssetError, ShapeError
from aslip.ik.kinematics import Kinematics


class LegClearance:
    """Distance between the collision bodies of the left and of the right leg.

    Bodies are the geoms of the robot's MJCF that may touch something.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        """Read the bodies.

        Raises:
            AssetError: a leg has none.
        """
        model, self._kinematics = kinematics.model, kinematics
        self._bodies = pin.buildGeomFromMJCF(
            model, str(kinematics.robot.mjcf), pin.GeometryType.COLLISION
        )
        joints = [body.parentJoint for body in self._bodies.geometryObjects]
        left, right = (
            [i for i, joint in enumerate(joints) if joint in leg] for leg in kinematics.subtrees
        )
        for one in left:
            for other in right:
                self._bodies.addCollisionPair(pin.CollisionPair(one, other))
        if not self._bodies.collisionPairs:
            raise AssetError(f"a leg of {kinematics.robot.mjcf.name} has no collision bodies")
        self._data, self._distances = model.createData(), pin.GeometryData(self._bodies)

    def __call__(self, qpos: np.ndarray) -> np.ndarray:
        """Least distance (n,) between the legs [m], negative where they overlap.

        Args:
            qpos: (n, nq) configurations.

        Raises:
            ShapeError: the configurations have another number of entries.
        """
        model = self._kinematics.model
        if np.ndim(qpos) != 2 or np.shape(qpos)[1] != model.nq:
            raise ShapeError(f"qpos must have shape (n, {model.nq}), got {np.shape(qpos)}")
        found = np.empty(len(qpos))
        for i, configuration in enumerate(self._kinematics.to_pinocchio(np.asarray(qpos, float))):
            pin.computeDistances(model, self._data, self._bodies, self._distances, configuration)
            found[i] = min(result.min_distance for result in self._distances.distanceResults)
        return found
