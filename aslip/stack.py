"""The environment most people want: a backend and a stack of transforms.

An experiment is a stack that differs from the default one in a line or two:

    make_env(drop=["foot_orient"])                               # ablate a reward term
    make_env(replace={"reward": WeightedReward({...})})          # weigh the terms otherwise
    make_env(replace={"start": ReferenceStart(library, "rest")}) # start at rest
    make_env(replace={"estimator": TrueState()})                 # perfect knowledge of the state
    make_env(drop=["noise"])                                     # perfect sensors
    make_env(reward_on="estimate")                               # reward what the robot knows
    make_env(stack=insert_before(stack, "reward", my_term=...))  # one more term
    make_env(stack=randomised(default_stack()))                  # robots that differ
    make_env(stack="paper")                                      # the paper to the letter
    make_env(stack="single_reference")                           # what the paper compares with

A stack is an ordered dict of names and transforms. It is never edited in place once it belongs to
an environment, where TorchRL would keep stale specs; build another.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from numbers import Integral
from types import MappingProxyType
from typing import Any, Final, Literal, cast, get_args

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose, RewardSum, StepCounter, Transform

from aslip import rewards, single_reference
from aslip.cassie import PHYSICS_TIMESTEP
from aslip.cassie.model import DEFAULT_FLOOR_FRICTION
from aslip.envs import BatchCassieEnv, CassieEnv, DmControlCassieEnv
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary, single_reference_library
from aslip.library.build import PAPER_SPEEDS
from aslip.rewards import PAPER_WEIGHTS
from aslip.single_reference import KNEELING_HEIGHT, SINGLE_REFERENCE_WEIGHTS
from aslip.transforms import (
    SINGLE_REFERENCE_TABLE,
    ActionDelta,
    AssembleObservation,
    CassieTransform,
    ClockInput,
    EstimatedState,
    Fall,
    Feedforward,
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
)
from aslip.transforms.base import require_keys

Backend = Literal["batch", "dm_control"]

RewardSource = Literal["truth", "estimate"]

Stack = dict[str, Callable[[], Transform]]

MAX_EPISODE_STEPS = 400
"""Policy steps of an episode, 12 s (Sec. IV-B)."""

EPISODE_ENDS: Final = ("low_reward", "step_limit")
"""Transforms that end training episodes though nobody fell; to watch a robot, leave them out."""

ON_TRUTH: Final[Mapping[str, Any]] = MappingProxyType(
    {"drop": ("noise",), "replace": {"estimator": TrueState}}
)
"""What to tell `make_env` for a policy that sees the simulator's truth instead of an estimate."""


