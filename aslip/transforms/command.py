"""What the operator wants, and where in the stride the clock is (Fig. 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real
from typing import cast

import torch
from tensordict import TensorDictBase
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
    """Forward speed to walk at: drawn at each reset, then held, or drawn anew now and then.

    To command from outside, write `td["command"]` between steps, or pass it to `env.reset`: a speed
    of the library's range, else `SpeedOutOfRangeError` is raised. It acts on the reference that the
    policy sees next, and on rewards from the step after; the phase goes on. In a reset of some
    robots only, with a `_reset` mask, theirs are drawn anew. For another distribution override
    `draw`.

    Args:
        library: bounds the speeds.
        speeds: speeds to draw from [m/s]; all gaits of the library by default ("a reference
            trajectory is randomly selected from the reduced-order model library", Sec. IV-B).
        interval: mean time between changes within an episode [s], at any policy step with the same
            probability; infinite in the paper, where a speed is kept for an episode.

    Raises:
        SpeedOutOfRangeError: a speed is outside the library.
        ConfigurationError: there are no speeds, or the interval is shorter than a policy step.
    """

    def __init__(
        self,
        library: GaitLibrary,
        speeds: Sequence[float] | None = None,
        interval: float = math.inf,
    ) -> None:
        super().__init__(in_keys=[], out_keys=["command"])
        number = isinstance(interval, Real) and not isinstance(interval, bool)
        if not number or not interval >= CASSIE.policy_period:
            raise ConfigurationError(
                f"interval must be a policy step, {CASSIE.policy_period} s, or more,"
                f" got {interval!r}"
            )
        self.interval = interval
        self.library = library
        self._bounds = torch.tensor([library.speeds[0], library.speeds[-1]], dtype=torch.float32)
        self.speeds: Tensor
        chosen = list(library.speeds if speeds is None else speeds)
        chosen = [check_number("a speed", v, what="in m/s") for v in chosen]
        if not chosen:
            raise ConfigurationError("speeds is empty; give at least one speed in m/s")
        self.register_buffer(
            "speeds",
            torch.tensor([library.check_speed(v) for v in chosen], dtype=torch.float32),
        )

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict = self._request(tensordict)
        tensordict = self._draw_into_reset(
            tensordict, "command", self.draw((*tensordict.batch_size, 1))
        )
        return tensordict.set("command", self._checked(tensordict))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set("command", tensordict["command"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        command = self._checked(tensordict)
        if math.isfinite(self.interval):
            chance = torch.rand(command.shape, generator=self.generator)
            changes = chance < CASSIE.policy_period / self.interval
            command = torch.where(changes, self.draw((*tensordict.batch_size, 1)), command)
        return next_tensordict.set("command", command)

    def _checked(self, tensordict: TensorDictBase) -> Tensor:
        """What is commanded, if gaits for it are in the library."""
        command = checked_column(tensordict, "command")
        # bounds rounded as the command is
        outside = (command < self._bounds[0]) | (command > self._bounds[1])
        if outside.any():
            self.library.check_speed(float(command[outside][0]))
        return command

    def draw(self, shape: tuple[int, ...]) -> Tensor:
        """Speeds to command [m/s], by `self.generator`, so that seeds reach them."""
        return self.speeds[torch.randint(len(self.speeds), shape, generator=self.generator)]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add `command`."""
        return extend_spec(observation_spec, {"command": 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare `command` as something a caller may set."""
        return extend_spec(state_spec, {"command": 1})


class PhaseClock(SeededTransform):
    r"""Stride fraction in [0, 1): random at each reset, then advanced by time.

    .. math:: \phi \leftarrow (\phi + \Delta t / T(v)) \bmod 1

    Public code counts whole samples and so plays the stride 12 to 16 % too fast; sampling by time
    keeps step length, frequency and speed consistent. A change of command keeps the phase.

    Args:
        library: gives the duration T of a stride at speed v.
    """

    def __init__(self, library: GaitLibrary) -> None:
        super().__init__(in_keys=["command"], out_keys=["phase"])
        self.library = library

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        tensordict = self._request(tensordict)
        shape = (*tensordict.batch_size, 1)
        draw = torch.rand(shape, generator=self.generator, dtype=torch.float32)
        tensordict = self._draw_into_reset(tensordict, "phase", draw)
        return tensordict.set("phase", checked_column(tensordict, "phase") % 1.0)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set("phase", tensordict["phase"])

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # a caller may have written either, command also as integers
        command, phase = (checked_column(tensordict, key) for key in ("command", "phase"))
        return next_tensordict.set("phase", advance_phase(self.library, phase, command))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add `phase`."""
        return extend_spec(observation_spec, {"phase": 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare `phase` as something a caller may set."""
        return extend_spec(state_spec, {"phase": 1})


def advance_phase(
    library: GaitLibrary, phase: Tensor, command: Tensor, period: float = CASSIE.policy_period
) -> Tensor:
    """Stride fraction (*b, 1) a policy step later.

    Args:
        library: gives the duration of a stride.
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
    """Write sine and cosine of the phase under `("clock", ...)`, as inputs of a policy."""

    def __init__(self) -> None:
        super().__init__(in_keys=["phase"], out_keys=[("clock", "sin"), ("clock", "cos")])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        entries = clock_entries(cast("Tensor", next_tensordict["phase"]))
        for key, entry in zip(self.out_keys, entries.values(), strict=True):
            next_tensordict.set(key, entry)
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add sine and cosine."""
        require_keys(self, observation_spec, ["phase"])
        return extend_spec(observation_spec, {("clock", "sin"): 1, ("clock", "cos"): 1})
