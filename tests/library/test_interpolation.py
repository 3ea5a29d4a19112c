"""Slopes of splines over phase."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from aslip.library.interpolation import periodic_slopes


def test_slopes_are_those_of_periodic_cubic_splines() -> None:
    for samples in (4, 5, 128):
        values = np.random.default_rng(samples).normal(size=(2, samples, 3))
        closed = np.concatenate([values, values[:, :1]], axis=1)
        spline = CubicSpline(np.arange(samples + 1), closed, axis=1, bc_type="periodic")
        expected = spline(np.arange(samples), 1)
        np.testing.assert_allclose(periodic_slopes(values), expected, rtol=0, atol=1e-14)
