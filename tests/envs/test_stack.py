"""Stacks are edited by name."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.data import Unbounded
from torchrl.envs.transforms import RewardScaling
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
    reward_terms,
    stack_name,
)
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary, pendulum_library
from aslip.transforms import (
    ActionDelta,
    AssembleObservation,
    Fall,
    LowReward,
    ObservationNoise,
    RandomNoise,
    RewardTerm,
    SeededTransform,
    SpeedCommand,
    WeightedReward,
)
from aslip.transforms.rewards import PAPER_WEIGHTS
from tests.helpers import MakeEnv


@pytest.mark.parametrize("how", ["drop", "replace"])
def test_an_unknown_name_is_refused_with_a_hint(make: MakeEnv, how: str) -> None:
    edit = ["foot_orientt"] if how == "drop" else {"foot_orientt": LowReward()}
    with pytest.raises(UnknownNameError, match="did you mean 'foot_orient'") as info:
        make(**{how: edit})
    assert "'low_reward'" in str(info.value)  # all names are listed


def test_a_name_like_no_other_is_refused_in_a_whole_sentence(make: MakeEnv) -> None:
    with pytest.raises(UnknownNameError) as info:
        make(drop=["zzz"])
    assert re.match(r"no transform 'zzz'[;.:] ", str(info.value))


def test_a_single_name_in_place_of_a_list_is_understood(make: MakeEnv) -> None:
    """drop="foot_orient" must not be read letter by letter."""
    terms = make(drop="foot_orient").observation_spec["reward_terms"]
    assert set(terms.keys()) == set(reward_terms()) - {"foot_orient"}


@pytest.mark.parametrize("name", ["low_reward", "step_limit", "episode_sum", "start"])
def test_transforms_that_nothing_reads_can_be_left_out(make: MakeEnv, name: str) -> None:
    check_env_specs(make(num_envs=2, drop=[name]))


def test_editing_one_environment_does_not_touch_another(
    make: MakeEnv, library: GaitLibrary
) -> None:
    stack = default_stack(library)
    names = list(stack)
    make(stack=stack, drop=["foot_orient"])
    assert list(stack) == names
    both = [make(stack=stack), make(stack=stack)]
    for env in both:
        assert set(env.observation_spec["reward_terms"].keys()) == set(reward_terms())


def test_steps_and_resets_build_no_specs(
    make: MakeEnv, library: GaitLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A transform that looks at its parent on every step makes TorchRL rebuild them all."""
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
    make(num_envs=2)
    # TorchRL's transforms copy all of them once a transform
    assert 30 < len(built) < 500


