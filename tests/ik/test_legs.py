"""Motor angles in closed form, checked against Newton's method with Pinocchio."""

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.estimation.legs import leg_chains
from aslip.ik import BodyTarget, Kinematics, LegTable, leg_torque, pelvis_axes, solve, static_torque
from aslip.ik.dynamics import motor_motion
from aslip.ik.legs import _leg
from aslip.ik.solve import newton
from aslip.ik.target import FootMotion
from aslip.robot import CASSIE

SIDEWAYS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])
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


def test_torques_balance_forces_ahead_of_the_centres(kinematics, table, targets, poses):
    found, _, good = poses
    _, heading, force = targets
    ahead = np.random.default_rng(3).uniform(-0.06, 0.06, heading.shape)
    toes = np.stack([np.cos(heading), np.sin(heading), 0 * heading], -1)
    # the moment of the force about the centre turns the sole
    legs = kinematics.legs(kinematics.at_origin(found))
    turned = legs.jacobian[..., 3:, :] @ motor_motion(kinematics, legs)
    moment = np.cross(ahead[..., None] * toes, force)
    expected = table.torque(*targets).reshape(200, 2, 5)
    expected -= (turned.swapaxes(-1, -2) @ moment[..., None])[..., 0]
    torque = table.torque(*targets, ahead).reshape(200, 2, 5)
    np.testing.assert_allclose(torque[good], expected[good], atol=0.02)
    assert abs(torque - table.torque(*targets).reshape(200, 2, 5)).max() > 10


def test_inertial_torques_are_those_of_inverse_dynamics(kinematics, table):
    """Feet swing below a pelvis that is pushed; the weight of the body that rolls is left out."""
    random, step, n = np.random.default_rng(2), 1e-3, 40
    centre = random.uniform((-0.15, 0.08, -0.82), (0.15, 0.25, -0.72), (n, 2, 3)) * SIDEWAYS
    size, toes = random.uniform(0, [0.2, 0.05, 0.08], (n, 2, 3)), random.uniform(-0.3, 0.3, (n, 2))
    rate, start, push = (
        random.uniform(-k, k, (n, *s)) for k, s in ((15, (2, 1)), (3, (2, 3)), (4, (3,)))
    )

    def motion(time):
        turn, still = toes * np.cos(rate[..., 0] * time), np.zeros((n, 2))
        spin = -toes * rate[..., 0] * np.sin(rate[..., 0] * time)
        upright = np.stack([np.cos(turn / 2), still, still, np.sin(turn / 2)], -1)
        place = centre + size * np.sin(rate * time + start) + push[:, None] * time**2 / 2
        speed = size * rate * np.cos(rate * time + start) + push[:, None] * time
        parts = place, upright, speed, np.stack([still, still, spin], -1)
        feet = (BodyTarget(*(part[:, i] for part in parts)) for i in range(2))
        found = solve(kinematics, BodyTarget(push * time**2 / 2, velocity=push * time), *feet)
        return found.qpos, pelvis_axes(kinematics, found.qpos, found.qvel)

    (_, slow), (qpos, velocity), (_, fast) = (motion(time) for time in (-step, 0.0, step))
    acceleration = (fast - slow) / (2 * step)
    expected = leg_torque(kinematics, qpos, velocity, acceleration)
    assert (abs(expected).max(0) > [5, 2, 15, 15, 0.2] * 2).all()
    indices = CASSIE.indices
    motors = (x[:, indices.motor_qvel] for x in (velocity, acceleration))
    torque = table.inertial_torque(qpos[:, indices.motor_qpos], *motors, push)
    error = abs(torque - expected)
    assert error.max() < 0.5
    assert np.quantile(error, 0.95) < 0.3


def test_tensors_of_any_batch_shape_equal_arrays(table, targets):
    given = [torch.tensor(x, dtype=torch.float32).reshape(4, 50, *x.shape[1:]) for x in targets]
    found, expected = (
        (
            angle,
            jacobian,
            table.torque(*x),
            table.inertial_torque(angle, angle, angle, x[2][..., 0, :]),
        )
        for x in (given, targets)
        for angle, jacobian in [table.motors(*x[:2])]
    )
    for got, array, size in zip(found, expected, (1, 8, 800, 800), strict=True):
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
