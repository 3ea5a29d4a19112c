"""States from which plans go on: starts on a gait, landings, and the frame that moves with them."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import torch
from tensordict import TensorDictBase
from torch import Tensor

from aslip.estimation import Tracking
from aslip.library import GaitLibrary
from aslip.library.transitions import HALF
from aslip.planning import WalkState
from aslip.robot import CASSIE, SIDES
from aslip.transforms.path import wrap
from aslip.transforms.rotation import rotate_about_vertical, yaw

ODOMETRY = ("pelvis_position", "pelvis_velocity", *(f"{side}_foot_position" for side in SIDES))
"""Entries of the odometry that plans follow."""

# share of a stride in double stance after each touchdown
_DOUBLE = 0.125
# vertical force on a foot from which it is loaded, if the estimate is the truth [N]
_LOADED = 50.0
# a foot lands before its time if it touches within this height of its foothold [m], this time
# before the touchdown, and this time after the one before [s]
_TOUCHING, _EARLY, _SHORTEST = 0.01, 0.12, 0.2


def start_state(
    library: GaitLibrary, phase: Tensor, command: Tensor, pelvis: Tensor, ground: Tensor
) -> WalkState:
    """State of n robots on gaits of the library.

    The left foot lifts off at phase 0 and the right one at 0.5; feet land an eighth before.

    Args:
        library: gaits.
        phase: (n, 1) stride fraction.
        command: (n, 3) command of the gait.
        pelvis: (n, 3) place of the pelvis, of which only x and y count [m].
        ground: (n, 1) height of the ground below the robot [m].
    """
    stride = library.stride(command)
    passed = torch.remainder(phase + _DOUBLE, 1.0)  # since the right touchdown
    stance = (passed < HALF).long()[:, 0]
    right = (stance == 1)[:, None]
    found = library.lookup(phase, command)
    lifted = torch.where(right, 0.0, HALF)
    before = library.lookup(lifted, command)
    # from the foot in stance to the other, when that lifted off
    step = before.left_foot_position - before.right_foot_position
    step = torch.where(right, step, -step)
    elapsed = (torch.remainder(passed, HALF) - _DOUBLE).clamp(min=0.0) * stride
    step = rotate_about_vertical(step, -command[:, 2:] * elapsed)
    place = torch.cat([pelvis[:, :2], ground], -1)
    body = torch.cat([place[:, :2], found.body_position[:, 2:] + ground], -1)
    feet = torch.stack([found.left_foot_position, found.right_foot_position], 1) + body[:, None]
    stood = feet[torch.arange(len(phase), device=phase.device), stance]
    return WalkState(
        body_position=body,
        body_velocity=found.body_velocity,
        foot_position=feet,
        foot_velocity=torch.stack([found.left_foot_velocity, found.right_foot_velocity], 1),
        foot_acceleration=torch.zeros_like(feet),
        foot_heading=torch.cat([found.left_foot_heading, found.right_foot_heading], -1),
        lift_off=torch.cat([(stood + step)[:, :2], ground], -1),
        stance=stance,
        since=(torch.remainder(passed, HALF) * stride)[:, 0],
    )


def phase_of(state: WalkState, left: Tensor, stride: Tensor) -> Tensor:
    """Stride fraction (n, 1) from which the library's clock lands when the plan does.

    Args:
        state: state of n robots.
        left: (n, 1) time until the plan's next touchdown [s].
        stride: (n, 1) stride of the library [s].
    """
    since, touchdown = state.since[:, None], HALF - _DOUBLE
    landed = since < _DOUBLE * stride
    within = torch.where(landed, touchdown + since / stride, (touchdown - left / stride).clip(0.0))
    # the left foot swings in the first half of the stride, and has just landed at its end
    first = (state.stance[:, None] == 0) == landed
    return torch.where(first, within, HALF + within) % 1.0


def recentred(into: TensorDictBase, shift: Tensor) -> TensorDictBase:
    """Move the origin of the odometry along the ground by (n, 2) [m, heading frame]; in place."""
    odometry = cast("TensorDictBase", into["odometry"])
    level = torch.nn.functional.pad(shift, (0, 1))
    moved = {n: v - level for n, v in odometry.items() if n.endswith("_position")}
    moved["path_error"] = odometry["path_error"] - shift
    turned = rotate_about_vertical(level, heading_of(into))
    return into.set("odometry", odometry.update(moved | {"origin": odometry["origin"] + turned}))


def frame_between(past: TensorDictBase, present: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Place (n, 2) [m] and yaw (n,) [rad] of the odometry's frame, seen from the one before."""
    before, after = (cast("Tensor", td["odometry", "origin"]) for td in (past, present))
    heading, turned = heading_of(past), heading_of(present)
    moved = rotate_about_vertical(after - before, -heading)
    return moved[:, :2], wrap(turned - heading)[:, 0]


