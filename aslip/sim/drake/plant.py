"""Robot as a `MultibodyPlant` of Drake, with the numbers of its MJCF.

Bodies, joints, springs, damping, reflected inertia, joint limits and loops are those of the
compiled MJCF; MuJoCo only reads the file. Drake's discrete plant solves each step as one convex
problem: dynamics, loops as ball constraints, joint limits, and contact of compliant points with
friction (Castro et al. 2022, "An unconstrained convex formulation of compliant contact").

A capsule touches the floor with the spheres at its two ends, as in MuJoCo: Drake finds one point
per pair of shapes, which would jump from one end of a level sole to the other. Legs touch each
other without friction.
"""

# Drake's stubs give arrays a wrong shape
# pyright: reportArgumentType=false, reportCallIssue=false, reportMissingModuleSource=false

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    AddContactMaterial,
    Capsule,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    SceneGraphConfig,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    MultibodyConstraintId,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    WeldJoint,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from aslip.robot import CASSIE, Robot
from aslip.robot.model import load_model
from aslip.sim.drake.contact import Contact

_APPROXIMATIONS = {
    "lagged": DiscreteContactApproximation.kLagged,
    "similar": DiscreteContactApproximation.kSimilar,
    "sap": DiscreteContactApproximation.kSap,
}
# contype of the MJCF's geoms that collide with the other leg
_LEGS = (2, 4)


