"""Random pushes reach the simulator, with the impulse and the times of their settings."""

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import step_mdp

from aslip.envs import default_stack, insert_before
from aslip.transforms import RandomPushes
from tests.helpers import MakeEnv


def _pushes(num: int, steps: int, **settings: Any) -> torch.Tensor:
    """Forces (steps, num, 3) without a simulator."""
    pushes = RandomPushes(**settings)
    pushes.set_seed(3)
    td = TensorDict(push=torch.zeros(num, 3), push_steps=torch.zeros(num, 1), batch_size=num)
    forces = []
    for _ in range(steps):
        td = pushes._step(td, TensorDict(batch_size=num))
        forces.append(td["push"])
    return torch.stack(forces)


def test_pushes_last_as_long_and_are_as_strong_as_asked() -> None:
    force = _pushes(400, 300, impulse=20.0, interval=1.5, duration=0.21)
    pushed = force.norm(dim=-1) > 0
    # 7 of 7 + 50 steps on average
    assert float(pushed[100:].float().mean()) == pytest.approx(7 / 57, abs=0.01)
    begins = pushed[1:] & ~pushed[:-1]
    step, robot = (int(index[0]) for index in torch.nonzero(begins, as_tuple=True))
    while_pushed = force[step + 1 : step + 8, robot]
    assert (while_pushed == while_pushed[0]).all()
    impulse = 0.21 * force[pushed].norm(dim=-1)
    assert float(impulse.max()) <= 20.0 + 1e-4
    assert float(impulse.mean()) == pytest.approx(10.0, abs=0.7)
    assert (force[..., 2] == 0).all()
    # directions are uniform
    assert float(force[pushed].mean(0).norm()) < 3.0


def test_a_push_moves_the_robot_and_ends_by_itself(make: MakeEnv) -> None:
    """The force written at the end of a step acts in the next one, and resets end it."""
    stack = insert_before(default_stack(), "command", pushes=RandomPushes(60.0, 0.03))
    env = make(stack=stack, num_envs=2, drop=["fall", "low_reward"])
    td = env.reset()
    assert (td["push"] == 0).all()
    td["command"] = torch.zeros(2, 1)
    velocities = []
    for _ in range(7):
        td = env.step(td.set("action", torch.zeros(2, 10)))
        velocities.append(td["next", "truth", "pelvis_velocity"][:, :2])
        td = step_mdp(td)
    force = td["push"][:, :2]
    assert (torch.linalg.vector_norm(force, dim=-1) > 0).all()
    gained = (velocities[-1] - velocities[0]).numpy()
    assert (np.sum(gained * force.numpy(), axis=1) > 0).all()
    td["_reset"] = torch.tensor([[True], [False]])
    after = env.reset(td)["push"]
    assert (after[0] == 0).all()
    assert (after[1] != 0).any()
