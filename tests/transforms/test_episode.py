"""First episodes end at different times; later episodes have full length."""

import torch
from tensordict import TensorDictBase
from torchrl.envs.transforms import StepCounter

import aslip
from aslip.envs import StackEnv
from aslip.training.environments import make_training_env
from tests.helpers import MakeEnv

LIMIT = 8


def _env(num_envs: int = 24, seed: int = 0) -> StackEnv:
    """Environment of robots that never fall."""
    return make_training_env(
        aslip.make_env,
        num_envs=num_envs,
        seed=seed,
        num_threads=1,
        drop=["fall", "low_reward"],
        replace={"step_limit": StepCounter(LIMIT)},
    )


def _walk(env: StackEnv, steps: int) -> list[TensorDictBase]:
    """Results of steps; robots are reset when their episodes end."""
    outcomes, td = [], env.reset()
    for _ in range(steps):
        td["action"] = torch.zeros(*td.batch_size, 10)
        full, td = env.step_and_maybe_reset(td)
        outcomes.append(full["next"])
    return outcomes


def test_only_the_first_episode_is_cut_short() -> None:
    """Robots that never fall are reset at different times; the count of steps stops at zero."""
    env, lengths = _env(16), [[] for _ in range(16)]
    env.set_seed(0)
    left = env.reset()["stagger"]
    env.set_seed(0)
    for k, outcome in enumerate(_walk(env, 2 * LIMIT + 1), 1):
        assert torch.equal(outcome["stagger"], (left - k).clamp(min=0))
        assert torch.equal(outcome["done"], outcome["truncated"])
        for i in outcome["done"][:, 0].nonzero()[:, 0].tolist():
            lengths[i].append(int(outcome["step_count"][i]))
    first = [each[0] for each in lengths]
    assert min(first) <= 3
    assert max(first) >= LIMIT - 2
    assert len(set(first)) > LIMIT / 2
    assert {length for each in lengths for length in each[1:]} == {LIMIT}


def test_ends_follow_the_seed() -> None:
    found = [_env(seed=seed).reset()["stagger"] for seed in (3, 3, 4)]
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])
    assert found[0].min() >= 1
    assert found[0].max() <= LIMIT


def test_staggered_ends_do_not_change_other_draws(make: MakeEnv) -> None:
    """`StaggeredEnds` does not change commands, phases and noise."""
    plain = make(num_envs=24, drop=["fall", "low_reward"]).reset()
    staggered = _env().reset()
    for key in ("command", "phase", "observation"):
        assert torch.equal(plain[key], staggered[key]), key
    assert "stagger" not in set(plain.keys())
