"""The mirror image of a walk is a valid walk."""

from typing import Any

import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError, UnknownNameError
from aslip.policy import PolicyShape, RunningNormalizer, make_actor
from aslip.policy.symmetry import Symmetrised, action_mirror, observation_mirror
from aslip.transforms import OBSERVATION_TABLE, SINGLE_REFERENCE_TABLE


def test_mirror_is_its_own_inverse() -> None:
    for mirror, size in ((observation_mirror(), 64), (action_mirror(), 10)):
        values = torch.randn(3, size)
        assert not torch.equal(mirror(values), values)
        assert torch.equal(mirror(mirror(values)), values)


def test_symmetrised_network_is_equivariant() -> None:
    inputs, outputs = observation_mirror(), action_mirror()
    net = torch.nn.Sequential(torch.nn.Linear(64, 32), torch.nn.ReLU(), torch.nn.Linear(32, 10))
    values = torch.randn(5, 3, 64)
    policy = Symmetrised(net, inputs, outputs)
    torch.testing.assert_close(policy(inputs(values)), outputs(policy(values)))
    assert not torch.allclose(net(inputs(values)), outputs(net(values)))
    value = Symmetrised(torch.nn.Linear(64, 1), inputs)
    torch.testing.assert_close(value(inputs(values)), value(values))


def test_clock_and_command_have_mirror_images() -> None:
    """Half a stride later, sine and cosine of the clock have the opposite sign."""
    mirror = observation_mirror(SINGLE_REFERENCE_TABLE)
    image = mirror(torch.arange(49.0))
    assert image[46:].tolist() == [-46.0, -47.0, 48.0]


def test_entries_of_two_sources_may_have_the_same_name() -> None:
    table = (*OBSERVATION_TABLE, ("reference", "motor_position"))
    mirror = observation_mirror(table)
    values = torch.randn(74)
    torch.testing.assert_close(mirror(mirror(values)), values)
    # motor angles start at 14 of the estimate; the other ones are last
    assert mirror.index[14:24].tolist() == [*range(19, 24), *range(14, 19)]
    assert mirror.index[64:].tolist() == [*range(69, 74), *range(64, 69)]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (["command", "command"], "repeated"),
        ([("reference", "left_foot_position")], "right_foot_position.* missing"),
    ],
)
def test_refuses_table_without_mirror_image(table: list[Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        observation_mirror(table)


def test_rates_and_accelerations_have_mirror_images() -> None:
    image = observation_mirror()(torch.arange(64.0))
    assert image[8:14].tolist() == [-8.0, 9.0, -10.0, 11.0, -12.0, 13.0]


def test_mirror_signs_of_custom_entries() -> None:
    """Actions have the mirror image of motors."""
    table = ["last_action", "left_load", "right_load"]
    loads = {"left_load": (1.0, -1.0), "right_load": (1.0, -1.0)}
    image = observation_mirror(table, loads)(torch.arange(14.0))
    assert torch.equal(image[:10], action_mirror()(torch.arange(10.0)))
    assert image[10:].tolist() == [12.0, -13.0, 10.0, -11.0]
    shape = PolicyShape(14, symmetric=True, mirror_signs=loads)
    actor = make_actor(RunningNormalizer(14), shape, table)
    assert actor(TensorDict(observation=torch.zeros(14)))["action"].shape == (10,)
    with pytest.raises(UnknownNameError, match=r"'left_load' is unknown: .*mirror_signs"):
        observation_mirror(table)
    with pytest.raises(ConfigurationError, match="must be 1 or -1"):
        PolicyShape(mirror_signs={"load": (0.5,)})
