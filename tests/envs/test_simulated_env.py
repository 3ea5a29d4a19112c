"""Features of simulated robots: pushes, states, recorded substeps, torques."""

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.envs import BatchEnv
from aslip.errors import ConfigurationError, ShapeError
from aslip.robot import CASSIE
from tests.helpers import BACKENDS, STANDING, MakeEnv, bare_env, standing_targets


@pytest.mark.parametrize("backend", BACKENDS)
def test_push_adds_its_impulse_to_one_robot_for_one_step(backend: str) -> None:
    """The robot is in the air, where no other force acts along y."""
    env, steps = bare_env(backend), 3
    qpos = STANDING.repeat(2, 1)
    qpos[:, 2] += 3.0
    initial = TensorDict(qpos=qpos, qvel=torch.zeros(2, 32), batch_size=2)
    td = env.reset(TensorDict(initial=initial, batch_size=2))
    force = torch.tensor([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]])
    for step in range(steps):
        td = TensorDict(motor_target=standing_targets(env), batch_size=2)
        if step == 1:
            td["push"] = force
        td = env.step(td)["next"]
    data = mujoco.MjData(env.model)
    momenta = []
    for row in range(2):
        data.qpos[:] = td["truth", "qpos"][row]
        data.qvel[:] = td["truth", "qvel"][row]
        mujoco.mj_forward(env.model, data)
        mujoco.mj_subtreeVel(env.model, data)
        momenta.append(CASSIE.total_mass * data.subtree_linvel[0, 1])
    assert momenta[0] == pytest.approx(0.0, abs=1e-3)
    assert momenta[1] == pytest.approx(100.0 * CASSIE.policy_period, rel=2e-3)


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("push", torch.zeros(2, 2), ShapeError),
        ("push", torch.tensor([[0.0, 0, 0], [0, torch.nan, 0]]), ConfigurationError),
        ("motor_target", torch.zeros(2, 9), ShapeError),
    ],
)
@pytest.mark.parametrize("backend", BACKENDS)
def test_invalid_pushes_and_targets_are_refused(
    backend: str, key: str, value: torch.Tensor, error: type[Exception]
) -> None:
    env = bare_env(backend)
    td = env.reset().set("motor_target", standing_targets(env))
    with pytest.raises(error, match=f"{key} must"):
        env.step(td.set(key, value))


def test_states_transfer_between_backends(make: MakeEnv) -> None:
    """During a push, and with the memory of the low level."""
    envs = [make(backend, num_envs=2, seed=2) for backend in BACKENDS]
    tds = [env.reset() for env in envs]
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        action = 0.2 * torch.randn(2, 10, generator=generator)
        push = 30 * torch.randn(2, 3, generator=generator)
        tds = [env.step(td.set("action", action).set("push", push))["next"] for env, td in
               zip(envs, tds, strict=True)]  # fmt: skip
    bases = [env.base_env for env in envs]
    np.testing.assert_array_equal(bases[0].states(), bases[1].states())
    fresh = [bare_env(backend) for backend in reversed(BACKENDS)]
    target = standing_targets(bases[0])
    for old, new in zip(bases, fresh, strict=True):
        new.set_states(old.states())
        for base in (old, new):
            base.step(TensorDict(motor_target=target, batch_size=2))
    for base in (*bases[1:], *fresh):
        np.testing.assert_array_equal(base.states(), bases[0].states())


def test_watch_records_every_substep_of_one_robot() -> None:
    seen = []
    for base in (bare_env("batch", 3), bare_env("dm_control", 3), BatchEnv(3, num_threads=2)):
        qpos = STANDING.repeat(3, 1)
        qpos[:, 2] += torch.arange(3.0) / 10
        initial = TensorDict(qpos=qpos, qvel=torch.zeros(3, 32), batch_size=3)
        base.reset(TensorDict(initial=initial, batch_size=3))
        base.watch(2)
        for _ in range(2):
            td = base.step(TensorDict(motor_target=standing_targets(base), batch_size=3))["next"]
        seen.append(base.watched.copy())
        state = torch.cat([td["truth", name][2] for name in ("qpos", "qvel")])
        np.testing.assert_array_equal(base.watched[-1, :67], state)
        torque = base.watched[-1, 67:77].astype(np.float32)
        np.testing.assert_array_equal(torque, td["truth", "motor_torque"][2])
        force = base.watched[:, 77:].mean(axis=0).reshape(2, 3)
        np.testing.assert_allclose(force, td["truth", "ground_force"][2], rtol=1e-5, atol=1e-5)
        base.watch(None)
        base.step(TensorDict(motor_target=standing_targets(base), batch_size=3))
        with pytest.raises(
            ConfigurationError, match=r"(robot|simulation) must be from 0 to 2, got 3"
        ):
            base.watch(3)
    np.testing.assert_array_equal(seen[0], seen[1])
    np.testing.assert_array_equal(seen[0], seen[2])
    # falling freely, then landing: height goes down from substep to substep
    assert (np.diff(seen[0][:, 2]) < 0).all()
