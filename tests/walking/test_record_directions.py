"""Recording and evaluation of walks in all directions."""

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase

import aslip
from aslip.envs import EPISODE_ENDS, StackEnv, walking_stack
from aslip.errors import ShapeError
from aslip.robot import CASSIE, SIDES
from aslip.training.environments import make_evaluation_env
from aslip.walking import WalkResult, evaluate, record_substeps, record_walks, walk_table
from aslip.walking.record import record
from tests.helpers import limp
from tests.library.bent import symmetric_library

COMMANDS = [[0.4, 0.1, 0.8], [0.0, -0.2, -0.5]]
STEPS = 8


def make(num_envs: int = 2, seed: int = 0) -> StackEnv:
    stack = walking_stack(symmetric_library())
    return aslip.make_env(
        stack=stack, num_envs=num_envs, seed=seed, num_threads=1, drop=(*EPISODE_ENDS, "noise")
    )


def test_recorded_walks_have_the_commands_of_all_axes() -> None:
    command = np.repeat(np.array(COMMANDS, dtype=np.float32)[None], STEPS, axis=0)
    command[4:, :, 2] = 0
    walks = record_walks(limp(), make(), command)
    np.testing.assert_array_equal(walks.command, command)
    assert walks.one(1, 2).command.shape == (STEPS - 2, 1, 3)
    assert walks.alive.all()
    # the frame moves along: robots stay near its origin
    assert np.abs(walks.pelvis_position[..., :2]).max() < 0.3
    # the frame turns with the command, and feet in it are those of the world
    np.testing.assert_allclose(
        np.diff(walks.frame[:5, 0, 2]), 0.8 * CASSIE.policy_period, rtol=1e-4
    )
    with closing(make()) as env:
        keys: list[Any] = [("next", "truth", f"{side}_foot_position") for side in SIDES]
        rows = record(limp(), env, command, keys)
    for i, key in enumerate(keys):
        feet = np.asarray(rows[key])[..., :2]
        moved = np.linalg.norm(feet - feet[:1], axis=-1)
        place = walks.foot_place[..., i, :]
        np.testing.assert_allclose(np.linalg.norm(place - place[:1], axis=-1), moved, atol=1e-5)
    forward = record_walks(limp(), make(), command[..., 0])
    np.testing.assert_array_equal(forward.command, command * [1.0, 0.0, 0.0])
    for wrong in (command[..., :2], command[:, :1], command[:, :1, 0]):
        with pytest.raises(ShapeError, match=r"command must be \(m, 2, 3\)"):
            record_walks(limp(), make(), wrong)


def test_substeps_are_recorded_with_a_command_of_all_axes() -> None:
    command = np.tile([0.4, 0.0, 0.5], (2, 1))
    found = record_substeps(limp(), make(1), command)
    assert len(found.pelvis_position) == 2 * CASSIE.substeps
    with pytest.raises(ShapeError, match=r"command must be \(m, 3\)"):
        record_substeps(limp(), make(1), command[:, :2])
    forward = [
        record_substeps(limp(), make(1), one) for one in (command[:, 0], command * [1.0, 0, 0])
    ]
    np.testing.assert_array_equal(forward[0].pelvis_position, forward[1].pelvis_position)


def test_evaluation_measures_velocities_along_the_path() -> None:
    """Mean velocity in the heading that turns with the command, and the pelvis' own turn."""
    results = evaluate(limp(), make(), COMMANDS, STEPS)
    env = make()
    request = {"command": torch.tensor(COMMANDS), "phase": torch.zeros(2, 1)}
    td = env.reset(request_of(request))
    start_yaw, velocities = pelvis_yaw(td), []
    for _ in range(STEPS):
        td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
        c, s = td["heading"][:, 0].cos(), td["heading"][:, 0].sin()
        x, y, _ = td["truth", "pelvis_velocity"].unbind(-1)
        velocities.append(torch.stack([c * x + s * y, c * y - s * x], dim=-1))
    mean = torch.stack(velocities).mean(0)
    turn = (pelvis_yaw(td) - start_yaw) / (STEPS * CASSIE.policy_period)
    for i, result in enumerate(results):
        commanded = (result.speed, result.sideways_speed, result.yaw_rate)
        assert commanded == pytest.approx(COMMANDS[i], abs=1e-6)
        assert result.mean_speed == pytest.approx(mean[i, 0].item(), abs=1e-5)
        assert result.mean_sideways_speed == pytest.approx(mean[i, 1].item(), abs=1e-5)
        assert result.mean_yaw_rate == pytest.approx(turn[i].item(), abs=0.02)
    assert "command [m/s, m/s, rad/s]" in (table := walk_table(results))
    assert "0.400, 0.100, 0.800" in table


def request_of(entries: dict[str, torch.Tensor]) -> TensorDictBase:
    return TensorDict(entries, batch_size=2)  # pyright: ignore[reportArgumentType]


def pelvis_yaw(td: TensorDictBase) -> torch.Tensor:
    w, x, y, z = td["truth", "pelvis_orientation"].unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def test_a_walk_that_does_not_turn_does_not_track_a_turn() -> None:
    straight = WalkResult(0.5, 400, True, 1.0, 0.5, 0.0, 1.0, {})
    assert straight.tracked
    assert not replace(straight, yaw_rate=0.5).tracked
    assert not replace(straight, sideways_speed=-0.3, mean_sideways_speed=math.nan).tracked
    assert replace(straight, yaw_rate=0.5, mean_yaw_rate=0.45).tracked


def test_evaluations_walk_the_same_commands_with_any_seed() -> None:
    first, second = (make_evaluation_env(make, seed) for seed in (0, 1))
    assert first[1] == second[1]
    assert first[0].num_envs == len(first[1]) == 32
    assert symmetric_library().covers(torch.tensor(first[1])).all()
