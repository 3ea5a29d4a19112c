"""Interface of robots: motor targets in, sensor packets out.

A real robot, a replayed log and a simulator are each a `RobotEnv`. Keys for n robots, with shapes
that omit the leading n:

| key | shape | meaning |
|---|---|---|
| `motor_target` | 10 | action: joint angles that PD loops track for 30 ms [rad] |
| `("sensors", name)` | W, k | packets of the last policy period, oldest first |
| `reward` | 1 | zero; transforms write rewards |
| `terminated`, `done` | 1 | the robot has stopped; transforms set all other ends |

`Robot.packet_sizes` has the names and sizes k of a packet's entries, `Robot.sensor_window` the
number W of packets. `SimulatedEnv` adds the true state, pushes and dynamics.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from aslip.base.arrays import Array
from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE, Robot


class RobotEnv(EnvBase):
    """N robots that track motor targets; the module lists the keys.

    A subclass implements `track`, `restart` and `packets`. `make_env(base=...)` puts a stack of
    transforms around it.

    Args:
        num_envs: number of robots.
        robot: robot model, `CASSIE` by default.
        command_size: size of a robot's `motor_target`; the number of motors by default.
    """

    place = torch.device("cpu")
    """Device of all entries."""

    @on_cpu_in_single
    def __init__(
        self, num_envs: int = 1, robot: Robot = CASSIE, command_size: int | None = None
    ) -> None:
        super().__init__(device=self.place, batch_size=torch.Size([num_envs]))
        self.robot = robot
        self.command_size = len(robot.motor_names) if command_size is None else command_size
        """Size of a robot's `motor_target`."""
        self._set_specs()

    @property
    def num_envs(self) -> int:
        """Number of robots."""
        return self.batch_size[0]

    # ------------------------------------------------- methods of a subclass

    @abstractmethod
    def track(self, motor_target: np.ndarray) -> np.ndarray:
        """Track motor targets for one policy period, 30 ms.

        Args:
            motor_target: (n, 10) [rad].

        Returns:
            (n,) bool, True for a robot that has stopped, which ends its episode.
        """

    @abstractmethod
    def restart(self, robots: np.ndarray) -> None:
        """Start new episodes of some robots.

        Args:
            robots: (k,) sorted indices.
        """

    @abstractmethod
    def packets(self) -> Mapping[str, np.ndarray]:
        """Packets of the last policy period: name of an entry -> (n, W, k)."""

    # ---------------------------------------------------------------- EnvBase

    def _set_specs(self) -> None:
        n = self.batch_size
        self.observation_spec = Composite(self._observation_specs(), shape=n)
        targets, single = torch.Size((*n, self.command_size)), torch.Size((*n, 1))
        self.action_spec = Composite(motor_target=Unbounded(targets, dtype=torch.float32), shape=n)
        self.reward_spec = Unbounded(single, dtype=torch.float32)
        flag = Binary(shape=single, dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), shape=n)

    def _observation_specs(self) -> dict[str, TensorSpec]:
        n = self.batch_size
        entries = {
            name: Unbounded(torch.Size((*n, self.robot.sensor_window, size)), dtype=torch.float32)
            for name, size in self.robot.packet_sizes.items()
        }
        return {"sensors": Composite(entries, shape=n)}

    @on_cpu_in_single
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        _refuse_requests(tensordict, ["push"])
        return self._result(self.track(self._checked_target(tensordict)))

    @on_cpu_in_single
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: object) -> TensorDictBase:
        del kwargs
        _refuse_requests(tensordict, ["initial", "dynamics", "course"])
        self.restart(self._robots_to_reset(tensordict))
        return self._start()

    def _set_seed(self, seed: int | None) -> None:
        """Do nothing: only transforms draw random numbers."""

    def _taken(self, value: Tensor) -> Array:
        """Numbers of an entry for the robots, in double precision."""
        return value.detach().double().numpy()

    def _given(self, value: Array, dtype: torch.dtype = torch.float32) -> Tensor:
        """Entry with numbers of the robots, a copy."""
        return torch.tensor(value, dtype=dtype)

    def _robots_to_reset(self, tensordict: TensorDictBase | None) -> Array:
        """(k,) indices of the robots that the mask `_reset` names; all without a mask."""
        mask = None if tensordict is None else tensordict.get("_reset", None)
        return np.arange(self.num_envs) if mask is None else np.flatnonzero(mask.numpy())

    def _checked_target(self, tensordict: TensorDictBase) -> Array:
        """(n, 10) motor targets in double precision.

        Raises:
            ShapeError: `motor_target` has the wrong shape.
        """
        expected = (*self.batch_size, self.command_size)
        target = cast("Tensor", tensordict["motor_target"])
        check_entry("motor_target", target, expected, finite=False)
        return self._taken(target)

    def _result(self, stopped: Array) -> TensorDict:
        """Entries after a step."""
        terminated = self._given(stopped, torch.bool)[:, None]
        return TensorDict(
            {
                **self._observation(stopped),
                "reward": torch.zeros(*self.batch_size, 1, dtype=torch.float32),
                "terminated": terminated,
                "done": terminated.clone(),
            },
            batch_size=self.batch_size,
        )

    def _start(self) -> TensorDict:
        """Entries after a reset."""
        none = np.zeros(self.num_envs, dtype=bool)
        return TensorDict(self._observation(none), batch_size=self.batch_size)

    def _observation(self, stopped: Array) -> dict[str, dict[str, Tensor]]:
        """Groups of the observed entries.

        Raises:
            ShapeError: `packets` lacks an entry or returns one of the wrong shape.
        """
        del stopped
        sensors, packets = {}, self.packets()
        for name, size in self.robot.packet_sizes.items():
            expected = (self.num_envs, self.robot.sensor_window, size)
            value = packets.get(name)
            shape = None if value is None else tuple(np.shape(value))
            if shape != expected:
                raise ShapeError(f"packets of {name!r} must have shape {expected}, got {shape}")
            sensors[name] = self._given(value)
        return {"sensors": sensors}

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Refuse copying and pickling; worker processes need a function that makes the environment.

        Raises:
            ConfigurationError: always.
        """
        raise ConfigurationError(
            "an environment is a running robot or simulation and cannot be copied or pickled; give"
            " ParallelEnv, EnvCreator and collectors a function that makes it, such as"
            f" functools.partial(aslip.make_env, num_envs={self.batch_size.numel()})"
        )


def check_entry(
    name: str, value: Tensor, expected: tuple[int, ...], *, finite: bool = True
) -> None:
    """Check an entry of a tensordict.

    Raises:
        ShapeError: the entry has another shape than `expected`.
        ConfigurationError: a number is not finite, if `finite` is true.
    """
    if tuple(value.shape) != expected:
        raise ShapeError(f"{name} must have shape {expected}, got {tuple(value.shape)}")
    if finite and not torch.isfinite(value).all():
        raise ConfigurationError(f"{name} must be finite, got {value.tolist()}")


def _refuse_requests(tensordict: TensorDictBase | None, keys: Sequence[str]) -> None:
    """Refuse entries that only a simulation can apply.

    Raises:
        ConfigurationError: the tensordict has one of the keys.
    """
    for key in keys:
        if tensordict is not None and key in tensordict:
            raise ConfigurationError(f"{key!r} is for simulated robots; remove it")
