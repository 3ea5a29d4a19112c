"""Environment with named and seeded transforms."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from typing import Any, cast

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import (
    Compose,
    ExcludeTransform,
    FrameSkipTransform,
    RewardSum,
    Transform,
)

from aslip.base.checks import check_count
from aslip.base.decorators import on_cpu_in_single
from aslip.envs.edit import needs_simulation
from aslip.envs.robot_env import RobotEnv
from aslip.envs.simulated_env import SimulatedEnv, reset_request
from aslip.errors import ConfigurationError
from aslip.transforms import (
    ActionDelta,
    EpisodeSum,
    EstimatedState,
    LastAction,
    LowReward,
    ObservationNoise,
    RewardTerm,
    SeededTransform,
    WeightedReward,
)
from aslip.transforms.base import require_keys


class StackEnv(TransformedEnv):
    """Transformed environment with named transforms, which `set_seed` seeds, too.

    Args:
        env: environment of the robots.
        transforms: name -> transform, first to last.
    """

    # usually; in general a RobotEnv
    base_env: SimulatedEnv

    # EnvBase's reads the specs of this environment; TransformedEnv's fails if another environment
    # wraps this one
    rand_action = EnvBase.rand_action

    __reduce_ex__ = RobotEnv.__reduce_ex__

    place = torch.device("cpu")

    def __init__(self, env: RobotEnv, transforms: Mapping[str, Transform]) -> None:
        self.place = env.place
        self._build(env, transforms)

    @on_cpu_in_single
    def _build(self, env: RobotEnv, transforms: Mapping[str, Transform]) -> None:
        _move(transforms.values(), env.place)
        compose = Compose(*transforms.values())  # pyright: ignore[reportArgumentType]
        super().__init__(env, compose)
        self.transform_names = tuple(transforms)
        for transform in transforms.values():
            _check_foreign(transform, env)
        self.seed: int | None = None
        """Seed of the last call of `set_seed`."""
        # entries of the last step or reset
        self._latest: TensorDictBase | None = None

    @property
    def transforms(self) -> list[Transform]:
        """The transforms, first to last."""
        return list(cast("Compose", self.transform))

    @EnvBase.action_spec.setter
    def action_spec(self, value: TensorSpec) -> None:
        """Refuse to set the spec: it follows from the transforms.

        Raises:
            ConfigurationError: always.
        """
        raise ConfigurationError(
            f"the action spec follows from the transforms and cannot be {type(value).__name__};"
            ' bound it with make_env(replace={"action": ActionDelta(limit=...)}) and the stack\'s'
            " own baseline_key"
        )

    def append_transform(
        self, transform: Transform | Callable[[TensorDictBase], TensorDictBase]
    ) -> TransformedEnv:
        """Add a transform at the end, named after its class.

        Raises:
            ConfigurationError: the transform does not work in a stack.
        """
        _check_foreign(transform, self)
        _move([transform] if isinstance(transform, Transform) else [], self.place)
        before = self.transforms
        super().append_transform(transform)
        return self._renamed(before)

    def insert_transform(self, index: int, transform: Transform) -> TransformedEnv:
        """Add a transform before another, named after its class.

        Raises:
            ConfigurationError: the transform does not work in a stack.
        """
        _check_foreign(transform, self)
        _move([transform], self.place)
        before = self.transforms
        super().insert_transform(index, transform)
        return self._renamed(before)

    def _renamed(self, before: list[Transform]) -> TransformedEnv:
        """Name and seed the transforms that are not in `before`; return this environment."""
        known = {id(t): name for name, t in zip(self.transform_names, before, strict=True)}
        names: list[str] = []
        for transform in self.transforms:
            name = known.get(id(transform), type(transform).__name__)
            taken = [*known.values(), *names]
            while id(transform) not in known and name in taken:
                name += "_"
            if self.seed is not None and id(transform) not in known:
                _seed_transform(name, transform, self.seed)
            names.append(name)
        self.transform_names = tuple(names)
        return self

    @on_cpu_in_single
    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        if kwargs:
            raise ConfigurationError(
                f"reset takes no keyword {', '.join(kwargs)}; to choose commands or phases, call it"
                " with TensorDict(command=..., batch_size=...) with one number per robot, (n, 1)"
            )
        # random transforms need the number of robots; TorchRL is slow to compute it
        if tensordict is None:
            tensordict = TensorDict(batch_size=self.batch_size)
        # TransformedEnv._reset, but with initial states, dynamics and stones, not in state_spec
        state_keys = self.state_spec.keys(True, True)
        request = tensordict.select(
            *self.reset_keys, *state_keys, *_chosen(tensordict), strict=False
        )
        if "_reset" in request and self._latest is not None:
            # requests of collectors have nothing but the mask
            lacking = [key for key in state_keys if key not in request]
            request.update(self._latest.select(*lacking, strict=False))
        request = cast("TensorDictBase", self.transform._reset_env_preprocess(request))
        started = self.base_env._reset(request)
        self.base_env._complete_done(self.base_env.full_done_spec, started)
        started = self.transform._reset(request, started)
        self._latest = self._completed(tensordict, started)
        return started

    @on_cpu_in_single
    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._latest = super()._step(tensordict)
        return self._latest

    def _completed(self, request: TensorDictBase, started: TensorDictBase) -> TensorDictBase:
        """Entries of all robots after a reset; robots that go on keep their latest entries.

        TorchRL merges the reset into the request and writes zeros for entries that the request
        lacks, so those are added to it. Requests lack entries if transforms wrap a `ParallelEnv`,
        whose processes receive only the mask and the entries of `state_spec`.
        """
        mask, latest = request.get("_reset", None), self._latest
        if mask is None or latest is None or mask.all():
            return started
        lacking = [key for key in started.keys() if key not in request]  # noqa: SIM118
        request.update(latest.select(*lacking, strict=False))
        kept = latest.select(*started.keys(True, True), strict=False)
        return started.select(*kept.keys(True, True)).where(mask.reshape(-1), kept)

    @on_cpu_in_single
    def set_seed(self, seed: int | None = None, static_seed: bool = False) -> int | None:
        """Seed the environment, and every transform by its name.

        So the random numbers of a transform do not depend on the other transforms in the stack.

        Raises:
            ConfigurationError: the seed is not a whole number of 0 or more.
        """
        if seed is not None:
            self.seed = seed = check_seed(seed)
            for name, transform in zip(self.transform_names, self.transforms, strict=True):
                _seed_transform(name, transform, seed)
        return super().set_seed(seed, static_seed=static_seed)


def _move(transforms: Iterable[Transform], place: torch.device) -> None:
    """Move transforms to a device, with a copy of what they share, such as gait libraries."""
    if place.type == "cpu":
        return
    shared: dict[int, Any] = {}
    for transform in transforms:
        for part in transform.modules():
            if not isinstance(part, Transform):
                continue
            for name, child in part._modules.items():
                if child is not None and not isinstance(child, Transform):
                    moved = shared.get(id(child)) or deepcopy(child).to(place)
                    part._modules[name] = shared[id(child)] = moved
            vars(part).update({name: _moved(value, place) for name, value in vars(part).items()})
            part._buffers = _moved(part._buffers, place)
            if isinstance(part, SeededTransform):
                part.move(place)


def _moved(value: Any, place: torch.device) -> Any:
    """Tensor, or list, tuple or dict of such, on a device; other values themselves."""
    if isinstance(value, Tensor):
        return value.to(place)
    if type(value) is dict:
        return {key: _moved(item, place) for key, item in value.items()}
    return type(value)(_moved(v, place) for v in value) if type(value) in (list, tuple) else value


def _seed_transform(name: str, transform: Transform, seed: int) -> None:
    """Seed a transform, and those inside a `Compose`, by name and seed of the environment."""
    inside = (part for part in transform.modules() if isinstance(part, SeededTransform))
    for number, part in enumerate(inside):
        entropy = [seed, zlib.crc32(name.encode()), *[number] * (number > 0)]
        part.set_seed(int(np.random.SeedSequence(entropy).generate_state(1)[0]))


def _chosen(tensordict: TensorDictBase) -> list[tuple[str, str]]:
    """Keys of the initial states, dynamics and stones that the caller of a reset chooses.

    A request with a mask `_reset` chooses none: it is the tensordict of the episode that ends.
    """
    if "_reset" in tensordict:
        return []
    groups = ("initial", "dynamics", "course")
    return [(group, name) for group in groups for name in reset_request(tensordict, group)]


def _check_foreign(transform: object, env: EnvBase) -> None:
    """Refuse TorchRL transforms that do not work in a stack.

    Args:
        transform: any transform.
        env: environment that it is added to.

    Raises:
        ConfigurationError: the transform does not work; the message names an alternative.
    """
    if isinstance(transform, FrameSkipTransform):
        raise ConfigurationError(
            "FrameSkipTransform repeats a step from the same tensordict: the robot would advance by"
            f" {transform.frame_skip} policy steps, clock and estimator by one; call env.step again"
            " with the same action instead"
        )
    if isinstance(transform, ExcludeTransform):
        spec = env.observation_spec
        for key in transform.excluded_keys:
            if isinstance(spec.get(key, None), Composite):
                raise ConfigurationError(
                    f"ExcludeTransform cannot exclude the group {key!r}; exclude its entries:"
                    f" ExcludeTransform(*{_entries(key, spec)})"
                )


def _entries(group: NestedKey, spec: Composite) -> list[NestedKey]:
    """Full keys of the entries of a group."""
    parents = (group,) if isinstance(group, str) else group
    inside = spec[group].keys(True, True)
    return [(*parents, *((key,) if isinstance(key, str) else key)) for key in inside]


def random_seed() -> int:
    """Seed that no other environment has, from the system's entropy."""
    return int(np.random.SeedSequence().generate_state(1)[0])


