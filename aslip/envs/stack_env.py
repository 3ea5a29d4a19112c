"""An environment whose transforms have names, and whose seed reaches them."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, TensorSpec
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import (
    Compose,
    ExcludeTransform,
    FrameSkipTransform,
    RewardSum,
    Transform,
)

from aslip.envs.robot_env import RobotEnv
from aslip.envs.simulated_env import SimulatedEnv, reset_request
from aslip.errors import ConfigurationError
from aslip.sim.checks import check_count
from aslip.transforms import (
    ActionDelta,
    EpisodeSum,
    EstimatedState,
    LastAction,
    LowReward,
    ObservationNoise,
    RandomDynamics,
    ReferenceStart,
    RewardTerm,
    SeededTransform,
    WeightedReward,
)
from aslip.transforms.base import require_keys


class StackEnv(TransformedEnv):
    """A transformed environment whose transforms have names, and whose seed reaches them.

    Args:
        env: the environment.
        transforms: name -> transform, first to last.
    """

    # in most stacks; else another RobotEnv
    base_env: SimulatedEnv

    # of this environment's own specs; TransformedEnv's, in an environment around this one, is
    # mistaken for one that an environment of its own kind has overwritten, and refused
    rand_action = EnvBase.rand_action

    __reduce_ex__ = RobotEnv.__reduce_ex__

    def __init__(self, env: RobotEnv, transforms: Mapping[str, Transform]) -> None:
        compose = Compose(*transforms.values())  # pyright: ignore[reportArgumentType]
        super().__init__(env, compose)
        self.transform_names = tuple(transforms)
        for transform in transforms.values():
            _check_foreign(transform, env)
        self.seed: int | None = None
        """The last seed that was set."""

    @property
    def transforms(self) -> list[Transform]:
        """The transforms, first to last."""
        return list(cast("Compose", self.transform))

    @EnvBase.action_spec.setter
    def action_spec(self, value: TensorSpec) -> None:
        """Refused: specs follow from the transforms, and the next one added would undo it."""
        raise ConfigurationError(
            f"the action spec follows from the transforms, so {type(value).__name__} cannot be set;"
            ' make_env(replace={"action": ActionDelta(limit=...)}) bounds it, with the baseline_key'
            " of the stack's own"
        )

    def append_transform(
        self, transform: Transform | Callable[[TensorDictBase], TensorDictBase]
    ) -> TransformedEnv:
        """Add a transform at the end; it is named after its class.

        Raises:
            ConfigurationError: the transform is one of TorchRL's that does not work in a stack.
        """
        _check_foreign(transform, self)
        before = self.transforms
        super().append_transform(transform)
        return self._renamed(before)

    def insert_transform(self, index: int, transform: Transform) -> TransformedEnv:
        """Add a transform in front of another; it is named after its class.

        Raises:
            ConfigurationError: the transform is one of TorchRL's that does not work in a stack.
        """
        _check_foreign(transform, self)
        before = self.transforms
        super().insert_transform(index, transform)
        return self._renamed(before)

    def _renamed(self, before: list[Transform]) -> TransformedEnv:
        """This environment, with names for transforms that were not there `before`."""
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
        if kwargs:
            raise ConfigurationError(
                f"reset takes no keyword {', '.join(kwargs)}; to choose commands or phases, give it"
                " TensorDict(command=..., batch_size=...) with one number a robot, (n, 1)"
            )
        # transforms that draw need the number of robots, and asking TorchRL for it is slow
        if tensordict is None:
            tensordict = TensorDict(batch_size=self.batch_size)
        # as TorchRL's, which would hand on nothing but the mask and what state_spec declares
        state_keys = self.state_spec.keys(True, True)
        request = tensordict.select(
            *self.reset_keys, *state_keys, *_chosen(tensordict), strict=False
        )
        request = cast("TensorDictBase", self.transform._reset_env_preprocess(request))
        started = self.base_env._reset(request)
        self.base_env._complete_done(self.base_env.full_done_spec, started)
        return self.transform._reset(request, started)

    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the environment, and every transform by its name.

        A transform thus draws the same numbers whichever others are dropped or replaced.

        Raises:
            ConfigurationError: the seed is not a whole number of at least 0.
        """
        if seed is not None:
            self.seed = seed = check_seed(seed)
            for name, transform in zip(self.transform_names, self.transforms, strict=True):
                if isinstance(transform, SeededTransform):
                    entropy = np.random.SeedSequence([seed, zlib.crc32(name.encode())])
                    transform.set_seed(int(entropy.generate_state(1)[0]))
        return super().set_seed(seed, static_seed=static_seed)


