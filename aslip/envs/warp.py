"""Simulator for training on a GPU: all robots on one device, on MuJoCo Warp."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import mujoco
import numpy as np
import torch
import warp as wp
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from aslip.base.checks import check_count
from aslip.envs.batch import MAX_BATCH_ENVS
from aslip.envs.simulated_env import SimulatedEnv
from aslip.robot import CASSIE, Robot
from aslip.robot.model import DEFAULT_FLOOR_FRICTION, load_model
from aslip.sim.warp.simulations import WarpSimulations
from aslip.transforms.rotation import rotate_inverse, upper_hemisphere


class WarpEnv(SimulatedEnv):
    """N robots on MuJoCo Warp; see `SimulatedEnv` for the keys. No entry visits the host.

    Args:
        num_envs: number of robots.
        device: device of robots and entries, such as "cuda" or "cpu".
        floor_friction: sliding friction of the floor.
        timestep: physics timestep [s]; see `aslip.robot.model.load_model`.
        robot: the robot.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        device: str = "cuda",
        floor_friction: float = DEFAULT_FLOOR_FRICTION,
        timestep: float | None = None,
        robot: Robot = CASSIE,
    ) -> None:
        num_envs = check_count("num_envs", num_envs, most=MAX_BATCH_ENVS)
        self._model = load_model(floor_friction, visual=False, timestep=timestep, robot=robot)
        self.simulations = WarpSimulations(num_envs, self._model, device, robot)
        sim = self.simulations
        self._live: dict[str, Tensor] = {
            name: wp.to_torch(array) for name, array in sim.arrays().items()
        }
        super().__init__(num_envs, robot)

    @property
    def model(self) -> mujoco.MjModel:
        """See `SimulatedEnv.model`; without visual geoms."""
        return self._model

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        live = self._live
        live["target"].copy_(cast("Tensor", tensordict["motor_target"]))
        push = tensordict.get("push", None)
        live["push"].copy_(torch.zeros_like(live["push"]) if push is None else push)
        self.simulations.advance()
        return self._result(live["diverged"].clone())

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        del kwargs
        live = self._live
        mask = None if tensordict is None else tensordict.get("_reset", None)
        live["restarted"].copy_(True if mask is None else mask[:, 0])
        for name in ("qpos", "qvel"):
            initial = None if tensordict is None else tensordict.get(("initial", name), None)
            live[f"initial_{name}"].copy_(live[f"standing_{name}"] if initial is None else initial)
        self.simulations.restart()
        return self._start()

    def _result(self, stopped: Any) -> TensorDict:
        stopped = torch.as_tensor(stopped)[:, None]
        zero = torch.zeros(stopped.shape, device=stopped.device)
        entries = {**self._observation(stopped), "reward": zero}
        entries |= {"terminated": stopped, "done": stopped.clone()}
        return TensorDict(entries, batch_size=self.batch_size)

    def _observation(self, stopped: Any) -> dict[str, dict[str, Tensor]]:
        names = self.robot.packet_sizes
        sensors = {name: self._live[f"sent_{name}"].clone() for name in names}
        return {"sensors": sensors, "truth": self._truth(torch.as_tensor(stopped).reshape(-1, 1))}

    def _truth(self, diverged: Any) -> dict[str, Tensor]:
        live, at = self._live, self.indices
        qpos, qvel = live["qpos"], live["qvel"]
        orientation = upper_hemisphere(qpos[:, at.pelvis_orientation])
        truth = {
            "qpos": qpos.double(),
            "qvel": qvel.double(),
            "pelvis_position": qpos[:, at.pelvis_position].clone(),
            "pelvis_orientation": orientation,
            "pelvis_velocity": qvel[:, at.pelvis_velocity].clone(),
            "pelvis_angular_velocity": qvel[:, at.pelvis_angular_velocity].clone(),
            "pelvis_acceleration": rotate_inverse(orientation, live["acceleration"][:, :3]),
            "motor_position": qpos[:, at.motor_qpos],
            "motor_velocity": qvel[:, at.motor_qvel],
            "joint_position": qpos[:, at.joint_qpos],
            "joint_velocity": qvel[:, at.joint_qvel],
            "motor_torque": live["torque"].clone(),
            "motor_power": live["power"].clone(),
            "ground_force": live["ground"].clone(),
            "largest_force": live["largest"].clone(),
        }
        for i, foot in enumerate(("left_foot", "right_foot")):
            truth[f"{foot}_position"] = live["site_xpos"][:, at.foot_site[i]].clone()
            truth[f"{foot}_velocity"] = live["sensordata"][:, at.foot_velocity[i]]
            truth[f"{foot}_orientation"] = upper_hemisphere(live["foot_orientation"][:, i])
        truth["diverged"] = torch.as_tensor(diverged).reshape(-1, 1)
        truth["slope"] = torch.zeros_like(qpos[:, :1])
        return truth

    # not yet
    def _advance(self, motor_target: np.ndarray, push: np.ndarray | None) -> np.ndarray:
        raise NotImplementedError

    def _restart(self, ids: np.ndarray, qpos: np.ndarray | None, qvel: np.ndarray | None) -> None:
        raise NotImplementedError

    def _snapshot(self) -> Any:
        raise NotImplementedError

    def _write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        raise NotImplementedError

    def _lengthen_memory(self, delay: float) -> None:
        raise NotImplementedError

    def packets(self) -> Mapping[str, np.ndarray]:
        raise NotImplementedError

    def states(self) -> np.ndarray:
        raise NotImplementedError

    def set_states(self, states: np.ndarray) -> None:
        raise NotImplementedError

    def watch(self, index: int | None) -> None:
        raise NotImplementedError

    @property
    def watched(self) -> np.ndarray:
        raise NotImplementedError
