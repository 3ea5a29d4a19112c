"""Clock of the stride (Fig. 2)."""

from __future__ import annotations

from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms.base import (
    ChosenAtReset,
    SeededTransform,
    checked_column,
    extend_spec,
    require_keys,
)


class PhaseClock(ChosenAtReset):
    r"""Advance the phase, the stride fraction in [0, 1), by time; draw it at each reset.

    .. math:: \phi \leftarrow (\phi + \Delta t / T(v)) \bmod 1

    The public code counts whole samples and so plays the stride 12 to 16 % too fast; sampling by
    time keeps step length, frequency and speed consistent. A change of command keeps the phase.

    Args:
        library: gaits, which give the stride duration T at command v.
        command_key: key of the command (n, c).
    """

    needs_env = "it draws phases at resets"

    def __init__(self, library: GaitLibrary, command_key: NestedKey = "command") -> None:
        super().__init__([command_key], {"phase": 1})
        self.library = library

    def _drawn(self, request: TensorDictBase) -> dict[NestedKey, Tensor]:
        return {"phase": torch.rand((*request.batch_size, 1), generator=self.generator)}

    def _accept(self, request: TensorDictBase) -> TensorDictBase:
        return request.set("phase", checked_column(request, "phase") % 1.0)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # a caller may have overwritten phase and command, even with integers
        command = checked_column(tensordict, self.in_keys[0], self.library.command_size)
        phase = checked_column(tensordict, "phase")
        return next_tensordict.set("phase", advance_phase(self.library, phase, command))


def advance_phase(library: GaitLibrary, phase: Tensor, command: Tensor) -> Tensor:
    """Stride fraction (*b, 1) a policy step later.

    Args:
        library: gaits, which give the stride duration.
        phase: (*b, 1) stride fraction.
        command: (*b, c) one value per axis of the library.
    """
    return (phase + CASSIE.policy_period / library.stride(command)) % 1.0


def clock_entries(phase: Tensor) -> dict[str, Tensor]:
    """Sine and cosine (*b, 1) of a stride fraction."""
    angle = 2 * torch.pi * phase
    return {"sin": angle.sin(), "cos": angle.cos()}


class ClockInput(SeededTransform):
    """Write sine and cosine (n, 1) of the phase, `("clock", ...)`, as inputs of a policy."""

    def __init__(self) -> None:
        super().__init__(["phase"], [("clock", "sin"), ("clock", "cos")])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for name, entry in clock_entries(cast("Tensor", next_tensordict["phase"])).items():
            next_tensordict.set(("clock", name), entry)
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add sine and cosine."""
        require_keys(self, observation_spec, self.in_keys)
        return extend_spec(observation_spec, dict.fromkeys(self.out_keys, 1))
