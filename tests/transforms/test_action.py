"""The policy's action becomes a motor target, and is stored as the last action."""

import math

import numpy as np
import pytest
import torch
from torchrl.data import Bounded
from torchrl.envs.utils import check_env_specs

from aslip.envs import StackEnv
from aslip.errors import ShapeError
from aslip.transforms import ActionDelta
from tests.helpers import MakeEnv


def _spy(env: StackEnv) -> list[np.ndarray]:
    """List of the motor targets that the backend gets from now on."""
    targets: list[np.ndarray] = []
    advance = env.base_env._advance

    def spy(motor_target: np.ndarray, push: np.ndarray | None) -> np.ndarray:
        targets.append(motor_target.copy())
        return advance(motor_target, push)

    env.base_env._advance = spy  # pyright: ignore[reportAttributeAccessIssue]
    return targets


@pytest.mark.parametrize("backend", ["batch", "dm_control"])
def test_the_target_is_the_reference_plus_the_action(make: MakeEnv, backend: str) -> None:
    env = make(backend, num_envs=2)
    targets = _spy(env)
    td = env.reset()
    for seed in range(2):
        action = torch.randn(2, 10, generator=torch.Generator().manual_seed(seed))
        reference = td["reference", "motor_target"].clone()
        stepped = env.step(td.set("action", action))
        np.testing.assert_array_equal(targets[-1], (reference + action).double().numpy())
        torch.testing.assert_close(stepped["action"], action, rtol=0, atol=0)
        td = stepped["next"]
    assert len(targets) == 2


def test_actions_are_not_clipped(make: MakeEnv) -> None:
    """Sec. IV-B, "the output is unbounded": no clipping between policy and PD loop."""
    env = make(drop=["low_reward"])
    targets = _spy(env)
    td = env.reset()
    reference = td["reference", "motor_target"].clone()
    env.step(td.set("action", torch.full((1, 10), 7.5)))
    np.testing.assert_allclose(targets[0], (reference + 7.5).numpy(), rtol=1e-6)


def test_the_bound_of_the_action_spec_can_be_chosen(make: MakeEnv) -> None:
    env = make(num_envs=2)
    assert isinstance(env.action_spec, Bounded)
    assert env.action_spec.shape == (2, 10)
    torch.testing.assert_close(env.action_spec.high, torch.full((2, 10), math.pi / 2))
    torch.testing.assert_close(env.action_spec.low, torch.full((2, 10), -math.pi / 2))
    env = make(num_envs=64, replace={"action": ActionDelta(limit=0.3)})
    torch.testing.assert_close(env.action_spec.high, torch.full((64, 10), 0.3))
    action = env.rand_action()["action"]
    assert env.action_spec.is_in(action)
    assert action.abs().amax() > 0.27


def test_another_baseline_can_be_named(make: MakeEnv) -> None:
    env = make(replace={"action": ActionDelta(("truth", "motor_position"))})
    targets = _spy(env)
    td = env.reset()
    env.step(td.set("action", torch.zeros(1, 10)))
    np.testing.assert_array_equal(targets[0], td["truth", "motor_position"].double().numpy())


def test_without_action_delta_the_action_is_the_target(make: MakeEnv) -> None:
    env = make(drop=["action", "action_diff", "last_action"])
    assert env.action_keys == ["motor_target"]
    check_env_specs(env)


def test_actions_of_another_shape_are_refused(make: MakeEnv) -> None:
    env = make(num_envs=2)
    td = env.reset()
    with pytest.raises(ShapeError, match=r"action must have shape \(2, 10\)"):
        env.step(td.set("action", torch.zeros(2, 9)))


def test_the_last_action_is_the_previous_one_and_zero_after_a_reset(make: MakeEnv) -> None:
    env = make(num_envs=2, drop=["low_reward"])
    td = env.reset()
    assert (td["last_action"] == 0).all()
    for k in range(3):
        action = torch.full((2, 10), 0.01 * k + 0.01)
        td = env.step(td.set("action", action))["next"]
        torch.testing.assert_close(td["last_action"], action, rtol=0, atol=0)
    assert (env.reset()["last_action"] == 0).all()
