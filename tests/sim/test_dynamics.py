"""Robots with different dynamics move like robots of models changed by hand."""

# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.envs import DmControlEnv, SimulatedEnv
from aslip.errors import ConfigurationError, ShapeError, UnknownNameError
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from tests.helpers import BACKENDS, bare_env

GRAVITY = 9.81
# all parameters except the delay, each away from its default
OTHER = {
    "mass": 1.13,
    "payload": 3.0,
    "floor_friction": 0.41,
    "spring_stiffness": 0.83,
    "joint_damping": 2.7,
    "reflected_inertia": 0.4,
    "motor_strength": 0.91,
    "slope": 0.07,
}


def _walk(env: SimulatedEnv, steps: int, seed: int = 0) -> np.ndarray:
    """(steps, n, 67) positions and velocities under random targets around the standing pose."""
    generator = torch.Generator().manual_seed(seed)
    standing = torch.tensor(env.model.key("standing").qpos[env.indices.motor_qpos])
    path = []
    for _ in range(steps):
        noise = 0.3 * torch.randn(10, generator=generator)
        target = (standing + noise).float().expand(env.num_envs, 10)
        truth = env.step(TensorDict(motor_target=target, batch_size=env.num_envs))["next", "truth"]
        path.append(torch.cat([truth["qpos"], truth["qvel"]], dim=-1).numpy())
    return np.array(path)


def _edit(change: Callable[[mujoco.MjModel], None]) -> DmControlEnv:
    """Robot with a model changed by hand."""
    env = DmControlEnv(1)
    model = env.physics[0].model.ptr
    change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return env


def _by_hand(model: mujoco.MjModel) -> None:
    model.body_mass[:] *= OTHER["mass"]
    model.body_inertia[:] *= OTHER["mass"]
    model.body_mass[model.body("pelvis").id] += OTHER["payload"]
    model.geom("floor").friction[0] = OTHER["floor_friction"]
    model.jnt_stiffness[:] *= OTHER["spring_stiffness"]
    model.dof_damping[:] *= OTHER["joint_damping"]
    model.dof_armature[:] *= OTHER["reflected_inertia"]
    model.actuator_gainprm[:, 0] *= OTHER["motor_strength"]
    model.opt.gravity[:] = GRAVITY * np.array([-np.sin(0.07), 0, -np.cos(0.07)])


# ----------------------------------------------------------------- equality


@pytest.mark.parametrize("backend", BACKENDS)
def test_dynamics_equal_a_model_changed_by_hand(backend: str) -> None:
    """Results are bit-equal, and the other robot has the default dynamics."""
    env = bare_env(backend)
    env.set_dynamics(OTHER, np.array([1]))
    env.reset()
    path = _walk(env, 12)
    edited, default = _edit(_by_hand), DmControlEnv(1)
    for row, single in ((0, default), (1, edited)):
        single.reset()
        np.testing.assert_array_equal(path[:, row], _walk(single, 12)[:, 0])


@pytest.mark.parametrize("backend", BACKENDS)
def test_nominal_values_restore_the_model(backend: str) -> None:
    env, default = bare_env(backend, 1), bare_env(backend, 1)
    nominal = {name: value[0] for name, value in default.dynamics.items()}
    env.set_dynamics(OTHER | {"torque_delay": 0.004})
    env.set_dynamics(nominal)
    env.reset()
    default.reset()
    np.testing.assert_array_equal(_walk(env, 8), _walk(default, 8))


# --------------------------------------------------------------------- laws


def _airborne(slope: float) -> Any:
    """State after a policy step of a robot in the air."""
    env = bare_env("batch", 1)
    qpos = torch.tensor(env.model.key("standing").qpos)[None]
    qpos[:, 2] = 5.0
    initial = TensorDict(qpos=qpos, qvel=torch.zeros(1, 32), batch_size=1)
    dynamics = TensorDict(slope=torch.full((1, 1), slope), batch_size=1)
    env.reset(TensorDict(initial=initial, dynamics=dynamics, batch_size=1))
    target = qpos[:, env.indices.motor_qpos.copy()].float()
    return env.step(TensorDict(motor_target=target, batch_size=1))["next"]


def test_slope_turns_gravity() -> None:
    """In the air the centre of mass accelerates with gravity."""
    model = load_model()
    data = mujoco.MjData(model)
    truth = _airborne(0.3)["truth"]
    data.qpos[:], data.qvel[:] = truth["qpos"][0], truth["qvel"][0]
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    fallen = GRAVITY * CASSIE.policy_period
    expected = [-fallen * np.sin(0.3), 0, -fallen * np.cos(0.3)]
    np.testing.assert_allclose(data.subtree_linvel[0], expected, atol=2e-4)


def test_imu_measures_attitude_relative_to_gravity() -> None:
    """The nose is up on an upward slope; in free fall nothing else changes."""
    flat, uphill = (_airborne(slope)["sensors"] for slope in (0.0, 0.3))
    w, x, y, z = uphill["orientation"][0, 0].double().numpy()
    forward = np.array([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)])
    np.testing.assert_allclose(forward, [np.cos(0.3), 0, np.sin(0.3)], atol=1e-4)
    for name in ("gyro", "accelerometer", "motor_position"):
        torch.testing.assert_close(flat[name], uphill[name], rtol=0, atol=1e-4)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("steps", [0, 6, 9, 40])
