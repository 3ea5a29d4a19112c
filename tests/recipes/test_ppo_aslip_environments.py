"""The PPO recipe trains and evaluates on the environments of its presets and on custom ones."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

import aslip
from aslip.errors import AslipError, ConfigurationError
from aslip.library import GaitLibrary
from aslip.policy import read_card
from aslip.robot.model import physics_timesteps
from aslip.training.environments import make_training_env
from aslip.training.run import TrainingStoppedError
from aslip.transforms import (
    OBSERVATION_TABLE,
    AssembleObservation,
    RewardTerm,
    SeededTransform,
    SpeedCommand,
    TrueState,
    WeightedReward,
)
from aslip.transforms.base import extend_spec
from aslip.transforms.rewards import PAPER_WEIGHTS
from aslip.walking import Walker
from recipes import ppo_aslip
from recipes.ppo_presets import environments
from recipes.ppo_settings import PRESETS, TIMESTEPS
from tests.helpers import TINY


def test_presets_set_their_environments() -> None:
    """Only training has staggered ends; the preset sets the interval of commands."""
    found = {}
    for name in PRESETS:
        made = environments(PRESETS[name])
        make_env = made.get("make_env", aslip.make_env)
        train = made.get("make_train_env", partial(make_training_env, make_env))
        envs = [make(num_envs=2, seed=0, num_threads=1) for make in (train, make_env)]
        commands = [next(t for t in e.transforms if isinstance(t, SpeedCommand)) for e in envs]
        found[name] = envs, [command.interval for command in commands]
        assert "StaggeredEnds" in envs[0].transform_names
        assert "StaggeredEnds" not in envs[1].transform_names
    for name, (_, intervals) in found.items():
        one_speed = name in ("paper", "single_reference")
        assert intervals == [math.inf if one_speed else 8.0, math.inf]
    trained, evaluated = found["robust"][0]
    assert trained.reset()["observation"].shape == evaluated.reset()["observation"].shape
    masses = trained.base_env.dynamics["mass"]
    assert masses[0] != masses[1]
    assert (evaluated.base_env.dynamics["mass"] == 1.0).all()
    for env in found["truth"][0]:
        assert "noise" not in env.transform_names
        assert any(isinstance(t, TrueState) for t in env.transforms)
    assert found["single_reference"][0][0].reset()["observation"].shape[-1] == 49
    assert "feedforward" not in found["paper"][0][1].transform_names


def test_only_training_has_coarse_physics(tmp_path: Path) -> None:
    made: list[float] = []

    def make_env(**settings: Any) -> Any:
        env = aslip.make_env(**settings)
        made.append(env.base_env.model.opt.timestep)
        return env

    ppo_aslip.main(replace(TINY, out=tmp_path / "default", total_steps=64), make_env)
    # evaluations are made first
    assert set(made[:2]) == {0.0005}
    assert set(made[2:]) == {0.001}
    assert physics_timesteps() == TIMESTEPS
    physics = {name: preset.physics_timestep for name, preset in PRESETS.items()}
    assert {name for name in physics if physics[name] == 0.0005} == {
        "paper",
        "single_reference",
        "straight",
    }


def test_a_custom_command_is_trained_and_evaluated(library: GaitLibrary, tmp_path: Path) -> None:
    seen: set[float] = set()

    class Watched(SpeedCommand):
        def draw(self, shape: tuple[int, ...]) -> torch.Tensor:
            drawn = super().draw(shape)
            seen.update(drawn.flatten().tolist())
            return drawn

    # a repeated speed is drawn more often
    command = Watched(library, speeds=[0.25, 0.5, 0.5, 1.0])
    make_env = partial(aslip.make_env, replace={"command": command})
    train = partial(make_training_env, make_env, 0.06)
    config = replace(TINY, out=tmp_path, total_steps=64)
    results = ppo_aslip.main(config, make_env, make_train_env=train)
    assert [r.speed for r in results] == [0.25, 0.5, 1.0]
    assert seen == {0.25, 0.5, 1.0}


def test_custom_observations_train_with_symmetry_and_walk(
    tmp_path: Path,
) -> None:
    """The policy file names its observation, and the policy walks in environments that have it."""
    signs = {"mirror_signs": {"own": (-1.0,)}}

    def make_env(**settings: Any) -> Any:
        table = (*OBSERVATION_TABLE, ("reference", "motor_position"), "own")
        stack = aslip.envs.insert_before(aslip.default_stack(), "observation", own=Named("own"))
        stack["observation"] = AssembleObservation(table)
        return aslip.make_env(stack=stack, **settings)

    ppo_aslip.main(replace(TINY, out=tmp_path, total_steps=64), make_env, network=signs)
    Walker(tmp_path, make_env(num_threads=1)).step()
    Walker(tmp_path, make_env(num_threads=1, drop=["noise"])).step()
    with pytest.raises(ConfigurationError, match="an unnamed stack"):
        Walker(tmp_path)
    with pytest.raises(ConfigurationError, match=r"has \['reference/motor_position', 'own'\]"):
        Walker(tmp_path, aslip.make_env(num_threads=1))


def test_a_stack_that_lacks_required_transforms_is_refused(tmp_path: Path) -> None:
    make_env = partial(aslip.make_env, replace={"command": Named("command")})
    with pytest.raises(AslipError, match=r"lacks a SpeedCommand|phase and command"):
        ppo_aslip.main(replace(TINY, out=tmp_path), make_env)


class Named(SeededTransform):
    """Write an entry of ones at resets and steps."""

    def __init__(self, name: str) -> None:
        super().__init__([], [name])

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        return self._call(self._request(tensordict))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        ones = torch.ones(*next_tensordict.batch_size, 1)
        return next_tensordict.set(self.out_keys[0], ones)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        return extend_spec(observation_spec, {self.out_keys[0]: 1})


def test_a_reward_that_is_not_finite_is_named(tmp_path: Path) -> None:
    def root(orientation: torch.Tensor) -> torch.Tensor:
        return (orientation[..., :1] - 2).sqrt()

    term = RewardTerm("foot_orient", root, [("truth", "pelvis_orientation")])
    make_env = partial(aslip.make_env, replace={"foot_orient": term})
    with pytest.raises(TrainingStoppedError, match="'foot_orient' is not finite"):
        ppo_aslip.main(replace(TINY, out=tmp_path), make_env)


def test_a_run_cannot_resume_with_another_environment(tmp_path: Path) -> None:
    config = replace(TINY, out=tmp_path, total_steps=64)

    def make_env(weights: Mapping[str, float], **settings: Any) -> Any:
        reward = WeightedReward(weights)
        return aslip.make_env(replace={"reward": reward}, drop=["noise"], **settings)

    paper, other = partial(make_env, PAPER_WEIGHTS), dict.fromkeys(PAPER_WEIGHTS, 0.2)
    ppo_aslip.main(config, paper)
    made_of = read_card(tmp_path)["made_by"]["transforms"]
    assert "noise" not in made_of
    assert "'com_vel': '0.3'" in made_of["reward"]
    assert json.loads((tmp_path / "config.json").read_text())["transforms"] == made_of
    resumed = replace(config, resume=True, total_steps=128)
    with pytest.raises(ConfigurationError, match="other settings: reward was"):
        ppo_aslip.main(resumed, partial(make_env, other))
    slower = partial(make_training_env, paper, 20.0)
    with pytest.raises(ConfigurationError, match="other settings: training/command was"):
        ppo_aslip.main(resumed, paper, make_train_env=slower)
    ppo_aslip.main(resumed, paper)
