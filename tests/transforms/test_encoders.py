"""Encoder offsets: what robots read, what their PD loops track, and how offsets are drawn."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict

from aslip.envs import StackEnv, default_stack, insert_before, robot_stack
from aslip.robot import CASSIE
from aslip.transforms import Difficulty, EncoderOffsets
from tests.helpers import MakeEnv

READINGS = ("sensors", "motor_position")


def _env(make: MakeEnv, num: int = 2, **settings: Any) -> StackEnv:
    stack = insert_before(default_stack(), "estimator", encoders=EncoderOffsets(**settings))
    return make(num_envs=num, stack=stack, drop=["noise", "low_reward"])


def test_readings_and_pd_loops_have_the_same_offset(make: MakeEnv) -> None:
    env = _env(make, largest=0.05)
    td = env.reset()
    for _ in range(3):
        offset = td["motor_offset"]
        angle = td["truth", "qpos"][:, CASSIE.indices.motor_qpos.tolist()].float()
        # encoders round, and the reading is up to one substep old
        torch.testing.assert_close(td[READINGS][:, -1] - offset, angle, rtol=0, atol=5e-3)
        torch.testing.assert_close(td["estimate", "motor_position"], td[READINGS][:, -1])
        td["action"] = torch.full((2, 10), 0.1)
        target = td["reference", "motor_target"] + 0.1 - offset
        torch.testing.assert_close(env.transform.inv(td.clone())["motor_target"], target)
        td = env.step(td)["next"]
        assert torch.equal(td["motor_offset"], offset)


def test_offsets_are_uniform_for_a_share_of_the_robots(make: MakeEnv) -> None:
    offset = _env(make, 200, largest=0.02, share=0.4).reset()["motor_offset"]
    drawn = offset.any(dim=1)
    assert drawn.float().mean().item() == pytest.approx(0.4, abs=0.12)
    assert -0.02 <= offset.min() < -0.019 and 0.019 < offset.max() <= 0.02
    assert offset[drawn].std().item() == pytest.approx(0.02 / 3**0.5, rel=0.1)
    # each motor has an offset of its own
    assert offset[drawn].std(dim=1).min() > 0


def test_a_reset_draws_offsets_for_its_robots_only(make: MakeEnv) -> None:
    env = _env(make)
    before = env.reset()
    td = env.reset(before.clone().set("_reset", torch.tensor([[True], [False]])))
    assert (td["motor_offset"][0] != before["motor_offset"][0]).all()
    assert torch.equal(td["motor_offset"][1], before["motor_offset"][1])


def test_offsets_grow_with_the_difficulty(make: MakeEnv) -> None:
    stack = insert_before(
        default_stack(),
        "estimator",
        difficulty=Difficulty(4),
        encoders=EncoderOffsets(difficulty_key="difficulty"),
    )
    env = make(num_envs=2, stack=stack)
    assert not env.reset()["motor_offset"].any()
    half, full = (
        env.reset(TensorDict(difficulty=torch.full((2, 1), level), batch_size=2))["motor_offset"]
        for level in (0.5, 1.0)
    )
    assert 0 < half.abs().max() <= 0.005
    assert full.abs().max() > 0.005


def test_a_real_robot_has_its_own_offsets() -> None:
    stack = insert_before(default_stack(), "estimator", encoders=EncoderOffsets())
    assert "encoders" not in robot_stack(stack)
