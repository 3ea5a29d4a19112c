"""Random commands, and a filter that limits their rate of change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.base.checks import TINY, check_number
from aslip.base.decorators import on_cpu_in_single
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms.base import (
    ChosenAtReset,
    SeededTransform,
    check_interval,
    checked_column,
    extend_spec,
    require_keys,
)

COMMAND_RATES: Final = (1.0, 0.75, 1.0)
"""Largest rates of change of a command: forward, sideways speed [m/s^2], yaw rate [rad/s^2]."""

_REDRAWS: Final = 100  # largest number of draws for a region that is no box


class RandomCommand(ChosenAtReset):
    """Draw the command at each reset, and at random times if `interval` is finite.

    The command (n, c) is forward speed, sideways speed [m/s] and yaw rate [rad/s]. To set it
    yourself, write `td["command"]` between steps, or pass it to `env.reset`. A new command changes
    the next reference that the policy sees, and the rewards from the step after; the phase does not
    jump. A partial reset (with a `_reset` mask) draws new commands for the reset robots only.
    Subclasses choose the distribution: override `draw`.

    Args:
        library: gaits, whose region bounds the command and whose c axes give its size.
        interval: mean time between changes within an episode [s]; each policy step has the same
            probability of a change. By default the command is constant in an episode.

    Raises:
        SpeedOutOfRangeError: a command is outside the region of the library.
        ConfigurationError: `interval` is shorter than a policy step.
    """

    needs_env = "it draws commands at resets"

    def __init__(self, library: GaitLibrary, interval: float = math.inf) -> None:
        super().__init__([], {"command": library.command_size})
        self.interval = check_interval(interval)
        self.library = library

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        return {"command": self.draw(self._shape(request))}

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        return request.set("command", self._checked(request))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = self._checked(tensordict)
        if math.isfinite(self.interval):
            chance = torch.rand((*tensordict.batch_size, 1), generator=self.generator)
            changes = chance < CASSIE.policy_period / self.interval
            command = torch.where(changes, self.draw(self._shape(tensordict)), command)
        return next_tensordict.set("command", command)

    def _shape(self, tensordict: TensorDictBase) -> tuple[int, ...]:
        return (*tensordict.batch_size, self.library.command_size)

    def _checked(self, tensordict: TensorDictBase) -> Tensor:
        """Command in the region of the library."""
        command = checked_column(tensordict, "command", self.library.command_size)
        outside = ~self.library.covers(command)[..., 0]
        if outside.any():
            self.library.check_command(command[outside][0].tolist())
        return command

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Random commands of the shape (*b, c), drawn by `self.generator`, which is seeded.

        Raises:
            NotImplementedError: the subclass has no distribution.
        """
        raise NotImplementedError


class SpeedCommand(RandomCommand):
    """Draw the commanded forward speed (n, 1) from a list; see `RandomCommand`.

    Args:
        library: straight gaits; the slowest and fastest one bound the command.
        speeds: speeds to draw from [m/s]; all gaits of the library by default ("a reference
            trajectory is randomly selected from the reduced-order model library", Sec. IV-B).
        interval: mean time between changes within an episode [s]; infinite in the paper.

    Raises:
        SpeedOutOfRangeError: a speed, or later a command, is outside the library's range.
        ConfigurationError: `speeds` is empty, the library has several axes, or `interval` is
            shorter than a policy step.
    """

    @on_cpu_in_single
    def __init__(
        self,
        library: GaitLibrary,
        speeds: Sequence[float] | None = None,
        interval: float = math.inf,
    ) -> None:
        super().__init__(library, interval)
        if library.command_size > 1:
            raise ConfigurationError(
                "SpeedCommand draws forward speeds only, and commands of this library have"
                f" {library.command_size} numbers; use VelocityCommand"
            )
        self.speeds: Tensor
        chosen = list(library.speeds if speeds is None else speeds)
        chosen = [check_number("a speed", v, what="in m/s") for v in chosen]
        if not chosen:
            raise ConfigurationError("speeds is empty; give at least one speed in m/s")
        self.register_buffer(
            "speeds",
            torch.tensor([library.check_command(v)[0] for v in chosen], dtype=torch.float32),
        )

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Random speeds [m/s] of the given shape, drawn by `self.generator`, which is seeded."""
        return self.speeds[torch.randint(len(self.speeds), shape, generator=self.generator)]


class VelocityCommand(RandomCommand):
    """Draw commands (n, c) uniformly over the region of the library; see `RandomCommand`.

    Some of the draws are special cases, which a uniform distribution never hits: straight ahead or
    backward, a turn on the spot, and stepping in place.

    Args:
        library: gaits over forward speed, sideways speed and yaw rate.
        interval: mean time between changes within an episode [s].
        straight: share of commands without sideways speed and yaw rate.
        turning: share of commands with a yaw rate only.
        in_place: share of zero commands.

    Raises:
        SpeedOutOfRangeError: a share is positive and the zero command is outside the region; later,
            if a command is outside the region.
        ConfigurationError: a share is negative, their sum exceeds 1, or `interval` is shorter than
            a policy step.
    """

    @on_cpu_in_single
    def __init__(
        self,
        library: GaitLibrary,
        interval: float = math.inf,
        *,
        straight: float = 0.2,
        turning: float = 0.1,
        in_place: float = 0.05,
    ) -> None:
        super().__init__(library, interval)
        shares = {"straight": straight, "turning": turning, "in_place": in_place}
        shares = {name: check_number(name, share, 0, 1) for name, share in shares.items()}
        self.straight, self.turning, self.in_place = shares.values()
        if sum(shares.values()) > 1 + 1e-9:
            raise ConfigurationError(f"shares of commands must add up to at most 1, got {shares}")
        if any(shares.values()):
            library.check_command([0.0] * library.command_size)
        ends = [(axis[0], axis[-1]) for axis in library.table.axes]
        self._low, self._high = torch.tensor(ends, dtype=torch.float32).T

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Random commands of the shape (*b, c), drawn by `self.generator`, which is seeded."""
        kept = self._kept(shape)
        command = self._within_box(shape, kept)
        for _ in range(_REDRAWS):
            outside = ~self.library.covers(command)
            if not outside.any():
                return command
            command = torch.where(outside, self._within_box(shape, kept), command)
        return self.library.nearest(command)

    def _kept(self, shape: tuple[int, ...]) -> Tensor:
        """Mask (*b, c) of the components that are not zero."""
        moves = [[1, 1, 1], [1, 0, 0], [0, 0, 1], [0, 0, 0]]
        ends = torch.tensor([self.straight, self.turning, self.in_place]).cumsum(0)
        chance = torch.rand((*shape[:-1], 1), generator=self.generator)
        kind = (chance < ends).sum(-1)  # 0: any, 1: in place, 2: turning, 3: straight
        return torch.tensor(moves)[-kind][..., : shape[-1]]

    def _within_box(self, shape: tuple[int, ...], kept: Tensor) -> Tensor:
        share = torch.rand(shape, generator=self.generator)
        return (self._low + share * (self._high - self._low)) * kept


