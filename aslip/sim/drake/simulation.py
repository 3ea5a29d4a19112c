"""Simulation of one robot in Drake, with drive and sensors of `aslip.sim.Simulations`."""

# Drake's stubs give arrays a wrong shape
# pyright: reportArgumentType=false, reportCallIssue=false, reportMissingModuleSource=false

from __future__ import annotations

import mujoco
import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.sim.drake.contact import Contact
from aslip.sim.drake.coordinates import Coordinates
from aslip.sim.drake.plant import Mechanism, placed
from aslip.sim.drive import PD, MakeDrive
from aslip.sim.sensors import Sensors
from aslip.sim.truth import PeriodLoads, Snapshot


class DrakeSimulation:
    """Robot in Drake, initially standing, driven as by `aslip.sim.Simulations`.

    Drive, motor limits, torque delay, encoders and IMU are those of `Simulations`; so are the
    shapes of all arrays, with n = 1. Accelerations for the IMU are differences of velocity over a
    substep. The robot is reset to standing if its state is not finite, or if Drake cannot solve a
    step.

    Args:
        model: compiled MJCF; the robot's by default.
        robot: robot of the model.
        drive: low level between commands and motors.
        contact: contact with the floor; Drake's by default.

    Raises:
        ConfigurationError: the model's timestep differs from `robot.physics_timestep`.
    """

    def __init__(
        self,
        *,
        model: mujoco.MjModel | None = None,
        robot: Robot = CASSIE,
        drive: MakeDrive = PD,
        contact: Contact | None = None,
    ) -> None:
        self._mechanism = Mechanism(model, robot, contact)
        self.model = self._mechanism.model
        """Compiled MJCF."""
        if self.model.opt.timestep != robot.physics_timestep:
            raise ConfigurationError(
                f"Drake needs a timestep of {robot.physics_timestep} s,"
                f" got {self.model.opt.timestep} s"
            )
        self.robot, self.indices = robot, robot.indices
        self.divergences = 0
        """Number of times that the robot was reset because it diverged."""
        self.sensors = Sensors(1, self.model, robot)
        """Sensors of the robot."""
        self._plant, diagram = self._mechanism.plant, self._mechanism.diagram
        self._diagram, self._context = diagram, diagram.CreateDefaultContext()
        self._state = self._plant.GetMyMutableContextFromRoot(self._context)
        self._after = diagram.AllocateDiscreteVariables()
        self._coordinates = Coordinates(self._plant, robot)
        self._drive, self._pushed = drive(1, robot), False
        self._loads = PeriodLoads(1, self.indices)
        # a motor's place among Drake's inputs
        actuators = [self._plant.GetJointActuatorByName(name) for name in robot.motor_names]
        self._inputs = np.array([actuator.input_start() for actuator in actuators])
        self._actuation = self._plant.get_actuation_input_port().FixValue(
            self._state, np.zeros(len(self._inputs))
        )
        self._force_port = self._plant.get_applied_spatial_force_input_port()
        self._feet = [
            self._plant.GetBodyByName(robot.skeleton.sites[name].body) for name in robot.foot_sites
        ]
        self._delayed = np.zeros((round(robot.torque_delay / robot.physics_timestep), 10))
        self.reset()

    @property
    def command_size(self) -> int:
        """Size of a command; see `Drive.command_size`."""
        return self._drive.command_size

    def reset(self, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None) -> None:
        """Restart the robot, the torque delay and the sensors.

        Args:
            qpos: (35,) initial positions, the standing keyframe by default.
            qvel: (32,) initial velocities, rest by default.
        """
        qpos = self.robot.standing if qpos is None else qpos
        qvel = np.zeros(self.indices.num_qvel) if qvel is None else qvel
        self._plant.SetPositionsAndVelocities(self._state, self._coordinates.to_drake(qpos, qvel))
        self._delayed[:] = 0.0
        self._torque = np.zeros((1, len(self._inputs)))
        self._loads.clear()
        self._read_state()
        # accelerations of a robot at rest on the floor
        self._acceleration = np.zeros_like(self._qvel)
        self.sensors.reset(np.arange(1), self._qpos, self._qvel, self._acceleration)

    def stand(self) -> None:
        """Restart at rest in the standing keyframe."""
        self.reset()

    def advance(self, motor_target: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Run one policy period; arguments and result as in `Simulations.advance`, with n = 1.

        Raises:
            ShapeError: `motor_target` or `push` has the wrong shape.
        """
        expected = {"motor_target": (1, self.command_size), "push": (1, 3)}
        for name, value in (("motor_target", motor_target), ("push", push)):
            if value is not None and value.shape != expected[name]:
                raise ShapeError(f"{name} must have shape {expected[name]}, got {value.shape}")
        self._push(np.zeros(3) if push is None else push[0])
        self._loads.clear()
        try:
            for index in range(self.robot.substeps):
                self._substep(index, motor_target)
            finite = np.isfinite(np.concatenate([self._qpos, self._qvel], axis=1)).all()
        except RuntimeError:  # Drake's solver found no solution
            finite = False
        self._loads.average(self.robot.substeps)
        self.sensors.finish()
        if not finite:
            self.divergences += 1
            self.reset()
        return np.array([not finite])

    @property
    def motor_torque(self) -> np.ndarray:
        """(1, m) torques of the motors at the joints in the last substep [N m]; a copy."""
        return self._torque.copy()

    def snapshot(self) -> Snapshot:
        """Arrays of the true state, in MuJoCo's coordinates.

        Readings of MuJoCo's sensors are zero, except those of the feet. `qfrc_actuator` has the
        motors' torques only.
        """
        sites = list(self.robot.skeleton.sites.values())
        position, matrix = np.zeros((1, len(sites), 3)), np.zeros((1, len(sites), 9))
        readings = np.zeros((1, self.model.nsensordata))
        for site in sites:
            body = self._plant.GetBodyByName(site.body)
            pose = body.EvalPoseInWorld(self._state) @ placed(site.position, site.quaternion)
            position[0, site.index] = pose.translation()
            matrix[0, site.index] = pose.rotation().matrix().ravel()
        for i, foot in enumerate(self._feet):
            motion = foot.EvalSpatialVelocityInWorld(self._state)
            arm = (
                position[0, self.indices.foot_site[i]]
                - foot.EvalPoseInWorld(self._state).translation()
            )
            readings[0, self.indices.foot_velocity[i]] = motion.Shift(arm).translational()
        readings[:, self.indices.ground_force] = self._loads.ground_force
        return Snapshot(
            self._qpos,
            self._qvel,
            self._acceleration,
            position,
            matrix,
            readings,
            self._loads.ground_force.copy(),
            self._joint_torque(),
            self._loads.motor_power.copy(),
            self._loads.largest_force.copy(),
        )

    def states(self) -> np.ndarray:
        """(1, k) copy of the complete state: Drake's, delayed torques and memory of the sensors."""
        state = self._plant.GetPositionsAndVelocities(self._state)
        return np.concatenate([state, self._delayed.ravel(), self.sensors.memory()[0]])[None]

    def _substep(self, index: int, target: np.ndarray) -> None:
        """Run the drive and one step of Drake."""
        sensors = self.sensors
        shaft = self._drive.torque(target, sensors.motor_position, sensors.motor_velocity)
        self._delayed = np.concatenate([self._delayed, shaft * self.robot.gear])
        self._torque, self._delayed = self._delayed[:1], self._delayed[1:]
        sensors.read(index, self._qpos, self._qvel)
        inputs = np.empty(len(self._inputs))
        inputs[self._inputs] = self._torque[0]
        self._actuation.GetMutableData().set_value(inputs)
        force = self._forces()
        self._diagram.CalcForcedDiscreteVariableUpdate(self._context, self._after)
        self._context.SetDiscreteState(self._after)
        before = self._qvel
        self._read_state()
        self._loads.add(force[None], self._joint_torque(), self._qvel)
        self._acceleration = (self._qvel - before) / self.robot.physics_timestep
        sensors.record_acceleration(index, self._acceleration)

    def _joint_torque(self) -> np.ndarray:
        """Torques (1, 32) of the motors at the joints, in the order of velocities [N m]."""
        torque = np.zeros_like(self._qvel)
        torque[:, self.indices.motor_qvel] = self._torque
        return torque

    def _read_state(self) -> None:
        """Read positions (1, 35) and velocities (1, 32) in MuJoCo's coordinates."""
        state = self._plant.GetPositionsAndVelocities(self._state)
        self._qpos, self._qvel = (row[None] for row in self._coordinates.from_drake(state))

    def _forces(self) -> np.ndarray:
        """(2, 3) forces of the floor on the feet during the present step [N, world]."""
        contacts = self._plant.get_contact_results_output_port().Eval(self._state)
        force, floor = np.zeros((2, 3)), self._plant.world_body().index()
        feet = [foot.index() for foot in self._feet]
        for i in range(contacts.num_point_pair_contacts()):
            contact = contacts.point_pair_contact_info(i)
            first, second = contact.bodyA_index(), contact.bodyB_index()
            if second in feet and first == floor:
                force[feet.index(second)] += contact.contact_force()
            elif first in feet and second == floor:
                force[feet.index(first)] -= contact.contact_force()
        return force

    def _push(self, force: np.ndarray) -> None:
        """Apply a force at the pelvis' origin from now on [N, world]."""
        if not (force.any() or self._pushed):
            return
        self._pushed = bool(force.any())
        applied = ExternallyAppliedSpatialForce()
        applied.body_index = self._plant.GetBodyByName(self.robot.pelvis).index()
        applied.F_Bq_W = SpatialForce(np.zeros(3), force)
        self._force_port.FixValue(self._state, Value([applied]))
