"""Balance on both feet, from estimates."""

import numpy as np
import pytest
import torch
from torch import Tensor

from aslip.estimation import LegKinematics
from aslip.robot import CASSIE
from aslip.transforms.balance import PENDULUM_RATE, _sole_ends, find_balance


def _standing(*velocity: float) -> dict[str, Tensor]:
    """Estimate (1, k) of a robot that stands upright and moves [m/s]."""
    at, qpos = CASSIE.indices, CASSIE.standing
    motors, joints = qpos[at.motor_qpos], qpos[at.joint_qpos]
    return {
        "orientation": torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        "velocity": torch.tensor([[*velocity, 0.0]]),
        "motor_position": torch.from_numpy(motors).float()[None],
        "joint_position": torch.from_numpy(joints).float()[None],
    }


def test_soles_are_those_of_the_leg_kinematics() -> None:
    rng, at = np.random.default_rng(0), CASSIE.indices
    motors = CASSIE.standing[at.motor_qpos] + 0.3 * rng.standard_normal((40, 10))
    joints = CASSIE.standing[at.joint_qpos] + 0.3 * rng.standard_normal((40, 6))
    expected = LegKinematics()(motors, joints)[:, :, :2]
    single = torch.from_numpy(motors).float(), torch.from_numpy(joints).float()
    found = _sole_ends(*single)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("velocity", "steady"),
    [
        *(((0.0, 0.0), True), ((0.12, 0.2), True), ((0.5, 0.0), False), ((-0.5, 0.0), False)),
        *(((0.0, 0.6), False), ((0.0, -0.6), False)),
    ],
)
def test_robot_is_steady_while_its_divergent_component_is_above_its_feet(
    velocity: tuple[float, float], steady: bool
) -> None:
    """Soles are 16 cm long, and a bit more than 0.2 m apart."""
    found = find_balance(_standing(*velocity))
    assert found.steady.item() == steady
    if velocity[1]:
        assert found.leans_left.item() == (velocity[1] > 0)


def test_balance_does_not_depend_on_the_heading() -> None:
    """A robot that has turned by a quarter, with the same velocity over its feet."""
    turned = _standing(0.0, 0.5)
    turned["orientation"] = torch.tensor([[0.5**0.5, 0.0, 0.0, 0.5**0.5]])
    assert not find_balance(turned).steady.item()
    turned["velocity"] = torch.tensor([[0.2, 0.0, 0.0]])
    assert find_balance(turned).steady.item()
    assert not find_balance(turned).leans_left.item()


def test_narrow_and_crossed_feet_are_not_steady() -> None:
    """Hip rolls that put the left foot towards, and beyond, the right one."""
    for roll in (0.15, 0.5):
        narrow = _standing(0.0, 0.0)
        narrow["motor_position"] = narrow["motor_position"].clone()
        narrow["motor_position"][0, 0] -= roll
        # the pelvis stays above the middle of the feet
        narrow["velocity"][0, 1] = PENDULUM_RATE * -roll / 2
        assert not find_balance(narrow).steady.item()
