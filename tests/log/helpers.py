"""Walks to record."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict

from aslip.envs import StackEnv

MakeRecorded = Callable[..., StackEnv]


def run(env: StackEnv, steps: int, size: float = 0.1) -> list[TensorDict]:
    """Steps of random actions, each with what came before; episodes begin anew when they end."""
    generator = torch.Generator().manual_seed(0)
    seen, td = [], env.reset()
    for step in range(steps):
        action = size * torch.randn(env.num_envs, 10, generator=generator)
        td["action"] = action
        if step in (3, 4):
            td["push"] = torch.tensor([[0.0, 20.0, 0.0]]).expand(env.num_envs, 3).clone()
        stepped, td = env.step_and_maybe_reset(td)
        seen.append(stepped.clone())
        td = td.exclude("push")
    return seen