class CommandFilter(SeededTransform):
    """Limit the rate of the command that clock, reference and path follow.

    When the command jumps, the reference does not. `filtered_command` (n, c) starts at the command,
    and moves straight towards it, so it stays in a convex region. `command` stays as the caller
    wrote it.

    Args:
        rates: largest change of forward speed, sideways speed [m/s^2] and yaw rate [rad/s^2].

    Raises:
        ConfigurationError: a rate is not a positive finite number.
    """

    _reads: tuple[NestedKey, ...] = ("command",)

    def __init__(self, rates: Sequence[float] = COMMAND_RATES) -> None:
        super().__init__(self._reads, ["filtered_command"])
        self.rates = checked_rates(rates)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        del tensordict
        return tensordict_reset.set(self.out_keys[0], tensordict_reset[self.in_keys[0]].clone())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        past = cast("Tensor", tensordict[self.out_keys[0]])
        command = self._aim(tensordict, cast("Tensor", next_tensordict[self.in_keys[0]]))
        following = approach_command(past, command, self._rates(tensordict))
        return next_tensordict.set(self.out_keys[0], following)

    def _rates(self, tensordict: TensorDictBase) -> Sequence[float] | Tensor:
        """Largest rates of each component, for all robots or (n, 3)."""
        del tensordict
        return self.rates

    def _aim(self, tensordict: TensorDictBase, command: Tensor) -> Tensor:
        """Command (n, c) that is approached."""
        del tensordict
        return command

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the filtered command."""
        require_keys(self, observation_spec, self.in_keys[:1])
        size = observation_spec[self.in_keys[0]].shape[-1]
        if size > len(self.rates):
            raise ConfigurationError(
                f"rates must have a number for each of the {size} components of a command, got"
                f" {self.rates}"
            )
        return extend_spec(observation_spec, {self.out_keys[0]: size})


def checked_rates(rates: Sequence[float]) -> tuple[float, ...]:
    """Check the largest rates of a command's components, and convert them to floats.

    Raises:
        ConfigurationError: a rate is not a positive finite number.
    """
    return tuple(check_number("a rate", rate, TINY, what="per s^2") for rate in rates)


def approach_command(past: Tensor, command: Tensor, rates: Sequence[float] | Tensor) -> Tensor:
    """Filtered command (*b, c) a policy step later, on the straight line to the command.

    Args:
        past: (*b, c) filtered command.
        command: (*b, c) command to approach.
        rates: largest rate of each component, for all or (*b, c or more) [m/s^2, rad/s^2].
    """
    change = command - past
    rates = torch.as_tensor(rates, dtype=change.dtype)
    limit = CASSIE.policy_period * rates[..., : change.shape[-1]]
    steps = (change.abs() / limit).amax(-1, keepdim=True)
    return torch.where(steps <= 1, command, past + change / steps.clamp(min=1))
