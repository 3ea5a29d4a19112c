"""Interactive control of one robot: commands, pushes and policy steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from aslip.base.decorators import on_cpu_in_single
from aslip.envs import EPISODE_ENDS, StackEnv, library_of, make_env, shipped_library
from aslip.errors import ConfigurationError, ShapeError
from aslip.library import Command, GaitLibrary, numbers
from aslip.library.footholds import yaw_rotation
from aslip.policy import (
    add_memory,
    check_policy_fits,
    forget,
    load_policy,
    policy_environment,
    policy_library,
)
from aslip.robot import CASSIE
from aslip.transforms.stones import COURSE_KEY
from aslip.walking.push import policy_steps
from aslip.walking.record import can_stand, next_start, reset_walks, take_step


def command_library(
    policy: TensorDictModuleBase | str | Path, library: GaitLibrary | None = None
) -> GaitLibrary:
    """Library over the commands of a policy; see `aslip.policy.policy_library`.

    A module without one counts as one that walks straight on the paper's gaits. The
    single-reference baseline, which scales one motion, has the speeds of these, too.

    Raises:
        AssetError, FileDamagedError: the policy does not exist, or its file is damaged.
        ConfigurationError: the policy follows other gaits.
    """
    if isinstance(policy, str | Path):
        library = policy_library(policy, library)
    if library is None or library.name == "single_reference":
        return shipped_library("gaits")
    return library


def _library_of(env: StackEnv, policy: TensorDictModuleBase | str | Path) -> GaitLibrary:
    """Library of an environment's clock; of its policy for one without a clock."""
    try:
        return library_of(env)
    except ConfigurationError:
        return command_library(policy)


