"""Transforms reject invalid settings, and invalid commands and phases from callers."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
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
from tests.helpers import MakeEnv

BAD = [float("nan"), float("inf"), "x", None, True]


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