def check_seed(seed: object) -> int:
    """Seed as a Python number; whole numbers of NumPy are seeds, too.

    Raises:
        ConfigurationError: the seed is not a whole number of 0 or more.
    """
    return check_count("seed", seed, least=0)


def check_wiring(env: StackEnv) -> None:
    """Check the order of the transforms and the entries that they read.

    Raises:
        ConfigurationError: a transform needs a simulated robot and this one is not, or has no
            effect at its place.
        UnknownNameError: a transform reads an entry that no other writes.
    """
    _check_simulation(env)
    available = env.full_observation_spec.clone()
    available.update(env.full_action_spec)
    available.update(env.full_reward_spec)
    available.update(env.full_done_spec)
    for i, (name, transform) in enumerate(zip(env.transform_names, env.transforms, strict=True)):
        if problem := _misplaced(transform, env.transforms[:i], env.transforms):
            raise ConfigurationError(f"{name!r} {problem}")
        if isinstance(transform, RewardTerm | ActionDelta | LastAction):
            require_keys(transform, available, transform.in_keys)


def _misplaced(transform: Transform, before: list[Transform], stack: list[Transform]) -> str:
    """Fault of a transform's place in a stack, as the end of a sentence; empty without one."""

    def has(some: list[Transform], kind: type[Transform]) -> bool:
        return any(isinstance(one, kind) for one in some)

    def rewarded(some: list[Transform]) -> bool:
        return any("reward" in one.out_keys for one in some)

    if isinstance(transform, RewardTerm) and has(before, WeightedReward):
        return 'comes after the sum; insert it with insert_before(stack, "reward", ...)'
    if getattr(transform, "must_be_last", False) and transform is not stack[-1]:
        return "must be the last transform, or its log misses the entries of later ones"
    # without any reward the sums are zero, which is right, but LowReward would end all episodes
    sums = isinstance(transform, EpisodeSum | RewardSum) and rewarded(stack)
    if (sums or isinstance(transform, LowReward)) and not rewarded(before):
        return "reads a reward that no transform before it writes; drop it, too"
    if isinstance(transform, ObservationNoise) and has(before, EstimatedState):
        return (
            "comes after the estimator and would have no effect; insert it with"
            ' insert_before(stack, "estimator", ...)'
        )
    return ""


def _check_simulation(env: StackEnv) -> None:
    """Refuse transforms that need a simulated robot around one that is not.

    Raises:
        ConfigurationError: a transform needs a simulation, see `needs_simulation`.
    """
    if isinstance(env.base_env, SimulatedEnv) or "truth" in env.base_env.observation_spec:
        return
    for name, transform in zip(env.transform_names, env.transforms, strict=True):
        if needs_simulation(transform):
            raise ConfigurationError(
                f"{name!r} ({type(transform).__name__}) needs a simulated robot, which"
                f" {type(env.base_env).__name__} is not; stack=robot_stack() has no such transforms"
            )
