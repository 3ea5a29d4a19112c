"""Robots that walk until they fall."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

from aslip.envs import StackEnv


def walk(
    env: StackEnv,
    actor: TensorDictModuleBase,
    td: TensorDictBase,
    steps: int,
    bar: tqdm,
    force: np.ndarray | None = None,
) -> tuple[TensorDictBase, np.ndarray]:
    """Walk on from a tensordict, which is left as it is, until all robots have fallen.

    Args:
        env: of n robots, in the state that the tensordict is of.
        actor: who acts.
        td: from where.
        steps: policy steps.
        bar: told of each robot's steps.
        force: (n, 3) on the pelvis all the while [N, world].

    Returns:
        The tensordict after the last step, and (n,) whether each robot has not fallen.
    """
    td = td.clone()
    alive = np.ones(env.num_envs, dtype=bool)
    for _ in range(steps):
        if force is not None:
            td["push"] = torch.from_numpy(force).float()
        td = env.step(actor(td))
        alive &= ~np.asarray(td["next", "terminated"][:, 0])
        td = step_mdp(td).exclude("push")
        bar.update(env.num_envs)
        if not alive.any():
            break
    return td, alive


def reset(env: StackEnv, speed: np.ndarray, phase: np.ndarray) -> TensorDictBase:
    """Start on the reference at speeds (n,) [m/s] and phases (n,)."""
    values = {"command": speed, "phase": phase}
    request = {name: torch.tensor(value)[:, None].float() for name, value in values.items()}
    return env.reset(TensorDict(request, batch_size=len(phase)))
