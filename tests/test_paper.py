"""Numbers of the paper in the code, each next to the sentence that it comes from.

Green et al. 2021, "Learning Spring Mass Locomotion: Guiding Policies with a Reduced-Order Model".
"""

import math

import numpy as np
import pytest
import torch

from aslip.envs import MAX_EPISODE_STEPS
from aslip.library import PAPER_SPEEDS, GaitLibrary
from aslip.policy import PolicyShape, RunningNormalizer, make_actor, make_critic
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.rom import SlipParameters
from aslip.transforms import LowReward, SpeedCommand, rewards
from recipes.ppo_presets import environments
from recipes.ppo_settings import PRESETS
from tests.helpers import MakeEnv


def test_observation_is_64d(make: MakeEnv) -> None:
    """Sec. IV-A.

    "form a 64D input space"
    """
    assert make().observation_spec["observation"].shape == (1, 64)
    assert PolicyShape().observation_size == 64


def test_action_is_10d(make: MakeEnv) -> None:
    """Sec. IV-A.

    "The output of the learned policy is a 10D vector containing motor position targets for each
    of Cassie's actuated joints."
    """
    assert make().action_spec.shape == (1, 10)
    assert PolicyShape().action_size == 10
    assert load_model().nu == 10


def test_policy_runs_at_33_hz_and_the_drive_at_2_khz() -> None:
    """Fig. 2.

    "At a relatively slow 33 Hz, ... the learned policy is evaluated. At a much faster 2000 Hz,
    the joint PD controller is evaluated"
    """
    assert pytest.approx(2000.0) == 1 / CASSIE.physics_timestep
    assert round(1 / CASSIE.policy_period) == 33
    assert pytest.approx(CASSIE.substeps * CASSIE.physics_timestep) == CASSIE.policy_period
    assert CASSIE.substeps == 60


def test_torque_delay_is_three_milliseconds() -> None:
    """Sec. IV-A.

    "Desired torques only take effect 0.003 seconds (6 time steps of the high frequency, PD
    control loop) after being 'sent' to the simulator."
    """
    assert pytest.approx(0.003) == CASSIE.torque_delay
    assert pytest.approx(6 * CASSIE.physics_timestep) == CASSIE.torque_delay
    np.testing.assert_allclose(load_model().actuator_delay, 0.003)  # pyright: ignore


def test_the_model_has_reflected_inertia() -> None:
    """Sec. IV-A.

    "Our dynamic model of Cassie includes the reflected inertia of each motor (defined as
    'armature' in MuJoCo)."
    """
    assert np.count_nonzero(load_model().dof_armature) == 10  # pyright: ignore


def test_reward_weights() -> None:
    """Sec. IV-B.

    "r = 0.3 r_CoM_vel + 0.3 r_foot_pos + 0.1 r_straight_diff + 0.2 r_foot_orient + 0.1
    r_action_diff"; "the maximum reward per step [is] 1"
    """
    assert dict(rewards.PAPER_WEIGHTS) == {
        "com_vel": 0.3,
        "foot_pos": 0.3,
        "straight_diff": 0.1,
        "foot_orient": 0.2,
        "action_diff": 0.1,
    }
    assert sum(rewards.PAPER_WEIGHTS.values()) == pytest.approx(1.0)


def test_the_first_three_terms_are_seventy_percent() -> None:
    """Sec. IV-B.

    "The first three terms of the reward function account for 70% of the total reward."
    """
    first = ("com_vel", "foot_pos", "straight_diff")
    assert sum(rewards.PAPER_WEIGHTS[name] for name in first) == pytest.approx(0.7)


def test_the_com_velocity_term_is_the_papers_formula() -> None:
    """Eq. 2.

    "r_CoM_vel = exp(-||v_CoM - v_refCoM||)"
    """
    level = torch.tensor([1.0, 0, 0, 0])
    velocity, reference = torch.tensor([1.0, -0.2, 0.1]), torch.tensor([0.4, 0.3, -0.6])
    expected = torch.exp(-torch.sqrt(((velocity - reference) ** 2).sum()))
    assert rewards.com_vel(level, velocity, reference).item() == pytest.approx(expected.item())


def test_episodes_end_after_400_steps_or_twelve_seconds() -> None:
    """Sec. IV-B.

    "We define the maximum episode length ... to be 400 steps of agent-environment interaction,
    which corresponds to 12 seconds."
    """
    assert MAX_EPISODE_STEPS == 400
    assert pytest.approx(12.0) == MAX_EPISODE_STEPS * CASSIE.policy_period


