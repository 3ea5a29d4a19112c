"""Transforms reject invalid settings, and invalid commands and phases from callers."""

import math
from functools import partial
from typing import Any, cast

import numpy as np
import pytest
import torch

import aslip
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.log import Recorder
from aslip.transforms import (
    ActionDelta,
    CommandFilter,
    EncoderOffsets,
    Fall,
    LowReward,
    RandomPushes,
    ReferenceInjection,
    RewardTerm,
    SpeedCommand,
    StandCommand,
    WeightedReward,
)
from aslip.walking import evaluate
from tests.helpers import MakeEnv, limp


@pytest.mark.parametrize(
    ("function", "wrong", "message"),
    [
        (aslip.make_env, {"num_envs": "8"}, "num_envs must be a whole number of 1 .*, got '8'"),
        (
            aslip.make_env,
            {"backend": 3},
            "backend must be one of .*'warp'., got 3",
        ),
        (aslip.make_env, {"library": "gaits"}, "got 'gaits'; aslip.GaitLibrary.load makes one"),
        (aslip.make_env, {"drop": [3]}, r"drop must be Iterable\[str\], got \[3\]"),
        (aslip.make_env, {"replace": {"noise": 3}}, "replace must be Mapping"),
        (aslip.make_env, {"floor_friction": "1"}, "floor_friction must be a number, got '1'"),
        (aslip.load_policy, {"name_or_path": 3}, "name_or_path must be str | Path, got 3"),
        (aslip.Controller, {"policy": "straight", "motor_lead": math.nan}, "motor_lead must be"),
        (aslip.Controller, {"policy": "straight", "command_rates": 1.0}, "command_rates must be"),
        (aslip.GymEnv, {"num_envs": np.ones(2)}, "num_envs must be a whole number"),
        (Recorder, {"path": "w.mcap", "robot": "0"}, "robot must be a whole number of 0 or more"),
        (evaluate, {"policy": limp(), "env": 3, "speeds": [0.0]}, "got 3; aslip.make_env makes"),
    ],
)
def test_arguments_of_wrong_types(function: Any, wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        function(**wrong)


def test_settings_are_numbers_in_their_ranges(library: GaitLibrary) -> None:
    makers: dict[str, Any] = {
        "height": Fall,
        "threshold": LowReward,
        "motor_lead": partial(ReferenceInjection, library),
        "a speed": lambda value: SpeedCommand(library, [value]),
        "a rate": lambda value: CommandFilter([1.0, value]),
        "limit": lambda value: ActionDelta(limit=value),
        "interval": lambda value: RandomPushes(interval=value),
        "share": StandCommand,
        "largest": EncoderOffsets,
        "the weight of 'a'": lambda value: WeightedReward({"a": value}),
    }
    for name, make in makers.items():
        for value in (math.nan, "x", True):
            with pytest.raises(ConfigurationError, match=f"{name} must be .*{value!r}"):
                make(value)
    for make in (
        lambda: StandCommand(1.5),
        lambda: EncoderOffsets(-0.1),
        lambda: ActionDelta(limit=0),
    ):
        with pytest.raises(ConfigurationError, match="must be a finite number from"):
            make()
    for weights in ({}, ["a"]):
        with pytest.raises(ConfigurationError, match="weights must map names of terms to weights"):
            WeightedReward(cast("Any", weights))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", 5, ["command"]), "a name and a function, got 'a' and 5"),
        (("", abs, ["command"]), "a name and a function"),
        (("a", abs, []), "'a' needs lists of the entries"),
        (("a", abs, "command"), "'a' needs lists .*got 'command'"),
    ],
)
def test_reward_terms(arguments: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RewardTerm(*arguments)


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
