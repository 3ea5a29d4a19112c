"""TorchRL's contract of transforms, situation by situation, for every public transform."""

from collections.abc import Callable, Iterator
from functools import partial

import pytest
import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.transforms import Compose, Transform
from torchrl.envs.utils import check_env_specs

import aslip
from aslip import transforms
from aslip.envs import StackEnv, default_stack, directions_stack, insert_before
from aslip.envs.directions import course_stack, planned_stack
from aslip.library import GaitLibrary
from aslip.sim.course import stairs
from aslip.transforms import SeededTransform
from tests.helpers import leaves
from tests.library.standing import standing_library

NUM = 2
PUBLIC = {
    value
    for name in transforms.__all__
    if isinstance(value := getattr(transforms, name), type)
    and issubclass(value, SeededTransform)
    and value not in (SeededTransform, transforms.RandomCommand)
}

ONLY_INSIDE = {kind for kind in PUBLIC if kind.needs_env and kind is not transforms.HeadingFrame}
"""Transforms that cannot wrap a batch of environments."""


def make_env(seed: int = 0) -> StackEnv:
    """Straight walks with one transform of each public class that fits."""
    library = GaitLibrary.load()
    stack = insert_before(
        default_stack(library),
        "start",
        course=transforms.RandomCourse([stairs(0.05), stairs(-0.05)]),
        dynamics=transforms.RandomDynamics(difficulty_key="difficulty"),
        difficulty=transforms.Difficulty(4),
    )
    stack = insert_before(
        stack,
        "observation",
        clock_input=transforms.ClockInput(),
        command_filter=transforms.CommandFilter(),
        pushes=transforms.RandomPushes(),
        distance=transforms.ReferenceDistance(),
        stones=transforms.SeenStones(count=4),
    )
    # whatever changes packets must come before the estimator
    stack = insert_before(stack, "estimator", encoders=transforms.EncoderOffsets())
    stack = insert_before(stack, "episode_sum", stagger=transforms.StaggeredEnds(9))
    return aslip.make_env(stack=stack, num_envs=NUM, seed=seed, num_threads=1)


def make_standing_env() -> StackEnv:
    """Robots that stand, with a perfect estimate: the remaining classes."""
    stack = directions_stack(standing_library())
    replace = {"estimator": transforms.TrueState()}
    return aslip.make_env(stack=stack, num_envs=NUM, seed=0, num_threads=1, replace=replace)


def make_planned_env() -> StackEnv:
    """Robots with planned footsteps on courses."""
    stones = stairs(0.05).stones[None]
    stack = course_stack(planned_stack(standing_library()), stones, stones)
    stack = insert_before(stack, "reference", footsteps=transforms.RandomFootsteps())
    return aslip.make_env(stack=stack, num_envs=NUM, seed=0, num_threads=1)


@pytest.fixture(scope="module")
def env() -> Iterator[StackEnv]:
    env = make_env()
    yield env
    env.close()


@pytest.fixture(scope="module")
def envs(env: StackEnv) -> Iterator[list[StackEnv]]:
    """Environments that have every public class together."""
    more = [make_standing_env(), make_planned_env()]
    yield [env, *more]
    for one in more:
        one.close()


Parts = Callable[[type[SeededTransform]], tuple[SeededTransform, TensorDictBase]]


@pytest.fixture(scope="module")
def parts(envs: list[StackEnv]) -> Parts:
    """Function from a class to its transform without an environment and transitions (k,)."""
    recorded = []
    for env in envs:
        torch.manual_seed(0)
        recorded.append(env.rollout(6, break_when_any_done=False).reshape(-1))
    assert recorded[0]["next", "done"].any()

    def of(kind: type[SeededTransform]) -> tuple[SeededTransform, TensorDictBase]:
        return next(
            (t.clone(), data)
            for env, data in zip(envs, recorded, strict=True)
            for t in env.transforms
            if type(t) is kind
        )

    return of


CLASSES = sorted(PUBLIC, key=lambda kind: kind.__name__)
OFFLINE = [kind for kind in CLASSES if not kind.needs_env]


def check_recomputed(found: TensorDictBase, recorded: TensorDictBase, kind: type) -> None:
    """Check that a transform recomputes its own entries bit for bit."""
    transform = kind.__name__
    expected = leaves(recorded)
    wrote = {key: value for key, value in leaves(found).items() if key in expected}
    assert wrote.keys() == leaves(found).keys(), transform
    for key, value in wrote.items():
        assert torch.equal(value, expected[key]), (transform, key)