class CassieTransformedEnv(TransformedEnv):
    """A transformed environment whose transforms have names, and whose seed reaches them.

    Args:
        env: the environment.
        transforms: name -> transform, first to last.
    """

    base_env: CassieEnv

    def __init__(self, env: CassieEnv, transforms: Mapping[str, Transform]) -> None:
        compose = Compose(*transforms.values())  # pyright: ignore[reportArgumentType]
        super().__init__(env, compose)
        self.transform_names = tuple(transforms)
        self.seed: int | None = None
        """The last seed that was set."""

    @property
    def transforms(self) -> list[Transform]:
        """The transforms, first to last."""
        return list(cast("Compose", self.transform))

    def append_transform(
        self, transform: Transform | Callable[[TensorDictBase], TensorDictBase]
    ) -> TransformedEnv:
        """Add a transform at the end; it is named after its class."""
        before = self.transforms
        super().append_transform(transform)
        return self._renamed(before)

    def insert_transform(self, index: int, transform: Transform) -> TransformedEnv:
        """Add a transform in front of another; it is named after its class."""
        before = self.transforms
        super().insert_transform(index, transform)
        return self._renamed(before)

    def _renamed(self, before: list[Transform]) -> TransformedEnv:
        """This, when what came to the transforms there were `before` has names."""
        known = {id(t): name for name, t in zip(self.transform_names, before, strict=True)}
        names: list[str] = []
        for transform in self.transforms:
            name = known.get(id(transform), type(transform).__name__)
            taken = [*known.values(), *names]
            while id(transform) not in known and name in taken:
                name += "_"
            names.append(name)
        self.transform_names = tuple(names)
        return self

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        # transforms that draw need the number of robots, and asking TorchRL for it is slow
        if tensordict is None:
            tensordict = TensorDict(batch_size=self.batch_size)
        return super()._reset(tensordict, **kwargs)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the environment, and every transform by its name.

        A transform thus draws the same numbers whichever others are dropped or replaced.

        Raises:
            ConfigurationError: it is no whole number of 0 or more.
        """
        if seed is not None:
            self.seed = seed = check_seed(seed)
            for name, transform in zip(self.transform_names, self.transforms, strict=True):
                if isinstance(transform, CassieTransform):
                    entropy = np.random.SeedSequence([seed, zlib.crc32(name.encode())])
                    transform.set_seed(int(entropy.generate_state(1)[0]))
        return super().set_seed(seed, static_seed=static_seed)


def reward_terms(reward_on: RewardSource = "truth") -> Stack:
    """The paper's five reward terms, by their names there (Sec. IV-B).

    Args:
        reward_on: where pelvis and feet are taken from, the simulator's truth or the odometry of
            the state estimator.
    """
    source = "truth" if reward_on == "truth" else "odometry"

    def body(*names: str) -> list[NestedKey]:
        return [(source, name) for name in names]

    def reference(*names: str) -> list[NestedKey]:
        return [("reference", name) for name in names]

    feet = ("left_foot_position", "right_foot_position")
    reads = {
        rewards.com_vel: body("pelvis_orientation", "pelvis_velocity") + reference("body_velocity"),
        rewards.foot_pos: body("pelvis_orientation", "pelvis_position", *feet) + reference(*feet),
        rewards.straight_diff: body("pelvis_position"),
        rewards.foot_orient: body("left_foot_orientation", "right_foot_orientation"),
    }
    terms: Stack = {
        function.__name__: partial(RewardTerm, function.__name__, function, keys)
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
    Rewards read the truth, as usual when training in simulation, where the simulator knows what a
    robot could only guess; with `reward_on="estimate"` they read the estimator's odometry instead.

    Args:
        library: the gaits; the shipped ones by default.
        reward_on: what pelvis and feet are taken from.
    """
    library = GaitLibrary.load() if library is None else library
    return {
        "start": lambda: ReferenceStart(library),
        "command": lambda: SpeedCommand(library),
        "clock": lambda: PhaseClock(library),
        "reference": lambda: ReferenceInjection(library),
        "feedforward": Feedforward,
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
        "episode_sum": lambda: RewardSum(in_keys=["reward"], out_keys=["episode_reward"]),
    }


def paper_stack(library: GaitLibrary | None = None, reward_on: RewardSource = "truth") -> Stack:
    """The paper's own stack: actions are added to the reference's angles as they are."""
    stack = default_stack(library, reward_on)
    del stack["feedforward"]
    stack["action"] = ActionDelta
    return stack


