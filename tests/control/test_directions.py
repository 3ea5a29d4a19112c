"""Controllers give the motor targets of stacks for all directions."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

import aslip
from aslip.control import Controller
from aslip.envs import directions_stack
from aslip.errors import ShapeError
from aslip.transforms import DIRECTION_TABLE, VelocityCommand
from tests.library.bent import symmetric_library


def _policy() -> TensorDictModule:
    """Untrained network with small actions."""
    torch.manual_seed(4)
    net = torch.nn.Sequential(torch.nn.Linear(82, 10), torch.nn.Tanh())
    module = TensorDictModule(
        lambda seen: 0.1 * net(seen), in_keys=["observation"], out_keys=["action"]
    )
    return module


def _controller() -> Controller:
    return Controller(_policy(), symmetric_library(), observation=DIRECTION_TABLE)


@torch.no_grad()
@pytest.mark.parametrize("num", [1, 3])
def test_motor_targets_are_those_of_a_stacks_rollout(num: int) -> None:
    """With noise, turns, changes of command and heading, falls and resets."""
    library = symmetric_library()
    stack = directions_stack(library)
    env = aslip.make_env(stack=stack, num_envs=num, seed=5, num_threads=1, drop=["low_reward"])
    policy, controller, restarts = _policy(), _controller(), 0
    command = cast("VelocityCommand", env.transforms[env.transform_names.index("command")])
    td = env.reset(TensorDict(heading=torch.linspace(0.1, 1.5, num)[:, None], batch_size=num))
    state = controller.start(td["sensors"], td["command"], phase=td["phase"], heading=td["heading"])
    for step in range(70):
        if step % 13 == 8:
            td["command"] = command.draw((num, 3))
        if step == 15:
            td["heading"] = td["heading"] + 1.0
        turned = td["heading"]
        td, following = env.step_and_maybe_reset(policy(td))
        ours, theirs = state.tensordict, env.transform.inv(td)
        for key in ("motor_target", "observation", "phase", "filtered_command", "estimator"):
            assert (ours[key] == theirs[key]).all(), (step, key)
        for name, value in ours["odometry"].items():
            assert torch.equal(value, theirs["odometry", name]), (step, name)
        restart = td["next", "done"]
        restarts += int(restart.sum())
        state, _ = controller.step(
            state,
            following["sensors"],
            following["command"],
            heading=torch.where(restart, following["heading"], turned),
            restart=restart,
            phase=following["phase"],
        )
        td = following
    assert restarts > 0


@torch.no_grad()
def test_the_heading_advances_by_itself() -> None:
    """A caller who never writes the heading gets the same targets as one who reads the stack's."""
    library = symmetric_library()
    env = aslip.make_env(stack=directions_stack(library), num_threads=1, seed=0)
    policy, controller = _policy(), _controller()
    td = env.reset(TensorDict(command=torch.tensor([[0.4, 0.1, 0.8]]), batch_size=1))
    state = controller.start(td["sensors"], td["command"], phase=td["phase"], heading=td["heading"])
    for _ in range(10):
        td = env.step(policy(td))["next"]
        state, _ = controller.step(state, td["sensors"])
        assert torch.equal(state.tensordict["observation"], td["observation"])


def test_a_number_is_a_forward_speed_and_commands_move_into_the_region() -> None:
    env = aslip.make_env(
        stack=directions_stack(symmetric_library()), num_envs=2, num_threads=1, seed=0
    )
    packets, controller = env.reset()["sensors"], _controller()
    entries = controller.start(packets, 0.5).tensordict
    assert entries["filtered_command"].tolist() == [[0.5, 0.0, 0.0]] * 2
    found = controller.start(packets, [9.0, -9.0, 0.4]).tensordict["command"]
    torch.testing.assert_close(found, torch.tensor([[0.8, -0.2, 0.4]]).expand(2, 3))
    with pytest.raises(ShapeError, match=r"command must be 3 numbers or \(2, 3\)"):
        controller.start(packets, torch.zeros(2, 1))
