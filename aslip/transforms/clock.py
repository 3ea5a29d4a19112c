"""Clock of the stride (Fig. 2)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms.base import SeededTransform, checked_column, extend_spec, require_keys


class PhaseClock(SeededTransform):
    r"""Advance the phase, the stride fraction in [0, 1), by time; draw it at each reset.

    .. math:: \phi \leftarrow (\phi + \Delta t / T(v)) \bmod 1

    The public code counts whole samples and so plays the stride 12 to 16 % too fast; sampling by
    time keeps step length, frequency and speed consistent. A change of command keeps the phase.

    Args:
        library: gaits, which give the stride duration T at command v.
        in_keys: key of the command (n, c).
        out_keys: key of the phase (n, 1).
    """

    num_in_keys, num_out_keys = 1, 1
    needs_env = "it draws phases at resets"

    def __init__(
        self,
        library: GaitLibrary,
        *,
        in_keys: Sequence[NestedKey] = ("command",),
        out_keys: Sequence[NestedKey] = ("phase",),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.library = library

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
        # a caller may have overwritten phase and command, even with integers
        command = checked_column(tensordict, self.in_keys[0], self.library.command_size)
        phase = checked_column(tensordict, self.out_keys[0])
        following = advance_phase(self.library, phase, command)
        return next_tensordict.set(self.out_keys[0], following)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the phase."""
        return extend_spec(observation_spec, {self.out_keys[0]: 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the phase as an entry that a caller may set."""
        return extend_spec(state_spec, {self.out_keys[0]: 1})


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
