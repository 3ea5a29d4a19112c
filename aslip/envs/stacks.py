"""Stacks by name: the default, the paper's own, and the paper's baseline."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from tensordict.utils import NestedKey
from torchrl.envs.transforms import StepCounter, Transform

from aslip.envs import RewardSource
from aslip.errors import ConfigurationError, UnknownNameError
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
    RandomDynamics,
    RandomNoise,
    ReferenceDistance,
    ReferenceInjection,
    ReferenceStart,
    RewardTerm,
    SpeedCommand,
    TrueState,
    WeightedReward,
    rewards,
    single_reference,
)
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.transforms.single_reference import KNEELING_HEIGHT, SINGLE_REFERENCE_WEIGHTS

# entries of one name in one frame, the robot's heading frame
_REWARD_SOURCES: Final[Mapping[RewardSource, str]] = MappingProxyType(
    {"truth": "true_odometry", "estimate": "odometry"}
)

Stack = dict[str, Callable[[], Transform]]
"""Name -> what makes a transform, first to last."""

MAX_EPISODE_STEPS = 400
"""Policy steps of an episode, 12 s (Sec. IV-B)."""

EPISODE_ENDS: Final = ("low_reward", "step_limit")
"""Transforms that end training episodes though nobody fell; to watch a robot, leave them out."""

ON_TRUTH: Final[Mapping[str, Any]] = MappingProxyType(
    {"drop": ("noise",), "replace": {"estimator": TrueState}}
)
"""What to tell `make_env` for a policy that sees the simulator's truth instead of an estimate."""


def reward_terms(reward_on: RewardSource = "truth") -> Stack:
    """The paper's five reward terms, by their names there (Sec. IV-B).

    Args:
        reward_on: where pelvis and feet are taken from, the simulator's truth or the odometry of
            the state estimator.
    """
    source = _REWARD_SOURCES[reward_on]

    def body(*names: str) -> list[NestedKey]:
        return [(source, name) for name in names]

    def goal(*names: str) -> list[NestedKey]:
        return [("goal", name) for name in names]

    feet = ("left_foot_position", "right_foot_position")
    reads = {
        rewards.com_vel: (body("pelvis_orientation", "pelvis_velocity"), goal("body_velocity")),
        rewards.foot_pos: (body("pelvis_orientation", "pelvis_position", *feet), goal(*feet)),
        rewards.straight_diff: (body("pelvis_position"), ()),
        rewards.foot_orient: (body("left_foot_orientation", "right_foot_orientation"), ()),
    }
    terms: Stack = {
        function.__name__: partial(RewardTerm, function.__name__, function, *keys)
        for function, keys in reads.items()
    }
    terms["action_diff"] = lambda: RewardTerm(
        "action_diff", rewards.action_diff, [], root_keys=["action", "last_action"]
    )
    return terms


def default_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """The default stack in order: name -> what makes the transform.

    The paper's, but for motor targets that make up for load and damping (`Feedforward`), with which
    learning to walk takes a fraction of the samples; see `paper_stack`.

    The policy never sees the truth: its input is what a state estimator makes of noisy sensors.
    A collector's `max_frames_per_traj` counts on its own; with it, drop `step_limit`.

    Rewards read the truth, as usual when training in simulation, where the simulator knows what a
    robot could only guess; with `reward_on="estimate"` they read the estimator's odometry instead.

    Args:
        library: the gaits; the shipped ones by default.
        reward_on: what pelvis and feet are taken from.
    """
    library = _shipped() if library is None else library
    return {
        "start": lambda: ReferenceStart(library),
        "command": lambda: SpeedCommand(library),
        "clock": lambda: PhaseClock(library),
        "reference": lambda: ReferenceInjection(library),
        "feedforward": Feedforward,
        "heading": HeadingFrame,
        "noise": ObservationNoise,
        "estimator": EstimatedState,
        "observation": AssembleObservation,
        "action": lambda: ActionDelta(("reference", "motor_target")),
        "last_action": LastAction,
        **reward_terms(reward_on),
        "reward": lambda: WeightedReward(PAPER_WEIGHTS),
        "fall": Fall,
        "low_reward": LowReward,
        "step_limit": lambda: StepCounter(MAX_EPISODE_STEPS),
        "first_step": FirstStep,
        "episode_sum": EpisodeSum,
    }


