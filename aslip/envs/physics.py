"""dm_control's physics of the robot, with the queries of a walking task."""

from __future__ import annotations

import warnings
from copy import deepcopy

import mujoco as mj
import numpy as np

with warnings.catch_warnings():
    # dm_control looks for a display on import; its absence matters only to those who render
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control import mujoco
    from dm_control.mujoco.wrapper import MjData

from aslip.base.assets import asset_path
from aslip.base.checks import check_states
from aslip.errors import ShapeError
from aslip.robot import CASSIE
from aslip.robot.model import DEFAULT_FLOOR_FRICTION, limit_warnings, set_floor_friction
from aslip.robot.rotation import rotate_inverse
from aslip.sim import PD, Drive, MakeDrive, Sensors, Snapshot
from aslip.sim.simulations import watched_size
from aslip.sim.truth import PeriodLoads, true_state

_INTEGRATION = mj.mjtState.mjSTATE_INTEGRATION

# dm_control has set its own handler on import
limit_warnings()


class BipedPhysics(mujoco.Physics):
    """Physics of the robot under motor targets; every query returns a copy.

    The control signal is the command of the drive, by default ten joint angles [rad]. Each substep
    of `step` runs the PD loop and the motor limits of `aslip.sim`.
    """

    @classmethod
    def load(cls, floor_friction: float = DEFAULT_FLOOR_FRICTION) -> BipedPhysics:
        """Physics of `assets/cassie.xml`, standing."""
        physics = cls.from_xml_path(str(asset_path("cassie.xml")))
        set_floor_friction(physics.model.ptr, floor_friction)
        with physics.reset_context():
            physics.stand()
        return physics

    def _reload_from_data(self, data: MjData) -> None:
        """Set up indices and drive; dm_control calls this from every constructor."""
        self.indices = CASSIE.indices
        self._loads = PeriodLoads(1, self.indices)
        self.drive: Drive = PD(1)
        """Low level between the control signal and the motors."""
        self.sensors = Sensors(1, data.model.ptr)
        self.watched: np.ndarray | None = None
        """(60, 83) substeps of the last policy period, as in `aslip.sim.Simulations.watched`; None
        before `watch`."""
        # calls after_reset(), which reads the attributes above
        super()._reload_from_data(data)

    def copy(self, share_model: bool = False) -> BipedPhysics:
        """Copy of the physics in the same state and with the same motor target."""
        other = super().copy(share_model)
        # dm_control copies MuJoCo's data only
        other._motor_target = self._motor_target.copy()
        other._loads = deepcopy(self._loads)
        other.sensors, other._substep = deepcopy(self.sensors), self._substep
        other.drive = deepcopy(self.drive)
        return other

    # ------------------------------------------------------------------ time

    def set_control(self, control: np.ndarray) -> None:
        """Set the command of the drive, by default joint angles (10,) [rad].

        Raises:
            ShapeError: the command has another shape.
        """
        control = np.asarray(control, dtype=np.float64)
        if control.shape != self._motor_target.shape:
            expected = self._motor_target.shape
            raise ShapeError(f"motor target must have shape {expected}, got {control.shape}")
        self._motor_target = control

    def use_drive(self, drive: MakeDrive) -> None:
        """Replace the low level between control signal and motors."""
        self.drive = drive(1, CASSIE)
        self._motor_target = self.drive.initial_command(self.motor_position()[None])[0]

    def push(self, force: np.ndarray) -> None:
        """Push the pelvis' origin with a force (3,) [N, world] until the next call."""
        self.data.xfrc_applied[self.indices.pelvis_body, :3] = force

    def watch(self, watched: bool = True) -> None:
        """Start or stop to record every substep in `watched`."""
        shape = (CASSIE.substeps, watched_size(self.model.ptr))
        self.watched = np.zeros(shape) if watched else None

    def step(self, nstep: int = 1) -> None:
        """Advance by substeps of PD control, motor limits and physics.

        Raises:
            PhysicsError: the simulation diverged.
        """
        self._loads.clear()
        sensors = self.sensors
        for _ in range(nstep):
            # the PD loop uses the readings of the previous step
            torque = self.drive.torque(
                self._motor_target[None], sensors.motor_position, sensors.motor_velocity
            )
            np.copyto(self.data.ctrl, torque[0])
            sensors.read(self._substep, self.data.qpos[None], self.data.qvel[None])
            super().step()
            sensors.record_acceleration(self._substep, self.data.qacc[None])
            if self.watched is not None:
                torque = self.data.qfrc_actuator[self.indices.motor_qvel]
                force = self.data.sensordata[self.indices.ground_force.ravel()]
                self.watched[self._substep] = np.concatenate(
                    [self.data.qpos, self.data.qvel, torque, force]
                )
            self._substep = (self._substep + 1) % CASSIE.substeps
            if self._substep == 0:
                sensors.finish()
            force = self.data.sensordata[self.indices.ground_force]
            self._loads.add(force[None], self.data.qfrc_actuator[None], self.data.qvel[None])
        self._loads.average(nstep)

    def stand(self) -> None:
        """Set the standing keyframe; call inside `reset_context`."""
        mj.mj_resetDataKeyframe(self.model.ptr, self.data.ptr, self.model.ptr.key("standing").id)

    def after_reset(self) -> None:
        """Recompute all quantities that follow from the state."""
        super().after_reset()
        self._motor_target = self.drive.initial_command(self.motor_position()[None])[0]
        self._loads.reset(slice(None), self.data.sensordata[self.indices.ground_force][None])
        state = (self.data.qpos, self.data.qvel, self.data.qacc)
        self.sensors.reset(np.zeros(1, dtype=int), *(array[None] for array in state))
        self._substep = 0

    # --------------------------------------------------------------- queries

    def snapshot(self) -> Snapshot:
        """Copies of the arrays that `aslip.sim.true_state` reads."""
        return Snapshot(
            np.array(self.data.qpos),
            np.array(self.data.qvel),
            np.array(self.data.qacc),
            np.array(self.data.site_xpos),
            np.array(self.data.site_xmat),
            np.array(self.data.sensordata),
            self._loads.ground_force[0].copy(),
            np.array(self.data.qfrc_actuator),
            self._loads.motor_power[0].copy(),
            self._loads.largest_force[0].copy(),
        )

    def full_state(self) -> np.ndarray:
        """(k,) complete state between policy periods; see `Simulations.states`."""
        physics = np.empty(mj.mj_stateSize(self.model.ptr, _INTEGRATION))
        mj.mj_getState(self.model.ptr, self.data.ptr, physics, _INTEGRATION)
        return np.concatenate([physics, self.sensors.memory()[0]])

    def set_full_state(self, state: np.ndarray) -> None:
        """Restore a result of `full_state`, from this or another physics of the same model.

        Raises:
            ShapeError: the state is of another model; the physics keeps its own.
        """
        size = mj.mj_stateSize(self.model.ptr, _INTEGRATION)
        state = check_states(state, (size + self.sensors.memory_size,))
        mj.mj_setState(self.model.ptr, self.data.ptr, state[:size], _INTEGRATION)
        # dm_control's step expects the position and velocity stages to be computed
        mj.mj_step1(self.model.ptr, self.data.ptr)
        self.sensors.set_memory(state[None, size:])
        self._substep = 0

    def packets(self) -> dict[str, np.ndarray]:
        """Packets of the last whole policy period, (`Robot.sensor_window`, k) each."""
        return {name: window[0].copy() for name, window in self.sensors.packets().items()}

    def true_state(self) -> dict[str, np.ndarray]:
        """Quantities of `aslip.sim.true_state` by name."""
        return true_state(self.snapshot(), self.indices)

    def pelvis_height(self) -> float:
        """Height of the pelvis origin above the floor [m]."""
        return float(self.data.qpos[self.indices.pelvis_position][2])

    def pelvis_upright(self) -> float:
        """Projection of the pelvis' z axis on the vertical, in [-1, 1]."""
        return float(self.named.data.xmat[CASSIE.pelvis, "zz"])

    def pelvis_velocity(self) -> np.ndarray:
        """Velocity of the pelvis in the pelvis frame, (3,) [m/s]."""
        return rotate_inverse(
            np.array(self.data.qpos[self.indices.pelvis_orientation]),
            np.array(self.data.qvel[self.indices.pelvis_velocity]),
        )

    def motor_position(self) -> np.ndarray:
        """Angles of the ten driven joints, (10,) [rad]."""
        return np.array(self.data.qpos[self.indices.motor_qpos])

    def motor_range(self) -> np.ndarray:
        """Limits of the ten driven joints, (10, 2) [rad]."""
        return np.stack([self.named.model.jnt_range[name] for name in CASSIE.motor_names])
