"""Input of the policy: 46 numbers of estimate and 18 of reference (Sec. IV-A)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, cast

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite

from aslip.transforms.base import SeededTransform, extend_spec, require_keys
from aslip.transforms.estimate import ESTIMATE_SIZES

_REFERENCE_NAMES = (
    "body_position",
    "body_velocity",
    "left_foot_position",
    "left_foot_velocity",
    "right_foot_position",
    "right_foot_velocity",
)

OBSERVATION_TABLE: Final[tuple[NestedKey, ...]] = (
    *(("estimate", name) for name in ESTIMATE_SIZES),
    *(("reference", name) for name in _REFERENCE_NAMES),
)
"""Keys of the entries of the observation, in order; see `AssembleObservation`."""

SINGLE_REFERENCE_TABLE: Final[tuple[NestedKey, ...]] = (
    *(("estimate", name) for name in ESTIMATE_SIZES),
    ("clock", "sin"),
    ("clock", "cos"),
    "command",
)
"""Keys of the 49 numbers of the single-reference method: estimate, clock and speed [m/s]."""

DIRECTION_TABLE: Final[tuple[NestedKey, ...]] = (
    *OBSERVATION_TABLE,
    ("reference", "body_heading"),
    ("reference", "left_foot_heading"),
    ("reference", "right_foot_heading"),
    "filtered_command",
    ("odometry", "path_error"),
    "last_action",
)
"""Keys of the 82 numbers for walks in all directions: the default 64, headings of the reference
[rad], filtered command, the estimated distance from the moving frame's origin [m], and the last
action [rad], with which the policy can tell how strongly the motors pull."""


def planned_table(keys: Sequence[NestedKey]) -> tuple[NestedKey, ...]:
    """Keys of an observation of robots that follow plans with a policy that has never seen one.

    The command that a plan amounts to is in the place of the filtered one, which stones may not
    allow.
    """
    return tuple(("plan", key) if key == "filtered_command" else key for key in keys)


PLANNED_TABLE: Final[tuple[NestedKey, ...]] = (*planned_table(DIRECTION_TABLE), ("plan", "step"))
"""Keys of the 87 numbers of policies that learn to follow plans: those of `planned_table`, and
where and when the next foot lands."""


class AssembleObservation(SeededTransform):
    """Concatenate entries, by default estimate and reference into `observation`.

    | index | entry | unit, frame |
    |---|---|---|
    | 0 | estimate: height | m |
    | 1-4 | orientation, wxyz | pelvis to heading frame, see `ESTIMATE_SIZES` |
    | 5-7 | velocity | m/s, heading frame |
    | 8-10 | angular velocity | rad/s, pelvis |
    | 11-13 | acceleration without gravity | m/s^2, pelvis |
    | 14-23 | motor positions | rad |
    | 24-33 | motor velocities | rad/s |
    | 34-39 | joint positions: left shin, tarsus, foot, then right | rad |
    | 40-45 | joint velocities | rad/s |
    | 46-48 | reference: body position | m, see `aslip.library.Reference` |
    | 49-51 | body velocity | m/s |
    | 52-54 | left foot position from the body | m |
    | 55-57 | left foot velocity over ground | m/s |
    | 58-60 | right foot position from the body | m |
    | 61-63 | right foot velocity over ground | m/s |

    It has neither command nor clock: speed and phase enter through the reference alone. The
    reference's feet do not move sideways, so elements 56 and 62 are always zero.

    Args:
        in_keys: keys of the entries (n, k) in order; give others for another policy input.
        out_keys: key of the concatenated entry.
    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey] = OBSERVATION_TABLE,
        *,
        out_keys: Sequence[NestedKey] = ("observation",),
    ) -> None:
        super().__init__(in_keys=in_keys, out_keys=out_keys)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(self.out_keys[0], join_entries(next_tensordict, self.in_keys))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the concatenated entry."""
        require_keys(self, observation_spec, self.in_keys)
        size = sum(observation_spec[key].shape[-1] for key in self.in_keys)
        return extend_spec(observation_spec, {self.out_keys[0]: size})


def join_entries(tensordict: TensorDictBase, keys: Sequence[NestedKey]) -> Tensor:
    """Entries (*b, k) of a tensordict, concatenated to (*b, sum of k)."""
    return torch.cat([cast("Tensor", tensordict[key]) for key in keys], dim=-1)
