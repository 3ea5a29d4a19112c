"""The policy's input, entry by entry."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from aslip.errors import UnknownNameError
from aslip.transforms import (
    ESTIMATE_SIZES,
    OBSERVATION_TABLE,
    ODOMETRY_SIZES,
    AssembleObservation,
    TrueState,
)
from tests.helpers import MakeEnv

# the reduced-order model's feet never move sideways
CONSTANT = [56, 62]


@pytest.mark.parametrize("when", ["reset", "step"])
def test_every_entry_is_where_the_table_says(make: MakeEnv, when: str) -> None:
    """The golden log has the names of all 64 columns in order."""
    env = make(num_envs=3)
    td = env.reset()
    if when == "step":
        td = env.step(td.set("action", torch.full((3, 10), 0.1)))["next"]
    observation = td["observation"]
    assert observation.shape == (3, 64)
    torch.testing.assert_close(
        observation, torch.cat([td[key] for key in OBSERVATION_TABLE], dim=-1), rtol=0, atol=0
    )


def test_no_element_of_the_observation_is_constant(make: MakeEnv) -> None:
    """Except for the lateral foot velocities: the model's feet swing straight ahead."""
    env = make(num_envs=4)
    data = env.rollout(25, break_when_any_done=False)
    spread = data["observation"].reshape(-1, 64).std(dim=0)
    assert (spread == 0).nonzero().flatten().tolist() == CONSTANT
    assert (spread[[i for i in range(64) if i not in CONSTANT]] > 1e-4).all()


def test_other_entries_can_be_assembled(make: MakeEnv) -> None:
    keys = ["command", ("estimate", "velocity"), "last_action"]
    stack_order = {"observation": AssembleObservation(["command", ("estimate", "velocity")])}
    env = make(num_envs=2, replace=stack_order)
    td = env.reset()
    assert td["observation"].shape == (2, 4)
    torch.testing.assert_close(td["observation"][:, :1], td["command"])
    check_env_specs(env)
    # a transform cannot read what comes later in the stack
    with pytest.raises(UnknownNameError, match="last_action"):
        make(replace={"observation": AssembleObservation(keys)})


def test_the_perfect_estimate_is_the_truth(make: MakeEnv) -> None:
    env = make(num_envs=2, drop=["noise"], replace={"estimator": TrueState()})
    td = env.reset()
    td = env.step(td.set("action", torch.full((2, 10), 0.1)))["next"]
    truth, estimate = td["truth"], td["estimate"]
    torch.testing.assert_close(estimate["height"], truth["pelvis_position"][:, 2:])
    for name, source in {
        "orientation": "pelvis_orientation",
        "velocity": "pelvis_velocity",
        "angular_velocity": "pelvis_angular_velocity",
        "acceleration": "pelvis_acceleration",
        "motor_position": "motor_position",
        "motor_velocity": "motor_velocity",
        "joint_position": "joint_position",
        "joint_velocity": "joint_velocity",
    }.items():
        torch.testing.assert_close(estimate[name], truth[source], rtol=0, atol=0)
        assert estimate[name].shape[-1] == ESTIMATE_SIZES[name]
    for name, size in ODOMETRY_SIZES.items():
        torch.testing.assert_close(td["odometry", name], truth[name], rtol=0, atol=0)
        assert truth[name].shape[-1] == size
