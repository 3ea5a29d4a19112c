"""Transforms reject invalid settings, and invalid commands and phases from callers."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch

import aslip
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.log import Recorder
from aslip.transforms import (
    Fall,
    LowReward,
    ObservationNoise,
    RandomPushes,
    ReferenceInjection,
    RewardTerm,
    SpeedCommand,
    StandCommand,
    WeightedReward,
)
from aslip.walking import evaluate
from tests.helpers import MakeEnv, limp

BAD = [float("nan"), float("inf"), "x", None, True]


@pytest.mark.parametrize(
    ("function", "wrong", "message"),
    [
        (
            aslip.make_env,
            {"num_envs": "8"},
            "num_envs must be a whole number of 1 or more, got '8'",
        ),
        (aslip.make_env, {"backend": 3}, "backend must be one of .'batch', 'dm_control'., got 3"),
        (aslip.make_env, {"library": "gaits"}, "got 'gaits'; aslip.GaitLibrary.load makes one"),
        (aslip.make_env, {"drop": 3}, r"drop must be Iterable\[str\], got 3"),
        (aslip.make_env, {"drop": [3]}, r"drop must be Iterable\[str\], got \[3\]"),
        (aslip.make_env, {"stack": ["a"]}, r"stack must be Stack | str, got \['a'\]"),
        (aslip.make_env, {"replace": {"noise": 3}}, "replace must be Mapping"),
        (aslip.make_env, {"floor_friction": "1"}, "floor_friction must be a number, got '1'"),
        (aslip.load_policy, {"name_or_path": 3}, "name_or_path must be str | Path, got 3"),
        (aslip.load_policy, {"name_or_path": "straight", "network": "mlp"}, "network must be"),
        (aslip.Controller, {"policy": None}, "policy must be str .*, got None"),
        (
            aslip.Controller,
            {"policy": "straight", "motor_lead": True},
            "motor_lead must be a number",
        ),
        (aslip.Controller, {"policy": "straight", "motor_lead": math.nan}, "motor_lead must be"),
        (aslip.Controller, {"policy": "straight", "command_rates": 1.0}, "command_rates must be"),
        (aslip.GymEnv, {"render_mode": np.ones(2)}, "render_mode must be str | None"),
        (aslip.GymEnv, {"num_envs": np.ones(2)}, "num_envs must be a whole number"),
        (Recorder, {"path": 3}, "path must be str | Path, got 3"),
        (
            Recorder,
            {"path": "w.mcap", "robot": "0"},
            "robot must be a whole number of 0 or more, got '0'",
        ),
        (evaluate, {"policy": "straight", "env": 3, "speeds": [0.0]}, "aslip.load_policy makes"),
        (evaluate, {"policy": limp(), "env": 3, "speeds": [0.0]}, "got 3; aslip.make_env makes"),
    ],
)
def test_arguments_of_wrong_types(function: Any, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        function(**wrong)


@pytest.mark.parametrize("value", BAD, ids=repr)
def test_numbers(library: GaitLibrary, value: Any) -> None:
    makers: dict[str, Any] = {
        "height": lambda: Fall(value),
        "threshold": lambda: LowReward(value),
        "motor_lead": lambda: ReferenceInjection(library, motor_lead=value),
        "a speed": lambda: SpeedCommand(library, [value]),
        "scale": lambda: ObservationNoise(scale=value),
        "the weight of 'a'": lambda: WeightedReward({"a": value}),
    }
    for name, make in makers.items():
        with pytest.raises(ConfigurationError, match=f"{name} must be a finite number.*{value!r}"):
            make()


@pytest.mark.parametrize("value", ["x", None, True], ids=repr)
def test_times_that_may_be_infinite(library: GaitLibrary, value: Any) -> None:
    makers: list[Any] = [partial(SpeedCommand, library), RandomPushes, StandCommand]
    for make in makers:
        with pytest.raises(ConfigurationError, match=f"interval must be .*{value!r}"):
            make(interval=value)
    with pytest.raises(ConfigurationError, match=f"bias_time must be .*{value!r}"):
        ObservationNoise(bias_time=value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", 5, ["command"]), "function of 'a' must be callable, got 5"),
        (("a", abs, []), "the term 'a' reads nothing"),
        (("a", abs, "command"), "next_keys of 'a' must be a list, got 'command'"),
        (("", abs, ["command"]), "name must be a string that is not empty"),
    ],
)
def test_reward_terms(arguments: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RewardTerm(*arguments)


@pytest.mark.parametrize("weights", [{}, 3, ["a"]], ids=repr)
def test_weights(weights: Any) -> None:
    with pytest.raises(ConfigurationError, match="weights must map names of terms to weights"):
        WeightedReward(weights)


def test_a_command_of_integers_is_a_speed(make: MakeEnv) -> None:
    env = make(num_envs=2)
    found = []
    for command in (torch.ones(2, 1), torch.ones(2, 1, dtype=torch.int64)):
        env.set_seed(0)
        td = env.reset()
        td["command"] = command
        found.append(env.step(td.set("action", torch.zeros(2, 10)))["next"])
    for key in ("command", "phase", "observation"):
        assert found[1][key].dtype == torch.float32
        assert torch.equal(found[0][key], found[1][key])


@pytest.mark.parametrize("key", ["command", "phase"])
def test_numbers_from_outside_between_steps_are_finite(make: MakeEnv, key: str) -> None:
    env = make(num_envs=2)
    td = env.reset().set("action", torch.zeros(2, 10))
    td[key][1] = torch.nan
    with pytest.raises(ConfigurationError, match=f"{key} must be finite"):
        env.step(td)
