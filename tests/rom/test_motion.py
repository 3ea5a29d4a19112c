"""Sampled motions interpolate, repeat and survive their arrays."""

import numpy as np
import pytest

from aslip.errors import FileDamagedError, ShapeError
from aslip.rom import Angle, MotionSample, SampledMotion, Track


class Circling:
    """Body and feet that move with the heading along a circle of 1 m radius, to the left."""

    command = np.array([0.5, 0.0, 0.5])
    stride = 0.8

    def sample(self, phase):
        angle = 0.5 * phase * self.stride
        zero, rate = np.zeros(len(phase)), np.full(len(phase), 0.5)

        def track(radius, height):
            position = [radius * np.sin(angle), 1 - radius * np.cos(angle), zero + height]
            velocity = [radius * np.cos(angle), radius * np.sin(angle), zero]
            return np.stack(position, axis=1), 0.5 * np.stack(velocity, axis=1)

        left, right = track(0.9, 0.0), track(1.1, 0.0)
        inward = np.stack([-np.sin(angle), np.cos(angle), zero + 10.0], axis=1)
        return MotionSample(
            body=Track(*track(1.0, 0.9)),
            feet=Track(*(np.stack(pair, axis=1) for pair in zip(left, right, strict=True))),
            ground_force=np.repeat(10.0 * inward[:, None], 2, axis=1),
            heading=Angle(angle, rate),
            foot_heading=np.stack([angle, angle - 0.1], axis=1),
        )


@pytest.fixture(scope="module")
def motion():
    return Circling()


@pytest.fixture(scope="module")
def sampled(motion):
    return SampledMotion.from_motion(motion, 64)


def test_resampling_returns_the_samples(sampled):
    again = SampledMotion.from_motion(sampled, 64)
    for name, value in sampled.to_arrays().items():
        np.testing.assert_allclose(again.to_arrays()[name], value, atol=1e-14, err_msg=name)


def test_interpolation_follows_the_motion_between_samples_and_strides(motion, sampled):
    """Positions and angles are cubic, forces and toes linear between samples."""
    phase = np.linspace(-1.3, 2.7, 301)
    found = SampledMotion(sampled.command, sampled.stride, sampled.sample(phase)).to_arrays()
    exact = SampledMotion(motion.command, motion.stride, motion.sample(phase)).to_arrays()
    for name, value in exact.items():
        tolerance = {"ground_force": 5e-3, "foot_heading": 5e-5}.get(name, 1e-5)
        np.testing.assert_allclose(found[name], value, atol=tolerance, err_msg=name)


def test_motion_is_restored_from_its_arrays(sampled):
    again = SampledMotion.from_arrays(sampled.to_arrays())
    np.testing.assert_equal(again.to_arrays(), sampled.to_arrays())
    arrays = sampled.to_arrays()
    del arrays["foot_heading"]
    with pytest.raises(FileDamagedError, match="needs 'foot_heading'"):
        SampledMotion.from_arrays(arrays)


@pytest.mark.parametrize("phase", [0.5, [[0.5]], [np.nan]])
def test_bad_phases_are_refused(sampled, phase):
    with pytest.raises(ShapeError, match="phase"):
        sampled.sample(np.asarray(phase))
