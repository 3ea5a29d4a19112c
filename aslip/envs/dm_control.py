"""Reference simulator: a walking task of dm_control, and robot environments made from it.

`Walk` rewards walking upright at a given speed. It needs no gait library, so that any dm_control
agent can use the robot. `DmControlEnv` runs the task without its rewards and ends; its states equal
those of the batched simulator bit for bit. It serves comparison and dm_control's tools.
"""

from __future__ import annotations

import warnings
from collections import OrderedDict
from collections.abc import Mapping
from copy import copy
from typing import Final

import mujoco
import numpy as np

with warnings.catch_warnings():
    # dm_control looks for a display on import; its absence matters only to those who render
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control.mujoco.wrapper import MjModel
    from dm_control.rl import control
    from dm_control.suite import base
    from dm_control.utils import rewards
    from dm_env import specs

from aslip.base.checks import check_count, check_number, check_states
from aslip.envs.physics import BipedPhysics
from aslip.envs.simulated_env import SimulatedEnv
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.robot.model import DEFAULT_FLOOR_FRICTION
from aslip.sim import PD, MakeDrive, Snapshot
from aslip.sim.dynamics import write_fields

MAX_DM_CONTROL_ENVS: Final = 1_024
"""Largest number of robots of one environment, each with its own model."""

_ONE = np.zeros(1, dtype=int)
# pelvis height [m] of full reward; gaits of the library stay above it
_STAND_HEIGHT = 0.75
# speed error [m/s] at which the reward falls to a tenth
_SPEED_MARGIN = 0.5
# margin [rad] of PD targets beyond the joint range, for torque at the joint's limit
_TARGET_MARGIN = 1.0


class Walk(base.Task):
    """Walk forward at a given speed, upright, in any direction of the world.

    Args:
        speed: forward speed to keep [m/s].
        terminate_on_fall: end the episode with discount 0 when the robot has fallen.
        random: `numpy.random.RandomState` or seed for the pelvis' initial velocity.
    """

    def __init__(
        self,
        speed: float = 1.0,
        *,
        terminate_on_fall: bool = True,
        random: np.random.RandomState | int | None = None,
    ) -> None:
        super().__init__(random=random)
        self._speed = check_number("speed", speed, what="in m/s")
        self._terminate_on_fall = terminate_on_fall

    def action_spec(self, physics: BipedPhysics) -> specs.BoundedArray:
        """Ten joint angles [rad], bounded by the joints' ranges and a margin."""
        low, high = physics.motor_range().T
        return specs.BoundedArray(
            low.shape, np.float64, low - _TARGET_MARGIN, high + _TARGET_MARGIN, "motor_target"
        )

    def initialize_episode(self, physics: BipedPhysics) -> None:
        """Stand with a small horizontal velocity in a random direction."""
        physics.stand()
        physics.data.qvel[physics.indices.pelvis_velocity][:2] = self.random.uniform(
            -0.1, 0.1, size=2
        )
        super().initialize_episode(physics)

    def get_observation(self, physics: BipedPhysics) -> OrderedDict[str, np.ndarray]:
        """True state of the robot without its position on the floor."""
        state = physics.true_state()
        observation = OrderedDict(height=state["pelvis_position"][2:])
        for name in (
            "pelvis_orientation",
            "pelvis_velocity",
            "pelvis_angular_velocity",
            "motor_position",
            "motor_velocity",
            "joint_position",
            "joint_velocity",
            "ground_force",
        ):
            observation[name] = state[name]
        return observation

    def get_reward(self, physics: BipedPhysics) -> float:
        """Product of the rewards for upright pelvis, height and speed; in [0, 1]."""
        upright = (1 + physics.pelvis_upright()) / 2
        high = rewards.tolerance(
            physics.pelvis_height(), (_STAND_HEIGHT, float("inf")), margin=_STAND_HEIGHT / 2
        )
        at_speed = rewards.tolerance(
            physics.pelvis_velocity()[0], (self._speed, self._speed), margin=_SPEED_MARGIN
        )
        return float(upright * high * at_speed)

    def get_termination(self, physics: BipedPhysics) -> float | None:
        """Discount 0 after a fall, else None."""
        fallen = self._terminate_on_fall and physics.pelvis_height() < CASSIE.fall_height
        return 0.0 if fallen else None


