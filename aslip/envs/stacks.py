"""Stacks by name: the default, the paper's, its baseline's, and those for all directions."""

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
    DYNAMICS_RANGES,
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    ClockInput,
    EncoderOffsets,
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
    RandomPushes,
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
from aslip.transforms.rewards import DIRECTION_WEIGHTS, PAPER_WEIGHTS
from aslip.transforms.single_reference import KNEELING_HEIGHT, SINGLE_REFERENCE_WEIGHTS

# groups with the same entries in the same frame, the heading frame
REWARD_SOURCES: Final[Mapping[RewardSource, str]] = MappingProxyType(
    {"truth": "true_odometry", "estimate": "odometry"}
)

Stack = dict[str, Callable[[], Transform]]
"""Name -> function that makes a transform, first to last."""

MAX_EPISODE_STEPS = 400
"""Policy steps of an episode, 12 s (Sec. IV-B)."""

EPISODE_ENDS: Final = ("low_reward", "step_limit")
"""Transforms that end episodes without a fall; drop them to evaluate a policy."""

ON_TRUTH: Final[Mapping[str, Any]] = MappingProxyType(
    {"drop": ("noise",), "replace": {"estimator": TrueState}}
)
"""Arguments of `make_env` for policies that observe the true state instead of the estimate."""


def reward_terms(reward_on: RewardSource = "truth") -> Stack:
    """Five reward terms of the paper, by its names (Sec. IV-B).

    Args:
        reward_on: source of pelvis and feet: the simulator's truth or the estimator's odometry.
    """
    source = REWARD_SOURCES[reward_on]

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
    """Default stack in order: name -> function that makes the transform.

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
    """Stack of the paper: actions are added to the motor angles of the reference."""
    stack = default_stack(library, reward_on)
    del stack["feedforward"]
    # actions must also compensate the lag of the PD loops: up to 1.8 rad with the shipped baseline
    stack["action"] = lambda: ActionDelta(limit=2.0)
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
    terms: Stack = {
        "joints": lambda: RewardTerm(
            "joints",
            single_reference.joints,
            [("truth", "qpos")],
            # motor angles of the reference are one policy step ahead
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
    # the library has rows for both ends of the speed range only
    stack["command"] = lambda: SpeedCommand(library, PAPER_SPEEDS)
    return stack


@functools.cache
def shipped_library(name: str) -> GaitLibrary:
    """Shipped library by name, read once; see `GaitLibrary.load`."""
    return GaitLibrary.load(name)


TURNING: Final = ("directions", "standing")
"""Names of the stacks for walks in all directions."""


def _turning(
    name: str, library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
    """Stack of `aslip.envs.directions` by name.

    Raises:
        ConfigurationError: commands of the library do not have three numbers, or it has no stop and
            start to stand.
    """
    from aslip.envs import directions  # imports this module

    make = {"directions": directions.directions_stack, "standing": directions.standing_stack}
    return make[name](library, reward_on)


STACKS: Final[Mapping[str, Callable[..., Stack]]] = {
    "default": default_stack,
    "paper": paper_stack,
    "single_reference": single_reference_stack,
    **{name: partial(_turning, name) for name in TURNING},
}
"""Name of a stack -> function of gait library and `reward_on` that makes it."""


_EVALUATION = (*PAPER_WEIGHTS, "reward", "fall", "low_reward", "step_limit", "episode_sum")
"""Transforms of the default stack that compute rewards or end episodes."""


def randomise_stack(
    stack: Stack, ranges: Mapping[str, tuple[float, float]] = DYNAMICS_RANGES
) -> Stack:
    """Copy of a stack with domain randomisation.

    Each reset draws the dynamics and, if the stack has `ObservationNoise`, a factor on its level.

    Args:
        stack: the stack.
        ranges: parameter -> least and greatest value; `sensor_noise` among them if the stack has
            sensor noise.

    Raises:
        ConfigurationError: `stack` is a name, or randomised already.
        UnknownNameError: the stack has no transform `start`.
    """
    stack = insert_before(stack, "start", dynamics=partial(RandomDynamics, ranges))
    return _replace_makers(stack, ObservationNoise, RandomNoise)


def _replace_makers(stack: Stack, old: type[Transform], new: type[Transform]) -> Stack:
    """Copy of a stack with one class in place of another, with the same arguments."""

    def other(make: Callable[[], Transform]) -> Callable[[], Transform]:
        if isinstance(make, partial) and make.func is old:
            return partial(new, *make.args, **make.keywords)
        return new if make is old else make

    return {name: other(make) for name, make in stack.items()}


def robot_stack(stack: Stack | None = None) -> Stack:
    """Copy of a stack for a real robot or a replayed log.

    Transforms that need a simulation (`needs_simulation`) are left out, and `ObservationNoise`, as
    real sensors have their own noise.

    Args:
        stack: `default_stack(reward_on="estimate")` by default.

    Raises:
        ConfigurationError: `stack` is a name.
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
    """Make a transform; reward terms read `terminated` in place of the simulator's `diverged`."""
    made = make()
    if not isinstance(made, RewardTerm):
        return made
    name = str(made.out_keys[0][-1])
    return RewardTerm(
        name, made.function, made.next_keys, made.root_keys, diverged_key="terminated"
    )


