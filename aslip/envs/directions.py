"""Stack for walks in all directions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from types import MappingProxyType
from typing import Final

from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs.transforms import Transform

from aslip.envs import RewardSource
from aslip.envs.stacks import Stack, default_stack, insert_before, shipped_library
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.transforms import (
    DIRECTION_TABLE,
    AssembleObservation,
    CommandFilter,
    EstimatedState,
    HeadingFrame,
    PhaseClock,
    ReferenceInjection,
    ReferenceStart,
    RewardTerm,
    StandClock,
    StandCommand,
    StandFilter,
    VelocityCommand,
    WeightedReward,
    rewards,
)
from aslip.transforms.rewards import DIRECTION_WEIGHTS
from aslip.transforms.standing import transitions_of

# headings of the goal that reward terms read on turns
_HEADINGS: Final = MappingProxyType(
    {
        "com_vel": ("body_heading",),
        "foot_pos": ("body_heading",),
        "foot_orient": ("left_foot_heading", "right_foot_heading"),
    }
)
_STEER: Final = "filtered_command"


def directions_stack(
    library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
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
    stack = default_stack(library, reward_on) | {
        "command": lambda: VelocityCommand(library),
        "clock": lambda: PhaseClock(library, in_keys=[_STEER]),
        "reference": lambda: ReferenceInjection(library, in_keys=[_STEER, "phase"]),
        "heading": lambda: HeadingFrame(command_key=_STEER),
        "estimator": lambda: EstimatedState(command_key=_STEER),
        "observation": lambda: AssembleObservation(DIRECTION_TABLE),
        "reward": lambda: WeightedReward(DIRECTION_WEIGHTS),
    }
    # the observation has the last action
    moved = {name: stack.pop(name) for name in ("action", "last_action")}
    stack = insert_before(stack, "observation", **moved)
    for name in _HEADINGS:
        stack[name] = partial(_turning_term, stack[name])
    stack = insert_before(stack, "clock", command_filter=CommandFilter)
    stack = insert_before(stack, "straight_diff", **_terms())
    return {name: make for name, make in stack.items() if name != "straight_diff"}


def _terms() -> Stack:
    """Reward terms that the paper does not have."""
    reads: dict[Callable[..., Tensor], tuple[list[NestedKey], list[NestedKey]]] = {
        # the policy observes estimates of both; the true ones drift away with the odometry
        rewards.path_diff: ([("odometry", "path_error")], [("goal", "body_position")]),
        rewards.heading_diff: ([("odometry", "pelvis_orientation")], [("goal", "body_heading")]),
        rewards.power: ([("truth", "motor_power")], [_STEER]),
        rewards.landing: ([("truth", "largest_force")], []),
        rewards.squeeze: ([("truth", "ground_force")], []),
    }
    return {
        function.__name__: partial(RewardTerm, function.__name__, function, *keys)
        for function, keys in reads.items()
    }


def standing_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """Stack of `directions_stack` in which robots also stand, stop and start (`StandClock`).

    Args:
        library: gait library over three commands, with stop and start; the shipped one by default.
        reward_on: source of pelvis and feet in the rewards.

    Raises:
        ConfigurationError: commands of the library do not have three numbers, or it has no stop and
            start.
    """
    library = shipped_library("directions") if library is None else library
    transitions_of(library)
    steered: list[NestedKey] = [_STEER, "phase", "mode", "stand"]
    stack = directions_stack(library, reward_on) | {
        "start": lambda: ReferenceStart(library, in_keys=["command", "phase", "mode"]),
        "command_filter": StandFilter,
        "clock": lambda: StandClock(library),
        "reference": lambda: ReferenceInjection(library, in_keys=steered),
        "heading": lambda: HeadingFrame(command_key=_STEER, mode_key="mode"),
        "estimator": lambda: EstimatedState(command_key=_STEER, mode_key="mode"),
    }
    return insert_before(stack, "reference", stand=StandCommand)


def _turning_term(make: Callable[[], Transform]) -> RewardTerm:
    """Make a reward term for turns: it reads headings of the goal, too."""
    term = make()
    assert isinstance(term, RewardTerm)
    name = str(term.out_keys[0][-1])
    goals: list[NestedKey] = [("goal", heading) for heading in _HEADINGS[name]]
    return RewardTerm(name, term.function, term.next_keys, [*term.root_keys, *goals])
