"""Walks of the linear inverted pendulum obey its dynamics and repeat themselves."""

import numpy as np
import pytest

from aslip.rom import PendulumWalk, SlipParameters

WALK = PendulumWalk(speed=0.8, stride=0.8, height=0.9, width=0.24)
GRAVITY = SlipParameters().gravity
PHASE = np.arange(4000) / 4000


def test_body_accelerates_away_from_its_stance_foot():
    motion = WALK.sample(PHASE)
    dt = WALK.stride / len(PHASE)
    acceleration = np.gradient(motion.body.velocity, dt, axis=0)
    omega_squared = GRAVITY / WALK.height
    # the right foot carries while the left swings
    for half, stance in ((slice(2, 1998), 1), (slice(2002, 3998), 0)):
        lever = motion.body.position[half] - motion.feet.position[half, stance]
        expected = omega_squared * lever[:, :2]
        np.testing.assert_allclose(acceleration[half, :2], expected, atol=2e-3)
        assert np.ptp(motion.feet.position[half, stance], axis=0).max() == 0
    assert (motion.body.position[:, 2] == WALK.height).all()


def test_velocities_are_derivatives():
    motion = WALK.sample(PHASE)
    dt = WALK.stride / len(PHASE)
    for track in (motion.body, motion.feet):
        middle = (track.velocity[1:] + track.velocity[:-1]) / 2
        np.testing.assert_allclose(np.diff(track.position, axis=0) / dt, middle, atol=2e-3)


def test_second_half_mirrors_the_first():
    motion = WALK.sample(PHASE)
    half, mirror = len(PHASE) // 2, np.array([1.0, -1.0, 1.0])
    step = np.array([WALK.speed * WALK.stride / 2, 0, 0])
    body = motion.body.position[:half] * mirror + step
    np.testing.assert_allclose(motion.body.position[half:], body, atol=1e-12)
    left = motion.feet.position[:half, 0] * mirror + step
    np.testing.assert_allclose(motion.feet.position[half:, 1], left, atol=1e-12)


def test_feet_keep_their_distance_and_clear_the_ground():
    motion = WALK.sample(PHASE)
    np.testing.assert_allclose(
        motion.feet.position[:, 0, 1] - motion.feet.position[:, 1, 1], WALK.width
    )
    assert motion.feet.position[..., 2].min() >= 0
    assert motion.feet.position[..., 2].max() == pytest.approx(WALK.clearance, abs=1e-3)


def test_ground_force_acts_on_the_stance_foot_alone():
    motion = WALK.sample(PHASE)
    swinging = np.linalg.norm(motion.feet.velocity, axis=-1) > 1e-6
    assert not motion.ground_force[swinging].any()
    np.testing.assert_allclose(motion.ground_force[..., 2].sum(1), WALK.mass * GRAVITY)


def test_next_stride_begins_where_this_one_ends():
    now, later = WALK.sample(PHASE[::100]), WALK.sample(PHASE[::100] + 1)
    ahead = [WALK.speed * WALK.stride, 0.0, 0.0]
    for name in ("body", "feet"):
        moved = getattr(later, name).position - getattr(now, name).position
        np.testing.assert_allclose(moved, np.broadcast_to(ahead, moved.shape), atol=1e-12)
