"""The reference backend: dm_control environments of the walking task, one after another.

Its states equal the batched backend's bit for bit; use it for viewing, for comparison, and where
dm_control's tools are wanted.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from copy import copy
from typing import Final

import mujoco
import numpy as np

with warnings.catch_warnings():
    # dm_control looks for a display on import; its absence matters only to those who render
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control.mujoco.wrapper import MjModel
    from dm_control.rl.control import PhysicsError

from aslip.envs import CassiePhysics, walk_environment
from aslip.envs.base import CassieEnv
from aslip.errors import ConfigurationError
from aslip.robot.model import DEFAULT_FLOOR_FRICTION
from aslip.sim import Snapshot
from aslip.sim.checks import check_count, check_states
from aslip.sim.dynamics import with_longer_memory, write_fields

MAX_DM_CONTROL_ENVS: Final = 1_024
"""Most robots of one environment, each with a model of its own; for more take the batch backend."""


class DmControlCassieEnv(CassieEnv):
    """N dm_control environments; see `CassieEnv` for the keys.

    Args:
        num_envs: number of robots, simulated in turn; at most `MAX_DM_CONTROL_ENVS`.
        floor_friction: sliding friction of the floor.
    """

    def __init__(
        self, num_envs: int = 1, *, floor_friction: float = DEFAULT_FLOOR_FRICTION
    ) -> None:
        num_envs = check_count("num_envs", num_envs, most=MAX_DM_CONTROL_ENVS)
        # time limit and falls are the transforms' and the base class's business
        self.environments = [
            walk_environment(
                time_limit=float("inf"), terminate_on_fall=False, floor_friction=floor_friction
            )
            for _ in range(num_envs)
        ]
        for environment in self.environments:
            environment.reset()
        self._model = copy(self.physics[0].model.ptr)
        super().__init__(num_envs, self.physics[0].indices)

    @property
    def physics(self) -> list[CassiePhysics]:
        """The robots' physics."""
        return [environment.physics for environment in self.environments]

    @property
    def model(self) -> mujoco.MjModel:
        """See `CassieEnv.model`; all of it."""
        return self._model

    def states(self) -> np.ndarray:
        """See `CassieEnv.states`."""
        return np.stack([physics.full_state() for physics in self.physics])

    def set_states(self, states: np.ndarray) -> None:
        """See `CassieEnv.set_states`."""
        states = check_states(states, self.states().shape)
        for physics, state in zip(self.physics, states, strict=True):
            physics.set_full_state(state)

    def watch(self, index: int | None) -> None:
        """See `CassieEnv.watch`."""
        if index is not None and not 0 <= index < self.num_envs:
            raise ConfigurationError(f"no robot {index!r}; there are {self.num_envs}, from 0")
        for i, physics in enumerate(self.physics):
            physics.watch(i == index)

    @property
    def watched(self) -> np.ndarray:
        """See `CassieEnv.watched`."""
        for physics in self.physics:
            if physics.watched is not None:
                return physics.watched
        raise ConfigurationError("no robot is watched; call watch(index) first")

    def _write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        for k, i in enumerate(ids):
            physics = self.physics[i]
            write_fields(physics.model.ptr, {name: rows[k] for name, rows in fields.items()})
            if "opt.gravity" in fields:
                physics.sensors.set_gravity(np.zeros(1, dtype=int), fields["opt.gravity"][k, None])

    def _lengthen_memory(self, delay: float) -> None:
        self._model = with_longer_memory(self.model, delay, visual=True)
        for physics in self.physics:
            watched = physics.watched is not None
            physics._reload_from_model(MjModel(copy(self._model)))
            physics.watch(watched)

    def _advance(self, motor_target: np.ndarray, push: np.ndarray | None) -> np.ndarray:
        diverged = np.zeros(self.num_envs, dtype=bool)
        for i, environment in enumerate(self.environments):
            self.physics[i].push(np.zeros(3) if push is None else push[i])
            try:
                environment.step(motor_target[i])
            except PhysicsError:
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

    def _packets(self) -> dict[str, np.ndarray]:
        packets = [physics.packets() for physics in self.physics]
        return {name: np.stack([packet[name] for packet in packets]) for name in packets[0]}