def without_outputs(recorded: TensorDictBase, transform: Transform) -> TensorDictBase:
    """Transitions without the entries that the transform writes, except those that it reads."""
    step = type(transform)._step is not Transform._step
    keys = [key for key in transform.out_keys if key not in {"terminated", "done"}]
    own = [("next", *((key,) if isinstance(key, str) else key)) if step else key for key in keys]
    if isinstance(transform, transforms.ReferenceInjection):
        own = [("reference", "body_position"), ("target", "body_position")]
    return recorded.exclude(*own).clone()


def test_every_public_transform_is_tested(envs: list[StackEnv]) -> None:
    found = {type(t) for env in envs for t in env.transforms}
    assert found >= PUBLIC


def test_single_environment(envs: list[StackEnv]) -> None:
    for env in envs:
        check_env_specs(env)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_inside_and_around_several_environments(env: StackEnv) -> None:
    """Entries are bit-equal inside and around environments, serial or parallel."""
    rollouts = []
    # forked: imports in each process would take most of the test's time
    processes = partial(ParallelEnv, mp_start_method="fork")
    for kind in (SerialEnv, processes):
        batch = kind(2, [partial(make_env, seed) for seed in (0, 1)])
        compose = Compose(*_around(env))  # pyright: ignore[reportArgumentType]
        several = TransformedEnv(batch, compose, auto_unwrap=False)
        torch.manual_seed(0)
        rollouts.append(several.rollout(4, break_when_any_done=False))
        if kind is processes:
            check_env_specs(batch)
        several.close(raise_if_closed=False)
    serial, parallel = rollouts
    assert serial.batch_size == (2, NUM, 4)
    partly = serial["next", "done"].sum(1) == 1
    assert partly.any(), "no robot continues while another is reset"
    assert leaves(parallel).keys() == leaves(serial).keys()
    for key, value in leaves(serial).items():
        assert torch.equal(leaves(parallel)[key], value), key
    for kind in (transforms.ClockInput, transforms.AssembleObservation):
        transform = next(t for t in env.transforms if type(t) is kind).clone()
        check_recomputed(transform(without_outputs(serial, transform)), serial, kind)


def _around(env: StackEnv) -> list[SeededTransform]:
    """Transforms that can wrap a batch of environments."""
    return [
        transform.clone()
        for transform in env.transforms
        if isinstance(transform, SeededTransform)
        and type(transform) not in {*ONLY_INSIDE, transforms.ActionDelta}
    ]


@pytest.mark.parametrize("kind", OFFLINE, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("wrap", [lambda t: t, lambda t: Compose(t), lambda t: nn.Sequential(t)])
def test_without_environment_in_a_compose_and_in_a_model(
    parts: Parts,
    kind: type[SeededTransform],
    wrap: Callable[[Transform], Callable[[TensorDictBase], TensorDictBase]],
) -> None:
    since_reset = (
        *(transforms.FirstStep, transforms.ReferenceDistance),
        *(transforms.CommandFilter, transforms.StandFilter),
    )
    transform, recorded = parts(kind)
    if kind in {transforms.LastAction, *since_reset}:
        recorded = recorded[~recorded["next", "done"][:, 0]]
    found = wrap(transform)(without_outputs(recorded, transform))
    check_recomputed(found, recorded, kind)


@pytest.mark.parametrize("kind", OFFLINE, ids=lambda kind: kind.__name__)
def test_in_a_replay_buffer(parts: Parts, kind: type[SeededTransform]) -> None:
    transform, recorded = parts(kind)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(64), batch_size=8)
    stored = recorded.clone()
    stored["row"] = torch.arange(len(stored))
    buffer.extend(without_outputs(stored, transform))
    buffer.append_transform(transform)
    sample = buffer.sample().exclude("index")
    check_recomputed(sample, stored[sample["row"]], kind)


@pytest.mark.parametrize(
    "kind", [kind for kind in CLASSES if kind.needs_env], ids=lambda kind: kind.__name__
)
def test_a_transform_that_needs_an_environment_says_why(
    parts: Parts, kind: type[SeededTransform]
) -> None:
    transform, recorded = parts(kind)
    with pytest.raises(NotImplementedError, match=f"{kind.__name__} acts in an environment only"):
        transform(recorded.clone())


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_inverse(parts: Parts, kind: type[SeededTransform]) -> None:
    """One transform turns actions into motor targets, one shifts them; others do not act."""
    transform, recorded = parts(kind)
    given = recorded.clone()
    if kind is transforms.EncoderOffsets:
        given["motor_target"] = recorded["action"]
    found = transform.inv(given)
    if kind is transforms.ActionDelta:
        expected = recorded["reference", "motor_target"] + recorded["action"]
        assert torch.equal(found.pop("motor_target"), expected)
    if kind is transforms.EncoderOffsets:
        expected = recorded["action"] - recorded["motor_offset"]
        assert torch.equal(found.pop("motor_target"), expected)
    assert leaves(found).keys() == leaves(recorded).keys()
    assert torch.equal(found["action"], recorded["action"])