def test_torques_act_after_the_delay(backend: str, steps: int) -> None:
    """A change of the target acts `steps` physics steps later."""
    torques = []
    for offset in (0.0, 0.2):
        env = bare_env(backend, 1)
        env.watch(0)
        env.set_dynamics({"torque_delay": steps * CASSIE.physics_timestep})
        env.reset()
        target = env.model.key("standing").qpos[env.indices.motor_qpos] + offset
        td = TensorDict(motor_target=torch.tensor(target[None]).float(), batch_size=1)
        env.step(td)
        torques.append(env.watched[:, 67:77].copy())
    differ = np.flatnonzero((torques[0] != torques[1]).any(axis=1))
    assert differ[0] == steps


def test_motor_strength_scales_the_delivered_torque() -> None:
    """The limit scales, too, as the first torques of a far target show."""
    env = bare_env("batch", 2)
    env.set_dynamics({"motor_strength": 0.7, "torque_delay": 0.0}, np.array([1]))
    env.set_dynamics({"torque_delay": 0.0}, np.array([0]))
    env.reset()
    first = []
    for robot in range(2):
        env.watch(robot)
        env.reset()
        env.step(TensorDict(motor_target=torch.full((2, 10), 3.0), batch_size=2))
        first.append(env.watched[0, 67:77].copy())
    np.testing.assert_allclose(first[1], 0.7 * first[0], rtol=1e-12)
    assert np.abs(first[0]).max() > 190  # hip pitch and knee give 195.2 N m at most


# ------------------------------------------------------------- longer memory


@pytest.mark.parametrize("backend", BACKENDS)
def test_longer_memory_of_commands_does_not_affect_other_robots(backend: str) -> None:
    """One robot gets a longer delay during a walk."""
    env, default = bare_env(backend), bare_env(backend)
    for each in (env, default):
        each.reset()
        _walk(each, 3)
    env.set_dynamics({"torque_delay": 0.011}, np.array([1]))
    path, expected = (_walk(each, 5, seed=1) for each in (env, default))
    np.testing.assert_array_equal(path[:, 0], expected[:, 0])
    assert (path[:, 1] != expected[:, 1]).any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_longer_memory_keeps_delayed_commands(backend: str) -> None:
    """The walk is the same if the memory was long from the start."""
    early, late = bare_env(backend, 1), bare_env(backend, 1)
    early.set_dynamics({"torque_delay": 0.02})
    early.set_dynamics({"torque_delay": 0.003})
    paths = []
    for env in (early, late):
        env.reset()
        _walk(env, 2)
        # this delay reaches back to the oldest command of the short memory
        env.set_dynamics({"torque_delay": 0.0045})
        env.set_dynamics({"torque_delay": 0.004})
        paths.append(_walk(env, 3, seed=1))
    np.testing.assert_array_equal(*paths)


def test_oldest_command_fills_a_longer_memory() -> None:
    """A delay beyond the memory applies the oldest command, then the later ones."""
    torques = []
    for delay in (0.004, 0.01):
        env = bare_env("batch", 1)
        env.reset()
        _walk(env, 2)
        env.watch(0)
        env.set_dynamics({"torque_delay": delay})
        _walk(env, 1, seed=1)
        torques.append(env.watched[:, 67:77].copy())
    short, long = torques
    np.testing.assert_array_equal(long[:12], np.tile(short[0], (12, 1)))
    np.testing.assert_array_equal(long[12:20], short[:8])


@pytest.mark.parametrize("backend", BACKENDS)
def test_states_resume_among_robots_of_the_same_dynamics(backend: str) -> None:
    env, other = bare_env(backend), bare_env(backend)
    for each in (env, other):
        each.set_dynamics(OTHER | {"torque_delay": [0.001, 0.012]})
        each.reset()
    _walk(env, 4)
    other.set_states(env.states())
    np.testing.assert_array_equal(_walk(env, 4, seed=1), _walk(other, 4, seed=1))


# ------------------------------------------------------------------- errors


@pytest.mark.parametrize("backend", BACKENDS)
def test_values_out_of_limits_are_refused_and_change_nothing(backend: str) -> None:
    env = bare_env(backend)
    before = env.dynamics
    for values, message in (
        (
            {"mass": 1.1, "floor_friction": [0.5, -1.0]},
            r"floor_friction of robot 1.*0\.01 to 5.*-1",
        ),
        ({"mass": 1e300}, r"mass of robot 0 must be from .* got 1e\+300"),
        ({"torque_delay": 0.2}, r"torque_delay of robot 0 must be from 0 to 0\.03 .*got 0\.2"),
        ({"slope": 45.0}, r"slope.*-0\.7 to 0\.7.*got 45"),
        ({"payload": float("nan")}, r"payload.*0 to 100.*got nan"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            env.set_dynamics(values)
    for name, value in env.dynamics.items():
        np.testing.assert_array_equal(value, before[name])
    assert not env.altered


def test_unknown_parameters_and_robots_are_named() -> None:
    env = bare_env("batch")
    with pytest.raises(UnknownNameError, match="did you mean 'floor_friction'"):
        env.set_dynamics({"floor_fricton": 1.0})
    with pytest.raises(ShapeError, match=r"mass.*\(2,\).*\(3,\)"):
        env.set_dynamics({"mass": [1.0, 1.0, 1.0]})
    for ids in ([2], [1, 0], [0, 0], [-1]):
        with pytest.raises(ConfigurationError, match="robots 0 to 1"):
            env.set_dynamics({"mass": 1.0}, np.array(ids))
    with pytest.raises(ShapeError, match=r"mass.*\(2, 1\)"):
        dynamics = TensorDict(mass=torch.ones(2), batch_size=2)
        env.reset(TensorDict(dynamics=dynamics, batch_size=2))
