"""Policies of two networks, for robots that follow a plan and for those that follow gaits."""

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError
from aslip.policy import (
    PolicyShape,
    RunningNormalizer,
    load_policy,
    make_actor,
    make_planned_actor,
    planned_weights,
    save_policy,
    update_normalizers,
)
from aslip.transforms import DIRECTION_TABLE
from aslip.transforms.observation import PLANNED_TABLE

SIZE = 87
SHAPE = PolicyShape(SIZE, hidden=(8, 8), symmetric=True)


def _observed() -> TensorDict:
    """Observations of four robots, of which the second and the last follow gaits."""
    observation = torch.randn(4, SIZE, generator=torch.Generator().manual_seed(1))
    observation[:, -1] = torch.tensor([1.0, 0.0, -1.0, 0.0])
    return TensorDict(observation=observation, batch_size=4)


def test_robots_without_a_plan_act_by_a_network_that_does_not_learn(tmp_path: Path) -> None:
    torch.manual_seed(3)
    single = make_actor(RunningNormalizer(SIZE), SHAPE, PLANNED_TABLE)
    both = make_planned_actor(RunningNormalizer(SIZE), SHAPE, PLANNED_TABLE)
    both.load_state_dict(planned_weights(single.state_dict()))
    expected = single(_observed())["action"]
    torch.testing.assert_close(both(_observed())["action"], expected)
    optimizer = torch.optim.SGD(both.parameters(), 1.0)
    both(_observed())["loc"].square().sum().backward()
    optimizer.step()
    update_normalizers([both], _observed())
    changed = both(_observed())["action"] != expected
    assert changed.any(1).tolist() == [True, False, True, False]
    save_policy(
        tmp_path / "policy.zip",
        both,
        SHAPE,
        network=make_planned_actor,
        stack="planned",
        observation=PLANNED_TABLE,
    )
    loaded = load_policy(tmp_path / "policy.zip")
    torch.testing.assert_close(loaded(_observed())["action"], both(_observed())["action"])


def test_the_observation_ends_with_the_next_step() -> None:
    shape = PolicyShape(SIZE - 5)
    with pytest.raises(ConfigurationError, match=r"ends with \('plan', 'step'\), got"):
        make_planned_actor(RunningNormalizer(SIZE - 5), shape, DIRECTION_TABLE)
