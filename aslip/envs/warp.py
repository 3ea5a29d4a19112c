"""Simulator for training on a GPU: all robots on one device, on MuJoCo Warp."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.base.checks import check_count
from aslip.envs.batch import MAX_BATCH_ENVS, SimulationsEnv
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE, Robot
from aslip.robot.model import DEFAULT_FLOOR_FRICTION, load_model
from aslip.sim.warp import CONSTRAINTS, CONTACTS, WarpSimulations, check_device

# share of policy steps in which contacts may overflow, and steps between looks at it
_MOST_OVERFLOWS = 1e-3
_LOOK_EVERY = 200


class WarpEnv(SimulationsEnv):
    """N robots on MuJoCo Warp; see `SimulatedEnv` for the keys. Entries stay on the device.

    Only `states` and `watched` visit the host.

    States are single precision. The episode of a robot whose contacts or constraints overflow their
    memory ends like that of one that diverged; `overflows` counts them.

    Args:
        num_envs: number of robots.
        device: device of robots and entries, such as "cuda" or "cpu".
        floor_friction: sliding friction of the floor.
        timestep: physics timestep [s]; see `aslip.robot.model.load_model`.
        robot: the robot.
        contacts: contacts of a robot for which there is memory.
        constraints: constraint rows of a robot for which there is memory.

    Raises:
        ConfigurationError: a setting is wrong, the device does not exist, or its memory is too
            small.
        MissingExtraError: MuJoCo Warp is not installed.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        device: str | torch.device = "cuda",
        floor_friction: float = DEFAULT_FLOOR_FRICTION,
        timestep: float | None = None,
        robot: Robot = CASSIE,
        contacts: int = CONTACTS,
        constraints: int = CONSTRAINTS,
    ) -> None:
        num_envs = check_count("num_envs", num_envs, most=MAX_BATCH_ENVS)
        self.place = check_device(device)
        model = load_model(floor_friction, visual=False, timestep=timestep, robot=robot)
        self._settings = {"robot": robot, "contacts": contacts, "constraints": constraints}
        self.simulations = WarpSimulations(num_envs, model, self.place, **self._settings)
        self._steps = 0
        super().__init__(num_envs, robot)

    @property
    def overflows(self) -> int:
        """Number of policy steps in which a robot's contacts overflowed since construction."""
        return int(self.simulations.overflows.sum())

    def _advance(self, motor_target: Tensor, push: Tensor | None) -> Tensor:
        self._steps += 1
        if self._steps % _LOOK_EVERY == 0 and self.overflows > _MOST_OVERFLOWS * (
            self._steps * self.num_envs
        ):
            raise ConfigurationError(
                f"contacts or constraints overflowed in {self.overflows} of"
                f" {self._steps * self.num_envs} policy steps of robots: raise contacts (now"
                f" {self.simulations.contacts}) and constraints (now"
                f" {self.simulations.constraints}) of WarpEnv"
            )
        return super()._advance(motor_target, push)

    def _use_model(self, model: mujoco.MjModel) -> None:
        if model.ngeom == self.model.ngeom and not model.nmesh:
            # torques wait long enough; only the rows of `states` become longer
            self.simulations.model = model
        else:
            self.simulations = WarpSimulations(self.num_envs, model, self.place, **self._settings)
            self.simulations.watch(self._watched_robot)

    def _taken(self, value: Tensor) -> Tensor:
        return value.detach()

    def _given(self, value: Any, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.as_tensor(value, dtype=dtype, device=self.place).clone()

    def _arranged(self, values: np.ndarray) -> Tensor:
        return torch.tensor(values, device=self.place)

    def _checked_ids(self, ids: Any) -> Tensor:
        return ids if isinstance(ids, Tensor) else self._arranged(super()._checked_ids(ids))

    def _robots_to_reset(self, tensordict: TensorDictBase | None) -> Tensor:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        everyone = torch.arange(self.num_envs, device=self.place)
        return everyone if mask is None else everyone[mask.reshape(-1)]
