"""Controllers give the motor targets of stacks for all directions."""

from typing import cast

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

import aslip
from aslip.control import Controller
from aslip.envs import walking_stack
from aslip.errors import ShapeError
from aslip.transforms import DIRECTION_TABLE, ODOMETRY_SIZES, PATH_SIZES, VelocityCommand
from tests.control.helpers import compare_rollouts, small_actions
from tests.library.bent import symmetric_library


def _controller() -> Controller:
    return Controller(small_actions(0.1), symmetric_library(), observation=DIRECTION_TABLE)


@torch.no_grad()
@pytest.mark.parametrize("num", [1, 3])
def test_motor_targets_are_those_of_a_stacks_rollout(num: int) -> None:
    """With noise, turns, changes of command and heading, falls and resets."""
    stack = walking_stack(symmetric_library())
    env = aslip.make_env(stack=stack, num_envs=num, seed=5, num_threads=1, drop=["low_reward"])
    command = cast("VelocityCommand", env.transforms[env.transform_names.index("command")])
    keys = ["motor_target", "observation", "phase", "filtered_command", "estimator"]
    keys += [("odometry", name) for name in (*ODOMETRY_SIZES, *PATH_SIZES)]

    def change(step: int, td: TensorDictBase) -> None:
        if step % 13 == 8:
            td["command"] = command.draw((num, 3))
        if step == 15:
            td["heading"] = td["heading"] + 1.0

    first = TensorDict(heading=torch.linspace(0.1, 1.5, num)[:, None], batch_size=num)
    list(
        compare_rollouts(
            env, small_actions(0.1), _controller(), keys, change, steps=70, first=first
        )
    )


@torch.no_grad()
def test_the_heading_advances_by_itself() -> None:
    """A caller who never writes the heading gets the same targets as one who reads the stack's."""
    library = symmetric_library()
    env = aslip.make_env(stack=walking_stack(library), num_threads=1, seed=0)
    policy, controller = small_actions(0.1), _controller()
    td = env.reset(TensorDict(command=torch.tensor([[0.4, 0.1, 0.8]]), batch_size=1))
    state = controller.start(td["sensors"], td["command"], phase=td["phase"], heading=td["heading"])
    for _ in range(10):
        td = env.step(policy(td))["next"]
        state, _ = controller.step(state, td["sensors"])
        assert torch.equal(state.tensordict["observation"], td["observation"])


def test_a_number_is_a_forward_speed_and_commands_move_into_the_region() -> None:
    env = aslip.make_env(
        stack=walking_stack(symmetric_library()), num_envs=2, num_threads=1, seed=0
    )
    packets, controller = env.reset()["sensors"], _controller()
    entries = controller.start(packets, 0.5).tensordict
    assert entries["filtered_command"].tolist() == [[0.5, 0.0, 0.0]] * 2
    found = controller.start(packets, [9.0, -9.0, 0.4]).tensordict["command"]
    torch.testing.assert_close(found, torch.tensor([[0.8, -0.2, 0.4]]).expand(2, 3))
    with pytest.raises(ShapeError, match=r"command must be 3 numbers or \(2, 3\)"):
        controller.start(packets, torch.zeros(2, 1))