def single_reference_stack(
    library: GaitLibrary | None = None, reward_on: RewardSource = "truth"
) -> Stack:
    """The paper's baseline in order: the method of Xie et al. 2018 on our robot and sensors.

    One motion in joint space is the reference at every speed, only its forward way is stretched by
    the command; the policy sees clock and speed instead of a reduced-order model.

    Args:
        library: of one motion, see `single_reference_library`; that of a pendulum by default.
        reward_on: as for the default stack; joints and springs are always the truth's.
    """
    library = _pendulum() if library is None else library
    source = "truth" if reward_on == "truth" else "odometry"
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
            [
                (source, "pelvis_position"),
                ("reference", "body_position"),
                ("reference", "distance"),
            ],
        ),
        "upright": lambda: RewardTerm(
            "upright", single_reference.upright, [(source, "pelvis_orientation")]
        ),
        "springs": lambda: RewardTerm(
            "springs",
            single_reference.springs,
            [("truth", "qpos"), *(("reference", foot) for foot in feet)],
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
def _pendulum() -> GaitLibrary:
    return single_reference_library()


STACKS: Final[Mapping[str, Callable[..., Stack]]] = {
    "aslip": default_stack,
    "paper": paper_stack,
    "single_reference": single_reference_stack,
}
"""Stacks by name: a function of gait library and `reward_on`."""


def acts_on(env: CassieTransformedEnv) -> str | None:
    """Name of the stack in `STACKS` that is the same to a policy; None if no stack is.

    Which rewards there are, when episodes end, and what robots and sensors are like makes no
    difference; what the policy observes, and what becomes of its action, does.
    """
    has = _interface(env.transforms)
    for name, make in STACKS.items():
        stack = make()
        if has == _interface([t() for t in stack.values()]):
            return name
    return None


# these change neither what a policy observes nor what becomes of its action
_NO_INTERFACE = (
    *(RewardTerm, WeightedReward, RewardSum, Fall, LowReward, StepCounter),
    *(ReferenceStart, SpeedCommand, RandomDynamics, ObservationNoise, EstimatedState, TrueState),
)


def _interface(transforms: Iterable[Transform]) -> list[tuple[Any, ...]]:
    """What transforms are to a policy, to be compared."""
    kept = [t for t in transforms if not isinstance(t, _NO_INTERFACE)]
    return [
        (type(t), t.in_keys, t.out_keys, _motion(getattr(t, "library", None)))
        for t in kept
        if t.in_keys or t.out_keys  # otherwise it only looks on
    ]


def _motion(library: GaitLibrary | None) -> list[list[float]]:
    """Numbers that tell a library from others: its motion at some points of the stride."""
    if library is None:
        return []
    lowest, *_, highest = library.speeds.tolist()
    points = torch.cartesian_prod(torch.arange(4) / 4, torch.linspace(lowest, highest, 3))
    motion = library.lookup(points[:, :1], points[:, 1:])
    return torch.cat([points, motion.motor_position, motion.body_velocity], dim=-1).tolist()


def randomised(stack: Stack) -> Stack:
    """A copy of a stack whose robots differ from episode to episode.

    Dynamics and, if there is sensor noise, its levels are drawn from
    `aslip.transforms.DYNAMICS_RANGES` at each reset.
    """
    stack = insert_before(stack, "start", dynamics=RandomDynamics)
    return {name: RandomNoise if name == "noise" else make for name, make in stack.items()}


def insert_before(stack: Stack, name: str, **new: Callable[[], Transform]) -> Stack:
    """A copy of a stack with more transforms, in front of the named one.

    Raises:
        UnknownNameError: the stack has no transform of that name.
    """
    _require_names(stack, [name])
    longer: Stack = {}
    for key, make in stack.items():
        if key == name:
            longer |= new
        longer[key] = make
    return longer


def make_env(
    backend: Backend = "batch",
    *,
    num_envs: int = 1,
    seed: int = 0,
    drop: Iterable[str] = (),
    replace: Mapping[str, Transform | Callable[[], Transform]] | None = None,
    stack: Stack | str = "aslip",
    reward_on: RewardSource = "truth",
    library: GaitLibrary | None = None,
    num_threads: int = 0,
    floor_friction: float = DEFAULT_FLOOR_FRICTION,
    timestep: float = PHYSICS_TIMESTEP,
) -> CassieTransformedEnv:
    """A TorchRL environment of n Cassies with the full stack of transforms.

    Args:
        backend: "batch" for training, "dm_control" for the reference task; same keys, same states.
        num_envs: number of robots n; all tensors have it as their first dimension.
        seed: reaches every random number, also inside transforms.
        drop: names of transforms to leave out. Without some reward terms the largest reward is
            smaller, while an episode still ends below 0.3: consider `LowReward` along with them.
        replace: name -> transform, or something that makes it, to take the place of another.
        stack: another stack altogether, or the name of one in `STACKS`.
        reward_on: what the rewards of a stack given by name read, "truth" or "estimate".
        library: gaits of a stack given by name; its own by default.
        num_threads: physics threads of the batch backend, 0 for all processors.
        floor_friction: sliding friction of the floor.
        timestep: of the batch backend's physics [s]: 0.0005, or 0.001 to train in half the time.

    Raises:
        ConfigurationError: unknown backend, a timestep that it cannot have, a number of
            environments or a seed that is none, a transform of another environment, settings of a
            named stack for one that is not, or transforms in an order in which one has no effect.
        UnknownNameError: there is no stack of that name, `drop` or `replace` names no transform of
            the stack, or a transform reads what no other writes.
    """
    if backend not in get_args(Backend):
        raise ConfigurationError(f"backend must be one of {get_args(Backend)}, got {backend!r}")
    if reward_on not in get_args(RewardSource):
        raise ConfigurationError(
            f"reward_on must be one of {get_args(RewardSource)}, got {reward_on!r}"
        )
    seed = check_seed(seed)
    if isinstance(stack, str):
        if stack not in STACKS:
            raise UnknownNameError.among("stack", stack, sorted(STACKS))
        stack = STACKS[stack](library, reward_on)
    elif library is not None or reward_on != "truth":
        raise ConfigurationError(
            "library and reward_on are for a stack that is given by name; give them to what makes"
            " the stack, such as default_stack(library, reward_on)"
        )
    drop = [drop] if isinstance(drop, str) else list(drop)
    chosen = _edited(stack, drop, dict(replace or {}))
    base: CassieEnv
    if backend == "batch":
        base = BatchCassieEnv(
            num_envs, num_threads=num_threads, floor_friction=floor_friction, timestep=timestep
        )
    else:
        if timestep != PHYSICS_TIMESTEP:
            raise ConfigurationError(
                f"the dm_control backend has a timestep of {PHYSICS_TIMESTEP} s, got {timestep!r}"
            )
        base = DmControlCassieEnv(num_envs, floor_friction=floor_friction)
    stack_of = {name: t if isinstance(t, Transform) else t() for name, t in chosen.items()}
    for name, transform in stack_of.items():
        if transform.container is not None:
            raise ConfigurationError(
                f"the transform {name!r} belongs to another environment; for several, give what"
                f" makes one: a class, or lambda: {type(transform).__name__}(...)"
            )
    env = CassieTransformedEnv(base, stack_of)
    _check_wiring(env)
    env.set_seed(seed)
    return env


def check_seed(seed: object) -> int:
    """A seed as a Python number, NumPy's included.

    Raises:
        ConfigurationError: it is no whole number of 0 or more.
    """
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise ConfigurationError(f"seed must be a whole number of 0 or more, got {seed!r}")
    return int(seed)


def _check_wiring(env: CassieTransformedEnv) -> None:
    """Check that what reward terms and the action read is there, before the first step needs it."""
    available = env.full_observation_spec.clone()
    available.update(env.full_action_spec)
    available.update(env.full_reward_spec)
    summed = rewarded = sensed = False
    ever_rewarded = any("reward" in transform.out_keys for transform in env.transforms)
    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        if isinstance(transform, RewardTerm) and summed:
            raise ConfigurationError(
                f"the reward term {transform.out_keys[0][-1]!r} comes after the sum and would not"
                ' count; insert_before(stack, "reward", ...) puts it in its place'
            )
        # a sum of nothing is right where there is no reward; an end of all episodes is not
        reads = isinstance(transform, LowReward) or (
            isinstance(transform, RewardSum) and ever_rewarded
        )
        if reads and not rewarded:
            raise ConfigurationError(
                f"no transform before {name!r} writes the reward that it reads; without one, drop"
                " it, too"
            )
        if isinstance(transform, ObservationNoise) and sensed:
            raise ConfigurationError(
                f"{name!r} comes after what reads the sensors and would have no effect;"
                ' insert_before(stack, "estimator", ...) puts it in its place'
            )
        summed |= isinstance(transform, WeightedReward)
        rewarded |= "reward" in transform.out_keys
        sensed |= isinstance(transform, EstimatedState)
        if isinstance(transform, RewardTerm | ActionDelta):
            require_keys(transform, available, transform.in_keys)
        if isinstance(transform, LastAction):
            require_keys(transform, available, ["action"])


def _edited(
    stack: Stack, drop: list[str], replace: dict[str, Transform | Callable[[], Transform]]
) -> dict[str, Transform | Callable[[], Transform]]:
    _require_names(stack, [*drop, *replace])
    return {name: replace.get(name, make) for name, make in stack.items() if name not in drop}


def _require_names(stack: Stack, names: Iterable[str]) -> None:
    """Check that a stack has transforms of these names.

    Raises:
        UnknownNameError: it lacks one; the message has the nearest name and all others.
    """
    for name in names:
        if name not in stack:
            raise UnknownNameError.among("transform", name, stack)
