"""Commanded speed, and the clock of the stride (Fig. 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms.base import (
    SeededTransform,
    check_number,
    checked_column,
    extend_spec,
    require_keys,
)


class SpeedCommand(SeededTransform):
    """Draw the commanded forward speed at each reset, and at random times if `interval` is finite.

    To set the command yourself, write `td["command"]` between steps, or pass it to `env.reset`. A
    new command changes the next reference that the policy sees, and the rewards from the step
    after; the phase does not jump. A partial reset (with a `_reset` mask) draws new commands for
    the reset robots only. Override `draw` for another distribution.

    Args:
        library: gaits; its slowest and fastest gait bound the command.
        speeds: speeds to draw from [m/s]; all gaits of the library by default ("a reference
            trajectory is randomly selected from the reduced-order model library", Sec. IV-B).
        interval: mean time between changes within an episode [s]; each policy step has the same
            probability of a change. Infinite in the paper: the speed is constant in an episode.
        out_keys: key of the command (n, 1) [m/s].
        period: duration of a policy step [s].

    Raises:
        SpeedOutOfRangeError: a speed, or later a command, is outside the library's range.
        ConfigurationError: `speeds` is empty, or `interval` is shorter than a policy step.
    """

    num_in_keys, num_out_keys = 0, 1
    needs_env = "it draws commands at resets"

    def __init__(
        self,
        library: GaitLibrary,
        speeds: Sequence[float] | None = None,
        interval: float = math.inf,
        *,
        out_keys: Sequence[NestedKey] = ("command",),
        period: float = CASSIE.policy_period,
    ) -> None:
        super().__init__(in_keys=[], out_keys=out_keys)
        number = isinstance(interval, Real) and not isinstance(interval, bool)
        if not number or not interval >= period:
            raise ConfigurationError(
                f"interval must be at least one policy step, {period} s, got {interval!r}"
            )
        self.interval, self._period = interval, period
        self.library = library
        self._bounds = torch.tensor([library.speeds[0], library.speeds[-1]], dtype=torch.float32)
        self.speeds: Tensor
        chosen = list(library.speeds if speeds is None else speeds)
        chosen = [check_number("a speed", v, what="in m/s") for v in chosen]
        if not chosen:
            raise ConfigurationError("speeds is empty; give at least one speed in m/s")
        self.register_buffer(
            "speeds",
            torch.tensor([library.check_command(v)[0] for v in chosen], dtype=torch.float32),
        )

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict = self._request(tensordict)
        draw = self.draw((*tensordict.batch_size, 1))
        tensordict = self._draw_into_reset(tensordict, self.out_keys[0], draw)
        return tensordict.set(self.out_keys[0], self._checked(tensordict))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set(self.out_keys[0], tensordict[self.out_keys[0]])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = self._checked(tensordict)
        if math.isfinite(self.interval):
            chance = torch.rand(command.shape, generator=self.generator)
            changes = chance < self._period / self.interval
            command = torch.where(changes, self.draw((*tensordict.batch_size, 1)), command)
        return next_tensordict.set(self.out_keys[0], command)

    def _checked(self, tensordict: TensorDictBase) -> Tensor:
        """Command within the range of the library."""
        command = checked_column(tensordict, self.out_keys[0])
        # the bounds are in single precision, as the command is
        outside = (command < self._bounds[0]) | (command > self._bounds[1])
        if outside.any():
            self.library.check_command(float(command[outside][0]))
        return command

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Random speeds [m/s] of the given shape, drawn by `self.generator`, which is seeded."""
        return self.speeds[torch.randint(len(self.speeds), shape, generator=self.generator)]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the command."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the command as an entry that a caller may set."""
        return extend_spec(state_spec, {self.out_keys[0]: 1})


class PhaseClock(SeededTransform):
    r"""Advance the phase, the stride fraction in [0, 1), by time; draw it at each reset.

    .. math:: \phi \leftarrow (\phi + \Delta t / T(v)) \bmod 1

    The public code counts whole samples and so plays the stride 12 to 16 % too fast; sampling by
    time keeps step length, frequency and speed consistent. A change of command keeps the phase.

    Args:
        library: gaits, which give the stride duration T at speed v.
        in_keys: key of the command (n, 1) [m/s].
        out_keys: key of the phase (n, 1).
        period: duration of a policy step [s].
    """

    num_in_keys, num_out_keys = 1, 1
    needs_env = "it draws phases at resets"

    def __init__(
        self,
        library: GaitLibrary,
        *,
        in_keys: Sequence[NestedKey] = ("command",),
        out_keys: Sequence[NestedKey] = ("phase",),
        period: float = CASSIE.policy_period,
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.library = library
        self._period = period

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict = self._request(tensordict)
        shape = (*tensordict.batch_size, 1)
        draw = torch.rand(shape, generator=self.generator, dtype=torch.float32)
        key = self.out_keys[0]
        tensordict = self._draw_into_reset(tensordict, key, draw)
        return tensordict.set(key, checked_column(tensordict, key) % 1.0)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set(self.out_keys[0], tensordict[self.out_keys[0]])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # a caller may have overwritten both, the command even with integers
        keys = (*self.in_keys, *self.out_keys)
        command, phase = (checked_column(tensordict, key) for key in keys)
        following = advance_phase(self.library, phase, command, self._period)
        return next_tensordict.set(self.out_keys[0], following)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the phase."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the phase as an entry that a caller may set."""
        return extend_spec(state_spec, {self.out_keys[0]: 1})


def advance_phase(
    library: GaitLibrary, phase: Tensor, command: Tensor, period: float = CASSIE.policy_period
) -> Tensor:
    """Stride fraction (*b, 1) a policy step later.

    Args:
        library: gaits, which give the stride duration.
        phase: (*b, 1) stride fraction.
        command: (*b, 1) forward speed [m/s].
        period: duration of a policy step [s].
    """
    return (phase + period / library.stride(command)) % 1.0


def clock_entries(phase: Tensor) -> dict[str, Tensor]:
    """Sine and cosine (*b, 1) of a stride fraction."""
    angle = 2 * torch.pi * phase
    return {"sin": angle.sin(), "cos": angle.cos()}


class ClockInput(SeededTransform):
    """Write sine and cosine of the phase, as inputs of a policy.

    Args:
        in_keys: key of the phase (n, 1).
        out_keys: keys of sine and cosine (n, 1).
    """

    num_in_keys, num_out_keys = 1, 2

    def __init__(
        self,
        *,
        in_keys: Sequence[NestedKey] = ("phase",),
        out_keys: Sequence[NestedKey] = (("clock", "sin"), ("clock", "cos")),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        entries = clock_entries(cast("Tensor", next_tensordict[self.in_keys[0]]))
        for key, entry in zip(self.out_keys, entries.values(), strict=True):
            next_tensordict.set(key, entry)
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add sine and cosine."""
        require_keys(self, observation_spec, self.in_keys)
        return extend_spec(observation_spec, dict.fromkeys(self.out_keys, 1))
