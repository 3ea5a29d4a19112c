"""Walking task and physics keep dm_control's contract and agree with MuJoCo."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo is a compiled module without complete type stubs

import dm_env
import mujoco
import numpy as np
import pytest
from absl.testing import absltest
from dm_control.rl import control
from dm_env import test_utils

from aslip.envs import BipedPhysics, Walk, walk_environment
from aslip.robot import CASSIE
from aslip.sim import Simulations, true_state


def _actions(environment: control.Environment, count: int, seed: int) -> np.ndarray:
    """Random targets around the standing pose."""
    rng = np.random.default_rng(seed)
    standing = environment.physics.motor_position()
    return standing + rng.uniform(-0.3, 0.3, (count, 10))


class TestEnvironmentContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """Environment test of dm_env, over more than one episode."""

    def make_object_under_test(self) -> dm_env.Environment:
        return walk_environment(time_limit=0.3, random=0)

    def make_action_sequence(self):
        return iter(_actions(walk_environment(), 25, 0))


# ------------------------------------------------------ the suite's contract


def _episode(seed: int, count: int = 15) -> list[dm_env.TimeStep]:
    environment = walk_environment(random=seed)
    steps = [environment.reset()]
    for action in _actions(walk_environment(), count, 0):
        steps.append(environment.step(action))
    return steps


def test_same_seed_and_actions_give_the_same_trajectory() -> None:
    for a, b in zip(_episode(3), _episode(3), strict=True):
        assert a.reward == b.reward
        for name in a.observation:
            np.testing.assert_array_equal(a.observation[name], b.observation[name])


def test_no_element_of_the_observation_is_constant() -> None:
    steps = _episode(0, 20)
    for name in steps[0].observation:
        values = np.stack([step.observation[name] for step in steps])
        assert (np.ptp(values, axis=0) > 0).all(), name


def test_reward_is_between_zero_and_one() -> None:
    rewards = [step.reward for step in _episode(0, 25)[1:]]
    assert min(rewards) >= 0
    assert max(rewards) <= 1
    assert max(rewards) - min(rewards) > 0.05


def test_reward_is_full_when_upright_high_and_at_speed() -> None:
    physics = BipedPhysics.load()
    task = Walk(speed=1.2)
    with physics.reset_context():
        physics.stand()
        physics.data.qvel[0] = 1.2
    assert task.get_reward(physics) == pytest.approx(1.0)
    with physics.reset_context():
        physics.data.qvel[0] = 1.7  # speed error of the margin
    assert task.get_reward(physics) == pytest.approx(0.1, abs=1e-6)
    with physics.reset_context():
        physics.data.qvel[0] = 1.2
        physics.data.qpos[3:7] = [0, 1, 0, 0]  # head down
        physics.data.qvel[:3] = [1.2, 0, 0]
    assert task.get_reward(physics) == pytest.approx(0.0, abs=1e-6)


def _lay_down(environment: control.Environment) -> None:
    """Put the robot prone just above the floor."""
    with environment.physics.reset_context():
        environment.physics.data.qpos[2] = CASSIE.fall_height - 0.05
        environment.physics.data.qpos[3:7] = np.array([1, 0, 1, 0]) / np.sqrt(2)


def test_falls_end_an_episode_with_discount_zero() -> None:
    environment = walk_environment(random=0)
    environment.reset()
    _lay_down(environment)
    step = environment.step(environment.physics.motor_position())
    assert step.last()
    assert step.discount == 0.0


def test_episodes_continue_after_a_fall_on_request() -> None:
    environment = walk_environment(terminate_on_fall=False, random=0)
    environment.reset()
    _lay_down(environment)
    assert environment.step(environment.physics.motor_position()).mid()


def test_time_limits_end_an_episode_with_discount_one() -> None:
    environment = walk_environment(time_limit=0.06, random=0)
    environment.reset()
    steps = [environment.step(environment.physics.motor_position()) for _ in range(2)]
    assert [step.last() for step in steps] == [False, True]
    assert steps[1].discount == 1.0


# --------------------------------------------------------------- the physics


@pytest.fixture
def physics() -> BipedPhysics:
    """The robot after two policy steps of a fall."""
    physics = BipedPhysics.load()
    with physics.reset_context():
        physics.stand()
        physics.data.qvel[:6] = [0.5, 0.2, 0.1, 0.3, -0.2, 0.4]
    physics.set_control(physics.motor_position() + 0.1)
    physics.step(120)
    return physics


def test_physics_equals_the_simulations_bit_for_bit() -> None:
    physics, simulations = BipedPhysics.load(), Simulations(1, num_threads=1)
    for target in _actions(walk_environment(), 5, 1):
        physics.set_control(target)
        physics.step(60)
        simulations.advance(target[None])
        truth = true_state(simulations.snapshot(), simulations.indices)
        for name, value in physics.true_state().items():
            np.testing.assert_array_equal(value, truth[name][0], err_msg=name)


def test_queries_agree_with_mujoco(physics: BipedPhysics) -> None:
    data = physics.data.ptr
    pelvis = data.body("pelvis")
    assert physics.pelvis_height() == pelvis.xpos[2]
    assert physics.pelvis_upright() == pelvis.xmat[8]
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(
        physics.model.ptr, data, mujoco.mjtObj.mjOBJ_XBODY, pelvis.id, velocity, 1
    )
    np.testing.assert_allclose(physics.pelvis_velocity(), velocity[3:], atol=1e-12)
    for i, name in ((0, "left_hip_roll"), (3, "left_knee"), (9, "right_foot")):
        assert physics.motor_position()[i] == data.joint(name).qpos[0]
        np.testing.assert_array_equal(physics.motor_range()[i], physics.model.ptr.joint(name).range)


@pytest.mark.parametrize("share_model", [False, True])
def test_copies_have_the_complete_state(physics: BipedPhysics, share_model: bool) -> None:
    """Push, warm start of the solver, delayed torques and sensors are equal bit for bit."""
    push = np.array([0.0, 60.0, 5.0])
    physics.push(push)
    physics.set_control(physics.motor_position() + 0.1)
    physics.step(60)
    assert physics.data.qacc_warmstart.any()
    twin = physics.copy(share_model=share_model)
    np.testing.assert_array_equal(twin.full_state(), physics.full_state())
    np.testing.assert_array_equal(twin.data.xfrc_applied[twin.indices.pelvis_body, :3], push)
    physics.step(60)
    twin.step(60)
    np.testing.assert_allclose(twin.data.qpos, physics.data.qpos, atol=1e-9)


def test_reset_ends_pushes_and_clears_the_warm_start(physics: BipedPhysics) -> None:
    physics.push(np.array([0.0, 60.0, 5.0]))
    physics.step(60)
    with physics.reset_context():
        physics.stand()
    assert not physics.data.qacc_warmstart.any()
    np.testing.assert_array_equal(physics.full_state(), BipedPhysics.load().full_state())
