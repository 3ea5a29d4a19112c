"""Motor angles in closed form, checked against Newton's method with Pinocchio."""

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.estimation.legs import leg_chains
from aslip.ik import Kinematics, LegTable, static_torque
from aslip.ik.legs import _leg
from aslip.ik.solve import newton
from aslip.ik.target import FootMotion
from aslip.robot import CASSIE

MIRROR = np.array([-1.0, -1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def table() -> LegTable:
    return LegTable()


@pytest.fixture(scope="module")
def targets() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, headings and forces of the feet (200, 2, ...) in steps of all kinds."""
    random = np.random.default_rng(0)
    position = random.uniform((-0.6, -0.1, 0.0), (0.6, 0.55, 0.35), (200, 2, 3))
    position[:, 1, 1] *= -1
    position[..., 2] = position[..., 2] * random.integers(0, 2, (200, 2)) - random.uniform(
        0.75, 1.0, (200, 1)
    )
    return position, random.uniform(-0.6, 0.6, (200, 2)), random.normal(0, 200, (200, 2, 3))


@pytest.fixture(scope="module")
def poses(kinematics: Kinematics, targets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Configurations by Newton's method, motor angles (200, 2, 5), and which are within limits."""
    position, heading, _ = targets
    zero, one, c, s = 0 * heading, 0 * heading + 1, np.cos(heading), np.sin(heading)
    turn = np.stack([c, -s, zero, s, c, zero, zero, zero, one], -1).reshape(200, 2, 3, 3)
    found, solved = newton(kinematics, FootMotion(position, turn, 0 * position, 0 * position))
    angle = found[:, kinematics.leg_q]
    good = solved & ((kinematics.lower <= angle) & (angle <= kinematics.upper)).all(-1)
    motors = np.take_along_axis(angle, kinematics.leg_motors[None], -1)
    return found, motors, good


@pytest.mark.parametrize(("kind", "tolerance"), [(np.float64, 1.5e-6), (np.float32, 3e-6)])
def test_angles_are_those_of_newtons_method(table, targets, poses, kind, tolerance):
    """The tolerance [rad] moves a sole by less than 0.01 mm."""
    _, expected, good = poses
    angle, jacobian = table.motors(*(x.astype(kind) for x in targets[:2]))
    assert angle.dtype == jacobian.dtype == kind
    assert good.mean() > 0.4
    np.testing.assert_allclose(angle.reshape(200, 2, 5)[good], expected[good], atol=tolerance)


def test_derivatives_are_those_of_differences(table, targets):
    """Also where angles are at their limits."""
    position, heading, _ = targets
    _, jacobian = table.motors(position, heading)
    for i, step in enumerate(1e-6 * np.eye(4)):
        ends = [table.motors(position + s[:3], heading + s[3])[0] for s in (step, -step)]
        expected = (ends[0] - ends[1]).reshape(200, 2, 5) / 2e-6
        np.testing.assert_allclose(jacobian[..., i], expected, atol=1e-7)


def test_torques_balance_the_forces(kinematics, table, targets, poses):
    found, _, good = poses
    expected = static_torque(kinematics, kinematics.to_mujoco(found), targets[2])
    torque = table.torque(*targets).reshape(200, 2, 5)
    np.testing.assert_allclose(torque[good], expected.reshape(200, 2, 5)[good], atol=0.02)


def test_tensors_of_any_batch_shape_equal_arrays(table, targets):
    given = [torch.tensor(x, dtype=torch.float32).reshape(4, 50, *x.shape[1:]) for x in targets]
    motors, torque = table.motors(*given[:2]), table.torque(*given)
    expected = *table.motors(*targets[:2]), table.torque(*targets)
    for got, array, size in zip((*motors, torque), expected, (1, 8, 800), strict=True):
        assert got.dtype == torch.float32
        np.testing.assert_allclose(got.flatten(0, 1).numpy(), array, atol=5e-6 * size)


def test_mirrored_targets_give_mirrored_angles(table, targets):
    position, heading, _ = targets
    angle, _ = table.motors(position, heading)
    mirrored, _ = table.motors(position[:, ::-1] * [1, -1, 1], -heading[:, ::-1])
    expected = angle.reshape(200, 2, 5)[:, ::-1] * MIRROR
    np.testing.assert_allclose(mirrored.reshape(200, 2, 5), expected, atol=1e-12)


def test_legs_too_long_are_as_long_as_possible_along_their_direction(table):
    # hip pitch, sole from the foot's hinge, and a direction in the plane of the leg
    base, ahead = np.array([-0.049 + 0.02, 0.1305, -0.09 - 0.057]), np.array([0.28, 0.0, -0.96])
    sides = np.array([[1, 1, 1], [1, -1, 1]])
    near, edge, far = (
        table.motors((base + length * ahead) * sides, np.zeros(2))[0].reshape(2, 5)
        for length in (0.9, 1.0, 3.0)
    )
    np.testing.assert_allclose(far, edge, atol=1e-5)
    assert (near[:, 3] < far[:, 3]).all()
    np.testing.assert_allclose(far[:, 3], np.radians(-37), atol=1e-3)


def test_targets_anywhere_give_finite_angles_within_the_limits(table):
    random = np.random.default_rng(1)
    position, heading = random.uniform(-3, 3, (300, 2, 3)), random.uniform(-4, 4, (300, 2))
    angle, jacobian = table.motors(position, heading)
    limits = np.array([CASSIE.skeleton.joints[name].range for name in CASSIE.motor_names])
    assert ((limits[:, 0] <= angle) & (angle <= limits[:, 1])).all()
    assert np.isfinite(jacobian).all()
    assert np.isfinite(table.torque(position, heading, position)).all()


def test_hips_of_another_kind_are_refused():
    chain = leg_chains(CASSIE)[0]
    with pytest.raises(ConfigurationError, match="axes that meet"):
        _leg(CASSIE, "left", chain._replace(hip_position=chain.hip_position + 0.01))
