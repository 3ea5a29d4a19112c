"""Stacks for straight walks: the default, the paper's and that of its baseline."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Final

from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.transforms import StepCounter

from aslip.envs import RewardSource
from aslip.envs.edit import Stack
from aslip.library import PAPER_SPEEDS, GaitLibrary
from aslip.transforms import (
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    ClockInput,
    EpisodeSum,
    EstimatedState,
    Fall,
    Feedforward,
    FirstStep,
    HeadingFrame,
    LastAction,
    LowReward,
    ObservationNoise,
    PhaseClock,
    RandomCommand,
    ReferenceDistance,
    ReferenceInjection,
    ReferenceStart,
    RewardTerm,
    SpeedCommand,
    WeightedReward,
    rewards,
    single_reference,
)
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.transforms.single_reference import KNEELING_HEIGHT, SINGLE_REFERENCE_WEIGHTS

# groups with the same entries in the same frame, the heading frame
REWARD_SOURCES: Final[Mapping[RewardSource, str]] = MappingProxyType(
    {"truth": "true_odometry", "estimate": "odometry"}
)

MAX_EPISODE_STEPS = 400
"""Policy steps of an episode, 12 s (Sec. IV-B)."""


def reward_terms(reward_on: RewardSource = "truth") -> Stack:
    """Five reward terms of the paper, by its names (Sec. IV-B).

    Args:
        reward_on: source of pelvis and feet: the simulator's truth or the estimator's odometry.
    """
    source = REWARD_SOURCES[reward_on]

    def body(*names: str) -> list[NestedKey]:
        return [(source, name) for name in names]

    def target(*names: str) -> list[NestedKey]:
        return [("target", name) for name in names]

    feet = ("left_foot_position", "right_foot_position")
    reads = {
        rewards.com_vel: (body("pelvis_orientation", "pelvis_velocity"), target("body_velocity")),
        rewards.foot_pos: (body("pelvis_orientation", "pelvis_position", *feet), target(*feet)),
        rewards.straight_diff: (body("pelvis_position"), ()),
        rewards.foot_orient: (body("left_foot_orientation", "right_foot_orientation"), ()),
    }
    return terms_of({**reads, rewards.action_diff: ((), ("action", "last_action"))})


def terms_of(reads: Mapping[Callable[..., Tensor], Sequence[Sequence[NestedKey]]]) -> Stack:
    """Reward terms by the names of their functions.

    Args:
        reads: function -> entries after and before the step that it reads, see `RewardTerm`.
    """
    return {
        function.__name__: RewardTerm(function.__name__, function, *keys)
        for function, keys in reads.items()
    }


def default_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """Default stack in order: name -> transform.

    It is the paper's stack with a feedforward torque that compensates load and damping
    (`Feedforward`); see `paper_stack`.

    The policy never observes the true state, but an estimate from noisy sensors. Rewards read the
    true state, a privileged input, or with `reward_on="estimate"` the estimator's odometry. Drop
    `step_limit` if a collector limits episodes by `max_frames_per_traj`.

    Args:
        library: gait library, the shipped one by default.
        reward_on: source of pelvis and feet in the rewards.
    """
    library = shipped_library("gaits") if library is None else library
    return stack_of(library, SpeedCommand(library), reward_on)


def stack_of(library: GaitLibrary, command: RandomCommand, reward_on: RewardSource) -> Stack:
    """Default stack with another library and other commands.

    Args:
        library: gait library.
        command: transform that draws commands in its region.
        reward_on: source of pelvis and feet in the rewards.
    """
    return {
        "start": ReferenceStart(library),
        "command": command,
        "clock": PhaseClock(library),
        "reference": ReferenceInjection(library),
        "feedforward": Feedforward(),
        "heading": HeadingFrame(),
        "noise": ObservationNoise(),
        "estimator": EstimatedState(),
        "observation": AssembleObservation(),
        "action": ActionDelta(("reference", "motor_target")),
        "last_action": LastAction(),
        **reward_terms(reward_on),
        "reward": WeightedReward(PAPER_WEIGHTS),
        "fall": Fall(),
        "low_reward": LowReward(),
        "step_limit": StepCounter(MAX_EPISODE_STEPS),
        "first_step": FirstStep(),
        "episode_sum": EpisodeSum(),
    }


def paper_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """Stack of the paper: actions are added to the motor angles of the reference."""
    stack = default_stack(library, reward_on)
    del stack["feedforward"]
    # actions must also compensate the lag of the PD loops: up to 1.8 rad with the shipped baseline
    stack["action"] = ActionDelta(limit=2.0)
    return stack


def single_reference_stack(
    library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
    """Stack of the paper's baseline: the method of Xie et al. 2018 on our robot and sensors.

    One motion in joint space is the reference at every speed; the command scales only its forward
    distance. The policy observes clock and speed instead of a reduced-order model.

    Args:
        library: library with one motion, see `aslip.library.single_reference_library`; the shipped
            one of a pendulum by default.
        reward_on: source of pelvis and feet in the rewards; joints and springs are always true.
    """
    library = shipped_library("single_reference") if library is None else library
    source = REWARD_SOURCES[reward_on]
    feet = ("left_foot_velocity", "right_foot_velocity")
    own = single_reference
    reads: dict[Callable[..., Tensor], tuple[list[NestedKey], list[NestedKey]]] = {
        # motor angles of the reference are one policy step ahead
        own.joints: ([("truth", "qpos")], [("reference", "motor_position")]),
        own.pelvis: (
            [(source, "pelvis_position")],
            [("target", "body_position"), ("target", "distance")],
        ),
        own.upright: ([(source, "pelvis_orientation")], []),
        own.springs: ([("truth", "qpos")], [("target", foot) for foot in feet]),
    }
    stack: Stack = {}
    for name, transform in paper_stack(library, reward_on).items():
        if name == "observation":
            stack |= {"clock_input": ClockInput(), "reference_distance": ReferenceDistance()}
        if name == "reward":
            stack |= terms_of(reads)
        if name not in PAPER_WEIGHTS:
            stack[name] = transform
    stack["observation"] = AssembleObservation(SINGLE_REFERENCE_TABLE)
    stack["reward"] = WeightedReward(SINGLE_REFERENCE_WEIGHTS)
    stack["fall"] = Fall(KNEELING_HEIGHT)
    # the library has rows for both ends of the speed range only
    stack["command"] = SpeedCommand(library, PAPER_SPEEDS)
    return stack


@functools.cache
def shipped_library(name: str) -> GaitLibrary:
    """Shipped library by name, read once; see `GaitLibrary.load`."""
    return GaitLibrary.load(name)