def test_episodes_end_below_a_reward_of_0_3() -> None:
    """Sec. IV-B.

    "... or when the reward for the current step is less than 0.3."
    """
    assert LowReward().threshold == 0.3


def test_ppo_hyper_parameters() -> None:
    """Table II; the preset adds nothing that is not in the paper."""
    config = PRESETS["paper"]
    assert config.learning_rate == 1e-4
    assert config.adam_epsilon == 1e-5
    assert config.gamma == 0.99
    assert config.clip == 0.2
    assert config.epochs == 3
    assert config.minibatch == 64
    # "sample size 5096", rounded up to whole steps of all robots
    assert config.samples == -(-5096 // config.num_envs) * config.num_envs
    assert config.last_learning_rate == config.learning_rate
    assert config.last_std == config.std == PolicyShape().std
    env = environments(PRESETS["paper"])["make_train_env"](num_envs=1, seed=0)
    (command,) = [t for t in env.transforms if isinstance(t, SpeedCommand)]
    assert math.isinf(command.interval)
    assert "feedforward" not in env.transform_names
    assert not config.symmetric
    assert config.value_scale == 1


def test_the_net_has_two_hidden_layers_of_256_with_relu() -> None:
    """Sec. IV-B.

    "a fully connected feed-forward neural network with 2 hidden layers of 256 nodes each ...
    The hidden layers use the ReLU activation function and the output is unbounded."
    """
    normalizer = RunningNormalizer(64)
    for net, outputs in ((make_actor(normalizer), 10), (make_critic(normalizer), 1)):
        layers = [m for m in net.modules() if isinstance(m, torch.nn.Linear)]
        sizes = [(layer.in_features, layer.out_features) for layer in layers]
        assert sizes == [(64, 256), (256, 256), (256, outputs)]
        assert sum(isinstance(m, torch.nn.ReLU) for m in net.modules()) == 2
        assert not any(isinstance(m, torch.nn.Tanh | torch.nn.Sigmoid) for m in net.modules())


def test_the_covariance_is_fixed() -> None:
    """Sec. IV-B.

    "We choose to use fixed covariance instead of making it an additional output"
    """
    actor = make_actor(RunningNormalizer(64))
    assert {p.shape for p in actor.parameters()} == {
        (256, 64), (256,), (256, 256), (10, 256), (10,),
    }  # fmt: skip


def test_speeds_of_the_library(library: GaitLibrary) -> None:
    """Sec. III-A.

    "We vary the average forward velocities from 0 to 2 m/s in steps of 0.1 m/s"
    """
    expected = np.arange(21) / 10
    np.testing.assert_allclose(PAPER_SPEEDS, expected, atol=1e-12)
    np.testing.assert_allclose(library.speeds, expected, atol=1e-12)
    assert [gait.speed for gait in library.gaits] == list(library.speeds)


def test_swing_clearance(library: GaitLibrary) -> None:
    """Sec. III-A.

    "The feet follow smooth paths with the 0.2 m specified vertical clearance height."
    """
    assert SlipParameters().swing_clearance == 0.2
    for gait in library.gaits:
        height = gait.sample(np.linspace(0, 1, 2001)).feet.position[:, 0, 2]
        assert height.max() == pytest.approx(0.2, abs=1e-4)
        assert height.min() >= -1e-9


def test_parameters_of_the_reduced_order_model() -> None:
    """Table I."""
    parameters = SlipParameters()
    assert parameters.mass == 30.0
    assert parameters.stiffness == 3000.0
    assert parameters.damping == 2.0
    assert parameters.actuator_inertia == 10.0
    assert parameters.gravity == 9.81


def test_the_body_is_highest_in_single_stance_and_lowest_in_double_stance(
    library: GaitLibrary,
) -> None:
    """Sec. III-A.

    "it reaches its peak height in single stance and the minimum height in double stance"
    """
    from aslip.rom import Mode

    for gait in library.gaits:
        motion = gait.sample(np.linspace(0, 1, 2000, endpoint=False))
        height = motion.body.position[:, 2]
        assert motion.mode[height.argmax()] != Mode.DOUBLE
        assert motion.mode[height.argmin()] == Mode.DOUBLE