class Walker:
    """One robot that walks until it falls.

    Args:
        policy: module that maps the environment's tensordict to `action`, or name or path for
            `load_policy`.
        env: environment of one robot. By default the policy's stack, with falls as the
            only end of an episode.
        library: gaits of the default environment, and the range of commands; by default those that
            `aslip.policy.policy_library` finds, or those of `env`.
        seed: seed of the default environment, by default its own.
        speed: first command: forward speed [m/s], or a number for each axis of the library.
        stand: first stand command.

    Raises:
        ConfigurationError: the environment has several robots, another observation or action
            baseline than the policy's card, or a robot that is to stand and cannot.
        SpeedOutOfRangeError: the library does not cover the command.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase | str | Path = "directions",
        env: StackEnv | None = None,
        *,
        library: GaitLibrary | None = None,
        seed: int | None = None,
        speed: Command | Sequence[float] = 0.0,
        stand: bool = False,
    ) -> None:
        if env is None:
            named = isinstance(policy, str | Path)
            made: dict[str, Any] = {"library": library}
            made = policy_environment(policy, library) if named else made
            env = make_env(seed=seed, drop=EPISODE_ENDS, num_threads=1, **made)
            library = command_library(policy, made["library"])
        self.library = _library_of(env, policy) if library is None else library
        if env.num_envs != 1:
            raise ConfigurationError(f"env of a Walker must have one robot, got {env.num_envs}")
        self.env = env
        self.policy = policy
        self.reset(speed, stand)

    @property
    def policy(self) -> TensorDictModuleBase:
        """Current policy; assign a module, name or path at any time. It begins without memory."""
        return self._policy

    @policy.setter
    def policy(self, policy: TensorDictModuleBase | str | Path) -> None:
        check_policy_fits(policy, self.env)
        if isinstance(policy, str | Path):
            policy = load_policy(policy)
        add_memory(self.env, policy)
        if hasattr(self, "_policy"):
            self.td = forget(self.td, policy)
        self._policy = policy

    @property
    def command(self) -> Command:
        """Commanded forward speed [m/s]; assign to change it.

        With a library of several axes, a number for each: forward, sideways speed [m/s], yaw rate
        [rad/s]. A number alone is a forward speed.
        """
        values = tuple(cast("torch.Tensor", self.td["command"])[0].tolist())
        return values[0] if len(values) == 1 else values

    @command.setter
    @on_cpu_in_single
    def command(self, command: Command | Sequence[float]) -> None:
        self.td["command"] = torch.tensor([self._checked(command)])

    @property
    def can_stand(self) -> bool:
        """True if the robot stands on command; see `stand`."""
        return can_stand(self.env)

    @property
    def stand(self) -> bool:
        """Stand command; assign to change it. False for robots that cannot stand.

        The robot slows down, stops at a touchdown and stands, until it is to walk again.

        Raises:
            ConfigurationError: at assignment of True, the robot cannot stand.
        """
        return self.can_stand and bool(self.td["stand"] > 0.5)

    @stand.setter
    @on_cpu_in_single
    def stand(self, stand: bool) -> None:
        if self.can_stand:
            self.td["stand"] = torch.tensor([[float(stand)]])
        elif stand:
            raise ConfigurationError(
                "the robot cannot stand; it needs a policy of the stack 'standing'"
            )

    @property
    def stones(self) -> np.ndarray | None:
        """(s, 6) stones of its course, by the columns of `aslip.sim.course.STONE`; None without.

        Assign as many to move, take away (NaN) or add some while it walks, until the next reset.

        Raises:
            ShapeError, ConfigurationError: at assignment, they have another shape, or are no
                stones; see `SimulatedEnv.set_stones`.
        """
        stones = self.td.get(COURSE_KEY, None)
        return None if stones is None else stones[0].double().numpy()

    @stones.setter
    @on_cpu_in_single
    def stones(self, stones: np.ndarray) -> None:
        if COURSE_KEY not in self.td.keys(True):
            raise ConfigurationError("the robot is on no course; make its stack by `course_stack`")
        # a copy, which does not follow the caller's array
        placed = torch.tensor(stones, dtype=torch.float32)[None]
        if placed.shape != self.td[COURSE_KEY].shape:
            expected = tuple(self.td[COURSE_KEY].shape[1:])
            raise ShapeError(f"stones must have shape {expected}, got {tuple(placed.shape[1:])}")
        self.env.base_env.set_stones(placed.double().numpy())
        self.td[COURSE_KEY] = placed

    def _checked(self, command: Command | Sequence[float]) -> tuple[float, ...]:
        size = self.library.command_size
        if size > 1 and np.ndim(command) == 0:
            command = (cast("float", command), *(0.0,) * (size - 1))
        return self.library.check_command(command)

    @on_cpu_in_single
    def push(self, force: Sequence[float], duration: float = 4 * CASSIE.policy_period) -> None:
        """Push the pelvis from the next policy step on; replaces the current push.

        Args:
            force: (3,) force [N]: to the front of the robot as it is now, to its left, and up.
            duration: duration [s], rounded up to policy steps.

        Raises:
            ConfigurationError: the force is not three finite numbers, or the duration not positive.
        """
        vector = np.array(force, dtype=np.float64)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise ConfigurationError(f"a push needs three finite forces [N], got {force!r}")
        if not 0 < duration < math.inf:
            raise ConfigurationError(f"a push needs a positive duration [s], got {duration!r}")
        orientation = cast("torch.Tensor", self.td["truth", "pelvis_orientation"])[0]
        turned = yaw_rotation(orientation.numpy()) @ vector
        self._push = torch.from_numpy(turned).float()[None]
        self._push_steps = policy_steps(duration)

    @on_cpu_in_single
    def reset(self, speed: Command | Sequence[float] | None = None, stand: bool = False) -> None:
        """Start again on the reference at phase 0, or standing.

        Args:
            speed: command; by default the current one.
            stand: stand command.

        Raises:
            SpeedOutOfRangeError: the library does not cover the command.
            ConfigurationError: the robot is to stand and cannot.
        """
        command = numbers(self.command) if speed is None else self._checked(speed)
        self.td: TensorDictBase = reset_walks(self.env, np.array([command]), stand=float(stand))
        """Current tensordict, input of the next policy step."""
        self.steps = 0
        """Policy steps since the last reset."""
        self.fallen = False
        """True after a step that ended in a fall or a diverged simulation."""
        self._push, self._push_steps = torch.zeros(1, 3), 0

    @property
    def time(self) -> float:
        """Time since the last reset [s]."""
        return self.steps * CASSIE.policy_period

    def step(self) -> TensorDictBase:
        """Take one policy step.

        Returns:
            The step, with its outcome under `"next"`.

        Raises:
            ConfigurationError: the robot has fallen; reset it.
        """
        if self.fallen:
            raise ConfigurationError("the robot has fallen; call reset() before the next step")
        if self._push_steps > 0:
            self.td["push"] = self._push
            self._push_steps -= 1
        td = take_step(self._policy, self.env, self.td)
        self.steps += 1
        self.fallen = bool(td["next", "terminated"])
        self.td = next_start(td)
        return td
