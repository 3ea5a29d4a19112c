"""Teach Cassie with soft actor-critic (Haarnoja et al. 2018): off-policy learning in a page.

    python recipes/sac_aslip.py --total-steps 60000          # runs/sac_aslip/

The environment is that of `ppo_aslip.py`, its action bounded, which the squashed Gaussian of SAC
needs. Of a transition the replay buffer stores only what the loss reads, 0.6 kB in place of 10 kB.
The policy is not tuned; the page shows how the parts fit. Its network is this recipe's own:

    aslip.load_policy("runs/sac_aslip", sac_aslip.make_actor)
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from aslip.errors import one_line_errors
from aslip.training.command_line import command_line


@dataclass(frozen=True)
class Config:
    """Settings of learning."""

    out: Path = Path("runs/sac_aslip")
    """Folder of the run."""
    seed: int = 0
    """Seed of all random numbers."""
    total_steps: int = 200_000
    """Policy steps to train for."""
    num_envs: int = 64
    """Robots simulated in parallel."""
    samples: int = 256
    """Policy steps between updates, of all robots together."""
    updates: int = 32
    """Gradient steps per update, of 256 transitions each."""
    gamma: float = 0.95
    """Discount factor."""
    learning_rate: float = 3e-4
    """Learning rate of Adam."""


if __name__ == "__main__":
    # before the imports below, which take seconds
    CONFIG = command_line(Config)

from collections.abc import Sequence
from functools import partial

import torch
from tensordict.nn import NormalParamExtractor, TensorDictModule
from tensordict.utils import NestedKey
from torch import nn
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SACLoss, SoftUpdate
from tqdm import tqdm

import aslip
from aslip.envs import observation_keys, policy_interface
from aslip.policy import PolicyShape, RunningNormalizer, save_policy
from aslip.training.collectors import LocalCollector
from aslip.training.progress import ProgressLog
from aslip.transforms import ActionDelta

_LIMIT = 0.5  # largest action [rad]
STORED: tuple[NestedKey, ...] = (
    "observation", "action", ("next", "observation"), ("next", "reward"), ("next", "done"),
    ("next", "terminated"),
)  # fmt: skip
"""Entries of a transition that the loss reads."""


def make_actor(
    normalizer: RunningNormalizer, shape: PolicyShape, observation: Sequence[NestedKey] = ()
) -> ProbabilisticActor:
    """Squashed Gaussian policy with a standard deviation that depends on the observation."""
    mlp = MLP(shape.observation_size, 2 * shape.action_size, num_cells=list(shape.hidden))
    net = nn.Sequential(normalizer, mlp, NormalParamExtractor())
    return ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -_LIMIT, "high": _LIMIT, "tanh_loc": False},
    )


class Critic(nn.Module):
    """Value of an observation and an action."""

    def __init__(self, normalizer: RunningNormalizer, shape: PolicyShape) -> None:
        super().__init__()
        self.normalizer = normalizer
        self.mlp = MLP(shape.observation_size + shape.action_size, 1, num_cells=list(shape.hidden))

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return (*b, 1) values."""
        return self.mlp(torch.cat([self.normalizer(observation), action / _LIMIT], dim=-1))


def main(config: Config) -> list[float]:
    """Train and save a policy; returns the mean reward of each batch."""
    torch.manual_seed(config.seed)
    bounded = {"action": partial(ActionDelta, ("reference", "motor_target"), limit=_LIMIT)}
    # what the loss reads beside action, reward and ends
    make_env = partial(aslip.make_env, replace=bounded, keep=["observation", "step_count"])
    env = aslip.make_env(replace=bounded)
    interface, keys, spec = policy_interface(env), observation_keys(env), env.action_spec_unbatched
    shape = PolicyShape(env.observation_spec["observation"].shape[-1], spec.shape[-1])
    env.close()

    normalizer = RunningNormalizer(shape.observation_size)
    actor = make_actor(normalizer, shape, keys)
    critic = ValueOperator(Critic(normalizer, shape), in_keys=["observation", "action"])
    loss = SACLoss(actor, critic, action_spec=spec, alpha_init=0.02)
    loss.make_value_estimator(gamma=config.gamma)
    target = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate)
    buffer = ReplayBuffer(storage=LazyTensorStorage(config.total_steps), batch_size=256)

    log, rewards = ProgressLog(config.out), []
    collector = LocalCollector(
        make_env, actor, num_envs=config.num_envs, samples=config.samples, seed=config.seed
    )
    bar = tqdm(total=config.total_steps, unit="step")
    with bar, collector:
        for data in collector:
            if len(buffer) == 0:
                normalizer.update(data["observation"])
            done = data["next", "done"]
            lengths = data["next", "step_count"][done].float()
            buffer.extend(data.reshape(-1).select(*STORED))
            for _ in range(config.updates):
                losses = loss(buffer.sample())
                optimizer.zero_grad()
                (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
                optimizer.step()
                target.step()
            rewards.append(float(data["next", "reward"].mean()))
            bar.update(data.numel())
            bar.set_postfix(reward=rewards[-1], alpha=float(losses["alpha"]))
            row = {"reward": rewards[-1], "episode_length": float(lengths.mean())}
            log.write(bar.n, row | {"alpha": float(losses["alpha"])})
            if bar.n >= config.total_steps:
                break
    log.close()
    path = config.out / "policy.zip"
    save_policy(path, actor, shape, {"seed": config.seed}, network=make_actor, **interface)
    print(f"mean reward {rewards[0]:.3f} -> {rewards[-1]:.3f}; {path}")
    return rewards


if __name__ == "__main__":
    with one_line_errors():
        main(CONFIG)
