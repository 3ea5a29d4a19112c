"""N simulations of a robot and its low level on one device, on MuJoCo Warp.

One graph holds a whole policy period, 60 substeps of drive, delay, physics and sensors, and the
restart of robots that diverged; a launch replays it. States are single precision. Tensors of
results are live views of the arrays on the device.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from aslip.base.checks import check_states
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import check_timestep, ground_geoms
from aslip.robot.rotation import quaternion_to_matrix
from aslip.sim.dynamics import DERIVING_FIELDS
from aslip.sim.parameters import DYNAMICS
from aslip.sim.simulations import watched_size
from aslip.sim.truth import Snapshot
from aslip.sim.warp import low_level as low
from aslip.sim.warp import restarts
from aslip.sim.warp.states import read_states, write_states
from aslip.sim.warp.structs import make_inertial, make_joints, make_motors

CONTACTS: Final = 24
"""Contacts of a robot for which there is memory, by default."""
CONSTRAINTS: Final = 96
"""Constraint rows of a robot for which there is memory, by default."""
# beyond, MuJoCo resets a simulation
_LARGEST = 1e10
# fields that MuJoCo derives from those of `DYNAMICS`
_DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0", "actuator_acc0")
# fields of stones, other than places
_STONES = ("geom_size", "geom_aabb", "geom_rbound")
# parameters of the low level, which are not Warp's
_OWN = {"drive.stiffness": "stiffness", "drive.damping": "damping", "actuator_delay": "delay"}
# of Warp's model
_FIELDS = {field for parameter in DYNAMICS.values() for field in parameter.fields} - _OWN.keys()


class WarpSimulations:
    """Batch of `num` simulations on a device, initially standing.

    Args:
        num: number of simulations.
        model: compiled model of the robot.
        place: device.
        robot: robot of the model.
        contacts: contacts of a robot for which there is memory.
        constraints: constraint rows of a robot for which there is memory.

    Raises:
        ConfigurationError: the model's timestep is not one of
            `aslip.robot.model.physics_timesteps`, or the device has too little memory.
    """

    def __init__(
        self,
        num: int,
        model: mujoco.MjModel,
        place: torch.device,
        robot: Robot = CASSIE,
        *,
        contacts: int = CONTACTS,
        constraints: int = CONSTRAINTS,
    ) -> None:
        check_timestep(model.opt.timestep, robot)
        self.num, self.model, self.robot, self.place = num, model, robot, place
        self.contacts, self.constraints = contacts, constraints
        self._stride = round(model.opt.timestep / robot.physics_timestep)
        wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
        wp.init()
        if not any(Path(str(wp.config.kernel_cache_dir)).glob("*aslip.sim.warp*")):
            print("compiling kernels, once, which takes a minute", file=sys.stderr)
        self._device = wp.device_from_torch(place)
        try:
            with wp.ScopedDevice(self._device):
                self._make_arrays(num)
                self._make_tensors()
                self._capture()
                wp.synchronize_device()
        except RuntimeError as error:
            if "memory" not in str(error) and "alloc" not in str(error):
                raise
            raise ConfigurationError(
                f"{place} has too little memory for {num} robots ({error}): take fewer"
            ) from error
        self.reset(torch.arange(num, device=place))

    def _make_arrays(self, num: int) -> None:
        undelayed = _without_delay(self.model)
        self._ground = torch.as_tensor(ground_geoms(self.model), device=self.place)
        self._own_stones = _STONES if len(self._ground) > 1 else ()
        batched = dict.fromkeys((*_FIELDS - {"opt.gravity"}, *_DERIVED, *self._own_stones), num)
        self.m = mjw.put_model(undelayed, batch_sizes=batched)
        self.m.opt.gravity = wp.array(np.tile(self.model.opt.gravity, (num, 1)), dtype=wp.vec3)
        self.d = mjw.make_data(undelayed, nworld=num, nconmax=self.contacts, njmax=self.constraints)
        robot, at = self.robot, self.robot.indices
        self.motors = make_motors(num, self.model, robot)
        self.joints = make_joints(num, robot)
        self.inertial = make_inertial(num, self.model, robot)
        self._feet = wp.array(at.ground_force.astype(np.int32), dtype=int)
        key = self.model.key("standing")
        self._standing = [wp.array(x[None], dtype=float) for x in (key.qpos, key.qvel)]
        self.initial = [wp.zeros((num, x.shape[1]), dtype=float) for x in self._standing]
        self._push = wp.zeros((num, 3), dtype=float)
        self.restarted = wp.zeros(num, dtype=bool)
        self.diverged = wp.zeros(num, dtype=bool)
        self._overflows = wp.zeros(num, dtype=int)
        self._robot_watched = wp.full(1, -1, dtype=int)
        self._watched = wp.zeros((robot.substeps, watched_size(self.model)), dtype=float)
        columns = (np.arange(at.num_qpos), np.arange(at.num_qvel), at.motor_qvel, at.ground_force)
        places = [np.stack([0 * c.ravel() + i, c.ravel()], axis=1) for i, c in enumerate(columns)]
        self._columns = wp.array(np.concatenate(places), dtype=int)

    def _make_tensors(self) -> None:
        """Tensors that share the memory of arrays."""
        d, motors, joints, inertial = self.d, self.motors, self.joints, self.inertial
        live = {
            "target": motors.target,
            "push": self._push,
            "restarted": self.restarted,
            "diverged": self.diverged,
            "overflows": self._overflows,
            "initial_qpos": self.initial[0],
            "initial_qvel": self.initial[1],
        }
        self._live = {name: wp.to_torch(array) for name, array in live.items()}
        self._standing_state = [wp.to_torch(array) for array in self._standing]
        sent = {
            "motor_position": motors.sent_position,
            "motor_velocity": motors.sent_velocity,
            "joint_position": joints.sent_position,
            "joint_velocity": joints.sent_velocity,
            "orientation": inertial.sent_orientation,
            "gyro": inertial.sent_gyro,
            "accelerometer": inertial.sent_force,
        }
        self._packets = {name: wp.to_torch(sent[name]) for name in self.robot.packet_sizes}
        state = (
            d.qpos, d.qvel, inertial.acceleration, d.site_xpos, d.site_xmat, d.sensordata,
            inertial.ground, inertial.torque, inertial.power, inertial.largest,
        )  # fmt: skip
        snapshot = Snapshot(*(wp.to_torch(array) for array in state))
        self._snapshot = replace(snapshot, site_xmat=snapshot.site_xmat.flatten(-2))
        own = {name: wp.to_torch(getattr(motors, of)) for name, of in _OWN.items()}
        self._fields = {
            name: wp.to_torch(_field(self.m, name)) for name in (*_FIELDS, *self._own_stones)
        } | own
        # of geoms of the world, Warp computes these only once
        self._places = {"geom_pos": wp.to_torch(d.geom_xpos), "geom_quat": wp.to_torch(d.geom_xmat)}

    def _capture(self) -> None:
        """Record the graphs; kernels are compiled before, as a capture cannot load modules."""
        self._graphs = {}
        runs: dict[str, Callable[[], None]] = {
            "period": self._period,
            "derive": lambda: mjw.set_const(self.m, self.d, restore=False),
            "restart": lambda: self._restart(self.restarted, self.initial),
        }
        for name, run in runs.items():
            run()
            with wp.ScopedCapture() as capture:
                run()
            self._graphs[name] = capture.graph

    def _launch(self, kernel: Any, dim: Any, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._device)

    def _period(self) -> None:
        """All substeps of a policy period, and the restart of robots that diverged."""
        pelvis = self.robot.indices.pelvis_body
        self._launch(low.push_pelvis, self.num, self._push, pelvis, self.d.xfrc_applied)
        for first in range(0, self.robot.substeps, self._stride):
            self._physics_step(first)
        d = self.d
        self._launch(
            restarts.find_diverged, self.num, self.motors, d.qpos, d.qvel, d.qacc, d.overflow,
            _LARGEST, self.diverged, self._overflows,
        )  # fmt: skip
        self._restart(self.diverged, self._standing)

    def _physics_step(self, first: int) -> None:
        d, m, per, num = self.d, self.m, self.robot.packet_substeps, self.num
        each_motor, each_joint = (num, d.ctrl.shape[1]), (num, len(self.robot.joint_names))
        packets = [s // per if (s + 1) % per == 0 else -1 for s in (first, first + 1)]
        gravity, timestep = m.opt.gravity, self.robot.physics_timestep
        self._launch(
            low.drive_motors, each_motor, self.motors, d.qpos, self._stride, packets[0], d.ctrl
        )
        self._launch(
            low.read_joints, each_joint, self.joints, self.inertial, gravity, d.qpos, d.qvel, 0.0,
            packets[0],
        )  # fmt: skip
        mjw.step(m, d)
        starts = int(first % per == 0)
        self._launch(
            low.add_specific_force, num, self.motors, self.inertial, gravity, d.qacc, starts,
            per, packets[0], 1,
        )  # fmt: skip
        if self._stride == 2:
            # joints halfway, as semi-implicit Euler moves at the velocity of the step's end; the
            # pelvis' attitude stays half a millisecond ahead
            self._launch(
                low.read_motors, each_motor, self.motors, d.qpos, d.qvel, timestep, packets[1]
            )
            self._launch(
                low.read_joints, each_joint, self.joints, self.inertial, gravity, d.qpos, d.qvel,
                timestep, packets[1],
            )  # fmt: skip
            self._launch(
                low.add_specific_force, num, self.motors, self.inertial, gravity, d.qacc, 0,
                per, packets[1], 0,
            )  # fmt: skip
        self._launch(
            low.add_loads, num, self.motors, self.inertial, self._feet, d.sensordata,
            d.qfrc_actuator, d.qvel, d.qacc, int(first == 0), self._stride / self.robot.substeps,
        )  # fmt: skip
        self._launch(
            low.record, self._columns.shape[0], self._robot_watched, self._columns, d.qpos, d.qvel,
            d.qfrc_actuator, d.sensordata, first, self._watched,
        )  # fmt: skip

    def _restart(self, restarted: wp.array, initial: list[wp.array]) -> None:
        """Restart marked robots, and bring derived quantities of all up to date."""
        d, m, num, timestep = self.d, self.m, self.num, self.robot.physics_timestep
        self._launch(
            restarts.restart, num, self.motors, restarted, *initial, d.time, d.qpos, d.qvel,
            d.qacc_warmstart, d.ctrl, d.overflow,
        )  # fmt: skip
        mjw.forward(m, d)
        self._launch(
            restarts.settle_motors, (num, d.ctrl.shape[1]), self.motors, restarted, d.qpos, d.qvel,
            timestep,
        )  # fmt: skip
        self._launch(
            restarts.settle_joints, (num, len(self.robot.joint_names)), self.joints, restarted,
            d.qpos, d.qvel, timestep,
        )  # fmt: skip
        self._launch(
            restarts.settle_inertial, num, self.motors, self.inertial, restarted, m.opt.gravity,
            self._feet, d.qpos, d.qvel, d.qacc, d.qfrc_actuator, d.sensordata,
        )  # fmt: skip

    @property
    def overflows(self) -> Tensor:
        """(n,) policy steps in which contacts or constraints overflowed."""
        return self._live["overflows"]

    def snapshot(self) -> Snapshot:
        """Live tensors of the true state; `qacc` has the pelvis' only."""
        return self._snapshot

    def packets(self) -> Mapping[str, Tensor]:
        """Live tensors of the packets of the last policy period."""
        return self._packets

    def advance(self, motor_target: Tensor, push: Tensor | None = None) -> Tensor:
        """Run one policy period.

        Args:
            motor_target: (n, m) joint angles [rad].
            push: (n, 3) forces on the pelvis' origin during the period [N, world]; zero by default.

        Returns:
            (n,) bool, True for simulations that diverged, or whose contacts overflowed, and that
            were reset to standing.
        """
        live = self._live
        live["target"].copy_(motor_target)
        live["push"].zero_() if push is None else live["push"].copy_(push)
        self._run("period")
        return live["diverged"]

    def reset(self, ids: Tensor, qpos: Tensor | None = None, qvel: Tensor | None = None) -> None:
        """Restart some simulations; see `aslip.sim.Simulations.reset`."""
        live = self._live
        live["restarted"].zero_()
        live["restarted"][ids] = True
        for name, value, standing in zip(
            ("qpos", "qvel"), (qpos, qvel), self._standing_state, strict=True
        ):
            live[f"initial_{name}"][ids] = standing if value is None else value.float()
        self._run("restart")

    def write_fields(self, ids: Tensor, fields: Mapping[str, Tensor]) -> None:
        """Change fields of some simulations' models; see `aslip.sim.Simulations.write_fields`."""
        for name, rows in fields.items():
            if name in self._places:
                rows = quaternion_to_matrix(rows) if name == "geom_quat" else rows
                self._places[name][ids[:, None], self._ground] = rows[:, self._ground].float()
                continue
            field = self._fields[name]
            if name == "actuator_delay":
                rows = torch.round(rows[:, 0] / self.model.opt.timestep)
            field[ids] = rows.to(field.dtype).reshape(len(ids), *field.shape[1:])
        if DERIVING_FIELDS & fields.keys():
            self._run("derive")
        if (DERIVING_FIELDS | self._places.keys()) & fields.keys():
            self._update_derived()

    def watch(self, index: int | None) -> None:
        """Record every substep of one simulation; see `aslip.sim.SimulationPool.watch`."""
        if index is not None and not 0 <= index < self.num:
            raise ConfigurationError(f"simulation must be from 0 to {self.num - 1}, got {index!r}")
        if index is not None and self._stride > 1:
            raise ConfigurationError(
                f"watch needs a timestep of {self.robot.physics_timestep} s,"
                f" got {self.model.opt.timestep} s"
            )
        self._robot_watched.fill_(-1 if index is None else index)
        wp.synchronize_device(self._device)

    @property
    def watched(self) -> np.ndarray:
        """(60, 83) substeps of the watched simulation; see `aslip.sim.Simulations.watched`."""
        wp.synchronize_device(self._device)
        return self._watched.numpy().astype(float)

    def _update_derived(self) -> None:
        """Bring derived quantities up to date: constraints read velocities of the step before."""
        self._live["restarted"].zero_()
        self._run("restart")

    def _run(self, graph: str) -> None:
        """Replay a graph, after what torch has asked of the device."""
        stream = wp.stream_from_torch(self.place) if self._device.is_cuda else None
        wp.capture_launch(self._graphs[graph], stream=stream)

    def states(self) -> np.ndarray:
        """(n, k) copy of the complete states; see `aslip.sim.Simulations.states`."""
        wp.synchronize_device(self._device)  # torch's stream is another one than Warp's
        return read_states(self.model, self.d, self.motors, self.joints)

    def set_states(self, states: np.ndarray) -> None:
        """Restore a result of `states`, of these or of other simulations of the same model.

        Raises:
            ShapeError: the states have another number or model; nothing is changed.
        """
        states = check_states(states, self.states().shape)
        write_states(states, self.model, self.d, self.motors, self.joints)
        wp.synchronize_device(self._device)
        self._update_derived()


def _field(model: mjw.Model, name: str) -> wp.array:
    """Array of a field by the name in `mujoco.batch`, such as "opt.gravity" for an option."""
    owner, _, option = name.rpartition(".")
    return getattr(model.opt if owner else model, option)


def _without_delay(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copy of a model whose motors act at once: torques wait in the ring."""
    copied = copy(model)
    # Warp has no such phase to disable
    copied.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    copied.actuator_delay[:] = 0.0
    copied.actuator_history[:] = 0
    return copied
