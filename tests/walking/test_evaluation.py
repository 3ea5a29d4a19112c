"""Evaluation at many speeds: lengths, returns, criteria and table."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import aslip
from aslip.envs import EPISODE_ENDS
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms import SpeedCommand
from aslip.walking import WalkResult, evaluate, walk_table
from tests.helpers import MakeEnv, limp

SPEEDS = [0.0, 1.0, 2.0]


def test_evaluation_equals_single_robot_rollouts(make: MakeEnv) -> None:
    """Steps, return, distance and terms of each robot count until its own end."""
    results = evaluate(limp(), make(num_envs=3), SPEEDS, num_steps=40)
    for i, (speed, result) in enumerate(zip(SPEEDS, results, strict=True)):
        env = make(num_envs=1, seed=i + 7)
        td = env.reset()
        td = env.reset(
            td.select().update({"command": torch.full((1, 1), speed), "phase": torch.zeros(1, 1)})
        )
        start = td["truth", "pelvis_position"][0, 0].item()
        total, feet, after = 0.0, 0.0, td
        steps = 0
        while steps < 40:
            steps += 1
            after = env.step(after.set("action", torch.zeros(1, 10)))["next"]
            total += after["reward"].item()
            feet += after["reward_terms", "foot_pos"].item()
            if after["terminated"].item():
                break
        assert result.speed == speed
        assert result.steps == steps
        assert result.survived == (not after["terminated"].item())
        assert result.total == pytest.approx(total, rel=1e-5)
        assert result.terms["foot_pos"] == pytest.approx(feet / steps, rel=1e-5)
        x, y, _ = after["truth", "pelvis_position"][0].tolist()
        assert result.mean_speed == pytest.approx(
            (x - start) / (steps * CASSIE.policy_period), rel=1e-4
        )
        assert result.lateral_drift == pytest.approx(abs(y), abs=1e-6)
    assert len({result.steps for result in results}) > 1  # they do not end together


def test_refuses_environments_of_other_robots_or_without_the_truth(make: MakeEnv) -> None:
    with pytest.raises(ConfigurationError, match="one robot for each of the 3 speeds, got 2"):
        evaluate(limp(), make(num_envs=2), SPEEDS)
    with pytest.raises(ConfigurationError, match=r"truth.*keep"):
        evaluate(limp(), make(num_envs=len(SPEEDS), keep=["observation"]), SPEEDS)


def test_evaluation_suspends_command_changes(make: MakeEnv, library: GaitLibrary) -> None:
    policy, speeds = aslip.load_policy("straight"), [0.0, 1.0, 2.0]
    restless = SpeedCommand(library, interval=0.06)
    found = [
        evaluate(policy, make(num_envs=3, replace=edits), speeds, num_steps=20)
        for edits in ({}, {"command": restless})
    ]
    assert found[0] == found[1]
    assert restless.interval == 0.06


def test_survived_on_feet_and_tracked_are_independent() -> None:
    walk = WalkResult(1.0, 400, True, 300.0, 1.1, 0.0, 0.99, {})
    still = WalkResult(2.0, 400, True, 200.0, 0.0, 0.0, 1.0, {})
    leaning, fallen = replace(walk, weight_ratio=0.8), replace(walk, survived=False)
    walks = [walk, still, leaning, fallen]
    assert [w.survived for w in walks] == [True, True, True, False]
    assert [w.on_feet for w in walks] == [True, True, False, True]
    assert [w.tracked for w in walks] == [True, False, True, True]
    assert walk_table(walks).endswith(
        "\n\nof 4 speeds 3 survived, 3 on the feet, 3 tracked within 0.2 m/s; mean return 275.0"
    )
    # for three policy steps, momentum can carry the robot
    assert replace(walk, steps=3, weight_ratio=0.8).on_feet


def test_weight_ratio_uses_simulated_mass_and_payload(make: MakeEnv) -> None:
    """A lighter robot that walks well is on its feet."""
    changes = [{}, {"mass": 0.85}, {"payload": 6.0}, {"slope": 0.1}]
    env = make(num_envs=4, drop=EPISODE_ENDS)
    for robot, change in enumerate(changes[1:], start=1):
        env.base_env.set_dynamics(change, np.array([robot]))
    results = evaluate(aslip.load_policy("straight"), env, [0.5] * 4, num_steps=150)
    assert [result.weight_ratio for result in results] == pytest.approx([1.0] * 4, abs=0.03)
    assert all(result.on_feet and result.survived for result in results)
