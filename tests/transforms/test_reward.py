"""Reward terms, their weighted sum, and ends of episodes."""

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs

import aslip
from aslip.errors import ShapeError, UnknownNameError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.transforms import RewardTerm, SpeedCommand, WeightedReward, rewards
from tests.helpers import MakeEnv

TERMS = list(rewards.PAPER_WEIGHTS)


def _step(env, action: Tensor | None = None):
    td = env.reset()
    return env.step(td.set("action", torch.zeros(*td.batch_size, 10) if action is None else action))


def test_terms_are_the_pure_functions_of_their_entries(make: MakeEnv) -> None:
    env = make(num_envs=4)
    data = _step(env, torch.full((4, 10), 0.05))
    truth, reference = data["next", "truth"], data["next", "reference"]
    expected = {
        "com_vel": rewards.com_vel(
            truth["pelvis_orientation"], truth["pelvis_velocity"], reference["body_velocity"]
        ),
        "foot_pos": rewards.foot_pos(
            truth["pelvis_orientation"],
            truth["pelvis_position"],
            truth["left_foot_position"],
            truth["right_foot_position"],
            reference["left_foot_position"],
            reference["right_foot_position"],
        ),
        "straight_diff": rewards.straight_diff(truth["pelvis_position"]),
        "foot_orient": rewards.foot_orient(
            truth["left_foot_orientation"], truth["right_foot_orientation"]
        ),
        "action_diff": rewards.action_diff(data["action"], data["last_action"]),
    }
    terms = data["next", "reward_terms"]
    assert set(terms.keys()) == set(expected)
    for name, value in expected.items():
        torch.testing.assert_close(terms[name], value, rtol=0, atol=0)
        assert ((value > 0) & (value <= 1)).all()


def test_terms_can_be_left_out(make: MakeEnv) -> None:
    name = "com_vel"
    env = make(num_envs=2, drop=name)  # one name, not a list of letters
    data = _step(env)
    terms = data["next", "reward_terms"]
    assert set(terms.keys()) == set(TERMS) - {name}
    expected = sum(rewards.PAPER_WEIGHTS[key] * terms[key] for key in set(TERMS) - {name})
    torch.testing.assert_close(data["next", "reward"], expected)
    check_env_specs(env)


# -------------------------------------------------------------------- misuse


def test_a_term_without_a_weight_is_refused(make: MakeEnv) -> None:
    weights = {name: 0.2 for name in TERMS if name != "foot_orient"}
    with pytest.raises(UnknownNameError, match=r"no weight for the reward terms \['foot_orient'\]"):
        make(replace={"reward": WeightedReward(weights)})


def test_a_term_that_reads_a_missing_entry_is_refused(make: MakeEnv) -> None:
    term = RewardTerm("com_vel", lambda x: x, [("truth", "pelvis_speed")])
    with pytest.raises(UnknownNameError, match="pelvis_speed"):
        make(replace={"com_vel": term})


# ----------------------------------------------------------- ends of episodes


def _constant(value: float) -> RewardTerm:
    return RewardTerm("com_vel", lambda v: torch.full_like(v[..., :1], value), ["phase"])


@pytest.mark.parametrize(
    ("value", "ends"),
    [(0.29, True), (0.3, False), (float("nan"), True)],
)
def test_a_low_reward_ends_the_episode(make: MakeEnv, value: float, ends: bool) -> None:
    """A reward below 0.3, or NaN, terminates; it does not truncate."""
    names = [name for name in TERMS if name != "com_vel"]
    env = make(
        num_envs=2,
        drop=names,
        replace={"com_vel": _constant(value), "reward": WeightedReward({"com_vel": 1.0})},
    )
    after = _step(env)["next"]
    for key, expected in (("terminated", ends), ("done", ends), ("truncated", False)):
        assert after[key][:, 0].tolist() == [expected] * 2, key


def test_the_step_limit_truncates_and_does_not_terminate(make: MakeEnv) -> None:
    """The 400th step is the last; its value may be bootstrapped."""
    env = make(num_envs=2)
    td = env.reset()
    td["step_count"][:] = 398
    td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    assert not td["done"].any()
    td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    assert (td["step_count"] == 400).all()
    assert td["truncated"].all()
    assert td["done"].all()
    assert not td["terminated"].any()


def test_a_term_of_the_wrong_shape_is_named(make: MakeEnv) -> None:
    term = RewardTerm("com_vel", lambda v: v.abs().sum(-1), [("truth", "pelvis_velocity")])
    env = make(num_envs=3, replace={"com_vel": term})
    with pytest.raises(ShapeError, match=r"'com_vel' must have shape \(3, 1\).*keepdim"):
        env.rollout(2)


# ------------------------------------------------------- a change of command


@pytest.mark.parametrize("stack", ["straight", "single_reference"])
def test_a_command_from_outside_is_not_rewarded_before_the_policy_sees_it(stack: str) -> None:
    """The reward of the step in which it is written follows the old command."""
    found = []
    for command in (None, 2.0):
        env = aslip.make_env(num_envs=2, num_threads=1, stack=stack, seed=0)
        start = TensorDict(command=torch.zeros(2, 1), phase=torch.full((2, 1), 0.3), batch_size=2)
        td = env.step(env.reset(start).set("action", torch.zeros(2, 10)))["next"]
        if command is not None:
            td["command"] = torch.full((2, 1), command)
        found.append(env.step(td.set("action", torch.zeros(2, 10)))["next"])
    for name, term in found[0]["reward_terms"].items():
        torch.testing.assert_close(found[1]["reward_terms", name], term, rtol=0, atol=0)
    body = [td["reference", "body_velocity"][..., 0] for td in found]
    assert (body[1] - body[0]).min() > 1.5  # the policy sees the new command


def test_a_drawn_command_is_rewarded_from_the_next_step_on(
    make: MakeEnv, library: GaitLibrary
) -> None:
    command = SpeedCommand(library, interval=CASSIE.policy_period)
    env = make(num_envs=16, replace={"command": command}, drop=["fall", "low_reward"])
    walk = env.rollout(4, break_when_any_done=False)
    truth, due = walk["next", "truth"], library.lookup(walk["next", "phase"], walk["command"])
    expected = rewards.com_vel(
        truth["pelvis_orientation"], truth["pelvis_velocity"], due.body_velocity
    )
    assert (walk["command"] != walk["next", "command"]).float().mean() > 0.8
    torch.testing.assert_close(walk["next", "reward_terms", "com_vel"], expected, rtol=0, atol=1e-6)