def needs_simulation(transform: Transform) -> bool:
    """True for a transform that reads the truth, or changes the state or the simulated robot."""
    groups = {key if isinstance(key, str) else key[0] for key in transform.in_keys}
    chooses = isinstance(transform, ReferenceStart | RandomDynamics | EncoderOffsets | RandomPushes)
    return chooses or bool(groups & {"truth", "true_odometry"})


def evaluation_stack(stack: Stack, library: GaitLibrary | None = None) -> Stack:
    """Copy of a stack for evaluation, with the same task and rewards for every experiment.

    Observation and action baseline are those of the given stack, whose own reward terms are left
    out. Robot, start, rewards and ends of episodes are those of `default_stack()`, or of
    `directions_stack(library)`, whose commands are walked; the rewards compare with its gaits, even
    if the policy observes another motion. A stack that stands keeps standing.

    Args:
        stack: the stack.
        library: library over three commands, for walks in all directions.

    Raises:
        ConfigurationError: `stack` is a name, or commands of the library do not have three numbers.
        UnknownNameError: the stack has no transform `start`.
    """
    _require_names(stack, ["start"])
    common, names = default_stack(), [*_EVALUATION]
    if library is not None:
        common = STACKS["standing" if "stand" in stack else "directions"](library)
        names = [name for name in common if name in {*names, *DIRECTION_WEIGHTS}]
    evaluation = {name: common[name] for name in ("start", *names)}
    trained = {"difficulty", "dynamics", "encoders", "pushes", "privileged"}
    seen = {name: make for name, make in stack.items() if name not in trained | {*evaluation}}
    # the noise of a nominal robot
    seen = _replace_makers(seen, RandomNoise, ObservationNoise)
    seen = {name: make for name, make in seen.items() if not isinstance(make(), RewardTerm)}
    judging: dict[str, Any] = {"out_keys": ("judge", "goal")}
    if library is not None:
        seen["command"] = common["command"]
        judging["in_keys"] = ["filtered_command", "phase"]
        judging["in_keys"] += ["mode", "stand"] if "stand" in stack else []
    goal = partial(ReferenceInjection, library or shipped_library("gaits"), **judging)
    return {"start": evaluation.pop("start"), **seen, "judge": goal, **evaluation}


def insert_before(stack: Stack, name: str, **new: Callable[[], Transform]) -> Stack:
    """Copy of a stack with more transforms, inserted before the named one.

    Raises:
        ConfigurationError: `stack` is a name, or has a new transform's name already.
        UnknownNameError: the stack has no transform of that name.
    """
    _require_names(stack, [name])
    if taken := sorted(new.keys() & stack.keys()):
        raise ConfigurationError(f"the stack has {taken} already; choose other names")
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
    """Copy of a stack with some transforms dropped and some replaced.

    Raises:
        UnknownNameError: the stack has no transform of that name.
    """
    drop = [drop] if isinstance(drop, str) else list(drop)
    _require_names(stack, [*drop, *replace])
    return {name: replace.get(name, make) for name, make in stack.items() if name not in drop}


def _require_names(stack: Stack, names: Iterable[str]) -> None:
    """Check that a stack has transforms of these names.

    Raises:
        ConfigurationError: `stack` is a name.
        UnknownNameError: a transform is missing; the message suggests the nearest name.
    """
    if isinstance(stack, str):
        raise ConfigurationError(
            f"stack must be a stack, such as default_stack(), not the name {stack!r}"
        )
    for name in names:
        if name not in stack:
            raise UnknownNameError.among("transform", name, stack)
