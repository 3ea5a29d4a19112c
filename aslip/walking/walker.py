"""One robot under a policy, a policy step at a time: commands, pushes, and what came of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from aslip.envs import EPISODE_ENDS, StackEnv, check_policy_fits, make_env
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import load_policy, policy_stack
from aslip.robot import POLICY_PERIOD


@dataclass(frozen=True)
class Schedule:
    """Commanded speeds over time: each holds until the next begins."""

    times: tuple[float, ...]
    """When each begins [s], ascending from 0."""
    speeds: tuple[float, ...]
    """[m/s]."""

    def __post_init__(self) -> None:
        """Check that the times are an order of events.

        Raises:
            ConfigurationError: they do not start at 0 or do not increase, or a number is not
                finite, or there are not as many speeds.
        """
        given = f"times {self.times} and speeds {self.speeds}"
        if not self.times or len(self.times) != len(self.speeds):
            raise ConfigurationError(f"a schedule needs as many times as speeds, got {given}")
        if not all(map(math.isfinite, self.times + self.speeds)):
            raise ConfigurationError(f"a schedule must be of finite numbers, got {given}")
        if self.times[0] != 0 or any(np.diff(self.times) <= 0):
            raise ConfigurationError(f"times must increase from 0, got {given}")

    @classmethod
    def parse(cls, text: str) -> Schedule:
        """Read "time:speed,time:speed,...", or one speed for all time.

        Raises:
            ConfigurationError: the text is something else.
        """
        try:
            if ":" not in text:
                return cls((0.0,), (float(text),))
            pairs = [entry.split(":") for entry in text.split(",")]
            times, speeds = zip(*((float(at), float(to)) for at, to in pairs), strict=True)
        except ValueError as error:
            if isinstance(error, ConfigurationError):
                raise
            raise ConfigurationError(
                f'a schedule is "time:speed,..." such as "0:0.0,4:1.0,8:0.5", got {text!r}'
            ) from None
        return cls(times, speeds)

    def at(self, time: float) -> float:
        """The speed commanded at a time [m/s]."""
        # half a substep of tolerance: policy steps add up to 3.9999999 s
        return self.speeds[int(np.searchsorted(self.times, time + 2.5e-4, side="right")) - 1]


def policy_steps(time: float) -> int:
    """Policy steps that a time [s] takes, the last one begun."""
    return math.ceil(time / POLICY_PERIOD - 1e-9)


@dataclass(frozen=True)
class Push:
    """A force on the pelvis for a while."""

    time: float
    """When it begins [s]."""
    force: tuple[float, float, float]
    """[N, world]."""
    duration: float = 4 * POLICY_PERIOD
    """[s]; rounded up to whole policy steps."""

    @classmethod
    def parse(cls, text: str) -> Push:
        """Read "time:x,y,z" or "time:x,y,z:duration".

        Raises:
            ConfigurationError: the text is something else.
        """
        try:
            time, force, *duration = text.split(":")
            x, y, z = map(float, force.split(","))
            push = cls(float(time), (x, y, z), *map(float, duration))
        except (ValueError, TypeError):
            push = None
        numbers = () if push is None else (push.time, *push.force, push.duration)
        if push is None or not all(map(math.isfinite, numbers)) or push.duration <= 0:
            raise ConfigurationError(
                f'a push is "time:x,y,z" or "time:x,y,z:duration" in s and N, got {text!r}'
            )
        return push


class Walker:
    """One robot that walks until it falls.

    Args:
        policy: what maps the environment's tensordict to `action`, or what `load_policy` takes.
        env: environment of one robot; by default the policy's stack without an end of episodes but
            falls.
        library: the gaits, of the default stack and for the range of commands.
        seed: of the default environment.
        speed: first command [m/s].

    Raises:
        ConfigurationError: the environment has another number of robots, or shows the policy
            another observation or adds its action to something else than in its training.
        SpeedOutOfRangeError: the library does not cover the speed.
    """

    def __init__(
        self,
        policy: TensorDictModuleBase | str | Path = "aslip",
        env: StackEnv | None = None,
        *,
        library: GaitLibrary | None = None,
        seed: int = 0,
        speed: float = 0.0,
    ) -> None:
        self.library = GaitLibrary.load() if library is None else library
        if env is None:
            stack = policy_stack(policy) if isinstance(policy, str | Path) else "aslip"
            gaits = None if stack == "single_reference" else self.library
            env = make_env(seed=seed, stack=stack, drop=EPISODE_ENDS, library=gaits, num_threads=1)
        if env.num_envs != 1:
            raise ConfigurationError(f"a walker is one robot, the environment has {env.num_envs}")
        self.env = env
        self.policy = policy
        self.reset(speed)

    @property
    def policy(self) -> TensorDictModuleBase:
        """What acts; a name or path may be assigned at any time."""
        return self._policy

    @policy.setter
    def policy(self, policy: TensorDictModuleBase | str | Path) -> None:
        if isinstance(policy, str | Path):
            check_policy_fits(policy, self.env)
            policy = load_policy(policy)
        self._policy = policy

    @property
    def command(self) -> float:
        """Commanded forward speed [m/s]; assign to change it."""
        return float(self.td["command"])

    @command.setter
    def command(self, speed: float) -> None:
        self.td["command"] = torch.full((1, 1), self.library.check_speed(speed))

    def push(self, force: Sequence[float], duration: float = 4 * POLICY_PERIOD) -> None:
        """Push the pelvis from the next policy step on, in place of any push there is.

        Args:
            force: (3,) [N, world].
            duration: [s], rounded up to policy steps.

        Raises:
            ConfigurationError: the force is not three finite numbers, or the duration not positive.
        """
        vector = torch.tensor(np.array(force, dtype=np.float64)).float()
        if vector.shape != (3,) or not torch.isfinite(vector).all():
            raise ConfigurationError(f"a push is three finite forces [N], got {force!r}")
        if not 0 < duration < math.inf:
            raise ConfigurationError(f"a push takes a positive time [s], got {duration!r}")
        self._push, self._push_steps = vector[None], policy_steps(duration)

    def reset(self, speed: float | None = None) -> None:
        """Start again on the reference at phase 0.

        Args:
            speed: command [m/s]; the present one by default.

        Raises:
            SpeedOutOfRangeError: the library does not cover the speed.
        """
        speed = self.command if speed is None else self.library.check_speed(speed)
        start = TensorDict(command=torch.full((1, 1), speed), phase=torch.zeros(1, 1), batch_size=1)
        self.td: TensorDictBase = self.env.reset(start)
        """The present: what the next action will be chosen from."""
        self.steps = 0
        """Policy steps since the last reset."""
        self.fallen = False
        """Whether the last step ended on the ground, or in a simulation that diverged."""
        self._push, self._push_steps = torch.zeros(1, 3), 0

    @property
    def time(self) -> float:
        """Since the last reset [s]."""
        return self.steps * POLICY_PERIOD

    @torch.no_grad()
    def step(self) -> TensorDictBase:
        """Walk for one policy step.

        Returns:
            The step, with the outcome under `"next"`.

        Raises:
            ConfigurationError: the robot has fallen; reset it.
        """
        if self.fallen:
            raise ConfigurationError("the robot has fallen; call reset() before the next step")
        td = self.td
        if self._push_steps > 0:
            td["push"] = self._push
            self._push_steps -= 1
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            td = self.env.step(self._policy(td))
        self.steps += 1
        self.fallen = bool(td["next", "terminated"])
        # TorchRL would carry the push on
        self.td = step_mdp(td).exclude("push")
        return td