class Mechanism:
    """Robot and floor in Drake.

    Args:
        model: compiled MJCF, the robot's by default.
        robot: robot of the model; gives timestep and motors.
        contact: contact with the floor.
    """

    def __init__(
        self,
        model: mujoco.MjModel | None = None,
        robot: Robot = CASSIE,
        contact: Contact | None = None,
    ) -> None:
        contact = Contact() if contact is None else contact
        self.model = load_model(visual=False, robot=robot) if model is None else model
        """Compiled MJCF that gives the numbers."""
        builder = DiagramBuilder()
        plant, scene = AddMultibodyPlantSceneGraph(builder, robot.physics_timestep)
        # no meshes of the shapes: only deformable bodies need them, and Drake warns of half spaces
        settings = SceneGraphConfig()
        settings.default_proximity_properties.resolution_hint = None
        scene.set_config(settings)
        self.plant: MultibodyPlant = plant
        """Bodies, joints, springs, motors, loops and contact."""
        plant.set_discrete_contact_approximation(_APPROXIMATIONS[contact.approximation])
        # contact forces of the present state, and not of the last step
        plant.SetUseSampledOutputPorts(False)
        plant.mutable_gravity_field().set_gravity_vector(self.model.opt.gravity)
        self.bodies: list[RigidBody] = [plant.world_body()]
        """Bodies in MuJoCo's order."""
        for index in range(1, self.model.nbody):
            self._add_body(index)
        for name in robot.motor_names:
            self._add_motor(name)
        self.loops = [self._close_loop(index) for index in range(self.model.neq)]
        """Constraints that close the legs' loops, in MuJoCo's order."""
        self._add_shapes(scene, contact)
        plant.Finalize()
        self.diagram: Diagram = builder.Build()
        """Plant and geometry, connected."""

    def _add_body(self, index: int) -> None:
        """Add a body and the joint to its parent."""
        body = self.model.body(index)
        turn = placed(np.zeros(3), body.iquat).rotation().matrix()
        inertia = turn @ np.diag(body.inertia) @ turn.T
        i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
        central = RotationalInertia(*inertia[i, j])
        spatial = SpatialInertia.MakeFromCentralInertia(body.mass[0], body.ipos, central)
        self.bodies.append(self.plant.AddRigidBody(body.name, spatial))
        self._add_joint(body)

    def _add_joint(self, body: Any) -> None:
        """Join a body to its parent; the joint has the name of the body."""
        plant, parent = self.plant, self.bodies[int(body.parentid[0])].body_frame()
        child, pose = self.bodies[int(body.id)].body_frame(), placed(body.pos, body.quat)
        if not body.jntnum[0]:
            plant.AddJoint(WeldJoint(body.name, parent, child, pose))
            return
        joint = self.model.joint(int(body.jntadr[0]))
        if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE:
            plant.AddJoint(QuaternionFloatingJoint(body.name, parent, child))
            return
        frame = plant.AddFrame(FixedOffsetFrame(f"{body.name}_parent", parent, pose))
        damping = float(joint.damping[0])
        if joint.type[0] == mujoco.mjtJoint.mjJNT_BALL:
            plant.AddJoint(BallRpyJoint(body.name, frame, child, damping))
            return
        zero = float(self.model.qpos0[joint.qposadr[0]])
        limited = bool(self.model.jnt_limited[joint.id])
        low, high = joint.range - zero if limited else (-np.inf, np.inf)
        hinge = RevoluteJoint(body.name, frame, child, joint.axis, low, high, damping)
        plant.AddJoint(hinge)
        if joint.stiffness[0]:
            rest = float(self.model.qpos_spring[joint.qposadr[0]]) - zero
            spring = RevoluteSpring(plant.GetJointByName(body.name), rest, joint.stiffness[0])
            plant.AddForceElement(spring)

    def _add_motor(self, name: str) -> None:
        """Add a motor with the reflected inertia of its rotor."""
        motor = self.plant.AddJointActuator(name, self.plant.GetJointByName(name))
        # inputs are torques at the joint: the gear is in the inertia
        motor.set_default_gear_ratio(1.0)
        motor.set_default_rotor_inertia(float(self.model.joint(name).armature[0]))

    def _close_loop(self, index: int) -> MultibodyConstraintId:
        """Tie a point of a body to a point of another one."""
        loop = self.model.equality(index)
        first, second = (self.bodies[int(i[0])] for i in (loop.obj1id, loop.obj2id))
        return self.plant.AddBallConstraint(first, loop.data[:3], second, loop.data[3:6])

    def _add_shapes(self, scene: SceneGraph, contact: Contact) -> None:
        """Add the floor, spheres that touch it, and capsules that touch the other leg."""
        friction = float(self.model.geom("floor").friction[0])
        rough, smooth = (_material(contact, coefficient) for coefficient in (friction, 0.0))
        register = self.plant.RegisterCollisionGeometry
        floor = register(self.plant.world_body(), RigidTransform(), HalfSpace(), "floor", rough)
        tips: list[GeometryId] = []
        legs: dict[int, list[GeometryId]] = {leg: [] for leg in _LEGS}
        for geom in map(self.model.geom, range(self.model.ngeom)):
            body, pose = self.bodies[int(geom.bodyid[0])], placed(geom.pos, geom.quat)
            radius, half = geom.size[:2]
            if geom.name == "floor":
                continue
            for i, end in enumerate((-half, half) if half else (0.0,)):
                at = pose @ RigidTransform(np.array([0.0, 0.0, end]))
                tips.append(register(body, at, Sphere(radius), f"{geom.name}_{i}", rough))
            if geom.contype[0] in legs:
                capsule = register(body, pose, Capsule(radius, 2 * half), geom.name, smooth)
                legs[int(geom.contype[0])].append(capsule)
        ours, others = legs.values()
        apart = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(tips))
        for leg in (ours, others):
            apart.ExcludeWithin(GeometrySet(leg))
            apart.ExcludeBetween(GeometrySet(leg), GeometrySet([floor, *tips]))
        scene.collision_filter_manager().Apply(apart)


def _material(contact: Contact, friction: float) -> ProximityProperties:
    """Material of a shape, twice as stiff as the contact: two equal shapes act in series."""
    properties = ProximityProperties()
    AddContactMaterial(
        dissipation=contact.dissipation,
        point_stiffness=2 * contact.stiffness,
        friction=CoulombFriction(friction, friction),
        properties=properties,
    )
    properties.AddProperty("material", "relaxation_time", contact.relaxation_time)
    return properties


def placed(position: ArrayLike, quaternion: ArrayLike) -> RigidTransform:
    """Pose of a frame relative to another from its position and orientation (wxyz) in it."""
    wxyz = np.asarray(quaternion)
    rotation = Quaternion(wxyz / np.linalg.norm(wxyz))
    return RigidTransform(rotation, np.asarray(position, dtype=np.float64))
