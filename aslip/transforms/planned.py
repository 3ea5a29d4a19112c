"""Reference motion of a planner, which decides where and when the feet land."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, Final, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, Unbounded

from aslip.base.arrays import namespace
from aslip.estimation import FilterNoise, StateEstimator
from aslip.library import GaitLibrary, WalkMode
from aslip.planning import BatchPlanner, Pendulum, Planner, Program, Stones, WalkState
from aslip.robot import CASSIE, SIDES
from aslip.transforms.base import SeededTransform, extend_spec, require_keys, reset_rows, spread
from aslip.transforms.estimate import ODOMETRY_SIZES, PATH_SIZES
from aslip.transforms.nested import (
    chosen,
    mapped,
    to_double,
    to_numpy,
    to_single,
)
from aslip.transforms.plan_motors import MOTORS, NEAR, PlanMotors
from aslip.transforms.plan_state import (
    ODOMETRY,
    contact_of,
    followed,
    frame_between,
    landed,
    phase_of,
    recentred,
    start_state,
)
from aslip.transforms.reference import reference_and_target
from aslip.transforms.rotation import rotate_about_vertical

PLAN_SIZES: Final[Mapping[str, int]] = MappingProxyType(
    {
        "state": WalkState.SIZE,
        "foothold": 3,
        "last_foothold": 3,
        "time": 1,
        "step": 5,
        "on_stones": 1,
        "filtered_command": 3,
    }
)
"""Entries of `("plan", ...)`, in the frame of the odometry: the state in a policy step, by the
columns of `WalkState.to_rows`; the next foothold [m]; that of the foot in stance, from the last
plan before it landed [m]; the time until the next touchdown [s]; what policies observe of both, the
next foothold from the body, above the foot in stance [m], the time until then [s] and the foot in
stance, 1 for the left and -1 for the right one, all zero for robots that follow the library; the
number of first footholds that stones allow, see `Plan.on_stones`; and the command that the plan
amounts to, see `Plan.command`, or of robots that follow the library the filtered command. For plans
of N steps there are `later_footholds` (N - 1, 3), too [m]."""

_VECTORS = (
    *("body_position", "body_velocity"),
    *(f"{side}_foot_{name}" for side in SIDES for name in ("position", "velocity")),
)
_HEADINGS = ("body_heading", *(f"{side}_foot_heading" for side in SIDES))
# read where they are
_OPTIONAL = ("heading", "estimator", ("truth", "ground_force"), "footsteps", "stones")
_COMMAND: Final = "filtered_command"
# shares of the distance to the estimate by which a plan moves in a policy step, and error of the
# divergent component from which it is the larger one [m]
_FOLLOW, _LARGE = (0.1, 0.6), 0.15
# limits of plans of robots that fall: body from the stance foot, above it [m], speed [m/s]
_FAR, _HIGH, _FAST = 0.8, 1.5, 3.5
# height of the body above the ground in the library's gaits [m]
_HEIGHT = 0.875


def default_planner() -> Planner:
    """Exact planner, of bodies as high as in the shipped library."""
    return Planner(Program(Pendulum(height=_HEIGHT)))


def planned_estimator() -> StateEstimator:
    """State estimator for ground of any height, as stones have."""
    return StateEstimator(noise=FilterNoise(ground=math.inf))


class PlannedReference(SeededTransform):
    """Write a plan's motion as `("reference", ...)` and `("target", ...)`, replanned at every step.

    It takes the place of `ReferenceInjection`, after the estimator, and writes the same entries.
    Robots follow a plan if they have stones or displaced footholds, see below. All others, and
    those that stop, stand and start, follow the library; their plan is only written.

    A plan goes on from the state to which the last one led, drawn to the estimate: body and stance
    foot move there by a share of the distance, and a swing foot stays on its path, which the new
    plan bends without a jump in position or velocity.

    The moving frame of robots that follow a plan is below its body, so that positions of the body
    in reference and target are zero along the ground. The origin of `("odometry", ...)` moves
    there, too: `path_error` is the distance of the pelvis from the plan's body. Their phase is the
    plan's. Also writes `("plan", ...)`, see `PLAN_SIZES`.

    If there are stones, `("stones", "corners")` (n, m, e, 2) and `("stones", "height")` (n, m)
    [m, frame of the odometry], feet land on them; NaN where is no stone. `("footsteps", "shift")`
    (n, 2) displaces the next foothold from the best one [m]; zero is a plan on the floor, too.

    Args:
        library: gaits on which episodes start, with stop and start if robots stand.
        planner: a `Planner`, which is exact and the default, or a `BatchPlanner`, for GPUs.
        stands: whether there are `mode` and `stand`, see `StandClock`.
    """

    needs_env = "plans go on from those of the step before"

    def __init__(
        self,
        library: GaitLibrary,
        planner: BatchPlanner | Planner | None = None,
        *,
        stands: bool = False,
    ) -> None:
        keys: list[NestedKey] = [_COMMAND, "phase", *(("mode", "stand") if stands else ())]
        keys += [("odometry", name) for name in (*ODOMETRY_SIZES, *PATH_SIZES)]
        super().__init__(keys, ["reference", "target", "plan"])
        self.library = library
        self.planner = default_planner() if planner is None else planner
        self._motors = PlanMotors(self.planner.program.pendulum)
        self._stands = stands

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        part = tensordict_reset.select(*self.in_keys, *_OPTIONAL, strict=False)
        found = self.begin(part if rows is None else cast("TensorDictBase", part[rows]))
        for key in (*self.out_keys, "odometry"):
            value = found[key]
            tensordict_reset.set(key, value if rows is None else _spread(value, rows))
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self.go_on(tensordict, next_tensordict)

    def begin(self, present: TensorDictBase) -> TensorDictBase:
        """Write the entries of robots that start, with those that the transform reads; in place."""
        phase = cast("Tensor", present["phase"])
        state = self._started(present)
        stood = state.of_foot(state.foot_position, swing=False)
        return self._written(present, state, stood).set("phase", phase)

    def go_on(self, past: TensorDictBase, present: TensorDictBase) -> TensorDictBase:
        """Write the entries a policy step after `past`, see `begin`; in place."""
        frame = frame_between(past, present)
        aim = cast("Tensor", past["plan", "foothold"])
        led = WalkState.from_rows(cast("Tensor", past["plan", "state"])).seen_from(*frame)
        state = self._drawn(landed(led, aim, past, present), present)
        flies = (state.since > self.planner.program.pendulum.double_stance)[:, None]
        shift, turn = torch.nn.functional.pad(frame[0], (0, 1)), -frame[1][:, None]
        last = cast("Tensor", past["plan", "last_foothold"])
        turned, last = (rotate_about_vertical(place - shift, turn) for place in (aim, last))
        left = cast("Tensor", past["plan", "time"]) - CASSIE.policy_period
        lands = (left <= 0) | (state.stance != led.stance)[:, None]
        last = torch.where(lands, turned, last)
        aim = torch.where(flies, torch.cat([turned[:, :2], left], -1), torch.nan)
        begins = ~followed(past)
        first = self._started(present).to_rows()
        state = WalkState.from_rows(torch.where(begins, first, state.to_rows()))
        aim = torch.where(begins, torch.nan, aim)
        stood = state.of_foot(state.foot_position, swing=False)
        last = torch.where(begins, stood, last)
        return self._written(present, state, last, aim)

    def _started(self, found: TensorDictBase) -> WalkState:
        odometry = cast("TensorDictBase", found["odometry"])
        pelvis, _, left, right = (cast("Tensor", odometry[name]) for name in ODOMETRY)
        ground = torch.minimum(left[:, 2:], right[:, 2:])
        phase, command = (cast("Tensor", found[key]) for key in ("phase", _COMMAND))
        return start_state(self.library, phase, command, pelvis, ground)

    def _drawn(self, state: WalkState, found: TensorDictBase) -> WalkState:
        """State, drawn to the estimate: body along the ground, and the foot in stance."""
        odometry = cast("TensorDictBase", found["odometry"])
        position, velocity, *feet = (cast("Tensor", odometry[name]) for name in ODOMETRY)
        contact = contact_of(found)
        stance = torch.arange(2, device=contact.device) == state.stance[:, None]
        share = torch.where(stance & contact, _FOLLOW[1], 0.0)[..., None]
        foot = torch.lerp(state.foot_position, torch.stack(feet, 1), share)
        stood = state.of_foot(foot, swing=False)
        away, faster = position - state.body_position, velocity - state.body_velocity
        # of the divergent component, which determines where the next steps must be
        error = (away + faster / self.planner.program.pendulum.rate)[:, :2].norm(dim=-1)
        slow, fast = _FOLLOW
        share = slow + (fast - slow) * (error / _LARGE).clamp(max=1.0)
        level = torch.nn.functional.pad(share[:, None].expand(-1, 2), (0, 1))
        body = state.body_position + level * away
        speed = state.body_velocity + level * faster
        off = body - stood
        off = torch.cat([off[:, :2].clamp(-_FAR, _FAR), off[:, 2:].clamp(-_HIGH, _HIGH)], -1)
        return replace(
            state,
            body_position=stood + off,
            body_velocity=speed.clamp(-_FAST, _FAST),
            foot_position=foot,
        )

    def _written(
        self, into: TensorDictBase, state: WalkState, last: Tensor, aim: Tensor | None = None
    ) -> TensorDictBase:
        """Plan from a state, and write reference, target, plan, odometry and phase.

        Reference and target are the plan's, or the library's of robots that follow it.
        """
        follows = self._follows(into)
        shift = torch.where(follows, state.body_position[:, :2], 0.0)
        aim = None if aim is None else torch.cat([aim[:, :2] - shift, aim[:, 2:]], -1)
        moved = state.seen_from(shift, 0 * shift[:, 0])
        now, later, around, plan = self._planned(into, moved, shift, aim)
        plan["last_foothold"] = last - torch.nn.functional.pad(shift, (0, 1))
        stood = moved.of_foot(moved.foot_position, swing=False)
        level = torch.nn.functional.pad(stood[:, 2:], (2, 0))
        side = 1.0 - 2.0 * moved.stance[:, None].to(stood)
        plan["step"] = torch.cat([plan["foothold"] - level, plan["time"], side], -1)
        turn = later.heading.angle
        reference = _entries_of(now, 0 * turn) | self._motors(later, around)
        target = _entries_of(later, turn)
        command, phase = (cast("Tensor", into[key]) for key in (_COMMAND, "phase"))
        planned = phase_of(state, plan["time"], self.library.stride(command))
        phase = torch.where(follows, planned, phase)
        standing = (into["mode"], into["stand"]) if self._stands else None
        gaits = reference_and_target(self.library, command, phase, standing=standing)
        reference, target = (
            {name: torch.where(follows, value, gait[name]) for name, value in own.items()}
            for own, gait in zip((reference, target), gaits, strict=True)
        )
        plan["step"] = torch.where(follows, plan["step"], 0.0)
        plan["filtered_command"] = torch.where(follows, plan["filtered_command"], command)
        into.set("phase", phase)
        for key, entries in zip(self.out_keys, (reference, target, plan), strict=True):
            into.set(key, TensorDict(entries, into.batch_size))
        return recentred(into, shift)

    def _follows(self, found: TensorDictBase) -> Tensor:
        """(n, 1) bool, robots that follow a plan."""
        corners = found.get(("stones", "corners"), None)
        everywhere = found.get(("footsteps", "shift"), None) is not None
        follows = torch.full_like(cast("Tensor", found["phase"]), everywhere, dtype=torch.bool)
        if corners is not None:
            follows = follows | _there(corners)[:, None]
        return follows & (found["mode"] == WalkMode.WALK) if self._stands else follows

    def _planned(
        self, found: TensorDictBase, state: WalkState, shift: Tensor, aim: Tensor | None
    ) -> tuple[Any, Any, tuple[Any, Any], dict[str, Tensor]]:
        """`PlanSample`s of tensors now, a step later and around that, and the plan's entries."""
        command = cast("Tensor", found[_COMMAND])
        footsteps = found.get(("footsteps", "shift"), None)
        kept: dict[str, Any] = {} if aim is None else {"aim": aim}
        free = kept if footsteps is None else {**kept, "shift": footsteps}
        corners = found.get(("stones", "corners"), None)
        if corners is None:
            return self._sampled(state, command, free)
        stones = corners - shift[:, None, None], found["stones", "height"]
        if isinstance(self.planner, Planner):
            return self._sampled(state, command, {**free, "stones": stones})
        there = _there(corners)
        plans = [self._sampled(state, command, o) for o in ({**kept, "stones": stones}, free)]
        return chosen(there, *plans)

    def _sampled(
        self, state: WalkState, command: Tensor, given: Mapping[str, Any]
    ) -> tuple[Any, Any, tuple[Any, Any], dict[str, Tensor]]:
        """Plan, and what `_planned` returns."""
        # single precision loses the time of the touchdown, of which costs hardly depend
        convert = to_numpy if isinstance(self.planner, Planner) else to_double
        single = partial(to_single, command.device)
        state, command, given = mapped(convert, (state, command, dict(given)))
        if "stones" in given:
            given = {**given, "stones": Stones.from_corners(*given["stones"])}
        plan = cast("Any", self.planner).plan(state, command, **given)
        period, num = CASSIE.policy_period, len(command)
        times = (0.0, period, period - NEAR, period + NEAR)
        zero = 0 * command[:, 0]
        samples = plan.sample(namespace(zero).concatenate([zero + time for time in times]))
        now, later, *around = (
            mapped(lambda value: value[k * num : (k + 1) * num], samples)  # noqa: B023
            for k in range(len(times))
        )
        written = {
            "state": later.state().to_rows(),
            "foothold": plan.foothold[:, 0],
            "later_footholds": plan.foothold[:, 1:],
            "time": plan.time[:, :1],
            "on_stones": plan.on_stones[:, None] + 0 * plan.time[:, :1],
            "filtered_command": plan.command,
        }
        return mapped(single, (now, later, tuple(around), written))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the fields of reference and target, and the plan."""
        require_keys(self, observation_spec, self.in_keys)
        target = dict.fromkeys(_VECTORS, 3) | dict.fromkeys(_HEADINGS, 1)
        reference = target | dict.fromkeys(MOTORS, len(CASSIE.stiffness))
        for key, sizes in zip(self.out_keys, (reference, target, PLAN_SIZES), strict=True):
            group = Composite(shape=observation_spec.shape)
            observation_spec[key] = extend_spec(group, sizes)
        later = torch.Size((*observation_spec.shape, self.planner.program.steps - 1, 3))
        observation_spec["plan", "later_footholds"] = Unbounded(later, dtype=torch.float32)
        return observation_spec


def _entries_of(sample: Any, turn: Tensor) -> dict[str, Tensor]:
    """Entries of body and feet (n, k) in a frame below the body that has turned by (n,) [rad]."""
    turn = turn[:, None]
    height = sample.body.position[:, 2] - sample.ground
    level = torch.nn.functional.pad(height[:, None], (2, 0))
    feet = sample.feet.position - sample.body.position[:, None]
    vectors = [level, rotate_about_vertical(sample.body.velocity, -turn)]
    for foot, velocity in zip(feet.unbind(1), sample.feet.velocity.unbind(1), strict=True):
        vectors += [rotate_about_vertical(vector, -turn) for vector in (foot, velocity)]
    headings = [sample.heading.angle[:, None], *sample.foot_heading.split(1, -1)]
    entries = dict(zip(_VECTORS, vectors, strict=True))
    return entries | {n: h - turn for n, h in zip(_HEADINGS, headings, strict=True)}


def _spread(value: Any, rows: Tensor) -> Any:
    """Entry, or group of entries, of the robots in a mask, see `spread`."""
    if isinstance(value, Tensor):
        return spread(value, rows)
    whole = {name: spread(entry, rows) for name, entry in value.items()}
    return TensorDict(whole, rows.shape)


def _there(corners: Tensor) -> Tensor:
    """(n,) bool, robots that have stones."""
    return corners.isfinite().flatten(1).any(1)