def walk_environment(
    speed: float = 1.0,
    *,
    time_limit: float = 12.0,
    terminate_on_fall: bool = True,
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    random: np.random.RandomState | int | None = None,
) -> control.Environment:
    """Make a dm_control environment of the `Walk` task at the policy rate of 33 Hz.

    Args:
        speed: forward speed to keep [m/s].
        time_limit: length of an episode [s]; by default the paper's 400 policy steps.
        terminate_on_fall: end the episode when the robot has fallen.
        floor_friction: sliding friction of the floor.
        random: `numpy.random.RandomState` or seed.
    """
    physics = BipedPhysics.load(floor_friction)
    assert physics.timestep() == CASSIE.physics_timestep
    return control.Environment(
        physics,
        Walk(speed, terminate_on_fall=terminate_on_fall, random=random),
        time_limit=time_limit,
        control_timestep=CASSIE.policy_period,
    )


class DmControlEnv(SimulatedEnv):
    """N robots in dm_control; see `SimulatedEnv` for the keys.

    Args:
        num_envs: number of robots, simulated one after another; at most `MAX_DM_CONTROL_ENVS`.
        floor_friction: sliding friction of the floor.
        drive: low level that takes `motor_target`; see `BatchEnv`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        floor_friction: float = DEFAULT_FLOOR_FRICTION,
        drive: MakeDrive = PD,
    ) -> None:
        num_envs = check_count("num_envs", num_envs, most=MAX_DM_CONTROL_ENVS)
        # transforms end episodes
        self.environments = [
            walk_environment(
                time_limit=float("inf"), terminate_on_fall=False, floor_friction=floor_friction
            )
            for _ in range(num_envs)
        ]
        for environment in self.environments:
            environment.physics.use_drive(drive)
            environment.reset()
        self._model = copy(self.physics[0].model.ptr)
        super().__init__(num_envs, CASSIE, self.physics[0].drive.command_size, drive)

    @property
    def physics(self) -> list[BipedPhysics]:
        """Physics of each robot."""
        return [environment.physics for environment in self.environments]

    _visual = True

    @property
    def model(self) -> mujoco.MjModel:
        """See `SimulatedEnv.model`; with visual geoms."""
        return self._model

    def states(self) -> np.ndarray:
        """See `SimulatedEnv.states`."""
        return np.stack([physics.full_state() for physics in self.physics])

    def set_states(self, states: np.ndarray) -> None:
        """See `SimulatedEnv.set_states`."""
        states = check_states(states, self.states().shape)
        for physics, state in zip(self.physics, states, strict=True):
            physics.set_full_state(state)

    def watch(self, index: int | None) -> None:
        """See `SimulatedEnv.watch`."""
        if index is not None and not 0 <= index < self.num_envs:
            raise ConfigurationError(f"robot must be from 0 to {self.num_envs - 1}, got {index!r}")
        for i, physics in enumerate(self.physics):
            physics.watch(i == index)

    @property
    def watched(self) -> np.ndarray:
        """See `SimulatedEnv.watched`."""
        for physics in self.physics:
            if physics.watched is not None:
                return physics.watched
        raise ConfigurationError("watched needs a robot; call watch(index) first")

    def _write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        for k, i in enumerate(ids):
            physics = self.physics[i]
            write_fields(physics.model.ptr, {name: rows[k] for name, rows in fields.items()})
            physics.drive.write_gains(_ONE, {name: rows[[k]] for name, rows in fields.items()})
            if "opt.gravity" in fields:
                physics.sensors.set_gravity(_ONE, fields["opt.gravity"][k, None])

    def _use_model(self, model: mujoco.MjModel) -> None:
        self._model = model
        for physics in self.physics:
            watched, drive = physics.watched is not None, physics.drive
            physics._reload_from_model(MjModel(copy(self._model)))
            physics.watch(watched)
            physics.drive = drive

    def _advance(self, motor_target: np.ndarray, push: np.ndarray | None) -> np.ndarray:
        diverged = np.zeros(self.num_envs, dtype=bool)
        for i, environment in enumerate(self.environments):
            self.physics[i].push(np.zeros(3) if push is None else push[i])
            try:
                environment.step(motor_target[i])
            except control.PhysicsError:
                diverged[i] = True
        self._restart(np.flatnonzero(diverged), None, None)
        return diverged

    def _restart(self, ids: np.ndarray, qpos: np.ndarray | None, qvel: np.ndarray | None) -> None:
        for k, i in enumerate(ids):
            physics = self.physics[i]
            with physics.reset_context():
                physics.stand()
                if qpos is not None:
                    physics.data.qpos[:] = qpos[k]
                if qvel is not None:
                    physics.data.qvel[:] = qvel[k]

    def _snapshot(self) -> Snapshot:
        return Snapshot.stack([physics.snapshot() for physics in self.physics])

    def packets(self) -> dict[str, np.ndarray]:
        """See `RobotEnv.packets`."""
        packets = [physics.packets() for physics in self.physics]
        return {name: np.stack([packet[name] for packet in packets]) for name in packets[0]}
