"""Other low levels through the public API: torques as actions, and gains."""

from functools import partial
from typing import cast

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from aslip.envs import BatchEnv, DmControlEnv
from aslip.robot import CASSIE
from aslip.sim import PD, Torque

MAKERS = [partial(BatchEnv, num_threads=1), DmControlEnv]


class VariablePD(PD):
    """Drive whose command is target angle, stiffness and damping of each motor."""

    @property
    def command_size(self) -> int:
        return 3 * super().command_size

    def torque(
        self,
        command: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        target, self.stiffness[:], self.damping[:] = np.split(command, 3, axis=1)
        return super().torque(np.ascontiguousarray(target), position, velocity, out)

    def initial_command(self, position: np.ndarray) -> np.ndarray:
        return np.concatenate([position, self.stiffness, self.damping], axis=1)


def _step(env: BatchEnv | DmControlEnv, command: torch.Tensor, steps: int = 3) -> TensorDictBase:
    td = cast("TensorDictBase", env.reset())
    for _ in range(steps):
        td = env.step(td.set("motor_target", command))["next"]
    return td


def _standing(num: int) -> torch.Tensor:
    return torch.tensor(np.tile(CASSIE.standing[CASSIE.indices.motor_qpos], (num, 1))).float()


@pytest.mark.parametrize("make", MAKERS, ids=["batch", "dm_control"])
def test_torques_can_be_actions(make: type[BatchEnv]) -> None:
    """Motors deliver torques at the joints within their limits, after the delay."""
    env = make(num_envs=2, drive=Torque)
    assert env.action_spec["motor_target"].shape == (2, 10)
    command = torch.zeros(2, 10)
    command[0, 3], command[1, 3] = 5.0, 1e4
    env.watch(1)
    torque = _step(env, command, 1)["truth", "motor_torque"]
    expected = torch.zeros(10)
    expected[3] = 5.0
    torch.testing.assert_close(torque[0], expected)
    limit = float(CASSIE.torque_limit[3] * CASSIE.gear[3])
    knee = env.watched[:, CASSIE.indices.num_qpos + CASSIE.indices.num_qvel + 3]
    assert (knee[:6] == 0).all()
    assert knee.max() == pytest.approx(limit)
    env.close()


def test_both_simulators_agree_on_torques() -> None:
    command = 3 * torch.randn(2, 10, generator=torch.Generator().manual_seed(0))
    batch, reference = (_step(make(num_envs=2, drive=Torque), command) for make in MAKERS)
    assert torch.equal(batch["truth", "qpos"], reference["truth", "qpos"])


@pytest.mark.parametrize("make", MAKERS, ids=["batch", "dm_control"])
def test_a_users_drive_takes_gains_as_actions(make: type[BatchEnv]) -> None:
    gains = torch.tensor(np.concatenate([CASSIE.stiffness, CASSIE.damping])).float()
    usual = torch.cat([_standing(2), gains.expand(2, -1)], dim=1)
    env = make(num_envs=2, drive=VariablePD)
    assert env.action_spec["motor_target"].shape == (2, 30)
    same = _step(env, usual)["truth", "qpos"]
    # damping has no exact single-precision value
    torch.testing.assert_close(same, _step(make(num_envs=2), _standing(2))["truth", "qpos"])
    limp = usual.clone()
    limp[:, 10:] = 0.0
    assert (_step(env, limp)["truth", "motor_torque"] == 0).all()


@pytest.mark.parametrize("make", MAKERS, ids=["batch", "dm_control"])
def test_gains_of_the_pd_loop_differ_from_robot_to_robot(make: type[BatchEnv]) -> None:
    env, target = make(num_envs=2), _standing(2) + 0.05
    env.set_dynamics({"pd_stiffness": [1.0, 0.0], "pd_damping": [1.0, 0.0]})
    torque = _step(env, target)["truth", "motor_torque"]
    assert (torque[1] == 0).all()
    expected = _step(make(num_envs=2), target)["truth", "motor_torque"]
    assert torch.equal(torque[0], expected[0])
    # also in simulations with a longer memory of commands
    env.set_dynamics({"torque_delay": 0.006})
    assert (_step(env, target)["truth", "motor_torque"][1] == 0).all()
