"""Stack for all directions: filtered commands, moving frames, mirrored walks."""

from typing import cast

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import aslip
from aslip.envs import (
    EPISODE_ENDS,
    GymEnv,
    StackEnv,
    directions_stack,
    evaluation_stack,
    insert_before,
    randomise_stack,
    robot_stack,
    walking_stack,
)
from aslip.errors import ConfigurationError, ShapeError, SpeedOutOfRangeError
from aslip.library import GaitLibrary, WalkMode
from aslip.policy.symmetry import action_mirror, observation_mirror
from aslip.robot import CASSIE
from aslip.transforms import (
    COMMAND_RATES,
    DIRECTION_TABLE,
    RandomPushes,
    RewardTerm,
    TrueState,
    VelocityCommand,
    rewards,
)
from aslip.transforms.command import approach_command
from aslip.transforms.path import advance_heading, arc
from aslip.transforms.rewards import DIRECTION_WEIGHTS
from tests.library.bent import symmetric_library
from tests.library.standing import standing_library

PERIOD = CASSIE.policy_period
FLIP = torch.tensor([1.0, -1.0, -1.0])


def make(num: int = 2, **settings: object) -> StackEnv:
    stack = walking_stack(symmetric_library())
    drop = (*EPISODE_ENDS, "noise", "fall")
    return aslip.make_env(stack=stack, num_envs=num, num_threads=1, drop=drop, **settings)  # pyright: ignore[reportArgumentType]


def start(env: StackEnv, command: list[list[float]], phase: list[float]) -> TensorDictBase:
    request = {"command": torch.tensor(command), "phase": torch.tensor(phase)[:, None]}
    return env.reset(TensorDict(request, batch_size=env.num_envs))  # pyright: ignore


def step(env: StackEnv, td: TensorDictBase, action: Tensor | None = None) -> TensorDictBase:
    """Take a policy step, with zero actions by default."""
    td["action"] = torch.zeros(env.num_envs, 10) if action is None else action
    return cast("TensorDictBase", env.step(td)["next"])


def test_the_reference_follows_the_filtered_command_and_the_entry_stays() -> None:
    env, library = make(1), symmetric_library()
    td = start(env, [[0.8, 0.0, 0.0]], [0.3])
    assert torch.equal(td["filtered_command"], td["command"])
    wanted = torch.tensor([[0.2, 0.2, -0.8]])
    td["command"] = wanted
    filtered, phase = td["filtered_command"], td["phase"]
    for _ in range(8):
        target = cast("TensorDictBase", td["target"])
        td = step(env, td)
        # the clock runs with the command during the step
        phase = (phase + PERIOD / library.stride(filtered)) % 1
        filtered = approach_command(filtered, wanted, COMMAND_RATES)
        assert torch.equal(td["command"], wanted)
        assert torch.equal(td["filtered_command"], filtered)
        assert torch.equal(td["phase"], phase)
        found = library.lookup(phase, filtered)
        assert torch.equal(td["reference", "left_foot_heading"], found.left_foot_heading)
        # neither body nor feet jump: the largest change of speed in a step is 0.06 m/s
        for name in ("body_position", "left_foot_position", "right_foot_position"):
            torch.testing.assert_close(td["reference", name], target.get(name), atol=0.02, rtol=0)
    assert torch.equal(td["observation"][:, -15:-12], filtered)


def test_rewards_and_odometry_are_in_a_frame_that_moves_along_the_path() -> None:
    """Truth and estimate, with the heading advanced by the yaw rate; a fixed frame would not."""
    env = make()
    command = torch.tensor([[0.8, 0.1, 0.8], [0.4, 0.0, -0.5]])
    td = start(env, command.tolist(), [0.1, 0.6])
    heading, started = td["heading"], td["true_odometry", "origin"]
    for _ in range(20):
        td = step(env, td)
        heading = advance_heading(heading, command)
        assert torch.equal(td["heading"], heading)
        for group in ("true_odometry", "odometry"):
            place = cast("Tensor", td[group, "pelvis_position"])
            assert torch.equal(td[group, "path_error"], place[:, :2])
    travelled = torch.linalg.vector_norm(td["true_odometry", "origin"] - started, dim=-1)
    assert (travelled > 0.1).all()
    torch.testing.assert_close(
        td["odometry", "path_error"], td["true_odometry", "path_error"], atol=0.08, rtol=0
    )
    # the reference of a step is the target of the step before
    error, body = td["odometry", "path_error"], td["reference", "body_position"]
    expected = rewards.path_diff(cast("Tensor", error), cast("Tensor", body))
    torch.testing.assert_close(td["reward_terms", "path_diff"], expected)


def test_an_evaluation_has_the_task_of_all_directions_for_every_experiment() -> None:
    """Randomised robots, pushes and other rewards of a training are left out."""
    library = symmetric_library()
    stack = walking_stack(library)
    trained = insert_before(randomise_stack(stack), "command", pushes=RandomPushes())
    trained["path_diff"] = RewardTerm("path_diff", torch.zeros_like, ["phase"])
    own = RewardTerm("own", torch.zeros_like, ["phase"])
    trained = insert_before(trained, "reward", own=own)
    assert evaluation_stack(trained, library)["noise"] is stack["noise"]
    drop = (*EPISODE_ENDS, "noise", "fall")
    envs = [
        aslip.make_env(stack=one, num_envs=2, num_threads=1, drop=drop, seed=0)
        for one in (stack, evaluation_stack(trained, library))
    ]
    command, phase = [[0.8, 0.2, 0.8], [0.0, 0.0, -0.5]], [0.05, 0.2]
    first, second = (step(env, start(env, command, phase)) for env in envs)
    assert "push" not in second
    assert torch.equal(first["reward"], second["reward"])
    assert torch.equal(first["observation"], second["observation"])
    # commands are of the common library, whatever the policy was trained on
    other = evaluation_stack(walking_stack(standing_library()), library)
    command = other["command"]
    assert isinstance(command, VelocityCommand)
    assert command.library is library