def _chosen(tensordict: TensorDictBase) -> list[tuple[str, str]]:
    """Keys with which the caller of a reset chooses starts and dynamics.

    A request that names robots to reset is a tensordict of the episode that ends, and what it holds
    is old, not chosen.
    """
    if "_reset" in tensordict:
        return []
    groups = ("initial", "dynamics")
    return [(group, name) for group in groups for name in reset_request(tensordict, group)]


def _check_foreign(transform: object, env: EnvBase) -> None:
    """Check that a transform of TorchRL's works with what the stack carries in the tensordict.

    Args:
        transform: the transform, ours or another.
        env: what it is added to.

    Raises:
        ConfigurationError: it does not; the message names what does.
    """
    if isinstance(transform, FrameSkipTransform):
        raise ConfigurationError(
            "FrameSkipTransform repeats a step from the same tensordict: the robot would move"
            f" {transform.frame_skip} policy steps, clock and estimator one; call env.step again"
            " with the same action instead"
        )
    if isinstance(transform, ExcludeTransform):
        spec = env.observation_spec
        for key in transform.excluded_keys:
            if isinstance(spec.get(key, None), Composite):
                raise ConfigurationError(
                    f"ExcludeTransform takes single entries, and {key!r} is a group; for all of"
                    f" them: ExcludeTransform(*{_entries(key, spec)})"
                )


def _entries(group: NestedKey, spec: Composite) -> list[NestedKey]:
    """Full keys of what is in a group."""
    parents = (group,) if isinstance(group, str) else group
    inside = spec[group].keys(True, True)
    return [(*parents, *((key,) if isinstance(key, str) else key)) for key in inside]


def check_seed(seed: object) -> int:
    """A seed as a Python number, NumPy's included.

    Raises:
        ConfigurationError: the seed is not a whole number of at least 0.
    """
    return check_count("seed", seed, least=0)


def check_wiring(env: StackEnv) -> None:
    """Check that what reward terms and the action read is there, before the first step needs it.

    Raises:
        ConfigurationError: a transform needs a simulation and the robot is none, or it is in a
            place where it has no effect.
        UnknownNameError: a transform reads what no other writes.
    """
    _check_simulation(env)
    available = env.full_observation_spec.clone()
    available.update(env.full_action_spec)
    available.update(env.full_reward_spec)
    available.update(env.full_done_spec)
    summed = rewarded = sensed = False
    ever_rewarded = any("reward" in transform.out_keys for transform in env.transforms)
    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        if isinstance(transform, RewardTerm) and summed:
            raise ConfigurationError(
                f"the reward term {transform.out_keys[0][-1]!r} comes after the sum and would not"
                ' count; insert_before(stack, "reward", ...) puts it in its place'
            )
        if getattr(transform, "must_be_last", False) and transform is not env.transforms[-1]:
            raise ConfigurationError(
                f"{name!r} must be the last transform, or what later ones write is not in its log;"
                f" the last one is {env.transform_names[-1]!r}"
            )
        # a sum of nothing is right where there is no reward; an end of all episodes is not
        reads = isinstance(transform, LowReward) or (
            isinstance(transform, EpisodeSum | RewardSum) and ever_rewarded
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
        if isinstance(transform, RewardTerm | ActionDelta | LastAction):
            require_keys(transform, available, transform.in_keys)


def _check_simulation(env: StackEnv) -> None:
    """Check that a robot which is no simulation has no transforms that need one.

    Raises:
        ConfigurationError: it has; the message names an entry that is missing.
    """
    if isinstance(env.base_env, SimulatedEnv):
        return
    entries = set(env.base_env.observation_spec.keys(True, True))
    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        truth = [key for key in transform.in_keys if key[0] == "truth" and key not in entries]
        if truth:
            lacks = f"reads {truth[0]!r}"
        elif isinstance(transform, ReferenceStart | RandomDynamics):
            lacks = "chooses the initial state or the dynamics"
        else:
            continue
        raise ConfigurationError(
            f"{name!r} ({type(transform).__name__}) {lacks}, which"
            f" {type(env.base_env).__name__} does not have; stack=robot_stack() leaves out all"
            " transforms that need a simulation"
        )
