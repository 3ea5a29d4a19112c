"""Simulator for training: all robots in one native batch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import mujoco
import numpy as np

from aslip.base.arrays import Array
from aslip.base.checks import check_count
from aslip.envs.simulated_env import SimulatedEnv
from aslip.robot import CASSIE, Robot
from aslip.robot.model import DEFAULT_FLOOR_FRICTION, load_model
from aslip.sim import PD, MakeDrive, SimulationPool, Snapshot

MAX_BATCH_ENVS: Final = 65_536
"""Largest number of robots of one environment, at 50 kB each. A larger number is probably a typing
error, and would fill the memory before failing."""


class SimulationsEnv(SimulatedEnv):
    """N robots in `simulations`, which have the methods of `aslip.sim.SimulationPool`."""

    simulations: Any
    _watched_robot: int | None = None

    @property
    def model(self) -> mujoco.MjModel:
        """See `SimulatedEnv.model`; without visual geoms."""
        return self.simulations.model

    def states(self) -> np.ndarray:
        """See `SimulatedEnv.states`."""
        return self.simulations.states()

    def set_states(self, states: np.ndarray) -> None:
        """See `SimulatedEnv.set_states`."""
        self.simulations.set_states(states)

    def watch(self, index: int | None) -> None:
        """See `SimulatedEnv.watch`."""
        self.simulations.watch(index)
        self._watched_robot = index

    @property
    def watched(self) -> np.ndarray:
        """See `SimulatedEnv.watched`."""
        return self.simulations.watched

    def packets(self) -> Mapping[str, Array]:
        """See `RobotEnv.packets`."""
        return self.simulations.packets()

    def _write_fields(self, ids: Array, fields: Mapping[str, Array]) -> None:
        self.simulations.write_fields(ids, fields)

    def _advance(self, motor_target: Array, push: Array | None) -> Array:
        return self.simulations.advance(motor_target, push)

    def _restart(self, ids: Array, qpos: Array | None, qvel: Array | None) -> None:
        self.simulations.reset(ids, qpos, qvel)

    def _snapshot(self) -> Snapshot:
        return self.simulations.snapshot()


class BatchEnv(SimulationsEnv):
    """N robots on `mujoco.batch`; see `SimulatedEnv` for the keys.

    Args:
        num_envs: number of robots, at most `MAX_BATCH_ENVS`.
        num_threads: physics threads, 0 for all processors.
        floor_friction: sliding friction of the floor.
        timestep: physics timestep [s]; see `aslip.robot.model.load_model`.
        robot: the robot.
        drive: low level that takes `motor_target`: `PD` takes joint angles, `Torque` takes joint
            torques; or another `aslip.sim.Drive`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        num_threads: int = 0,
        floor_friction: float = DEFAULT_FLOOR_FRICTION,
        timestep: float | None = None,
        robot: Robot = CASSIE,
        drive: MakeDrive = PD,
    ) -> None:
        num_envs = check_count("num_envs", num_envs, most=MAX_BATCH_ENVS)
        model = load_model(floor_friction, visual=False, timestep=timestep, robot=robot)
        self._settings = {"num_threads": num_threads, "robot": robot, "drive": drive}
        self.simulations = SimulationPool(num_envs, model=model, **self._settings)
        super().__init__(num_envs, robot, self.simulations.command_size, drive)

    def _use_model(self, model: mujoco.MjModel) -> None:
        self.simulations = SimulationPool(self.num_envs, model=model, **self._settings)
        self.simulations.watch(self._watched_robot)
