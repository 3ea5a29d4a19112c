"""Check of a motion's velocities by central differences."""

import numpy as np


def check_velocities(gait, atol):
    """Assert that sampled velocities are derivatives of the positions, within `atol` [m/s]."""
    step = 1e-6
    phase = np.linspace(0.003, 0.997, 200)
    before, middle, after = (gait.sample(phase + d) for d in (-step, 0.0, step))
    for name in ("body", "feet"):
        ends = getattr(before, name).position, getattr(after, name).position
        difference = (ends[1] - ends[0]) / (2 * step * gait.stride)
        np.testing.assert_allclose(getattr(middle, name).velocity, difference, atol=atol)