def landed(
    led: WalkState, foothold: Tensor, past: TensorDictBase, present: TensorDictBase
) -> WalkState:
    """State in which feet have landed that touch the ground a little before their time.

    Args:
        led: state to which the plan led.
        foothold: (n, 3) where the foot in flight was going to, of which the height counts [m].
        past: entries of the step before.
        present: entries now.
    """
    odometry = cast("TensorDictBase", present["odometry"])
    estimated = torch.stack([cast("Tensor", odometry[name]) for name in ODOMETRY[2:]], 1)
    swing = torch.arange(2, device=led.stance.device) != led.stance[:, None]
    left = cast("Tensor", past["plan", "time"]) - CASSIE.policy_period
    low = estimated[..., 2] < foothold[:, 2:] + _TOUCHING
    soon = (left > 0) & (left < _EARLY) & (led.since[:, None] > _SHORTEST)
    lands = swing & contact_of(present) & low & soon
    now = lands.any(-1)
    rest = torch.where(lands[..., None], 0.0, 1.0)
    stood = led.of_foot(led.foot_position, swing=False)
    return replace(
        led,
        foot_position=torch.where(lands[..., None], estimated, led.foot_position),
        foot_velocity=rest * led.foot_velocity,
        foot_acceleration=rest * led.foot_acceleration,
        lift_off=torch.where(now[:, None], stood, led.lift_off),
        stance=torch.where(now, 1 - led.stance, led.stance),
        since=torch.where(now, 0.0, led.since),
    )


def followed(found: TensorDictBase) -> Tensor:
    """(n, 1) bool, robots that follow their plan, and not the library."""
    return cast("Tensor", found["plan", "step"])[:, -1:] != 0


def landing_foot(found: TensorDictBase) -> Tensor:
    """Foot (n,) that lands next in plans, 0 for the left and 1 for the right."""
    led = WalkState.from_rows(cast("Tensor", found["plan", "state"]))
    # the state is that after a policy step, within which the foot may land
    lands = cast("Tensor", found["plan", "time"])[:, 0] <= CASSIE.policy_period
    return torch.where(lands, led.stance, 1 - led.stance)


def footholds_in_world(found: TensorDictBase) -> Tensor:
    """Footholds (n, N, 3) of plans, as far from the true pelvis as from the estimated one [m]."""
    truth, odometry, plan = (
        cast("TensorDictBase", found[group]) for group in ("truth", "odometry", "plan")
    )
    footholds = torch.cat([plan["foothold"][:, None], plan["later_footholds"]], 1)
    turn = yaw(truth["pelvis_orientation"]) - yaw(odometry["pelvis_orientation"])
    place = footholds - odometry["pelvis_position"][:, None]
    return truth["pelvis_position"][:, None] + rotate_about_vertical(place, turn[:, None])


def heading_of(found: TensorDictBase) -> Tensor:
    """(n, 1) yaw of the heading frame; robots without that entry have it in the estimator [rad]."""
    heading = found.get("heading", None)
    if heading is None:
        memory = cast("Tensor", found["estimator", "memory"])
        heading = Tracking.from_rows(memory).heading[:, None].float()
    return heading


def contact_of(found: TensorDictBase) -> Tensor:
    """(n, 2) bool, loaded feet; of robots whose estimate is the truth, by the true forces."""
    contact = found.get(("estimator", "contact"), None)
    if contact is None:
        contact = cast("Tensor", found["truth", "ground_force"])[..., 2] > _LOADED
    return contact
