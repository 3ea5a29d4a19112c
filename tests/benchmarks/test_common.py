"""Policies, environments and reports of benchmarks: shipped ones, and those of users."""

import json
import math
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import CatFrames, Transform

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv
from aslip.errors import ConfigurationError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, make_recurrent_actor
from aslip.transforms import ActionDelta, EstimatedState, TrueState, WeightedReward
from aslip.transforms.rewards import PAPER_WEIGHTS
from benchmarks.common import Common, Policies, Subject, write_results
from benchmarks.flags import Directions, check_numbers
from benchmarks.paper import foot_placement, ground_force
from benchmarks.robustness import pushes, walking_quality
from benchmarks.robustness.parameters import SWEEPS
from benchmarks.system import estimator


class AirTime(Transform):
    """Reward with a state: seconds since a foot last carried the robot."""

    def __init__(self) -> None:
        super().__init__(in_keys=["air_time"], out_keys=["air_time"])

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> Any:
        return tensordict_reset.set("air_time", torch.zeros(*tensordict_reset.batch_size, 1))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> Any:
        carried = next_tensordict["truth", "ground_force"][..., 2].sum(-1, keepdim=True) > 20
        time = torch.where(carried, 0.0, tensordict["air_time"] + 0.03)
        next_tensordict["reward"] = next_tensordict["reward"] - time
        return next_tensordict.set("air_time", time)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["air_time"] = Unbounded(torch.Size([*observation_spec.shape, 1]))
        return observation_spec


def make_own_env(**settings: Any) -> StackEnv:
    """Default stack with a history of two observations and a reward with a state."""
    env = aslip.make_env(**settings)
    env.append_transform(CatFrames(2, dim=-1, in_keys=["observation"]))
    env.append_transform(AirTime())
    return env


def own_policies() -> dict[str, TensorDictModuleBase]:
    """Untrained policies, with and without memory."""
    torch.manual_seed(0)
    shape = PolicyShape(128, hidden=(16,), symmetric=False)
    return {
        "mlp": make_actor(RunningNormalizer(128), shape),
        "gru": make_recurrent_actor(RunningNormalizer(128), shape),
    }


POLICIES = own_policies()


def test_benchmarks_accept_custom_policy_and_environment(tmp_path: Path) -> None:
    """From Python, with a module and `make_env`; reports name the policy by its class."""
    of: Any = (POLICIES["gru"], make_own_env)
    few: dict[str, Any] = {"out": tmp_path, "speeds": (0.5,), "settle": 0.15, "walk": 0.3}
    (placement,) = foot_placement.main(foot_placement.Config(**few), *of)[0.5]
    assert placement.offset.shape[1] == 2
    rows = ground_force.main(ground_force.Config(**few), *of)
    assert rows[0]["policy"] == "ProbabilisticActor"
    assert walking_quality.main(walking_quality.Config(**few), *of)[0]["power"]["mean"] > 0
    sweeps: dict[str, Any] = {sweep.flag: () for sweep in SWEEPS.values()}
    config = pushes.Config(
        **{**sweeps, "payload": (0.0,)}, out=tmp_path, walks=1,
        directions=1, phases=1, repeats=1, bisections=1, settle=0.06, after=0.06, episode=0.3,
    )  # fmt: skip
    assert pushes.main(config, *of)["sweeps"][0]["trials"] == 1
    small = {"steps": 2, "repeats": 1, "falls": 2, "ages": (0, 1, 10), "out": tmp_path}
    estimator.main(estimator.Config(**small), *of)
    about = json.loads((tmp_path / "pushes.json").read_text())
    assert about["policies"] == ["ProbabilisticActor"]


def test_benchmarks_keep_the_edits_of_a_partial_make_env() -> None:
    """In addition to the transforms that the benchmarks themselves drop and replace."""
    reward = WeightedReward(dict.fromkeys(PAPER_WEIGHTS, 0.1))
    make_env = partial(
        aslip.make_env, drop="feedforward", replace={"reward": reward, "action": ActionDelta()}
    )
    for truth, kind in ((False, EstimatedState), (True, TrueState)):
        with closing(
            Subject.load(POLICIES["mlp"], make_env).walking_env(Common(truth=truth), 1)
        ) as env:
            assert not {"feedforward", *EPISODE_ENDS} & set(env.transform_names)
            assert ("noise" in env.transform_names) is not truth
            assert any(isinstance(t, kind) for t in env.transforms)
            weights = [t.weights for t in env.transforms if isinstance(t, WeightedReward)]
            assert weights == [dict.fromkeys(PAPER_WEIGHTS, 0.1)]


def test_policies_of_one_name_are_seeds_of_a_method() -> None:
    config = Common(policy=("default=straight", "paper=robust", "default=robust", "straight"))
    methods = Policies(config).methods()
    names = {method: [subject.name for subject in ones] for method, ones in methods.items()}
    assert names == {
        "default": ["straight", "robust"],
        "paper": ["robust"],
        "straight": ["straight"],
    }


def test_policies_that_learned_to_stand_keep_their_own_stack() -> None:
    """A policy of plans cannot observe what `directions` writes."""
    subjects = Policies(Directions(policy=("directions", "stones"))).load("directions")
    environments = [cast("partial[StackEnv]", subject.make_env).keywords for subject in subjects]
    assert [environment["stack"] for environment in environments] == ["directions", "planned"]


def test_results_are_valid_json_with_nan(tmp_path: Path) -> None:
    write_results(tmp_path, "mine", {"rows": [{"a": math.nan, "b": (1.0, -math.inf)}]}, "|")
    text = (tmp_path / "mine.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {"rows": [{"a": None, "b": [1.0, None]}]}


def test_settings_are_checked_by_name() -> None:
    for settings, message in (
        ({"walks": -1, "speed": 1.0}, "walks must be 0 or more, got -1"),
        ({"walks": 0, "speed": math.inf}, "speed must be positive, got inf"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            check_numbers(SimpleNamespace(**settings), "speed", walks=0)
