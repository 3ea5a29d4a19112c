"""Stack for walks in all directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Final, cast

import numpy as np
from tensordict.utils import NestedKey
from torch import Tensor

from aslip.envs import RewardSource
from aslip.envs.edit import Stack, insert_before, require_names
from aslip.envs.straight import REWARD_SOURCES, shipped_library, stack_of, terms_of
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.planning import BatchPlanner, Planner
from aslip.sim.course import Course
from aslip.transforms import (
    DIRECTION_TABLE,
    AssembleObservation,
    CommandFilter,
    CourseCommand,
    EstimatedState,
    HeadingFrame,
    PhaseClock,
    PlannedReference,
    RandomCourse,
    ReferenceInjection,
    ReferenceStart,
    RewardTerm,
    SeenStones,
    StandClock,
    StandCommand,
    StandFilter,
    VelocityCommand,
    WeightedReward,
    rewards,
)
from aslip.transforms.observation import PLANNED_TABLE
from aslip.transforms.planned import planned_estimator
from aslip.transforms.rewards import DIRECTION_WEIGHTS, PLANNED_WEIGHTS
from aslip.transforms.standing import required_transitions

# headings of the target that reward terms read on turns
_HEADINGS: Final = MappingProxyType(
    {
        "com_vel": ("body_heading",),
        "foot_pos": ("body_heading",),
        "foot_orient": ("left_foot_heading", "right_foot_heading"),
    }
)
_FILTERED: Final = "filtered_command"


def walking_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """Stack for walks in all directions: commands of forward speed, sideways speed and yaw rate.

    It is the default stack, with a filter of the command (`CommandFilter`), which clock, reference
    and path follow, and with rewards and odometry in a frame that moves along that path.

    Args:
        library: gait library over three commands, the shipped one by default.
        reward_on: source of pelvis and feet in the rewards; heading and distance from the path are
            always the estimated ones, which the policy observes, power and forces the true ones.

    Raises:
        ConfigurationError: commands of the library do not have three numbers.
    """
    library = shipped_library("directions") if library is None else library
    if library.command_size != 3:
        raise ConfigurationError(
            "a stack for all directions needs a library over forward speed, sideways speed and yaw"
            f" rate, got one whose commands have {library.command_size} numbers"
        )
    stack = stack_of(library, VelocityCommand(library), reward_on) | {
        "clock": PhaseClock(library, _FILTERED),
        "reference": ReferenceInjection(library, in_keys=[_FILTERED, "phase"]),
        "heading": HeadingFrame(command_key=_FILTERED),
        "estimator": EstimatedState(command_key=_FILTERED),
        "observation": AssembleObservation(DIRECTION_TABLE),
        "reward": WeightedReward(DIRECTION_WEIGHTS),
    }
    # the observation has the last action
    moved = {name: stack.pop(name) for name in ("action", "last_action")}
    stack = insert_before(stack, "observation", **moved)
    for name, headings in _HEADINGS.items():
        term = cast("RewardTerm", stack[name])
        keys = [*term.root_keys, *(("target", heading) for heading in headings)]
        stack[name] = RewardTerm(name, term.function, term.next_keys, keys)
    stack = insert_before(stack, "clock", command_filter=CommandFilter())
    stack = insert_before(stack, "straight_diff", **_terms())
    del stack["straight_diff"]
    return stack


def _terms() -> Stack:
    """Reward terms that the paper does not have."""
    reads: dict[Callable[..., Tensor], tuple[list[NestedKey], list[NestedKey]]] = {
        # the policy observes estimates of both; the true ones drift away with the odometry
        rewards.path_diff: ([("odometry", "path_error")], [("target", "body_position")]),
        rewards.heading_diff: ([("odometry", "pelvis_orientation")], [("target", "body_heading")]),
        rewards.power: ([("truth", "motor_power")], [_FILTERED]),
        rewards.landing: ([("truth", "largest_force")], []),
        rewards.squeeze: ([("truth", "ground_force")], []),
    }
    return terms_of(reads)


def directions_stack(
    library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
    """Stack of `walking_stack` in which robots also stand, stop and start (`StandClock`).

    Args:
        library: gait library over three commands, with stop and start; the shipped one by default.
        reward_on: source of pelvis and feet in the rewards.

    Raises:
        ConfigurationError: commands of the library do not have three numbers, or it has no stop and
            start.
    """
    library = shipped_library("directions") if library is None else library
    required_transitions(library)
    looked_up: list[NestedKey] = [_FILTERED, "phase", "mode", "stand"]
    stack = walking_stack(library, reward_on) | {
        "start": ReferenceStart(library, in_keys=["command", "phase", "mode"]),
        "command_filter": StandFilter(),
        "clock": StandClock(library),
        "reference": ReferenceInjection(library, in_keys=looked_up),
        "heading": HeadingFrame(command_key=_FILTERED, mode_key="mode"),
        "estimator": EstimatedState(command_key=_FILTERED, mode_key="mode"),
    }
    return insert_before(stack, "reference", stand=StandCommand())


def planned_stack(
    library: GaitLibrary | None = None,
    reward_on: RewardSource = "truth",
    planner: BatchPlanner | Planner | None = None,
) -> Stack:
    """Stack of `directions_stack` in which a planner decides where and when the feet land.

    Its `PlannedReference` comes after the estimator, and it has a reward for feet at their planned
    places. Policies observe where and when the next foot lands, and the command that the plan
    amounts to instead of the one given, which stones may not allow. Robots without stones, and
    those that stop, stand and start, follow the library.

    Args:
        library: gait library over three commands, with stop and start; the shipped one by default.
        reward_on: source of pelvis and feet in the rewards.
        planner: see `PlannedReference`.

    Raises:
        ConfigurationError: commands of the library do not have three numbers, or it has no stop and
            start.
    """
    library = shipped_library("directions") if library is None else library
    stack = directions_stack(library, reward_on)
    del stack["reference"]
    feedforward = stack.pop("feedforward")
    reference = PlannedReference(library, planner, stands=True)
    follows = {"command_key": _FILTERED, "mode_key": "mode"}
    stack["estimator"] = EstimatedState(planned_estimator(), **follows)
    # the last action comes first in the observation's part of the stack, as in `walking_stack`
    stack = insert_before(stack, "action", reference=reference, feedforward=feedforward)
    feet = ("left_foot_position", "right_foot_position")
    source = REWARD_SOURCES[reward_on]
    reads: dict[Callable[..., Tensor], tuple[list[NestedKey], list[NestedKey]]] = {
        rewards.feet_apart: (
            [(source, foot) for foot in feet],
            [("target", foot) for foot in feet],
        ),
        rewards.touchdown: (
            [("truth", "ground_force")],
            [("plan", name) for name in ("state", "step")],
        ),
        rewards.footstep: (
            [
                *(("odometry", foot) for foot in feet),
                *(("plan", name) for name in ("last_foothold", "state", "step")),
            ],
            [],
        ),
        rewards.level: ([(source, "pelvis_orientation")], []),
        rewards.velocity_diff: (
            [(source, name) for name in ("pelvis_orientation", "pelvis_velocity")],
            [("target", name) for name in ("body_velocity", "body_heading")],
        ),
        rewards.speed_diff: ([(source, "pelvis_velocity")], [("plan", _FILTERED)]),
    }
    stack = insert_before(stack, "reward", **terms_of(reads))
    del stack["com_vel"]
    return stack | {
        "observation": AssembleObservation(PLANNED_TABLE),
        "reward": WeightedReward(PLANNED_WEIGHTS),
    }


def course_stack(
    stack: Stack, courses: Sequence[Course] | np.ndarray, shown: np.ndarray | None = None
) -> Stack:
    """Stack of planned footsteps for robots on courses, which they see and are led along.

    Args:
        stack: `planned_stack`.
        courses: see `aslip.transforms.RandomCourse`; a robot whose stones are all NaN is on the
            floor and follows the library.
        shown: see `RandomCourse`.

    Raises:
        UnknownNameError: the stack has no `command`, `command_filter` or `reference`.
    """
    require_names(stack, ["command"])
    command = cast("VelocityCommand", stack["command"])
    stack = {**stack, "command": CourseCommand(command.library, command.interval)}
    stack = insert_before(stack, "command_filter", course=RandomCourse(courses, shown))
    return insert_before(stack, "reference", seen=SeenStones())
