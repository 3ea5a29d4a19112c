"""Heading frame: x axis straight ahead, z axis up; at rest or along the commanded path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import Composite

from aslip.robot import SIDES
from aslip.transforms.base import SeededTransform, checked_column, extend_spec, require_keys
from aslip.transforms.estimate import ODOMETRY_SIZES
from aslip.transforms.path import advance, advance_heading, move_origin, place_in_path
from aslip.transforms.rotation import (
    conjugate,
    heading_to_world,
    multiply,
    rotate_inverse,
    upper_hemisphere,
    yaw,
)

_TRUTH = (*ODOMETRY_SIZES, "slope", "ground_height")
_BODIES = ("pelvis", *(f"{side}_foot" for side in SIDES))
# distance from the world's origin within which a start counts as at the origin [m]; the
# reference's body sways by 0.02 m
_SWAY: Final = 0.05


class HeadingFrame(SeededTransform):
    """Write the heading and perfect odometry: the truth in the heading frame.

    `("true_odometry", ...)` has the names and the frame of `("odometry", ...)`, see
    `ODOMETRY_SIZES`: z is up (against gravity), x along the entry `heading`, which does not turn
    with the robot. `("truth", ...)` is in the world frame. Rewards and metrics read
    `true_odometry` instead, so a robot may start at any place and yaw.

    `heading` (n, 1) [rad] is the yaw that counts as straight ahead; setting it does not turn the
    robot. Pass it to a reset, `env.reset(TensorDict(heading=...))`, or write `td["heading"]`
    between steps. By default it is the true yaw of the pelvis at the reset, as it always is after a
    partial reset (with a `_reset` mask).

    `("true_odometry", "origin")` (n, 3) [m, world] is the point on the ground below the start, or
    below the world's origin if the pelvis starts within 0.05 m of it: the reference sways by 0.02 m
    about its line.

    With a `command_key` the frame moves along the commanded path: at each step, heading and origin
    follow the twist of that command, about the pelvis, and a pelvis further than `LEASH` from the
    origin drags it along slowly. `("true_odometry", "path_error")` (n, 2) is then
    the distance of the pelvis from the origin, forward and sideways [m]. With a `mode_key`, stops
    move the origin below the pelvis.

    Args:
        command_key: key of the command (n, c) whose path the frame follows; None for a frame at
            rest.
        mode_key: key of the mode (n, 1) of robots with a stand command, as `StandClock` writes it.
    """

    needs_env = "it reads the headings of robots at resets"

    def __init__(
        self,
        *,
        command_key: NestedKey | None = None,
        mode_key: NestedKey | None = None,
    ) -> None:
        keys: list[NestedKey] = [("truth", name) for name in _TRUTH]
        keys += [key for key in (command_key, mode_key) if key is not None]
        super().__init__(in_keys=keys, out_keys=["heading", "true_odometry"])
        self._command_key, self._mode_key = command_key, mode_key
        self._origin_key = unravel_key((self.out_keys[1], "origin"))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        truth = cast("Mapping[str, Tensor]", tensordict_reset["truth"])
        key = self.out_keys[0]
        # with a `_reset` mask, the entry is left over from the episode before, not chosen
        chosen = "_reset" not in tensordict and tensordict.get(key, None) is not None
        heading = checked_column(tensordict, key) if chosen else true_heading(truth)
        return self._written(tensordict_reset, heading, start_of(truth))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        heading = checked_column(tensordict, self.out_keys[0])
        origin = cast("Tensor", tensordict[self._origin_key])
        if self._command_key is not None:
            command = cast("Tensor", tensordict[self._command_key])
            slope = cast("Tensor", next_tensordict["truth", "slope"])
            error = cast("Tensor", tensordict[unravel_key((self.out_keys[1], "path_error"))])
            origin = move_origin(origin, heading, advance(command, error), slope)
            heading = advance_heading(heading, command)
        return self._written(next_tensordict, heading, origin)

    def _written(self, into: TensorDictBase, heading: Tensor, origin: Tensor) -> TensorDictBase:
        truth = cast("Mapping[str, Tensor]", into["truth"])
        into.set(self.out_keys[0], heading)
        entries = {"origin": origin, **in_heading_frame(truth, heading, origin)}
        if self._command_key is not None:
            mode = None if self._mode_key is None else cast("Tensor", into[self._mode_key])
            entries = place_in_path(entries, origin, heading, truth["slope"], mode)
        return into.set(self.out_keys[1], TensorDict(entries, into.batch_size))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add heading, origin and the entries of `ODOMETRY_SIZES`."""
        require_keys(self, observation_spec, self.in_keys)
        group = Composite(shape=observation_spec.shape)
        sizes = {"origin": 3, **ODOMETRY_SIZES}
        if self._command_key is not None:
            sizes["path_error"] = 2
        observation_spec[self.out_keys[1]] = extend_spec(group, sizes)
        return extend_spec(observation_spec, {self.out_keys[0]: 1})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare the heading as an entry that a caller may set."""
        return extend_spec(state_spec, {self.out_keys[0]: 1})


def true_heading(truth: Mapping[str, Tensor]) -> Tensor:
    """(*b, 1) yaw of the pelvis about the vertical [rad], as a perfect IMU would measure it."""
    upright = heading_to_world(truth["slope"], torch.zeros_like(truth["slope"]))
    return yaw(_seen_from(upright, truth["pelvis_orientation"]))


def start_of(truth: Mapping[str, Tensor]) -> Tensor:
    """(*b, 3) origin [m, world] of robots that start with this truth; see `HeadingFrame`."""
    x, y, z = truth["pelvis_position"].split(1, dim=-1)
    near = torch.hypot(x, y) < _SWAY
    x, y = (torch.where(near, 0.0, part) for part in (x, y))
    # the point below the pelvis along gravity
    ground = truth["ground_height"]
    return torch.cat([x - truth["slope"].tan() * (z - ground), y, ground], dim=-1)


def in_heading_frame(
    truth: Mapping[str, Tensor], heading: Tensor, origin: Tensor
) -> dict[str, Tensor]:
    """Pelvis and feet as perfect odometry would give them.

    Args:
        truth: entries of `ODOMETRY_SIZES` [world], and `slope`, (*b, k) each.
        heading: (*b, 1) [rad].
        origin: (*b, 3) [m, world].

    Returns:
        The entries of `ODOMETRY_SIZES`; heights are above the origin's level, on a slope above the
        floor straight below the pelvis. If heading, slope and origin are zero, they equal those of
        `truth` bit for bit.
    """
    to_world = heading_to_world(truth["slope"], heading).unsqueeze(-2)
    places = [truth[f"{body}_position"] - origin for body in _BODIES]
    vectors = torch.stack([*places, truth["pelvis_velocity"]], dim=-2)
    *places, velocity = rotate_inverse(to_world, vectors).unbind(-2)
    orientations = torch.stack([truth[f"{body}_orientation"] for body in _BODIES], dim=-2)
    turned = _seen_from(to_world, orientations)
    # on a slope, heights count from the ground below the robot
    height = (truth["pelvis_position"] - origin)[..., 2:] / truth["slope"].cos()
    lift = torch.nn.functional.pad(height - places[0][..., 2:], (2, 0))
    entries = {"pelvis_velocity": velocity}
    for i, body in enumerate(_BODIES):
        entries[f"{body}_position"] = places[i] + lift
        entries[f"{body}_orientation"] = turned[..., i, :]
    return {name: entries[name] for name in ODOMETRY_SIZES}


def _seen_from(frame: Tensor, orientation: Tensor) -> Tensor:
    """Orientations (*b, 4) relative to frames (*b, 4), both given to world; w >= 0."""
    return upper_hemisphere(multiply(conjugate(frame), orientation))