def paper_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """The paper's own stack: actions are added to the reference's angles as they are."""
    stack = default_stack(library, reward_on)
    del stack["feedforward"]
    # the delta also makes up for how far PD loops lag behind: 1.8 rad with the shipped baseline
    stack["action"] = lambda: ActionDelta(limit=2.0)
    return stack


def single_reference_stack(
    library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
    """The paper's baseline in order: the method of Xie et al. 2018 on our robot and sensors.

    One motion in joint space is the reference at every speed, only its forward way is stretched by
    the command; the policy sees clock and speed instead of a reduced-order model.

    Args:
        library: of one motion, see `aslip.library.single_reference_library`; the shipped one of a
            pendulum by default.
        reward_on: as for the default stack; joints and springs are always the truth's.
    """
    library = _pendulum() if library is None else library
    source = _REWARD_SOURCES[reward_on]
    feet = ("left_foot_velocity", "right_foot_velocity")
    terms: Stack = {
        "joints": lambda: RewardTerm(
            "joints",
            single_reference.joints,
            [("truth", "qpos")],
            # motor angles are read a policy step ahead: those of the past step are due now
            root_keys=[("reference", "motor_position")],
        ),
        "pelvis": lambda: RewardTerm(
            "pelvis",
            single_reference.pelvis,
            [(source, "pelvis_position")],
            root_keys=[("goal", "body_position"), ("goal", "distance")],
        ),
        "upright": lambda: RewardTerm(
            "upright", single_reference.upright, [(source, "pelvis_orientation")]
        ),
        "springs": lambda: RewardTerm(
            "springs",
            single_reference.springs,
            [("truth", "qpos")],
            root_keys=[("goal", foot) for foot in feet],
        ),
    }
    stack: Stack = {}
    for name, make in paper_stack(library, reward_on).items():
        if name == "observation":
            stack["clock_input"], stack["reference_distance"] = ClockInput, ReferenceDistance
        if name == "reward":
            stack |= terms
        if name not in PAPER_WEIGHTS:
            stack[name] = make
    stack["observation"] = lambda: AssembleObservation(SINGLE_REFERENCE_TABLE)
    stack["reward"] = lambda: WeightedReward(SINGLE_REFERENCE_WEIGHTS)
    stack["fall"] = lambda: Fall(KNEELING_HEIGHT)
    # the library has a row for each end of the range only
    stack["command"] = lambda: SpeedCommand(library, PAPER_SPEEDS)
    return stack


@functools.cache
def _shipped() -> GaitLibrary:
    return GaitLibrary.load()


@functools.cache
def _pendulum() -> GaitLibrary:
    return GaitLibrary.load("single_reference")


STACKS: Final[Mapping[str, Callable[..., Stack]]] = {
    "aslip": default_stack,
    "paper": paper_stack,
    "single_reference": single_reference_stack,
}
"""Stacks by name: a function of gait library and `reward_on`."""


_EVALUATION = (*PAPER_WEIGHTS, "reward", "fall", "low_reward", "step_limit", "episode_sum")
"""Transforms of the default stack that reward a robot or end its episode."""


def randomise_stack(stack: Stack) -> Stack:
    """A copy of a stack with domain randomisation: robots differ from episode to episode.

    Dynamics and, if there is sensor noise, its levels are drawn from
    `aslip.transforms.DYNAMICS_RANGES` at each reset.

    Raises:
        ConfigurationError: `stack` is a name instead of a stack, or randomised already.
        UnknownNameError: it has no transform `start`.
    """
    stack = insert_before(stack, "start", dynamics=RandomDynamics)
    return {name: RandomNoise if name == "noise" else make for name, make in stack.items()}


def robot_stack(stack: Stack | None = None) -> Stack:
    """A copy of a stack for robots that are no simulation: a real one, a replayed log.

    It is without transforms that need a simulation, see `needs_simulation`, and without
    `ObservationNoise`: the sensors of a robot have noise of their own.

    Args:
        stack: `default_stack(reward_on="estimate")` by default.

    Raises:
        ConfigurationError: `stack` is a name instead of a stack.
    """
    stack = default_stack(reward_on="estimate") if stack is None else stack
    _require_names(stack, [])
    makers = {name: partial(_make_for_robot, make) for name, make in stack.items()}
    made = {name: make() for name, make in makers.items()}
    return {
        name: makers[name] if isinstance(transform, RewardTerm) else stack[name]
        for name, transform in made.items()
        if not needs_simulation(transform) and not isinstance(transform, ObservationNoise)
    }


def _make_for_robot(make: Callable[[], Transform]) -> Transform:
    """Make a transform; a reward term reads that a robot has stopped, not that it diverged."""
    made = make()
    if not isinstance(made, RewardTerm):
        return made
    name = str(made.out_keys[0][-1])
    return RewardTerm(
        name, made.function, made.next_keys, made.root_keys, diverged_key="terminated"
    )


def needs_simulation(transform: Transform) -> bool:
    """True for a transform that reads the truth, or chooses how a simulation starts."""
    groups = {key if isinstance(key, str) else key[0] for key in transform.in_keys}
    chooses = isinstance(transform, ReferenceStart | RandomDynamics)
    return chooses or bool(groups & {"truth", "true_odometry"})


def evaluation_stack(stack: Stack) -> Stack:
    """A copy of a stack for evaluation: policies of all experiments get the same task and reward.

    What a policy observes and what its action is added to stay the stack's own. The robot, where it
    starts, rewards and ends of episodes are those of `default_stack()`; its gaits are the goal of
    the rewards, also where the policy sees another model's motion.

    Raises:
        ConfigurationError: `stack` is a name instead of a stack.
        UnknownNameError: it has no transform `start`.
    """
    _require_names(stack, ["start"])
    common = default_stack()
    judges = {name: common[name] for name in ("start", *_EVALUATION)}
    seen = {name: make for name, make in stack.items() if name not in {"dynamics", *judges}}
    goal = partial(ReferenceInjection, GaitLibrary.load(), out_keys=("judge", "goal"))
    return {"start": judges.pop("start"), **seen, "judge": goal, **judges}


def insert_before(stack: Stack, name: str, **new: Callable[[], Transform]) -> Stack:
    """A copy of a stack with more transforms, in front of the named one.

    Raises:
        ConfigurationError: `stack` is a name instead of a stack, or has a new transform's name.
        UnknownNameError: the stack has no transform of that name.
    """
    _require_names(stack, [name])
    if taken := sorted(new.keys() & stack.keys()):
        raise ConfigurationError(f"the stack has {taken} already; assign, or take other names")
    longer: Stack = {}
    for key, make in stack.items():
        if key == name:
            longer |= new
        longer[key] = make
    return longer


def edit_stack(
    stack: Stack,
    drop: Iterable[str],
    replace: Mapping[str, Transform | Callable[[], Transform]],
) -> dict[str, Transform | Callable[[], Transform]]:
    """A copy of a stack without some transforms, and with something else for others.

    Raises:
        UnknownNameError: the stack has no transform of such a name.
    """
    drop = [drop] if isinstance(drop, str) else list(drop)
    _require_names(stack, [*drop, *replace])
    return {name: replace.get(name, make) for name, make in stack.items() if name not in drop}


def _require_names(stack: Stack, names: Iterable[str]) -> None:
    """Check that a stack has transforms of these names.

    Raises:
        ConfigurationError: it is the name of a stack.
        UnknownNameError: it lacks one; the message has the nearest name and all others.
    """
    if isinstance(stack, str):
        raise ConfigurationError(
            f"{stack!r} is the name of a stack, give the stack itself, such as default_stack()"
        )
    for name in names:
        if name not in stack:
            raise UnknownNameError.among("transform", name, stack)
