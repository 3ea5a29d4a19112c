"""N simulations of a robot and its low level, on `mujoco.batch`.

Guarantees:

- One `advance` is one policy period: 60 substeps of drive, motor limits, delay and physics. With a
  physics timestep of two substeps, a step applies the mean torque of both, and the encoders of the
  second one read the joints interpolated to the middle of the step.
- Results do not depend on the number of threads. They equal a loop over single simulations, each
  with its own model if `write_fields` has changed it.
- A simulation that diverges (MuJoCo warning or error, state not finite) is reset to standing,
  counted, and reported by `advance`; the others are not affected.

Warning: arrays of `snapshot()` are live views; copy them to keep them beyond the next call.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from aslip.base.checks import check_count, check_ids, check_states
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import check_timestep, load_model
from aslip.sim.drive import PD, MakeDrive
from aslip.sim.dynamics import DERIVING_FIELDS
from aslip.sim.parameters import DRIVE
from aslip.sim.sensors import Sensors
from aslip.sim.truth import PeriodLoads, Snapshot

# recompute position and velocity stages, as mj_step1 does, so that sensors match the state
_CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)
_NONE = int(mujoco.mjtStage.mjSTAGE_NONE)
# batch.warning holds (lastinfo, number) for each kind of warning
_WARNING_COUNT = 1


class Simulations:
    """Batch of `num` simulations, initially standing.

    Args:
        num: number of simulations.
        model: compiled model; by default the robot's, without visual geoms.
        num_threads: physics threads, 0 for all processors.
        robot: robot of the model.
        drive: low level between commands and motors.

    Raises:
        ConfigurationError: `num` or `num_threads` is not a count, or the model's timestep is not
            one of `aslip.robot.model.physics_timesteps`.
    """

    def __init__(
        self,
        num: int,
        *,
        model: mujoco.MjModel | None = None,
        num_threads: int = 0,
        robot: Robot = CASSIE,
        drive: MakeDrive = PD,
    ) -> None:
        num = check_count("the number of simulations", num)
        num_threads = check_count("num_threads", num_threads, least=0)
        self.model = load_model(visual=False, robot=robot) if model is None else model
        check_timestep(self.model.opt.timestep, robot)
        self.robot, self.indices = robot, robot.indices
        self.batch = Batch(self.model, num, num_threads)
        self.divergences = 0
        """Number of simulations that diverged and were reset since construction."""
        self._drive = drive(num, robot)
        self._stride = round(self.model.opt.timestep / self.robot.physics_timestep)
        self._torques = np.zeros((2, num, self.model.nu))
        self._halfway = np.zeros((num, self.model.nq))
        at = self.indices
        self._encoders = (
            np.concatenate([at.motor_qpos, at.joint_qpos]),
            np.concatenate([at.motor_qvel, at.joint_qvel]),
        )
        self.sensors = Sensors(num, self.model, robot)
        """Sensors of the robots."""
        self._loads = PeriodLoads(num, self.indices)
        self._watched: int | None = None
        self.watched = np.zeros((self.robot.substeps, watched_size(self.model)))
        """(60, 83) `qpos` 35, `qvel` 32, motor torques 10 [N m, at the joint] and ground forces
        2 x 3 [N, world] after each substep of the last policy period, for the simulation of
        `watch`. Torques and forces are those that acted during the substep."""
        # live arrays, bound once: binding takes longer than PD control
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self._ctrl = self.batch.bind("ctrl")
        self._site_xpos = self.batch.bind("site_xpos")
        self._site_xmat = self.batch.bind("site_xmat")
        self._qacc = self.batch.bind("qacc")
        self._qfrc_actuator = self.batch.bind("qfrc_actuator")
        self._push = self.batch.bind("xfrc_applied")[:, self.indices.pelvis_body, :3]
        self._pushed = False
        self._sensordata = self.batch.bind("sensordata")
        self.stand()

    @property
    def num(self) -> int:
        """Number of simulations."""
        return self.batch.nsim

    @property
    def command_size(self) -> int:
        """Size of a robot's command; see `Drive.command_size`."""
        return self._drive.command_size

    def reset(
        self, ids: np.ndarray, qpos: np.ndarray | None = None, qvel: np.ndarray | None = None
    ) -> None:
        """Restart some simulations, with their time, delayed commands, warm start and warnings.

        Args:
            ids: (k,) simulations, sorted and unique.
            qpos: (k, 35) initial positions, the standing keyframe by default.
            qvel: (k, 32) initial velocities, rest by default.

        Raises:
            ConfigurationError: a simulation does not exist.
            ShapeError: an array has the wrong shape.
        """
        ids = check_ids(ids, self.num)
        if len(ids) == 0:
            return
        for name, value, state in (("qpos", qpos, self.qpos), ("qvel", qvel, self.qvel)):
            expected = (len(ids), state.shape[1])
            if value is not None and value.shape != expected:
                raise ShapeError(f"{name} must have shape {expected}, got {value.shape}")
        self.batch.reset(ids, keyframe=self.model.key("standing").id, stage=_NONE)
        if qpos is not None:
            self.qpos[ids] = qpos
        if qvel is not None:
            self.qvel[ids] = qvel
        self.batch.forward(ids)
        self._loads.reset(ids, self._sensordata[ids][:, self.indices.ground_force])
        self.sensors.reset(ids, self.qpos[ids], self.qvel[ids], self._qacc[ids])

    def stand(self) -> None:
        """Restart all simulations, standing."""
        self.reset(np.arange(self.num))

    def write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Change fields of some simulations' models from the next substep on.

        MuJoCo copies changed fields into the model before every step; those of
        `aslip.sim.DYNAMICS` make a step 2 % slower.

        Args:
            ids: (k,) simulations, sorted and unique.
            fields: field, by the name in `mujoco.batch` -> (k, ...).

        Raises:
            ConfigurationError: a simulation does not exist.
        """
        ids = check_ids(ids, self.num)
        for name, rows in fields.items():
            if not name.startswith(DRIVE):
                self.batch.expand(name)[ids] = rows
        self._drive.write_gains(ids, fields)
        if DERIVING_FIELDS & fields.keys():
            self.batch.set_const(ids)
        if "opt.gravity" in fields:
            self.sensors.set_gravity(ids, fields["opt.gravity"])

    def watch(self, index: int | None) -> None:
        """Record every substep of one simulation in `watched` from now on; None stops it.

        Raises:
            ConfigurationError: the timestep is not a substep.
        """
        if index is not None and self._stride > 1:
            raise ConfigurationError(
                f"watch needs a timestep of {self.robot.physics_timestep} s,"
                f" got {self.model.opt.timestep} s"
            )
        self._watched = index

    def advance(self, motor_target: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Run one policy period.

        Args:
            motor_target: (n, `command_size`) commands of the drive, joint angles for `PD` [rad].
            push: (n, 3) forces on the pelvis' origin during the period [N, world]; zero by default.

        Returns:
            (n,) bool, True for simulations that diverged and were reset to standing.

        Raises:
            ShapeError: `motor_target` or `push` has the wrong shape.
        """
        if motor_target.shape != (self.num, self._drive.command_size):
            expected = (self.num, self._drive.command_size)
            raise ShapeError(f"motor_target must have shape {expected}, got {motor_target.shape}")
        if push is not None and push.shape != (self.num, 3):
            raise ShapeError(f"push must have shape {(self.num, 3)}, got {push.shape}")
        if push is not None or self._pushed:
            self._push[:] = 0.0 if push is None else push
            self._pushed = push is not None
        self.batch.warning[:] = 0
        self._loads.clear()
        failed = np.zeros(self.num, dtype=bool)
        substep = self._substep if self._stride == 1 else self._two_substeps
        for first in range(0, self.robot.substeps, self._stride):
            last = first + self._stride == self.robot.substeps
            substep(first, motor_target, failed, _CURRENT if last else _NONE)
            force = self._sensordata[:, self.indices.ground_force]
            self._loads.add(force, self._qfrc_actuator, self.qvel)
            if self._watched is not None:
                self._record(first, self._watched)
        self._loads.average(self.robot.substeps / self._stride)
        self.sensors.finish()
        diverged = failed | self.batch.warning[..., _WARNING_COUNT].any(axis=1) | ~self._finite()
        self.divergences += int(diverged.sum())
        self.reset(np.flatnonzero(diverged))
        return diverged

    def snapshot(self) -> Snapshot:
        """Live views of the arrays of the true state."""
        return Snapshot(
            self.qpos,
            self.qvel,
            self._qacc,
            self._site_xpos,
            self._site_xmat,
            self._sensordata,
            self._loads.ground_force,
            self._qfrc_actuator,
            self._loads.motor_power,
            self._loads.largest_force,
        )

    @property
    def motor_torque(self) -> np.ndarray:
        """(n, m) torques of the motors at the joints in the last substep [N m]; a copy."""
        return self._qfrc_actuator[:, self.indices.motor_qvel]

    def states(self) -> np.ndarray:
        """(n, k) copy of the complete states.

        A row is the physics state `mujoco.mjtState.mjSTATE_INTEGRATION` followed by the memory of
        the sensors.
        """
        return np.concatenate([self.batch.state, self.sensors.memory()], axis=1)

    @property
    def state_size(self) -> int:
        """Length of one simulation's row in `states`."""
        return self.batch.state.shape[1] + self.sensors.memory_size

    def set_states(self, states: np.ndarray) -> None:
        """Restore a result of `states`, from these or other simulations of the same model.

        `snapshot` is valid again after the next `advance`.

        Raises:
            ShapeError: the states have another number or model; nothing is changed.
        """
        states = check_states(states, (self.num, self.state_size))
        physics = self.batch.state.shape[1]
        self.batch.state[:] = states[:, :physics]
        self.sensors.set_memory(states[:, physics:])
        self._pushed = bool(self._push.any())

    def _substep(self, index: int, target: np.ndarray, failed: np.ndarray, stage: int) -> None:
        """Run the drive and one physics step."""
        # the drive uses the readings of the previous substep
        position, velocity = self.sensors.motor_position, self.sensors.motor_velocity
        self._drive.torque(target, position, velocity, out=self._ctrl)
        self.sensors.read(index, self.qpos, self.qvel)
        self._step(failed, stage)
        self.sensors.record_acceleration(index, self._qacc)

    def _two_substeps(self, first: int, target: np.ndarray, failed: np.ndarray, stage: int) -> None:
        """Run the drive twice and one physics step of two substeps."""
        sensors, torques = self.sensors, self._torques
        self._drive.torque(target, sensors.motor_position, sensors.motor_velocity, out=torques[0])
        sensors.read(first, self.qpos, self.qvel)
        self._drive.torque(target, sensors.motor_position, sensors.motor_velocity, out=torques[1])
        np.add(*torques, out=self._ctrl)
        self._ctrl *= 0.5
        self._step(failed, stage)
        sensors.record_acceleration(first, self._qacc)
        # semi-implicit Euler moves at the velocity of the step's end, so that joints are
        # interpolated; the pelvis' attitude stays half a millisecond ahead
        position, velocity = self._encoders
        self._halfway[:] = self.qpos
        self._halfway[:, position] -= self.robot.physics_timestep * self.qvel[:, velocity]
        sensors.read(first + 1, self._halfway, self.qvel)
        sensors.record_acceleration(first + 1, self._qacc)

    def _step(self, failed: np.ndarray, stage: int) -> None:
        """Step the simulations that have not failed, and mark those that fail."""
        ids = np.flatnonzero(~failed) if failed.any() else None
        try:
            self.batch.step(ids, stage=stage)
        except SimulationError as error:
            failed[error.ids] = True

    def _record(self, substep: int, index: int) -> None:
        """Write the state after a substep to `watched`."""
        np.concatenate(
            [
                self.qpos[index],
                self.qvel[index],
                self._qfrc_actuator[index, self.indices.motor_qvel],
                self._sensordata[index, self.indices.ground_force.ravel()],
            ],
            out=self.watched[substep],
        )

    def _finite(self) -> np.ndarray:
        arrays = (self.qpos, self.qvel, self._loads.ground_force.reshape(self.num, -1))
        return np.isfinite(np.concatenate(arrays, axis=1)).min(axis=1)


def watched_size(model: mujoco.MjModel) -> int:
    """Length of a substep's row in `Simulations.watched`."""
    return model.nq + model.nv + model.nu + 2 * 3
