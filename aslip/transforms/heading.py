"""The robot's own frame: where it was, and which way it was to go, when it began."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from aslip.robot import SIDES
from aslip.transforms.base import SeededTransform, checked_column, extend_spec, require_keys
from aslip.transforms.estimate import ODOMETRY_SIZES
from aslip.transforms.rotation import conjugate, multiply, rotate_inverse, upper_hemisphere, yaw

_GROUP = "true_odometry"
_ORIGIN = (_GROUP, "origin")
_BODIES = ("pelvis", *(f"{side}_foot" for side in SIDES))
# the reference's body sways about its line by 0.02 m: a start this close to it is on it [m]
_SWAY: Final = 0.05


class HeadingFrame(SeededTransform):
    """Write the truth as perfect odometry, `("true_odometry", ...)`: where the robot went since.

    Entries have the names and the frame of `("odometry", ...)`, see `ODOMETRY_SIZES`: z is up
    against gravity, x along the robot's heading. Rewards and metrics read them in place of
    `("truth", ...)`, whose axes are the world's, so that a robot may start anywhere and turned by
    any angle.

    The heading is a yaw against gravity, under `heading` (n, 1) [rad]. A reset takes it from its
    tensordict, `env.reset(TensorDict(heading=...))`: what the robot is told about which way is
    ahead; it turns no robot. By default, and in a reset of some robots only, with a `_reset` mask,
    it is the true yaw of the pelvis then. Write `td["heading"]` between steps to change it.

    `("true_odometry", "origin")` (n, 3) [m, world] is on the floor below the place of the start, or
    at the world's origin where the pelvis starts within 0.05 m of it: the reference sways by
    0.02 m about its line.
    """

    def __init__(self) -> None:
        truth = [*ODOMETRY_SIZES, "slope"]
        super().__init__(in_keys=[("truth", name) for name in truth], out_keys=["heading", _GROUP])

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        truth = cast("Mapping[str, Tensor]", tensordict_reset["truth"])
        # an old one, not one that was chosen, where a mask names the robots to reset
        chosen = "_reset" not in tensordict and tensordict.get("heading", None) is not None
        heading = checked_column(tensordict, "heading") if chosen else true_heading(truth)
        return self._written(tensordict_reset, heading, start_of(truth))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        heading = checked_column(tensordict, "heading")
        return self._written(next_tensordict, heading, cast("Tensor", tensordict[_ORIGIN]))

    def _written(self, into: TensorDictBase, heading: Tensor, origin: Tensor) -> TensorDictBase:
        truth = cast("Mapping[str, Tensor]", into["truth"])
        into.set("heading", heading)
        return into.set(_GROUP, {"origin": origin, **in_heading_frame(truth, heading, origin)})

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add `heading` and the entries of `ODOMETRY_SIZES`."""
        require_keys(self, observation_spec, self.in_keys)
        sizes = {(_GROUP, name): size for name, size in ODOMETRY_SIZES.items()}
        return extend_spec(observation_spec, {"heading": 1, _ORIGIN: 3, **sizes})

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        """Declare `heading` as something a caller may set."""
        return extend_spec(state_spec, {"heading": 1})


def true_heading(truth: Mapping[str, Tensor]) -> Tensor:
    """(*b, 1) yaw of the pelvis against gravity [rad], as a perfect IMU would say."""
    upright = _to_world(truth["slope"], torch.zeros_like(truth["slope"]))
    return yaw(_seen_from(upright, truth["pelvis_orientation"]))


def start_of(truth: Mapping[str, Tensor]) -> Tensor:
    """(*b, 3) origin [m, world] of robots that start here; see `HeadingFrame`."""
    x, y, z = truth["pelvis_position"].split(1, dim=-1)
    near = torch.hypot(x, y) < _SWAY
    x, y = (torch.where(near, 0.0, part) for part in (x, y))
    # straight below is along gravity
    return torch.cat([x - truth["slope"].tan() * z, y, torch.zeros_like(z)], dim=-1)


def in_heading_frame(
    truth: Mapping[str, Tensor], heading: Tensor, origin: Tensor
) -> dict[str, Tensor]:
    """Pelvis and feet as odometry would have them if it were perfect.

    Args:
        truth: entries of `ODOMETRY_SIZES` [world], and `slope`, (*b, k) each.
        heading: (*b, 1) [rad].
        origin: (*b, 3) [m, world].

    Returns:
        The entries of `ODOMETRY_SIZES`, heights above the ground straight below the pelvis. Bit for
        bit those of `truth` if heading, slope and origin are zero.
    """
    to_world = _to_world(truth["slope"], heading).unsqueeze(-2)
    places = [truth[f"{body}_position"] - origin for body in _BODIES]
    vectors = torch.stack([*places, truth["pelvis_velocity"]], dim=-2)
    *places, velocity = rotate_inverse(to_world, vectors).unbind(-2)
    orientations = torch.stack([truth[f"{body}_orientation"] for body in _BODIES], dim=-2)
    turned = _seen_from(to_world, orientations)
    # on a slope a robot rises with the ground below it
    height = truth["pelvis_position"][..., 2:] / truth["slope"].cos()
    lift = torch.nn.functional.pad(height - places[0][..., 2:], (2, 0))
    entries = {"pelvis_velocity": velocity}
    for i, body in enumerate(_BODIES):
        entries[f"{body}_position"] = places[i] + lift
        entries[f"{body}_orientation"] = turned[..., i, :]
    return {name: entries[name] for name in ODOMETRY_SIZES}


def _to_world(slope: Tensor, heading: Tensor) -> Tensor:
    """(*b, 4) heading frame to world, wxyz, of (*b, 1) slopes of the floor and headings [rad]."""
    tilt, turn = slope / 2, heading / 2
    cosine, sine = turn.cos(), turn.sin()
    return torch.cat(
        [
            tilt.cos() * cosine,
            tilt.sin() * sine,
            tilt.sin() * cosine,
            tilt.cos() * sine,
        ],
        dim=-1,
    )


def _seen_from(frame: Tensor, orientation: Tensor) -> Tensor:
    """Orientations (*b, 4) relative to frames (*b, 4), both to the world; w >= 0."""
    return upper_hemisphere(multiply(conjugate(frame), orientation))
