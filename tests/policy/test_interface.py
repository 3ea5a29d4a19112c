"""Interface between policies and environments, and its checks."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs.transforms import CatFrames, InitTracker, ObservationNorm, RewardScaling

import aslip
from aslip.envs import StackEnv, default_stack, describe_transforms, insert_before, library_of
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    baseline_key,
    check_policy_fits,
    make_actor,
    policy_interface,
    read_card,
    save_policy,
    stack_name,
)
from aslip.transforms import (
    OBSERVATION_TABLE,
    ActionDelta,
    AssembleObservation,
    RewardTerm,
    SeededTransform,
)
from aslip.walking import Walker
from benchmarks.common import Common, Subject
from tests.helpers import MakeEnv


class Smooth(SeededTransform):
    """Smooth actions before they are added to the reference."""

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("action", 0.5 * tensordict["action"])


def _with(library: GaitLibrary, make: MakeEnv, *more: Any) -> StackEnv:
    """Environment of the default stack with more transforms at the end."""
    stack = {**default_stack(library), **{f"more{i}": one for i, one in enumerate(more)}}
    return make(stack=stack)


def _saved(path: Path, env: StackEnv, size: int = 64) -> Path:
    """Save a policy as a recipe does after a training on an environment."""
    interface = policy_interface(env)
    actor = make_actor(RunningNormalizer(size), PolicyShape(size), interface["observation"])
    save_policy(path, actor, PolicyShape(size), **interface)
    return path


HARMLESS = (InitTracker(), RewardScaling(loc=0.0, scale=0.1))


def test_other_transforms_keep_the_interface_to_policies(
    make: MakeEnv, library: GaitLibrary, tmp_path: Path
) -> None:
    env = _with(library, make, *HARMLESS)
    env.rollout(2)
    assert stack_name(env) == "straight"
    path = _saved(tmp_path / "policy.zip", env)
    assert read_card(path)["baseline"] == "reference/motor_target"
    check_policy_fits(path, env)
    check_policy_fits("straight", env)
    check_policy_fits(path, make())
    assert Walker(path, seed=0).env.num_envs == 1


CHANGES = {
    "frames": (CatFrames(3, dim=-1, in_keys=["observation"]), "observation"),
    "norm": (ObservationNorm(0.0, 2.0, in_keys=["observation"]), "observation"),
    "smooth": (Smooth(), "action"),
}


@pytest.mark.parametrize(("change", "what"), CHANGES.values(), ids=CHANGES)
def test_transforms_of_observation_or_action_change_the_interface(
    make: MakeEnv, library: GaitLibrary, tmp_path: Path, change: Any, what: str
) -> None:
    env = _with(library, make, change)
    assert stack_name(env) is None
    assert (baseline_key(env) is None) == (what == "action")


def test_benchmarks_name_the_difference_to_a_policys_stack(
    make: MakeEnv, library: GaitLibrary, tmp_path: Path
) -> None:
    entries = list(OBSERVATION_TABLE)
    other_key = ActionDelta(("reference", "motor_velocity"))
    fewer, reverse = entries[:-1], entries[::-1]
    stacks: dict[str, tuple[dict[str, Any], int, str]] = {
        "order": (
            {"replace": {"observation": AssembleObservation(reverse)}},
            64,
            r"another order, \['reference/right_foot_velocity'",
        ),
        "fewer": (
            {"replace": {"observation": AssembleObservation(fewer)}},
            61,
            r"lacks \['reference/right_foot_velocity'\]",
        ),
        "baseline": ({"replace": {"action": other_key}}, 64, "to 'reference/motor_velocity'"),
        "action": (
            {"stack": insert_before(default_stack(library), "action", smooth=Smooth())},
            64,
            "added to None",
        ),
    }
    for name, (settings, size, message) in stacks.items():
        path = _saved(tmp_path / f"{name}.zip", make(**settings), size)
        with pytest.raises(ConfigurationError, match=rf"{name}\.zip.*{message}"):
            Subject.load(path).walking_env(Common(), 1)
        with pytest.raises(ConfigurationError, match=f"{name}.zip.*does not fit"):
            check_policy_fits(path, make())
        assert aslip.load_policy(path)


def test_baselines_of_the_action_must_be_equal(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match=r"to 'reference/motor_target'.*it to 'ref"):
        check_policy_fits("straight", make(stack="paper"))
    with pytest.raises(ConfigurationError, match="does not fit"):
        Walker("straight", make(stack="paper"))


def test_description_of_an_environment_tells_reward_functions_apart(make: MakeEnv) -> None:
    def text(function: Callable[..., Any]) -> str:
        term = RewardTerm("foot_orient", function, [("truth", "pelvis_orientation")])
        return describe_transforms(make(replace={"foot_orient": term}))["foot_orient"]

    def zero(q: torch.Tensor, scale: float = 1.0) -> torch.Tensor:
        return 0 * scale * q[..., :1]

    def one(q: torch.Tensor) -> torch.Tensor:
        return 0 * q[..., :1] + 1

    texts = [text(f) for f in (zero, one, partial(zero, scale=2.0), partial(zero, scale=3.0))]
    assert len({*texts}) == 4
    assert texts[2] == text(partial(zero, scale=2.0))
    assert "locals>.zero" in texts[0]


def test_gaits_are_those_of_the_clock(library: GaitLibrary) -> None:
    assert library_of(aslip.make_env(stack=default_stack(library), seed=0)) is library
    with pytest.raises(ConfigurationError, match="the stack lacks a PhaseClock or StandClock"):
        library_of(aslip.make_env(stack={}))
