"""Libraries of pendulum walks: an ablation, and the single-reference baseline."""

import numpy as np
import pytest
import torch

from aslip.ik import Kinematics, static_torque
from aslip.library import GaitLibrary, pendulum_library, single_reference_library
from aslip.library.table import ARRAYS
from aslip.rom import PendulumWalk, SlipParameters

WALK = PendulumWalk(speed=0.8, stride=0.8, height=0.9, width=0.24)


@pytest.fixture(scope="module")
def single() -> GaitLibrary:
    return single_reference_library(WALK, samples=64)


def test_command_scales_only_the_forward_motion_of_the_pelvis(single: GaitLibrary) -> None:
    phase = torch.arange(23, dtype=torch.float64)[:, None] / 23
    slow, fast = (single.lookup(phase, torch.full_like(phase, v)) for v in (0.4, 1.6))
    assert torch.equal(slow.motor_position, fast.motor_position)
    assert torch.equal(slow.left_foot_position, fast.left_foot_position)
    torch.testing.assert_close(4 * slow.body_velocity[:, 0], fast.body_velocity[:, 0])
    torch.testing.assert_close(slow.body_velocity[:, 1:], fast.body_velocity[:, 1:])
    assert slow.body_velocity[:, 0].mean() == pytest.approx(0.4, abs=1e-3)
    assert torch.equal(single.stride(torch.tensor([[0.0], [2.0]])), torch.full((2, 1), WALK.stride))


def test_swing_feet_of_pendulums_are_as_far_below_the_body_as_in_gaits(
    library: GaitLibrary,
) -> None:
    table = pendulum_library(library.gaits, samples=32).table
    phase = np.arange(320) / 320
    for lowest, gait in zip(-table.foot_position[..., 0, 2].max(1), library.gaits, strict=True):
        sample = gait.sample(phase)
        leg = sample.body.position[:, 2] - sample.feet.position[:, 0, 2]
        assert lowest == pytest.approx(leg.min(), abs=5e-3)  # of 32 samples


def test_pendulums_have_mass_and_clearance_of_gaits(
    library: GaitLibrary,
) -> None:
    """So a comparison with gaits isolates the motion of the body over the feet."""
    gaits = library.gaits[5:7]
    pendulums = pendulum_library(gaits, samples=32)
    pairs = zip(pendulums.table.qpos, pendulums.table.motor_torque, gaits, strict=True)
    kinematics = Kinematics()
    for row, (qpos, torque, gait) in enumerate(pairs):
        p = gait.parameters
        height = pendulums.table.body_position[row, 0, 2]
        foot = pendulums.table.foot_position[row, :, 0, 2] + height
        phase = np.arange(320) / 320
        lifted = gait.sample(phase).feet.position[:, 0, 2].max()
        assert foot.max() == pytest.approx(lifted, abs=4e-3)  # of 32 samples
        walk = PendulumWalk(
            speed=gait.speed, stride=gait.stride, height=height, clearance=p.swing_clearance,
            width=p.foot_separation, mass=p.mass,
        )  # fmt: skip
        force = walk.sample(np.arange(32) / 32).ground_force
        expected = static_torque(kinematics, qpos, force)
        np.testing.assert_allclose(torque, expected, atol=1e-9)
        carried = gait.sample(phase).leg_force.sum(-1).mean()
        assert force[..., 2].sum(1).mean() == pytest.approx(p.weight, rel=1e-12)
        assert carried == pytest.approx(p.weight, rel=0.03)


def test_shipped_baseline_is_reproduced() -> None:
    """Solving the inverse kinematics again gives the shipped table up to rounding."""
    shipped, solved = GaitLibrary.load("single_reference"), single_reference_library()
    for name in ARRAYS:
        found, expected = getattr(shipped.table, name), getattr(solved.table, name)
        np.testing.assert_allclose(found, expected, atol=1e-9, err_msg=name)
    assert shipped.table.torque_jumps
    feet = shipped.table.foot_position[0, :, 0, 2] + shipped.table.body_position[0, :, 2]
    assert feet.max() == pytest.approx(0.15, abs=5e-4)
    assert PendulumWalk().clearance == SlipParameters().swing_clearance == 0.2
    assert PendulumWalk().mass == SlipParameters().mass == 30.0


def test_torques_never_overshoot_at_the_change_of_stance(library: GaitLibrary) -> None:
    """Each lookup lies between the samples on either side; a C2 spline overshoots by 13 N m."""
    pendulums, per_sample = pendulum_library(library.gaits[5:7]), 10
    table = pendulums.table.motor_torque[0]
    phase = np.arange(len(table) * per_sample) / (len(table) * per_sample)
    column = torch.tensor(phase)[:, None]
    speed = torch.full_like(column, pendulums.speeds[0])
    found = pendulums.lookup(column, speed).motor_torque.numpy()
    left = np.repeat(table, per_sample, axis=0)
    right = np.repeat(np.roll(table, -1, axis=0), per_sample, axis=0)
    assert (found >= np.minimum(left, right) - 1e-3).all()
    assert (found <= np.maximum(left, right) + 1e-3).all()
    assert np.abs(left - right).max() > 50  # there is a jump


def test_stretched_walks_match_their_table(single: GaitLibrary) -> None:
    phase = np.arange(64) / 64
    for row, motion in enumerate(single.motions):
        sample, ahead = (
            motion.sample(phase),
            np.outer(phase, [motion.command[0] * WALK.stride, 0, 0]),
        )
        table = single.table
        np.testing.assert_allclose(
            sample.body.position - ahead, table.body_position[row], atol=1e-12
        )
        np.testing.assert_allclose(sample.body.velocity, table.body_velocity[row], atol=1e-12)
        np.testing.assert_array_equal(sample.feet.velocity, table.foot_velocity[row])
        offset = sample.feet.position - sample.body.position[:, None]
        np.testing.assert_allclose(offset, table.foot_position[row], atol=1e-12)
