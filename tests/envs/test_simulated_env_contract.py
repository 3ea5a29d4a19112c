"""TorchRL's contract of environments, for both backends, with and without the full stack."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

import aslip
from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.robot.model import physics_timesteps
from aslip.transforms import Fall
from aslip.walking import evaluate
from tests.helpers import (
    BACKENDS,
    STANDING,
    MakeEnv,
    bare_env,
    differing,
    leaves,
    standing_targets,
)  # fmt: skip


class RandomActions:
    """Policy with its own random actions, the same for every environment."""

    def __init__(self, seed: int, size: float = 0.3) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        self.size = size

    def __call__(self, td: TensorDict) -> TensorDict:
        action = self.size * torch.randn(*td.batch_size, 10, generator=self.generator)
        return td.set("action", action)


def _rollout(env: EnvBase, steps: int, seed: int = 0) -> Any:
    return env.rollout(steps, RandomActions(seed), break_when_any_done=False)  # pyright: ignore


# ------------------------------------------------------------------- specs


@pytest.mark.parametrize("backend", BACKENDS)
def test_base_environments_keep_their_specs(backend: str) -> None:
    check_env_specs(bare_env(backend), break_when_any_done="both")


def test_environments_keep_their_specs_in_a_serial_env(make: MakeEnv) -> None:
    serial = SerialEnv(2, lambda: make(num_envs=2))
    try:
        check_env_specs(serial, break_when_any_done="both")
        assert _rollout(serial, 5)["observation"].shape == (2, 2, 5, 64)
    finally:
        serial.close()


def test_all_entries_but_the_exact_state_are_single_precision(make: MakeEnv) -> None:
    data = _rollout(make(num_envs=1), 2)
    for key, value in leaves(data).items():
        if value.dtype == torch.float64:
            exact = (("truth", "qpos"), ("truth", "qvel"), ("estimator", "memory"))
            assert key[-2:] in exact, key


# ------------------------------------------------------- equality and seeds


def test_backends_are_equal_bit_for_bit(make: MakeEnv) -> None:
    """50 policy steps of random actions under the full stack, with falls and resets in between."""
    rollouts = [_rollout(make(backend, num_envs=3, seed=5), 50) for backend in BACKENDS]
    done = rollouts[0]["next", "done"][..., 0]
    assert done.any(dim=1).all()  # every robot was reset
    assert not done.all(dim=0).any()  # but not all at once
    assert differing(*rollouts) == []


def test_rollouts_are_equal_for_equal_seeds_only(make: MakeEnv) -> None:
    first, again, other = (_rollout(make(num_envs=2, seed=seed), 25, seed=9) for seed in (3, 3, 4))
    assert differing(first, again) == []
    assert {"command", "phase"} <= set(differing(first, other))
    assert first["next", "done"].any()


def test_transforms_draw_from_the_seed_and_not_from_the_global_generator(make: MakeEnv) -> None:
    env = make(num_envs=4, seed=1)
    torch.manual_seed(0)
    first = env.reset()
    env.set_seed(1)
    torch.manual_seed(1)
    second = env.reset()
    for key in ("command", "phase"):
        torch.testing.assert_close(first[key], second[key], rtol=0, atol=0)


# ------------------------------------------------------------ base behaviour


@pytest.mark.parametrize("backend", BACKENDS)
def test_robot_stands_after_a_reset_without_a_state(backend: str) -> None:
    td = bare_env(backend).reset()
    torch.testing.assert_close(td["truth", "qpos"], STANDING.repeat(2, 1), rtol=0, atol=0)
    assert (td["truth", "qvel"] == 0).all()
    assert not td["done"].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_fallen_robots_are_terminated(backend: str) -> None:
    base = bare_env(backend)
    env = TransformedEnv(base, Fall())
    qpos = STANDING.repeat(2, 1)
    qpos[1, 2] = CASSIE.fall_height - 0.05
    qpos[1, 3:7] = torch.tensor([0.5, 0, 0.5, 0]) * 2**0.5
    initial = TensorDict(qpos=qpos, qvel=torch.zeros(2, 32), batch_size=2)
    base.reset(TensorDict(initial=initial, batch_size=2))
    start = TensorDict(motor_target=standing_targets(base), batch_size=2)
    after = env.step(start)["next"]
    assert after["terminated"][:, 0].tolist() == [False, True]
    assert after["done"][:, 0].tolist() == [False, True]
    assert not after["truth", "diverged"].any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_nan_target_ends_the_episode_of_its_robot_only(backend: str) -> None:
    broken, whole = bare_env(backend, 3), bare_env(backend, 3)
    tds = [broken.reset(), whole.reset()]
    target = standing_targets(broken)
    bad = target.clone()
    bad[1, 4] = torch.nan
    for k in range(3):
        tds[0].set("motor_target", bad if k == 1 else target)
        tds[1].set("motor_target", target)
        tds = [env.step(td)["next"] for env, td in zip((broken, whole), tds, strict=True)]
        for key, value in leaves(tds[0].exclude("motor_target")).items():
            torch.testing.assert_close(value[[0, 2]], tds[1][key][[0, 2]], rtol=0, atol=0)
        if k == 1:
            assert tds[0]["terminated"][:, 0].tolist() == [False, True, False]
            assert tds[0]["truth", "diverged"][:, 0].tolist() == [False, True, False]
            torch.testing.assert_close(tds[0]["truth", "qpos"][1], STANDING, rtol=0, atol=0)
    assert (broken.divergences, whole.divergences) == (1, 0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_nan_action_ends_the_episode_of_its_robot_only(make: MakeEnv) -> None:
    """With the full stack, the robot is reset and continues; the others stay bit-equal."""
    settings: dict[str, Any] = {"num_envs": 3, "seed": 2}
    broken, whole = make(**settings), make(**settings)
    tds = [broken.reset(), whole.reset()]
    for k in range(5):
        action = torch.full((3, 10), 0.02)
        tds[1].set("action", action)
        tds[0].set("action", action.clone())
        if k == 2:
            tds[0]["action"][1, 0] = torch.nan
        (stepped, tds[0]), (other, tds[1]) = (
            env.step_and_maybe_reset(td) for env, td in zip((broken, whole), tds, strict=True)
        )
        rows = torch.tensor([0, 2])
        assert differing(stepped["next"][rows], other["next"][rows]) == []
        assert differing(tds[0][rows], tds[1][rows]) == []
        assert stepped["next", "terminated"][:, 0].tolist() == [False, k == 2, False]
        assert all(torch.isfinite(value).all() for value in leaves(tds[0]).values())
        after = stepped["next"].exclude("last_action")
        assert all(torch.isfinite(value).all() for value in leaves(after).values())
        assert (after["reward"][1] == 0) == (k == 2)
    assert broken.base_env.divergences == 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_floor_has_the_requested_friction(make: MakeEnv, backend: str) -> None:
    model = make(backend, floor_friction=0.05).base_env.model
    assert model.geom("floor").friction[0] == 0.05


def test_policy_walks_with_half_as_many_physics_steps(make: MakeEnv) -> None:
    """A policy of the 2 kHz physics walks as fast there; a longer delay keeps the timestep."""
    env = make(num_envs=2, timestep=physics_timesteps()[1])
    env.base_env.set_dynamics({"torque_delay": 0.012})
    env.base_env.set_dynamics({"torque_delay": CASSIE.torque_delay + 0.0006})
    assert env.base_env.dynamics["torque_delay"] == pytest.approx([0.004, 0.004])
    assert env.base_env.model.opt.timestep == physics_timesteps()[1]
    env = make(timestep=physics_timesteps()[1])
    (result,) = evaluate(aslip.load_policy("straight"), env, [1.0], num_steps=100)
    assert result.survived
    assert result.mean_speed == pytest.approx(1.0, abs=0.06)
    with pytest.raises(ConfigurationError, match=r"dm_control.*0\.0005 s, got 0\.001"):
        make("dm_control", timestep=physics_timesteps()[1])


@pytest.mark.parametrize("backend", BACKENDS)
def test_steps_do_not_share_memory(backend: str) -> None:
    """Steps contain no live views of the simulator: the next step does not change them."""
    env = bare_env(backend)
    td = env.reset()
    kept = td.clone()
    after = env.step(td.clone().set("motor_target", standing_targets(env)))["next"]
    kept_after = after.clone()
    env.step(TensorDict(motor_target=standing_targets(env) + 0.3, batch_size=2))
    env.reset()
    assert differing(td, kept) == []
    assert differing(after, kept_after) == []
