"""Stacks: edits by name, seeds, and checks of names and order."""

import pickle
from typing import Any, cast

import numpy as np
import pytest
import torch
from torch import Tensor
from torchrl.data import Unbounded
from torchrl.envs.transforms import CatFrames, Compose, RewardScaling
from torchrl.envs.utils import check_env_specs

from aslip.envs import (
    ON_TRUTH,
    STACKS,
    BatchEnv,
    default_stack,
    describe_transforms,
    insert_before,
    make_env,
    randomise_stack,
)
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary, pendulum_library
from aslip.policy import stack_name
from aslip.transforms import (
    ActionDelta,
    AssembleObservation,
    Fall,
    LowReward,
    ObservationNoise,
    PhaseClock,
    ReferenceInjection,
    RewardTerm,
    SeededTransform,
    SpeedCommand,
    WeightedReward,
)
from aslip.transforms.rewards import PAPER_WEIGHTS
from tests.helpers import STRAIGHT_STACKS, MakeEnv, differing, limp, seeded


@pytest.mark.parametrize("how", ["drop", "replace"])
def test_unknown_names_are_refused_with_a_suggestion(make: MakeEnv, how: str) -> None:
    edit = ["foot_orientt"] if how == "drop" else {"foot_orientt": LowReward()}
    with pytest.raises(UnknownNameError, match="did you mean 'foot_orient'") as info:
        make(**{how: edit})
    assert "'low_reward'" in str(info.value)  # all names are listed


