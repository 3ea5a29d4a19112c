"""Simulated robots: what both simulators share.

Keys beside those of `RobotEnv`, for n robots (shapes omit the leading n):

| key | shape | meaning |
|---|---|---|
| `push` | 3 | optional input: force on the pelvis for these 30 ms [N, world] |
| `("truth", ...)` | | see `aslip.sim.true_state`; `qpos` and `qvel` are doubles |
| `("truth", "diverged")` | 1 | the simulation diverged in this policy step and stands now |
| `("truth", "slope")` | 1 | rise of the floor along the world's x [rad], of `aslip.sim.DYNAMICS` |
| `terminated`, `done` | 1 | the simulation diverged |

A reset may carry `("initial", "qpos")` (35) and `("initial", "qvel")` (32); without them the robot
stands, or starts where a stack's `ReferenceStart` puts it. It may also carry `("dynamics", name)`
(1) with parameters of `aslip.sim.DYNAMICS`; a robot keeps those that neither the caller gives nor a
stack's `RandomDynamics` draws. They are no part of `state_spec`, whose entries TorchRL expects in
every step, too, so that TorchRL's own wrappers, such as `SerialEnv`, do not hand them on.

A NaN target makes that one simulation diverge; it does not touch the others. TorchRL carries keys
that no one writes from step to step, so whoever sets `push` takes it out again.

Beside the keys there are `dynamics`, `weight` and `set_dynamics`, and for logs and replay `states`,
`set_states` and `watch`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, cast

import mujoco
import numpy as np
import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, TensorSpec, Unbounded

from aslip.envs.robot_env import RobotEnv
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE, Robot
from aslip.sim import PD, Dynamics, MakeDrive, Snapshot, true_state
from aslip.sim.checks import check_ids
from aslip.sim.dynamics import longest_delay, with_memory_of

# the exact state, for logs and replay; all else is for networks
_DOUBLE = ("qpos", "qvel")


class SimulatedEnv(RobotEnv):
    """N simulated robots under motor targets; see the module for the keys.

    Args:
        num_envs: number of robots.
        robot: the robot.
        command_size: numbers in `motor_target`; one a motor by default.
        drive: low level that `motor_target` commands.
    """

    def __init__(
        self,
        num_envs: int,
        robot: Robot = CASSIE,
        command_size: int | None = None,
        drive: MakeDrive = PD,
    ) -> None:
        self.make_drive = drive
        """Low level that `motor_target` commands."""
        self.indices = robot.indices
        self.divergences = 0
        """Simulations that diverged, and were put back on their feet, since construction."""
        self._dynamics = Dynamics(num_envs, self.model, robot)
        self.altered = False
        """A robot has had other dynamics than `model`."""
        super().__init__(num_envs, robot, command_size)

    # ----------------------------------------------- what a simulator gives

    @abstractmethod
    def _advance(self, motor_target: np.ndarray, push: np.ndarray | None) -> np.ndarray:
        """Run one policy period; return (n,) bool, who diverged.

        Args:
            motor_target: (n, 10) [rad].
            push: (n, 3) forces on the pelvis [N, world], or none.
        """

    @abstractmethod
    def _restart(self, ids: np.ndarray, qpos: np.ndarray | None, qvel: np.ndarray | None) -> None:
        """Restart (k,) simulations at (k, 35) and (k, 32), or standing."""

    @abstractmethod
    def _snapshot(self) -> Snapshot:
        """The arrays of all simulations, leading shape (n,)."""

    @abstractmethod
    def _write_fields(self, ids: np.ndarray, fields: Mapping[str, np.ndarray]) -> None:
        """Change fields (k, ...) of the models of (k,) robots."""

    @abstractmethod
    def _lengthen_memory(self, delay: float) -> None:
        """Replace `model` and all simulations by ones that can delay commands for so long [s]."""

    @property
    @abstractmethod
    def model(self) -> mujoco.MjModel:
        """The robots' model, as it is without `set_dynamics`."""

    @abstractmethod
    def states(self) -> np.ndarray:
        """(n, k) copy of all that the simulations' future depends on, between policy steps.

        `mjSTATE_INTEGRATION` first, then the sensors' memory; the same for both backends. What
        transforms remember travels in the tensordict.
        """

    @abstractmethod
    def set_states(self, states: np.ndarray) -> None:
        """Write what `states` returned, of this or another environment of the same model.

        Raises:
            ShapeError: the states are of another number or model; nothing has been written then.
        """

    @abstractmethod
    def watch(self, index: int | None) -> None:
        """Keep every substep of one robot in `watched` from now on; None for none.

        Raises:
            ConfigurationError: there is no such robot.
        """

    @property
    @abstractmethod
    def watched(self) -> np.ndarray:
        """(60, 83) substeps of the watched robot's last policy step; see `Simulations.watched`."""

    # --------------------------------------------------------------- dynamics

    @property
    def dynamics(self) -> dict[str, np.ndarray]:
        """(n,) copies of each parameter's values, by the names of `aslip.sim.DYNAMICS`."""
        return {name: values.copy() for name, values in self._dynamics.values.items()}

    @property
    def weight(self) -> np.ndarray:
        """(n,) force that carries each robot as it is, its mass, payload and slope counted [N]."""
        fields = self._dynamics.fields(np.arange(self.num_envs), ("mass", "payload", "slope"))
        return -fields["body_mass"].sum(axis=1) * fields["opt.gravity"][:, 2]

    def set_dynamics(self, values: Mapping[str, ArrayLike], ids: np.ndarray | None = None) -> None:
        """Give robots other dynamics, from the next physics step on and through resets.

        `states` does not hold them. A torque delay beyond the model's memory of commands, 4 ms, has
        all simulations moved to a model with a longer one; `states` are longer from then on.

        Args:
            values: parameter of `aslip.sim.DYNAMICS` -> one value, or one a robot.
            ids: (k,) the robots, sorted and unique; all by default.

        Raises:
            UnknownNameError: there is no such parameter.
            ShapeError: not one value a robot.
            ConfigurationError: there is no such robot; or a value is outside the limits, and
                nothing has been changed then.
        """
        everyone = np.arange(self.num_envs)
        robots = everyone if ids is None else check_ids(ids, self.num_envs)
        fields = self._dynamics.update(robots, values)
        if not fields:
            return
        self.altered = True
        delay = float(fields.get("actuator_delay", np.zeros(1)).max())
        if delay > longest_delay(self.model):
            model, states = self.model, self.states()
            self._lengthen_memory(delay)
            self._write_fields(everyone, self._dynamics.fields(everyone))
            self.set_states(with_memory_of(states, model, self.model))
        else:
            self._write_fields(robots, fields)

    # ---------------------------------------------------------------- EnvBase

    def track(self, motor_target: np.ndarray) -> np.ndarray:
        """Track motor targets without a push; see `RobotEnv.track`."""
        return self._advance(motor_target, None)

    def restart(self, robots: np.ndarray) -> None:
        """Put robots on their feet; see `RobotEnv.restart`."""
        self._restart(robots, None, None)

    def _observation_specs(self) -> dict[str, TensorSpec]:
        nobody = np.zeros(self.batch_size, dtype=bool)
        truth = {
            key: Binary(shape=value.shape, dtype=torch.bool)
            if value.dtype == torch.bool
            else Unbounded(value.shape, dtype=value.dtype)
            for key, value in self._truth(nobody).items()
        }
        return {**super()._observation_specs(), "truth": Composite(truth, shape=self.batch_size)}

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        target, push = self._checked_target(tensordict), tensordict.get("push", None)
        diverged = self._advance(target, None if push is None else self._checked_push(push))
        self.divergences += int(diverged.sum())
        return self._result(diverged)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        del kwargs
        rows = self._robots_to_reset(tensordict)
        initial: list[np.ndarray | None] = [None, None]
        if tensordict is not None:
            start = reset_request(tensordict, "initial")
            for name in start.keys() - set(_DOUBLE):
                raise UnknownNameError.among("initial state", name, _DOUBLE)
            for i, name in enumerate(_DOUBLE):
                if name in start:
                    initial[i] = self._checked_initial(name, start[name])[rows]
            self.set_dynamics(self._requested_dynamics(tensordict, rows), rows)
        self._restart(rows, *initial)
        return self._start()

    def _checked_push(self, push: Tensor) -> np.ndarray:
        """Forces on all robots, if they are such.

        Raises:
            ShapeError: wrong shape.
            ConfigurationError: not finite.
        """
        expected = (*self.batch_size, 3)
        if tuple(push.shape) != expected:
            raise ShapeError(f"push must have shape {expected}, got {tuple(push.shape)}")
        if not torch.isfinite(push).all():
            raise ConfigurationError(f"push must be finite, got {push.tolist()}")
        return push.detach().double().numpy()

    def _checked_initial(self, name: str, value: Tensor) -> np.ndarray:
        """Initial positions or velocities of all robots, if they are such.

        Raises:
            ShapeError: wrong shape.
            ConfigurationError: not finite.
        """
        expected = tuple(self.observation_spec["truth", name].shape)
        if tuple(value.shape) != expected:
            raise ShapeError(f"initial {name} must have shape {expected}, got {tuple(value.shape)}")
        if not torch.isfinite(value).all():
            row = int((~torch.isfinite(value)).any(-1).nonzero()[0])
            raise ConfigurationError(f"initial {name} of robot {row} is not finite")
        return value.double().numpy()

    def _requested_dynamics(self, tensordict: TensorDictBase, rows: np.ndarray) -> dict[str, Any]:
        """Values (k,) that a reset asks for.

        Raises:
            ShapeError: wrong shape.
        """
        expected = (*self.batch_size, 1)
        values = {}
        for name, value in reset_request(tensordict, "dynamics").items():
            if tuple(value.shape) != expected:
                raise ShapeError(f"{name} must have shape {expected}, got {tuple(value.shape)}")
            values[name] = value.detach().numpy()[rows, 0]
        return values

    def _observation(self, stopped: np.ndarray) -> dict[str, dict[str, Tensor]]:
        return {**super()._observation(stopped), "truth": self._truth(stopped)}

    def _truth(self, diverged: np.ndarray) -> dict[str, Tensor]:
        truth = {
            key: torch.tensor(value, dtype=torch.float64 if key in _DOUBLE else torch.float32)
            for key, value in true_state(self._snapshot(), self.indices).items()
        }
        truth["diverged"] = torch.tensor(diverged[:, None])
        truth["slope"] = torch.tensor(self._dynamics.values["slope"][:, None], dtype=torch.float32)
        return truth


def reset_request(tensordict: TensorDictBase, group: str) -> dict[str, Tensor]:
    """Entries of a reset's request under one key, "initial" or "dynamics", by their names.

    Raises:
        ShapeError: what stands there is not a tensordict.
    """
    entries = tensordict.get(group, None)
    if entries is None:
        return {}
    if not isinstance(entries, TensorDictBase):
        raise ShapeError(f"{group} must be a TensorDict of named entries, got {type(entries)}")
    return {str(name): cast("Tensor", value) for name, value in entries.items()}
