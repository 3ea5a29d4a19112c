"""Stacks are edited by name."""

from __future__ import annotations

import re
from typing import Any

import pytest
import torch
from torchrl.data import Unbounded
from torchrl.envs.utils import check_env_specs

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.rewards import PAPER_WEIGHTS
from aslip.stack import default_stack, insert_before, make_env, reward_terms
from aslip.transforms import Fall, LowReward, RewardTerm, WeightedReward
from tests.conftest import MakeEnv


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
    assert ("reward_terms", "foot_orient") not in make(drop="foot_orient").full_reward_spec.keys(
        True
    )


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
        terms = {("reward_terms", name) for name in reward_terms()}
        assert terms <= set(env.full_reward_spec.keys(True))


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
    # a few copies of each leaf are TorchRL's way; ten thousands were a mistake of ours
    assert 30 < len(built) < 10_000


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


@pytest.mark.parametrize("seed", [-1, 0.5, True, None])
def test_a_seed_that_is_none_is_refused(seed: Any) -> None:
    with pytest.raises(ConfigurationError, match="seed must be"):
        make_env(seed=seed)


def _constant_term() -> RewardTerm:
    return RewardTerm("late", lambda height: torch.ones_like(height), [("estimate", "height")])
