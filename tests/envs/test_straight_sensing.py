"""Observations, and rewards if asked, do not depend on the true state."""

from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey
from torchrl.envs.utils import check_env_specs, step_mdp

import aslip
from aslip.envs import StackEnv, default_stack, insert_before
from aslip.library import GaitLibrary
from aslip.transforms import SeededTransform
from tests.helpers import MakeEnv

# transforms that may read the true state
PRIVILEGED = ["low_reward", "fall", "step_limit"]


class NoTruth(SeededTransform):
    """Replace all true quantities by NaN, except the heading that the estimator starts with."""

    def __init__(self) -> None:
        groups: list[NestedKey] = ["truth", "true_odometry"]
        super().__init__(in_keys=groups, out_keys=groups)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        for group in self.in_keys:
            for key, value in cast("TensorDict", next_tensordict[group]).items():
                wrong = float("nan") if value.is_floating_point() else True
                next_tensordict.set((group, key), torch.full_like(value, wrong))
        return next_tensordict


def _walk(env: StackEnv, steps: int = 12) -> list[TensorDictBase]:
    """Walk with fixed random actions; one robot is reset in between."""
    generator = torch.Generator().manual_seed(0)
    td = cast("TensorDictBase", env.reset())
    seen = [td.clone()]
    for step in range(steps):
        td["action"] = 0.1 * torch.randn(td.batch_size[0], 10, generator=generator)
        td = step_mdp(env.step(td))
        if step == steps // 2:
            td["_reset"] = torch.tensor([[False], [True], [False]])
            td = cast("TensorDictBase", env.reset(td))
        seen.append(td.clone())
    return seen


def _envs(make: MakeEnv, library: GaitLibrary, **edit: object) -> list[StackEnv]:
    stack = default_stack(library)
    blind = insert_before(stack, "noise", no_truth=NoTruth())
    settings = {"num_envs": 3, "seed": 4, "drop": PRIVILEGED, **edit}
    return [make(stack=stack, **settings), make(stack=blind, **settings)]


def test_observation_does_not_depend_on_the_true_state(make: MakeEnv, library: GaitLibrary) -> None:
    """Observations are bit-equal if all entries under `truth` are NaN."""
    whole, unaware = (_walk(env) for env in _envs(make, library))
    for ours, theirs in zip(whole, unaware, strict=True):
        assert not torch.isfinite(theirs["truth", "qpos"]).any()
        assert torch.equal(ours["observation"], theirs["observation"])
        assert torch.isfinite(ours["observation"]).all()


# ----------------------------------------------------------------------- estimates


def test_estimates_of_a_noisy_walk_are_close_to_the_truth(make: MakeEnv) -> None:
    """After half a second of the shipped policy with noisy sensors."""
    env = make(num_envs=4, seed=0, drop=PRIVILEGED)
    policy = aslip.load_policy("straight")
    speeds = torch.tensor([[0.0], [0.5], [1.0], [2.0]])
    start = {"command": speeds, "phase": torch.zeros(4, 1)}
    td = cast("TensorDictBase", env.reset(TensorDict(start, batch_size=[4])))
    errors = []
    with torch.no_grad():
        for _ in range(40):
            td = step_mdp(env.step(policy(td)))
            errors.append(td["odometry", "pelvis_velocity"] - td["truth", "pelvis_velocity"])
    rms = torch.stack(errors[15:]).square().mean((0, 1)).sqrt()
    assert (rms < torch.tensor([0.05, 0.05, 0.08])).all()
    height = td["estimate", "height"] - td["truth", "pelvis_position"][:, 2:]
    assert (height.abs() < 0.01).all()
    for side in ("left", "right"):
        for what, most in (("position", 0.15), ("orientation", 0.02)):
            name = f"{side}_foot_{what}"
            error = td["odometry", name] - td["truth", name]
            assert (error.abs() < most).all(), name


# ------------------------------------------------------------------------- rewards


def test_rewards_on_the_estimate_need_no_true_state(make: MakeEnv, library: GaitLibrary) -> None:
    """They equal the rewards on the truth up to the estimator's errors."""
    envs = [make(num_envs=3, seed=4, drop=PRIVILEGED, reward_on=on) for on in ("truth", "estimate")]
    check_env_specs(envs[1])
    envs[1] = make(num_envs=3, seed=4, drop=PRIVILEGED, reward_on="estimate")
    policy = aslip.load_policy("straight")
    with torch.no_grad():
        walks = [env.rollout(25, policy, break_when_any_done=False) for env in envs]
    seen, estimated = (walk["next", "reward"][:, 15:] for walk in walks)
    assert (seen - estimated).abs().mean() < 0.02
    assert not torch.equal(seen, estimated)
    blind = insert_before(default_stack(library, "estimate"), "noise", no_truth=NoTruth())
    unaware = make(stack=blind, num_envs=3, seed=4, drop=[*PRIVILEGED, "reward", "episode_sum"])
    # the sum is left out: it reads whether the simulation diverged
    terms = unaware.rollout(2, break_when_any_done=False)["next", "reward_terms"]
    assert all(torch.isfinite(term).all() for term in terms.values())
