"""Dynamics and noise of robots vary within the given ranges, and only at resets."""

import math
from collections.abc import Mapping
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from aslip.envs import Stack, StackEnv, default_stack, insert_before, randomise_stack
from aslip.errors import ConfigurationError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.sim import DYNAMICS
from aslip.transforms import DYNAMICS_RANGES, RandomDynamics
from tests.helpers import MakeEnv, differing

Ranges = Mapping[str, tuple[float, float]]
# all parameters, at their defaults
NOMINAL: Ranges = {
    name: (value, value)
    for name, value in (
        dict.fromkeys(DYNAMICS, 1.0) | {"payload": 0.0, "torque_delay": 0.003, "slope": 0.0}
    ).items()
}


def _stack(library: GaitLibrary, ranges: Ranges) -> Stack:
    return randomise_stack(default_stack(library), ranges)


def _rollout(env: StackEnv, steps: int, seed: int = 0) -> Any:
    """Rollout with random actions and automatic resets."""
    generator = torch.Generator().manual_seed(seed)

    def act(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", 0.3 * torch.randn(*td.batch_size, 10, generator=generator))

    return env.rollout(steps, act, break_when_any_done=False)  # pyright: ignore


def _dynamics(td: TensorDictBase) -> dict[str, torch.Tensor]:
    return dict(td["dynamics"].items())


# --------------------------------------------------------- no randomisation


def test_ranges_of_zero_width_at_the_defaults_change_nothing(
    make: MakeEnv, library: GaitLibrary
) -> None:
    """Bit for bit, through falls and resets."""
    default = _rollout(make(num_envs=2, seed=3), 30)
    env = make(num_envs=2, seed=3, stack=_stack(library, NOMINAL))
    rollout = _rollout(env, 30)
    assert default["next", "done"].any()
    assert not env.base_env.altered
    assert _dynamics(rollout)["torque_delay"].unique().tolist() == pytest.approx([0.003])
    for part in (rollout, rollout["next"]):
        del part["dynamics"]
    assert differing(default, rollout) == []


@pytest.mark.parametrize("ranges", [{"joint_damping": (1.0, 1.0)}, {"floor_friction": (0.6, 0.6)}])
def test_the_given_friction_of_an_environment_is_kept(
    make: MakeEnv, library: GaitLibrary, ranges: Ranges
) -> None:
    """Also if it is drawn in single precision, which cannot represent it exactly."""
    env = make(num_envs=1, stack=_stack(library, ranges), floor_friction=0.6)
    env.reset()
    assert env.base_env.dynamics["floor_friction"].tolist() == [0.6]
    assert not env.base_env.altered


# --------------------------------------------------------------------- draws


def test_a_share_of_the_parameters_is_drawn_and_the_others_are_nominal(make: MakeEnv) -> None:
    """Drawn values are those of a share of 1."""
    found = []
    for share in (1.0, 0.3, 0.0):
        dynamics = RandomDynamics(share=share)
        stack = insert_before(default_stack(), "start", dynamics=dynamics)
        found.append(_dynamics(make(num_envs=200, seed=1, stack=stack).reset()))
    full, some, none = (torch.cat([*one.values()], dim=-1) for one in found)
    nominal = torch.tensor([DYNAMICS[name].nominal for name in found[0]])
    torch.testing.assert_close(none, nominal.expand_as(none))
    drawn = some != nominal
    torch.testing.assert_close(some[drawn], full[drawn])
    # five standard errors
    assert drawn.float().mean().item() == pytest.approx(0.3, abs=5 * 0.46 / drawn.numel() ** 0.5)


def test_draws_fill_their_ranges(make: MakeEnv, library: GaitLibrary) -> None:
    """Means and correlations are within 5 standard errors; draws reach every third of the range."""
    num = 64
    td = make(num_envs=num, stack=_stack(library, DYNAMICS_RANGES)).reset()
    assert set(_dynamics(td)) == set(DYNAMICS_RANGES)
    for name, (low, high) in DYNAMICS_RANGES.items():
        value = td["dynamics", name]
        assert value.shape == (num, 1)
        assert value.dtype == torch.float32
        share = (value - low) / (high - low)
        assert -1e-6 <= share.min() < 1 / 3
        assert 2 / 3 < share.max() <= 1 + 1e-6
        assert abs(share.mean() - 0.5) < 5 * math.sqrt(1 / 12 / num), name
    correlation = torch.corrcoef(torch.cat(list(_dynamics(td).values()), dim=-1).T)
    assert (correlation - torch.eye(len(correlation))).abs().max() < 5 / math.sqrt(num)


def test_the_same_seed_draws_the_same(make: MakeEnv, library: GaitLibrary) -> None:
    """Draws do not depend on other transforms or on other ranges."""
    friction = {"floor_friction": DYNAMICS_RANGES["floor_friction"]}
    several, alone = _stack(library, DYNAMICS_RANGES), _stack(library, friction)

    def draws(seed: int, stack: Stack, **settings: Any) -> list[float]:
        env = make(num_envs=3, seed=seed, stack=stack, **settings)
        both = [env.reset()["dynamics", "floor_friction"] for _ in range(2)]
        return torch.cat(both)[:, 0].tolist()

    first = draws(1, several)
    assert len(set(first)) == 6
    assert draws(1, several, drop=["foot_orient"]) == first
    assert draws(1, alone) == first
    assert not set(draws(2, several)) & set(first)


def test_only_reset_robots_get_new_parameters(make: MakeEnv, library: GaitLibrary) -> None:
    """Until then, robots keep their values, even if only one has a longer delay."""
    ranges = {**DYNAMICS_RANGES, "torque_delay": (0.0, 0.02)}
    env = make(num_envs=3, stack=_stack(library, ranges))
    td = _rollout(env, 30)
    done = td["next", "done"][:, :-1, 0]
    assert done.any()
    assert not done.all()
    for name, values in _dynamics(td).items():
        kept = values[:, 1:] == values[:, :-1]
        assert (kept[..., 0] == ~done).all(), name
        torch.testing.assert_close(td["next", "dynamics", name], values, rtol=0, atol=0)
    last = td["next"][:, -1]
    held = torch.tensor(env.base_env.dynamics["mass"]).float()[~last["done"][:, 0]]
    torch.testing.assert_close(held, last["dynamics", "mass"][~last["done"][:, 0], 0])


def test_a_caller_can_choose_parameters(make: MakeEnv, library: GaitLibrary) -> None:
    """A reset of all robots takes chosen values; later resets draw."""
    env = make(num_envs=2, stack=_stack(library, {"mass": (0.9, 1.1), "slope": (0.0, 0.0)}))
    chosen = TensorDict(mass=torch.tensor([[0.5], [1.5]]), payload=torch.ones(2, 1), batch_size=2)
    td = env.reset(TensorDict(dynamics=chosen, batch_size=2))
    assert td["dynamics", "mass"][:, 0].tolist() == [0.5, 1.5]
    assert env.base_env.dynamics["mass"].tolist() == [0.5, 1.5]
    assert env.base_env.dynamics["payload"].tolist() == [1.0, 1.0]  # which is not drawn
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert 0.9 <= td["dynamics", "mass"][0, 0] <= 1.1
    assert td["dynamics", "mass"][1, 0] == 1.5
    assert env.base_env.dynamics["mass"].tolist()[1] == 1.5


# ------------------------------------------------------------------- contract


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"mass": (1.2, 0.8)}, r"mass.*\(low, high\), got \(1\.2, 0\.8\)"),
        ({"floor_friction": (0.0, 1.0)}, r"floor_friction.*0\.01 to 5, got 0\.0"),
        ({"sensor_noise": (math.nan, 1.0)}, r"sensor_noise.*nan"),
    ],
)
def test_invalid_ranges_are_refused(ranges: Ranges, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        RandomDynamics(ranges)


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'joint_damping'"):
        RandomDynamics({"joint_dampng": (1.0, 2.0)})


# ---------------------------------------------------------------------- noise


def _errors(env: StackEnv, clean: StackEnv, steps: int) -> torch.Tensor:
    """Mean error (n, steps + 1) of the gyro, from the same rollout with and without noise."""
    rollouts = [_rollout(each, steps) for each in (env, clean)]
    packets = [
        torch.cat([r["sensors", "gyro"], r["next", "sensors", "gyro"][:, -1:]], 1) for r in rollouts
    ]
    return (packets[0] - packets[1]).abs().mean((-1, -2))


def test_each_robot_has_its_own_noise(make: MakeEnv, library: GaitLibrary) -> None:
    """With the same seed, a factor of two doubles the error exactly, and zero removes it."""
    settings: dict[str, Any] = {"num_envs": 1, "seed": 4, "drop": ["low_reward"]}
    clean = make(**settings | {"drop": ["low_reward", "noise"]})
    errors = {}
    for factor in (0.0, 1.0, 2.0):
        stack = _stack(library, {"sensor_noise": (factor, factor)})
        clean.set_seed(4)
        errors[factor] = _errors(make(**settings, stack=stack), clean, 6)
    assert errors[1.0].min() > 0
    torch.testing.assert_close(errors[2.0], 2 * errors[1.0], rtol=1e-3, atol=0)
    assert not errors[0.0].any()