class Unregistered(SeededTransform):
    """Writes a key that no spec has."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=["novel"])


def test_a_key_that_a_transform_writes_without_a_spec_is_named(library: GaitLibrary) -> None:
    with pytest.raises(UnknownNameError, match="Unregistered writes 'novel'"):
        make_env(stack={**default_stack(library), "novel": Unregistered})


def test_specs_of_the_environment_below_stay_as_they_are(make: MakeEnv) -> None:
    """Transforms write into a copy, also when another is added later."""
    env = make(num_envs=2)
    alone = BatchEnv(2, num_threads=1)
    for _ in range(2):
        assert "observation" in env.observation_spec
        assert env.base_env.output_spec == alone.output_spec
        assert env.base_env.input_spec == alone.input_spec
        env.append_transform(RewardScaling(0.0, 2.0))


def test_a_transform_of_another_environment_is_refused(make: MakeEnv) -> None:
    fall = Fall()
    env = make(replace={"fall": fall})
    with pytest.raises(ConfigurationError, match=r"'fall' belongs to another.*lambda: Fall\("):
        make(replace={"fall": fall})
    assert fall in env.transforms


def test_a_factory_may_replace_a_transform(make: MakeEnv) -> None:
    env = make(num_envs=2, replace={"low_reward": lambda: LowReward(0.9999)})
    data = env.rollout(5, break_when_any_done=True)
    assert data["next", "terminated"].any()


def test_no_transform_but_the_command_has_buffers_or_parameters(make: MakeEnv) -> None:
    """No transform holds state of an episode: all of it travels in the tensordict."""
    env = make(num_envs=2)
    before = {name: value.clone() for name, value in env.transform.state_dict().items()}
    env.rollout(5, break_when_any_done=False)
    assert set(before) == {"transforms.1.speeds"}
    after = env.transform.state_dict()
    assert before.keys() == after.keys()
    assert all((after[name] == value).all() for name, value in before.items())


def _constant_term() -> RewardTerm:
    return RewardTerm("late", torch.ones_like, [("truth", "diverged")])


def test_a_term_after_the_sum_is_refused(library: GaitLibrary) -> None:
    late = {**default_stack(library), "late": _constant_term}
    with pytest.raises(ConfigurationError, match="'late' comes after the sum"):
        make_env(stack=late)


def test_a_term_can_be_inserted_before_the_sum(library: GaitLibrary) -> None:
    stack = insert_before(default_stack(library), "reward", late=_constant_term)
    stack["reward"] = lambda: WeightedReward({**PAPER_WEIGHTS, "late": 5.0})
    env = make_env(stack=stack)
    td = env.reset()
    after = env.step(td.set("action", torch.zeros(1, 10)))["next"]
    rest = sum(PAPER_WEIGHTS[name] * after["reward_terms", name] for name in PAPER_WEIGHTS)
    torch.testing.assert_close(after["reward"], rest + 5.0)
    with pytest.raises(UnknownNameError, match="no transform 'sum'"):
        insert_before(stack, "sum", late=_constant_term)


def test_a_transform_draws_the_same_whatever_else_is_in_the_stack(library: GaitLibrary) -> None:
    full = make_env(num_envs=8, seed=3, library=library).reset()
    other = make_env(num_envs=8, seed=3, library=library, drop=["start", "com_vel"]).reset()
    torch.testing.assert_close(full["command"], other["command"], rtol=0, atol=0)
    torch.testing.assert_close(full["phase"], other["phase"], rtol=0, atol=0)


def test_no_two_transforms_draw_the_same_numbers(library: GaitLibrary) -> None:
    """Nor does one with another seed: phases would go with commands, noise with both."""
    env = make_env(stack=randomise_stack(default_stack(library)))
    drawn = []
    for seed in (0, 1):
        env.set_seed(seed)
        transforms = [t for t in env.transforms if isinstance(t, SeededTransform)]
        drawn += [tuple(torch.rand(4, generator=t.generator).tolist()) for t in transforms]
    assert len(set(drawn)) == len(drawn) == 2 * len(transforms)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "3"])
def test_a_seed_that_is_none_is_refused(make: MakeEnv, seed: Any) -> None:
    with pytest.raises(ConfigurationError, match="seed must be a whole number"):
        make(seed=seed)
    with pytest.raises(ConfigurationError, match="seed must be a whole number"):
        make().set_seed(seed)


def test_a_seed_may_be_of_numpy(make: MakeEnv) -> None:
    first, second = (make(seed=seed).reset() for seed in (np.int64(3), 3))
    assert (first["observation"] == second["observation"]).all()


@pytest.mark.parametrize("stack", list(STACKS))
@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_every_stack_keeps_its_specs(make: MakeEnv, backend: str, stack: str) -> None:
    library = {"library": None} if stack == "single_reference" else {}
    check_env_specs(make(backend, num_envs=2, stack=stack, **library))


@pytest.mark.parametrize("stack", list(STACKS))
def test_another_default_of_precision_changes_nothing(make: MakeEnv, stack: str) -> None:
    library = {"library": None} if stack == "single_reference" else {}
    walks = []
    for dtype in (torch.float32, torch.float64):
        torch.set_default_dtype(dtype)
        try:
            env = make(num_envs=2, stack=stack, seed=1, **library)
            check_env_specs(env)
            env.set_seed(1)
            zeros = torch.zeros(2, 10, dtype=torch.float32)
            walks.append(env.step(env.reset().set("action", zeros)))
        finally:
            torch.set_default_dtype(torch.float32)
    for key in ("observation", ("next", "reward")):
        assert walks[1][key].dtype == torch.float32
        assert torch.equal(walks[0][key], walks[1][key])


def test_transforms_that_come_later_have_names(make: MakeEnv) -> None:
    """Seeds, checkpoints and logs go by names."""
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


def test_transforms_in_an_order_without_effect_are_refused(library: GaitLibrary) -> None:
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


def test_randomised_robots_have_noise_only_if_there_was_some(library: GaitLibrary) -> None:
    stack = default_stack(library)
    assert randomise_stack(stack)["noise"] is RandomNoise
    del stack["noise"]
    assert "noise" not in randomise_stack(stack)
    with pytest.raises(ConfigurationError, match="not the name 'aslip'"):
        randomise_stack("aslip")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("settings", [{"reward_on": "estimate"}, {"library": None}])
def test_settings_of_named_stacks_are_refused_for_others(
    library: GaitLibrary, settings: dict[str, Any]
) -> None:
    settings = {"library": library} if "library" in settings else settings
    with pytest.raises(ConfigurationError, match="library and reward_on"):
        make_env(stack=default_stack(library), **settings)


def test_the_stack_that_is_the_same_to_a_policy_is_found(
    make: MakeEnv, library: GaitLibrary
) -> None:
    for name in STACKS:
        assert stack_name(make_env(stack=name, num_threads=1)) == name
    stack = insert_before(default_stack(library), "reward", upright=_constant_term)
    stack["reward"] = lambda: WeightedReward({**PAPER_WEIGHTS, "late": 0.1})
    assert stack_name(make(stack=stack, drop=["low_reward", "fall"])) == "aslip"
    assert stack_name(make(**ON_TRUTH)) == "aslip"
    assert stack_name(make(stack=randomise_stack(default_stack(library)))) == "aslip"
    assert stack_name(make(drop=["feedforward"], replace={"action": ActionDelta})) == "paper"
    blind = AssembleObservation([("estimate", "height")])
    assert stack_name(make(replace={"observation": blind})) is None
    assert stack_name(make(library=pendulum_library(library.gaits))) is None


class WithFunctions(Fall):
    def __init__(self, functions: list[Any]) -> None:
        super().__init__()
        self.functions = functions


def test_an_environment_tells_what_it_is_made_of(make: MakeEnv, library: GaitLibrary) -> None:
    """Whatever its robots and seed, and before and after it is used."""
    env = make(num_envs=2)
    told = describe_transforms(env)
    assert list(told) == list(env.transform_names)
    assert "threshold=0.3" in told["low_reward"]
    assert "21 motions from 0 to 2 m/s" in told["clock"]
    env.rollout(3)
    assert describe_transforms(env) == told == describe_transforms(make(num_envs=1, seed=7))
    # what is in a list has no address in its text, or no run could be resumed
    both = [
        describe_transforms(make(replace={"fall": lambda: WithFunctions([lambda: 0])}))
        for _ in range(2)
    ]
    assert both[0] == both[1]
    slow = make(replace={"command": SpeedCommand(library, [0.0, 0.25])})
    assert [name for name in told if describe_transforms(slow)[name] != told[name]] == ["command"]
    louder = make(stack=randomise_stack(default_stack(library)))
    assert describe_transforms(louder)["noise"] != told["noise"]
    assert "'mass': '(0." in describe_transforms(louder)["dynamics"]


def test_names_that_a_stack_has_cannot_be_inserted(library: GaitLibrary) -> None:
    with pytest.raises(ConfigurationError, match=r"\['noise'\] already"):
        insert_before(default_stack(library), "start", noise=RandomNoise)
    with pytest.raises(ConfigurationError, match=r"\['dynamics'\] already"):
        randomise_stack(randomise_stack(default_stack(library)))
