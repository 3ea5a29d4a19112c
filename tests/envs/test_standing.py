"""Evaluations of robots that stand on a wish."""

from __future__ import annotations

import torch
from tensordict import TensorDict

import aslip
from aslip.envs import EPISODE_ENDS, evaluation_stack, standing_stack
from aslip.library import WalkMode
from tests.library.standing import standing_library


def test_an_evaluation_judges_standing_robots_by_standing() -> None:
    """Its goal and rewards are those of the stack itself, through a stop."""
    library = standing_library()
    stack = standing_stack(library)
    drop = (*EPISODE_ENDS, "noise", "fall")
    ends = [
        aslip.make_env(stack=one, num_envs=2, num_threads=1, drop=drop, seed=0)
        for one in (stack, evaluation_stack(stack, library))
    ]
    entries = {"phase": torch.tensor([[0.33], [0.6]]), "stand": torch.tensor([[1.0], [0.0]])}
    request = TensorDict({"command": torch.zeros(2, 3), **entries}, batch_size=2)
    tds = [env.reset(request.clone()) for env in ends]
    for _ in range(4):
        for i, env in enumerate(ends):
            tds[i]["action"], tds[i]["stand"] = torch.zeros(2, 10), torch.ones(2, 1)
            tds[i] = env.step(tds[i])["next"]
        assert torch.equal(tds[0]["reward"], tds[1]["reward"])
    assert tds[0]["mode"][0].item() != tds[0]["mode"][1].item()


def test_robots_stand_where_a_stop_ends() -> None:
    """Pushed or late robots need not go back to the path of their commands."""
    library = standing_library()
    stack = standing_stack(library)
    env = aslip.make_env(
        stack=stack, num_envs=1, num_threads=1, drop=(*EPISODE_ENDS, "fall"), seed=0
    )
    entries = {"phase": torch.full((1, 1), 0.38), "stand": torch.zeros(1, 1)}
    td = env.reset(TensorDict({**entries, "command": torch.zeros(1, 3)}, batch_size=1))
    td["stand"], td["mode"], modes = torch.ones(1, 1), torch.full((1, 1), WalkMode.STOP), []
    for _ in range(25):
        td["action"] = torch.zeros(1, 10)
        td = env.step(td)["next"]
        modes.append(WalkMode(int(td["mode"])))
        for group in ("odometry", "true_odometry"):
            error = torch.linalg.vector_norm(td[group, "path_error"])
            assert (error < 1e-6) == (modes[-1] == WalkMode.STOP)
    assert {WalkMode.STOP, WalkMode.STAND} <= {*modes}
