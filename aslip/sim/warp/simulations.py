"""N simulations of a robot and its low level on one device, on MuJoCo Warp.

One graph holds a whole policy period, 60 substeps of drive, delay, physics and sensors, and the
restart of robots that diverged; a launch replays it. States are single precision.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from aslip.base.checks import check_states
from aslip.robot import CASSIE, Robot
from aslip.sim.sensors import JOINT_VELOCITY_FILTER, filter_start
from aslip.sim.warp import low_level as low
from aslip.sim.warp.states import history_of_ring, ring_of_history, state_parts

CONTACTS: Final = 24
"""Contacts for which there is memory, per robot."""
CONSTRAINTS: Final = 96
"""Constraint rows for which there is memory, per robot."""
_INTEGRATION = int(mujoco.mjtState.mjSTATE_INTEGRATION)
# beyond, MuJoCo resets a simulation
_LARGEST = 1e10


class WarpSimulations:
    """Batch of `num` simulations on a device, initially standing.

    Arrays live on the device, and each call changes them in place.

    Args:
        num: number of simulations.
        model: compiled model of the robot.
        device: Warp's name of the device, such as "cuda:0" or "cpu".
        robot: robot of the model.
    """

    def __init__(
        self, num: int, model: mujoco.MjModel, device: str = "cpu", robot: Robot = CASSIE
    ) -> None:
        self.num, self.model, self.robot, self.device = num, model, robot, device
        self._stride = round(model.opt.timestep / robot.physics_timestep)
        with wp.ScopedDevice(device):
            undelayed = _without_delay(model)
            self.m = mjw.put_model(undelayed)
            self.d = mjw.make_data(undelayed, nworld=num, nconmax=CONTACTS, njmax=CONSTRAINTS)
            self._make_arrays(num)
            self._capture()
        self.reset()

    def _make_arrays(self, num: int) -> None:
        robot, at = self.robot, self.robot.indices
        motors, joints = len(robot.motor_names), len(robot.joint_names)
        packets = robot.sensor_window

        def sent(size: int) -> wp.array:
            return wp.zeros((num, packets, size), dtype=float)

        step = 2 * np.pi / 2.0**robot.motor_encoder_bits / robot.gear
        self.motors = _struct(
            low.Motors,
            qpos=at.motor_qpos.astype(np.int32),
            qvel=at.motor_qvel.astype(np.int32),
            gear=robot.gear,
            slope=-2.0 / (robot.no_load_speed / robot.gear),
            limit=robot.torque_limit,
            step=step,
            velocity_step=step / np.pi,
            stiffness=np.tile(robot.stiffness, (num, 1)),
            damping=np.tile(robot.damping, (num, 1)),
            target=np.zeros((num, motors)),
            delay=np.full(num, round(robot.torque_delay / self.model.opt.timestep), np.int32),
            tick=np.zeros(num, np.int32),
            waiting=np.zeros((num, low.RING, motors)),
            count=np.zeros((num, low.TAPS, motors), np.int32),
            position=np.zeros((num, motors)),
            velocity=np.zeros((num, motors)),
            sent_position=sent(motors),
            sent_velocity=sent(motors),
        )
        numerator, denominator, constant, ramp, gain = filter_start(robot.physics_timestep)
        double = {"numerator": numerator, "denominator": denominator}
        double |= {"constant": constant, "ramp": ramp, "memory": np.zeros((num, joints, len(ramp)))}
        self.joints = _struct(
            low.Joints,
            qpos=at.joint_qpos.astype(np.int32),
            qvel=at.joint_qvel.astype(np.int32),
            step=2 * np.pi / 2.0**robot.joint_encoder_bits,
            ramp_gain=gain,
            sent_position=sent(joints),
            sent_velocity=sent(joints),
            **{name: wp.array(value, dtype=wp.float64) for name, value in double.items()},
        )
        self.inertial = _struct(
            low.Inertial,
            site=wp.vec3(*self.model.site(robot.imu_site).pos),
            attitude=wp.zeros(num, dtype=wp.quat),
            spin=wp.zeros(num, dtype=wp.vec3),
            force=wp.zeros(num, dtype=wp.vec3),
            sent_orientation=sent(4),
            sent_gyro=sent(3),
            sent_force=sent(3),
            acceleration=np.zeros((num, 6)),
            torque=np.zeros((num, motors)),
            ground=np.zeros((num, 2, 3)),
            largest=np.zeros((num, 2)),
            power=np.zeros((num, motors)),
        )
        self._ground = wp.array(at.ground_force.astype(np.int32), dtype=int)
        key = self.model.key("standing")
        self._standing = [wp.array(x[None], dtype=float) for x in (key.qpos, key.qvel)]
        self.initial = [wp.zeros((num, x.shape[1]), dtype=float) for x in self._standing]
        self._push = wp.zeros((num, 3), dtype=float)
        self._feet = wp.array(at.foot_site.astype(np.int32), dtype=int)
        self.foot_orientation = wp.zeros((num, 2, 4), dtype=float)
        self.restarted = wp.zeros(num, dtype=bool)
        self.diverged = wp.zeros(num, dtype=bool)
        self.overflowed = wp.zeros(num, dtype=bool)

    def _capture(self) -> None:
        """Record the graphs; kernels are compiled before, as a capture cannot load modules."""
        self._graphs = {}
        runs: dict[str, Callable[[], None]] = {
            "period": self._period,
            "restart": lambda: self._restart(self.restarted, self.initial),
        }
        for name, run in runs.items():
            run()
            with wp.ScopedCapture() as capture:
                run()
            self._graphs[name] = capture.graph

    def _launch(self, kernel: Any, dim: Any, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device)

    def _period(self) -> None:
        """All substeps of a policy period, and the restart of robots that diverged."""
        pelvis = self.robot.indices.pelvis_body
        self._launch(low.push_pelvis, self.num, self._push, pelvis, self.d.xfrc_applied)
        for first in range(0, self.robot.substeps, self._stride):
            self._physics_step(first)
        d = self.d
        self._launch(
            low.find_diverged, self.num, d.qpos, d.qvel, d.qacc, d.overflow, _LARGEST,
            self.diverged, self.overflowed,
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
            low.feel, num, self.motors, self.inertial, gravity, d.qacc, starts, per, packets[0], 1
        )
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
                low.feel, num, self.motors, self.inertial, gravity, d.qacc, 0, per, packets[1], 0
            )
        self._launch(
            low.weigh, num, self.motors, self.inertial, self._ground, d.sensordata,
            d.qfrc_actuator, d.qvel, d.qacc, int(first == 0), self._stride / self.robot.substeps,
        )  # fmt: skip

    def _restart(self, restarted: wp.array, initial: list[wp.array]) -> None:
        """Restart marked robots, and bring derived quantities of all up to date."""
        d, m, num, timestep = self.d, self.m, self.num, self.robot.physics_timestep
        self._launch(
            low.restart, num, self.motors, restarted, *initial, d.time, d.qpos, d.qvel,
            d.qacc_warmstart, d.ctrl, d.overflow,
        )  # fmt: skip
        mjw.forward(m, d)
        self._launch(
            low.settle_motors, (num, d.ctrl.shape[1]), self.motors, restarted, d.qpos, d.qvel,
            timestep,
        )  # fmt: skip
        self._launch(
            low.settle_joints, (num, len(self.robot.joint_names)), self.joints, restarted, d.qpos,
            d.qvel, timestep,
        )  # fmt: skip
        self._launch(
            low.settle_inertial, num, self.motors, self.inertial, restarted, m.opt.gravity,
            self._ground, d.qpos, d.qvel, d.qacc, d.qfrc_actuator, d.sensordata,
        )  # fmt: skip
        self._launch(low.orient_feet, (num, 2), self._feet, d.site_xmat, self.foot_orientation)

    def arrays(self) -> dict[str, wp.array]:
        """Live arrays by name: inputs, and what packets and truth are made of."""
        d, motors, joints, inertial = self.d, self.motors, self.joints, self.inertial
        return {
            "target": motors.target,
            "push": self._push,
            "restarted": self.restarted,
            "diverged": self.diverged,
            "initial_qpos": self.initial[0],
            "initial_qvel": self.initial[1],
            "standing_qpos": self._standing[0],
            "standing_qvel": self._standing[1],
            "sent_motor_position": motors.sent_position,
            "sent_motor_velocity": motors.sent_velocity,
            "sent_joint_position": joints.sent_position,
            "sent_joint_velocity": joints.sent_velocity,
            "sent_orientation": inertial.sent_orientation,
            "sent_gyro": inertial.sent_gyro,
            "sent_accelerometer": inertial.sent_force,
            "qpos": d.qpos,
            "qvel": d.qvel,
            "site_xpos": d.site_xpos,
            "sensordata": d.sensordata,
            "foot_orientation": self.foot_orientation,
            **{n: getattr(inertial, n) for n in ("acceleration", "torque", "ground", "largest")},
            "power": inertial.power,
        }

    def advance(self) -> None:
        """Run one policy period with the targets in `motors.target`."""
        wp.capture_launch(self._graphs["period"])

    def reset(self) -> None:
        """Restart all simulations, standing."""
        for initial, standing in zip(self.initial, self._standing, strict=True):
            initial.assign(np.repeat(standing.numpy(), self.num, axis=0))
        self.restarted.fill_(True)
        self.restart()

    def states(self) -> np.ndarray:
        """(n, k) copy of the complete states; see `aslip.sim.Simulations.states`."""
        motors, model = self.motors, self.model
        parts = state_parts(model)
        physics = np.tile(_default_state(model), (self.num, 1))
        tick = motors.tick.numpy()
        physics[:, parts["time"]] = tick[:, None] * model.opt.timestep
        for name, array in self._mirrored().items():
            physics[:, parts[name]] = array.numpy().reshape(self.num, -1)
        physics[:, parts["history"]] = history_of_ring(motors.waiting.numpy(), tick, model)
        memory = (
            motors.count.numpy()[:, 1:],
            self.joints.memory.numpy().swapaxes(1, 2),
            motors.position.numpy(),
            motors.velocity.numpy(),
        )
        return np.concatenate([physics, *(part.reshape(self.num, -1) for part in memory)], axis=1)

    @property
    def state_size(self) -> int:
        """Length of one simulation's row in `states`."""
        return self.states().shape[1]

    def set_states(self, states: np.ndarray) -> None:
        """Restore a result of `states`, of these or of other simulations of the same model.

        Raises:
            ShapeError: the states have another number or model; nothing is changed.
        """
        states = check_states(states, (self.num, self.state_size))
        parts, motors, num = state_parts(self.model), self.motors, self.num
        tick = np.rint(states[:, parts["time"]][:, 0] / self.model.opt.timestep).astype(int)
        for name, array in self._mirrored().items():
            array.assign(states[:, parts[name]].reshape(array.numpy().shape))
        motors.tick.assign(tick)
        motors.waiting.assign(ring_of_history(states[:, parts["history"]], tick, self.model))
        taps, width = low.TAPS, motors.position.shape[1]
        joints = self.joints.memory
        sizes = [(taps - 1) * width, joints.shape[1] * joints.shape[2], width]
        memory = states[:, mujoco.mj_stateSize(self.model, _INTEGRATION) :]
        count, joint, position, velocity = np.split(memory, np.cumsum(sizes), axis=1)
        counts = motors.count.numpy().copy()
        counts[:, 1:] = count.reshape(num, taps - 1, width)
        motors.count.assign(counts)
        joints.assign(joint.reshape(num, joints.shape[2], -1).swapaxes(1, 2))
        motors.position.assign(position)
        motors.velocity.assign(velocity)
        # derived quantities: MuJoCo Warp's constraints read body velocities of the step before
        self.restarted.zero_()
        self.restart()

    def _mirrored(self) -> dict[str, wp.array]:
        """Arrays that MuJoCo's integration state has, too, by its names."""
        d = self.d
        return {"qpos": d.qpos, "qvel": d.qvel, "warmstart": d.qacc_warmstart, "ctrl": d.ctrl} | {
            "xfrc_applied": d.xfrc_applied
        }

    def restart(self) -> None:
        """Restart the simulations marked in `restarted` at the states in `initial`."""
        wp.capture_launch(self._graphs["restart"])


def _default_state(model: mujoco.MjModel) -> np.ndarray:
    """Integration state after a reset."""
    state = np.empty(mujoco.mj_stateSize(model, _INTEGRATION))
    mujoco.mj_getState(model, mujoco.MjData(model), state, _INTEGRATION)
    return state


def _without_delay(model: mujoco.MjModel) -> mujoco.MjModel:
    """Copy of a model whose motors act at once: torques wait in the ring."""
    from copy import copy

    copied = copy(model)
    copied.actuator_delay[:] = 0.0
    copied.actuator_history[:] = 0
    return copied


def _struct(kind: Any, **values: Any) -> Any:
    """Struct of Warp with arrays on the current device."""
    struct = kind()
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            whole = np.issubdtype(value.dtype, np.integer)
            value = wp.array(value, dtype=int if whole else float)
        setattr(struct, name, value)
    return struct