def test_steps_and_resets_build_no_specs(
    make: MakeEnv, library: GaitLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A transform that uses its parent in a step makes TorchRL rebuild all specs."""
    env, built = make(num_envs=2), []
    td = env.reset()
    td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    original = Unbounded.__init__

    def count(self: Unbounded, *args: Any, **kwargs: Any) -> None:
        built.append(self)
        original(self, *args, **kwargs)

    monkeypatch.setattr(Unbounded, "__init__", count)
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    td["done"][0] = td["terminated"][0] = True
    env.maybe_reset(td)
    assert len(built) == 0
    entries = len(list(make(num_envs=2).observation_spec.keys(True, True)))
    # TorchRL's transforms copy all specs once per transform
    assert 30 < len(built) < 5.5 * entries


class Unregistered(SeededTransform):
    """Transform that writes a key without a spec."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=["novel"])


def test_keys_without_a_spec_are_named(library: GaitLibrary) -> None:
    with pytest.raises(UnknownNameError, match="Unregistered writes 'novel'"):
        make_env(stack={**default_stack(library), "novel": Unregistered()})


def test_transforms_do_not_change_the_specs_of_the_base(make: MakeEnv) -> None:
    """Transforms change a copy, also if another is added later."""
    env = make(num_envs=2)
    alone = BatchEnv(2, num_threads=1)
    for _ in range(2):
        assert "observation" in env.observation_spec
        assert env.base_env.output_spec == alone.output_spec
        assert env.base_env.input_spec == alone.input_spec
        env.append_transform(RewardScaling(0.0, 2.0))


def test_environments_of_one_stack_share_gaits_and_nothing_that_changes(
    library: GaitLibrary,
) -> None:
    """Neither with each other nor with the stack, which stays as it was; also if pickled."""
    stack = randomise_stack(default_stack(library))
    stack["frames"] = CatFrames(2, dim=-1, in_keys=["observation"], out_keys=["frames"])
    same = pickle.loads(pickle.dumps(stack))
    first, other = (make_env(stack=stack, num_envs=2, seed=3, num_threads=1) for _ in range(2))
    alone = other.rollout(4, limp())
    first.rollout(3, limp())
    other.set_seed(3)
    sent = make_env(stack=same, num_envs=2, seed=3, num_threads=1).rollout(4, limp())
    assert differing(other.rollout(4, limp()), alone) == differing(sent, alone) == []
    for name, one, two in zip(stack, first.transforms, other.transforms, strict=True):
        assert stack[name].parent is None
        kept, held, others = (
            {**vars(t), **dict(t.named_buffers(recurse=False))} for t in (stack[name], one, two)
        )
        for key, value in held.items():
            if "_hooks" not in key and isinstance(value, list | dict | torch.Generator | Tensor):
                assert value is not kept.get(key), (name, key)
                assert value is not others.get(key), (name, key)
    assert all(t.library is library for t in first.transforms if isinstance(t, PhaseClock))


def test_clones_draw_numbers_of_their_own() -> None:
    term = seeded(ObservationNoise())
    draws = [torch.rand(3, generator=t.generator) for t in (term, term.clone(), term.clone())]
    assert len(torch.stack(draws).unique(dim=0)) == 3


def test_stacks_of_other_things_than_transforms_are_refused(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match=r"replace must be .*, got \{'fall': <class"):
        make(replace={"fall": Fall})
    with pytest.raises(ConfigurationError, match=r"stack must be .*, got \{'fall': <class"):
        make(stack={**default_stack(), "fall": Fall})


def test_no_transform_but_the_command_has_buffers_or_parameters(make: MakeEnv) -> None:
    """All state of an episode is in the tensordict."""
    env = make(num_envs=2)
    before = {name: value.clone() for name, value in env.transform.state_dict().items()}
    env.rollout(5, break_when_any_done=False)
    assert set(before) == {"transforms.1.speeds"}
    after = env.transform.state_dict()
    assert before.keys() == after.keys()
    assert all((after[name] == value).all() for name, value in before.items())


def _constant_term() -> RewardTerm:
    return RewardTerm("late", torch.ones_like, [("truth", "diverged")])


def test_reward_terms_after_the_sum_are_refused(library: GaitLibrary) -> None:
    late = {**default_stack(library), "late": _constant_term()}
    with pytest.raises(ConfigurationError, match="'late' comes after the sum"):
        make_env(stack=late)


def test_reward_terms_can_be_inserted_before_the_sum(library: GaitLibrary) -> None:
    stack = insert_before(default_stack(library), "reward", late=_constant_term())
    stack["reward"] = WeightedReward({**PAPER_WEIGHTS, "late": 5.0})
    env = make_env(stack=stack, seed=0)
    td = env.reset()
    after = env.step(td.set("action", torch.zeros(1, 10)))["next"]
    rest = sum(PAPER_WEIGHTS[name] * after["reward_terms", name] for name in PAPER_WEIGHTS)
    torch.testing.assert_close(after["reward"], rest + 5.0)
    with pytest.raises(UnknownNameError, match="no transform 'sum'"):
        insert_before(stack, "sum", late=_constant_term())


def test_no_two_transforms_draw_the_same_numbers(library: GaitLibrary) -> None:
    """Otherwise phases, commands and noise would be correlated."""
    env = make_env(stack=randomise_stack(default_stack(library)), seed=0)
    drawn = []
    for seed in (0, 1):
        env.set_seed(seed)
        transforms = [t for t in env.transforms if isinstance(t, SeededTransform)]
        drawn += [tuple(torch.rand(4, generator=t.generator).tolist()) for t in transforms]
    assert len(set(drawn)) == len(drawn) == 2 * len(transforms)


@pytest.mark.parametrize("stack", ["paper", "directions"])
def test_without_a_seed_every_transform_draws_numbers_of_its_own(make: MakeEnv, stack: str) -> None:
    settings = {"stack": randomise_stack(STACKS[stack](None, "truth"))}
    first, second = (make(seed=None, **settings) for _ in range(2))
    for one, other in zip(first.transforms, second.transforms, strict=True):
        if isinstance(one, SeededTransform):
            drawn = cast("SeededTransform", other).generator.get_state()
            assert not torch.equal(one.generator.get_state(), drawn)
    assert not differing(first.reset(), make(seed=first.seed, **settings).reset())


def test_transforms_added_later_or_inside_a_compose_follow_the_seed(make: MakeEnv) -> None:
    def noise(seed: int | None) -> torch.Tensor:
        twice: Any = ObservationNoise(), ObservationNoise()
        env = make(seed=seed, replace={"noise": Compose(*twice)})
        env.insert_transform(0, ObservationNoise())
        inside = (
            t for t in cast("Any", env.transform).modules() if isinstance(t, ObservationNoise)
        )
        return torch.stack([torch.rand(3, generator=t.generator) for t in inside])

    seeded = noise(1)
    assert torch.equal(noise(1), seeded)
    drawn = torch.cat([seeded, noise(2), noise(None), noise(None)])
    assert len(drawn.unique(dim=0)) == len(drawn) == 12


def test_seeds_may_be_numbers_of_numpy(make: MakeEnv) -> None:
    first, second = (make(seed=seed).reset() for seed in (np.int64(3), 3))
    assert (first["observation"] == second["observation"]).all()


@pytest.mark.parametrize("stack", STRAIGHT_STACKS)
@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_every_stack_keeps_its_specs(make: MakeEnv, backend: str, stack: str) -> None:
    library = {"library": None} if stack == "single_reference" else {}
    env = make(backend, num_envs=2, stack=stack, **library)
    check_env_specs(env, break_when_any_done="both")


def test_appended_and_inserted_transforms_have_names(make: MakeEnv) -> None:
    """Seeds, checkpoints and logs identify transforms by name."""
    env = make()
    names = env.transform_names
    env.append_transform(RewardScaling(0.0, 2.0))
    env.append_transform(RewardScaling(0.0, 0.5))
    env.insert_transform(names.index("observation"), ObservationNoise())
    where = names.index("observation")
    expected = [*names[:where], "ObservationNoise", *names[where:], "RewardScaling"]
    assert env.transform_names == (*expected, "RewardScaling_")
    assert len(env.transforms) == len(env.transform_names)
    env.set_seed(3)
    env.rollout(2)


def test_transforms_without_effect_at_their_place_are_refused(library: GaitLibrary) -> None:
    stack = default_stack(library)
    with pytest.raises(ConfigurationError, match="'low_reward' reads a reward"):
        make_env(library=library, drop=["reward"])
    late = {**{k: v for k, v in stack.items() if k != "reward"}, "reward": stack["reward"]}
    with pytest.raises(ConfigurationError, match="'low_reward' reads a reward"):
        make_env(stack=late)
    del late["low_reward"]
    with pytest.raises(ConfigurationError, match="'episode_sum' reads a reward"):
        make_env(stack=late)
    late = {**{k: v for k, v in stack.items() if k != "noise"}, "noise": stack["noise"]}
    with pytest.raises(ConfigurationError, match="'noise' comes after"):
        make_env(stack=late)


def test_names_of_stacks_cannot_be_edited() -> None:
    with pytest.raises(ConfigurationError, match="not the name 'straight'"):
        randomise_stack("straight")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("settings", [{"reward_on": "estimate"}, {"library": None}])
def test_settings_of_named_stacks_are_refused_for_others(
    library: GaitLibrary, settings: dict[str, Any]
) -> None:
    settings = {"library": library} if "library" in settings else settings
    with pytest.raises(ConfigurationError, match="library and reward_on"):
        make_env(stack=default_stack(library), **settings)


def test_stack_name_finds_the_stack_with_the_same_interface(
    make: MakeEnv, library: GaitLibrary
) -> None:
    for name in STRAIGHT_STACKS:
        assert stack_name(make_env(stack=name, num_threads=1, seed=0)) == name
    stack = insert_before(default_stack(library), "reward", upright=_constant_term())
    stack["reward"] = WeightedReward({**PAPER_WEIGHTS, "late": 0.1})
    assert stack_name(make(stack=stack, drop=["low_reward", "fall"])) == "straight"
    assert stack_name(make(**ON_TRUTH)) == "straight"
    assert stack_name(make(stack=randomise_stack(default_stack(library)))) == "straight"
    assert stack_name(make(drop=["feedforward"], replace={"action": ActionDelta()})) == "paper"
    blind = AssembleObservation([("estimate", "height")])
    assert stack_name(make(replace={"observation": blind})) is None
    pendulum = pendulum_library(library.gaits)
    assert stack_name(make(library=pendulum)) == "straight"
    assert stack_name(make(replace={"reference": ReferenceInjection(pendulum)})) is None


class WithFunctions(Fall):
    def __init__(self, functions: list[Any]) -> None:
        super().__init__()
        self.functions = functions


def test_descriptions_have_classes_and_settings(make: MakeEnv, library: GaitLibrary) -> None:
    """The description does not depend on robots, seed and use."""
    env = make(num_envs=2)
    texts = describe_transforms(env)
    assert list(texts) == list(env.transform_names)
    assert "threshold=0.3" in texts["low_reward"]
    assert f"21 motions, SHA-256 {library.sha256[:12]}" in texts["clock"]
    env.rollout(3)
    assert describe_transforms(env) == texts == describe_transforms(make(num_envs=1, seed=7))
    # texts of list items must not contain addresses, otherwise no run could be resumed
    both = [
        describe_transforms(make(replace={"fall": WithFunctions([lambda: 0])})) for _ in range(2)
    ]
    assert both[0] == both[1]
    slow = make(replace={"command": SpeedCommand(library, [0.0, 0.25])})
    assert [name for name in texts if describe_transforms(slow)[name] != texts[name]] == ["command"]
    varied = make(stack=randomise_stack(default_stack(library)))
    assert "'mass': '(0." in describe_transforms(varied)["dynamics"]


def test_existing_names_cannot_be_inserted(library: GaitLibrary) -> None:
    with pytest.raises(ConfigurationError, match=r"\['noise'\] already"):
        insert_before(default_stack(library), "start", noise=ObservationNoise())
    with pytest.raises(ConfigurationError, match=r"\['dynamics'\] already"):
        randomise_stack(randomise_stack(default_stack(library)))
