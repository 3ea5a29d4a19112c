"""Difficulty rises with a robot's steps, and narrows dynamics and pushes."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import StepCounter

import aslip
from aslip.envs import StackEnv, default_stack, insert_before
from aslip.errors import ConfigurationError
from aslip.sim import DYNAMICS
from aslip.transforms import Difficulty, RandomDynamics, RandomPushes

RANGES = {"mass": (0.8, 1.4), "payload": (4.0, 8.0), "torque_delay": (0.005, 0.009)}


def make(num: int = 4, ramp: int = 5) -> StackEnv:
    stack = insert_before(
        default_stack(),
        "start",
        dynamics=RandomDynamics(RANGES, difficulty_key="difficulty"),
        difficulty=Difficulty(ramp),
        pushes=RandomPushes(20.0, 0.03, 0.03, difficulty_key="difficulty"),
    )
    return aslip.make_env(stack=stack, num_envs=num, num_threads=1, drop=["low_reward"], seed=0)


def test_difficulty_carries_over_the_episodes_of_a_training() -> None:
    """A collector's requests for resets have nothing but a mask."""
    env, heaviest = make(4, 40), 0.0
    env.append_transform(StepCounter(7))
    td = env.reset()
    for step in range(24):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(4, 10)))
        assert td["difficulty"].flatten().tolist() == pytest.approx([(step + 1) / 40] * 4)
        heaviest = max(heaviest, float(td["dynamics", "payload"].max()))
    # the last episodes start at a difficulty of 0.525, with payloads from 2.1 to 4.2 kg
    assert heaviest > 2.1
    assert env.reset()["difficulty"].sum() == 0


def test_episodes_go_on_in_another_environment_at_their_difficulty() -> None:
    """Difficulty after a resume, where requests for resets have nothing but a mask."""
    first, other = make(2), make(2)
    td, bad = first.reset(), torch.zeros(2, 10)
    for env in (first, first, other):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(2, 10)))
    bad[1] = torch.nan
    stepped, td = other.step_and_maybe_reset(td.set("action", bad))
    assert stepped["next", "done"].flatten().tolist() == [False, True]
    assert td["difficulty"].flatten().tolist() == pytest.approx([0.8, 0.8])


def test_robots_that_took_steps_elsewhere_start_as_hard() -> None:
    env = make(2, 100)
    (difficulty,) = (t for t in env.transforms if isinstance(t, Difficulty))
    for steps, expected in ((30, 0.3), (200, 1.0)):
        difficulty.resume(steps)
        assert env.reset()["difficulty"].flatten().tolist() == pytest.approx([expected] * 2)


def test_a_full_reset_starts_the_curriculum_again() -> None:
    env, mask = make(2), torch.tensor([[True], [False]])
    td = env.reset()
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(2, 10)))["next"]
    assert env.reset()["difficulty"].flatten().tolist() == [0.0, 0.0]
    # a request with nothing but a mask finds what the reset began with, not the steps before it
    assert env.reset(TensorDict(_reset=mask, batch_size=2))["difficulty"][0] == 0
    request = TensorDict(_reset=mask, difficulty=torch.full((2, 1), 0.5), batch_size=2)
    assert env.reset(request)["difficulty"][0] == 0.5
    td = env.reset(TensorDict(_reset=torch.ones(2, 1, dtype=torch.bool), batch_size=2))
    assert td["difficulty"].flatten().tolist() == [0.5, 0.0]


def test_ranges_grow_from_the_nominal_value() -> None:
    env, drawn = make(200), []
    for difficulty in (0.0, 0.5, 1.0):
        env.set_seed(3)
        request = TensorDict(difficulty=torch.full((200, 1), difficulty), batch_size=200)
        td = env.reset(request)
        drawn.append({name: td["dynamics", name] for name in RANGES})
        for name in RANGES:
            found = torch.from_numpy(env.base_env.dynamics[name])[:, None].float()
            # a delay is a whole number of physics steps
            torch.testing.assert_close(found, td["dynamics", name], atol=3e-4, rtol=0)
    for name, (low, high) in RANGES.items():
        easy, middle, hard = (one[name] for one in drawn)
        assert (easy == DYNAMICS[name].nominal).all()
        torch.testing.assert_close(middle, (easy + hard) / 2)
        assert low <= hard.min() < hard.max() <= high


@pytest.mark.parametrize("names", [["dynamics"], ["difficulty", "dynamics"]])
def test_ranges_need_a_difficulty_later_in_the_stack(names: list[str]) -> None:
    makers = {
        "difficulty": Difficulty(5),
        "dynamics": RandomDynamics(RANGES, difficulty_key="difficulty"),
    }
    stack = insert_before(default_stack(), "start", **{name: makers[name] for name in names})
    with pytest.raises(ConfigurationError, match="needs Difficulty after RandomDynamics"):
        aslip.make_env(stack=stack, num_envs=2, num_threads=1).reset()


def test_impulses_grow_from_zero() -> None:
    env = make()
    forces = []
    for difficulty in (0.0, 0.5, 1.0):
        env.set_seed(3)
        td = env.reset(TensorDict(difficulty=torch.full((4, 1), difficulty), batch_size=4))
        forces.append(env.step(td.set("action", torch.zeros(4, 10)))["next", "push"])
    assert not forces[0].any()
    assert forces[2].norm(dim=-1).min() > 0
    torch.testing.assert_close(forces[1], forces[2] / 2)