def test_rewards_read_the_estimated_heading_and_the_largest_force() -> None:
    assert sum(DIRECTION_WEIGHTS.values()) == pytest.approx(1.0)
    env = make(2)
    before = start(env, [[0.1, 0.0, 0.1]] * 2, [0.3, 0.3])
    for _ in range(3):
        target = cast("Tensor", before["target", "body_heading"])
        td = step(env, before)
        terms = cast("TensorDictBase", td["reward_terms"])
        assert {*terms.keys()} == {*DIRECTION_WEIGHTS}
        orientation = cast("Tensor", td["odometry", "pelvis_orientation"])
        assert torch.equal(terms.get("heading_diff"), rewards.heading_diff(orientation, target))
        largest = cast("Tensor", td["truth", "largest_force"])
        assert torch.equal(terms.get("landing"), rewards.landing(largest).float())
        expected = sum(DIRECTION_WEIGHTS[name] * term for name, term in terms.items())
        torch.testing.assert_close(td["reward"], expected)
        before = td


def test_mirrored_commands_and_actions_lead_to_mirrored_observations() -> None:
    """Robot 1 starts half a stride later with sideways speed and yaw rate reversed.

    The pelvis is not quite symmetric, so the images diverge slowly.
    """
    env = make(replace={"estimator": TrueState()})
    command = torch.tensor([0.5, 0.15, 0.6])
    td = start(env, [command.tolist(), (command * FLIP).tolist()], [0.2, 0.7])
    mirror, mirror_action = observation_mirror(DIRECTION_TABLE), action_mirror()
    generator = torch.Generator().manual_seed(0)
    # contacts and the stiff loops amplify the pelvis' asymmetry most in accelerations
    slow = torch.ones(82, dtype=torch.bool)
    slow[8:14] = slow[24:34] = slow[40:46] = False
    wanted = torch.tensor([0.2, -0.1, -0.5])
    for i in range(4):
        image, other = mirror(td["observation"][1]), td["observation"][0]
        torch.testing.assert_close(image[slow], other[slow], atol=3e-3, rtol=0)
        if i == 1:
            td["command"] = torch.stack([wanted, wanted * FLIP])
        action = 0.1 * torch.randn(10, generator=generator)
        td = step(env, td, torch.stack([action, mirror_action(action)]))
        for name, term in td["reward_terms"].items():
            # a touchdown of 580 N differs by 2.3 N; squared, `landing` is exp(-(F/W - 0.9) / 0.3)
            one, image = term.square() if name == "landing" else term
            torch.testing.assert_close(one, image, atol=2e-3, rtol=0, msg=name)
    # the entries that turns add, and the last action, were compared at values other than zero, but
    # for the body's heading
    assert (td["observation"][:, 65:].abs() > 1e-4).all()


def test_commands_outside_the_region_are_refused() -> None:
    env = make(1)
    with pytest.raises(SpeedOutOfRangeError, match=r"yaw rate -0\.8 to 0\.8"):
        start(env, [[0.5, 0.0, 0.9]], [0.0])
    td = start(env, [[0.5, 0.0, 0.5]], [0.0])
    td["command"] = torch.ones(1, 1)
    with pytest.raises(ShapeError, match=r"command must have shape \(1, 3\)"):
        step(env, td)


def test_a_straight_library_is_refused(library: GaitLibrary) -> None:
    with pytest.raises(ConfigurationError, match="commands have 1 numbers"):
        walking_stack(library)


def test_the_stack_of_a_real_robot_turns_without_the_truth() -> None:
    """The estimator itself advances the heading that it took from the first packet."""
    stack = robot_stack(walking_stack(symmetric_library(), reward_on="estimate"))
    assert "heading" not in stack
    env = aslip.make_env(stack=stack, num_threads=1, drop=EPISODE_ENDS, seed=0)
    td = env.reset(TensorDict(command=torch.tensor([[0.0, 0.0, 0.8]]), batch_size=1))
    before = td["estimate", "orientation"]
    td = step(env, td)
    # the frame turned, the robot has hardly started to
    turned = float(td["estimate", "orientation"][0, 3] - before[0, 3])
    assert turned < -0.5 * 0.8 * PERIOD / 2
    displacement = arc(torch.tensor([[0.0, 0.0, 0.8]]))
    torch.testing.assert_close(td["odometry", "origin"], displacement, atol=1e-6, rtol=0)


def test_options_of_gymnasium_take_a_command_of_three_numbers() -> None:
    env = GymEnv(stack=walking_stack(symmetric_library()), num_threads=1)
    _, info = env.reset(seed=1, options={"command": [0.5, -0.1, 0.25]})
    assert info["command"] == [0.5, pytest.approx(-0.1), 0.25]
    assert env.observation_space.shape == (82,)
    env.close()


def test_an_evaluation_rewards_standing_robots_for_standing() -> None:
    """Its target and rewards are those of the stack itself, through a stop."""
    library = standing_library()
    stack = directions_stack(library)
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
    stack = directions_stack(library)
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
