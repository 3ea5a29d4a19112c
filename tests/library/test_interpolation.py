"""Slopes of splines over phase, periodic and with two ends."""

from typing import Any

import numpy as np
import torch
from scipy.interpolate import CubicSpline

from aslip.library.interpolation import OpenTable, open_slopes, periodic_slopes


def test_slopes_are_those_of_periodic_cubic_splines() -> None:
    for samples in (4, 5, 128):
        values = np.random.default_rng(samples).normal(size=(2, samples, 3))
        closed = np.concatenate([values, values[:, :1]], axis=1)
        spline = CubicSpline(np.arange(samples + 1), closed, axis=1, bc_type="periodic")
        expected = spline(np.arange(samples), 1)
        np.testing.assert_allclose(periodic_slopes(values), expected, rtol=0, atol=1e-14)


def test_open_slopes_are_those_of_clamped_cubic_splines() -> None:
    """Clamped to the slopes of the cubics through the four samples at either end."""
    for samples in (4, 5, 24):
        values, at = np.random.default_rng(samples).normal(size=(2, samples, 3)), np.arange(samples)
        ends = [
            np.polynomial.Polynomial.fit(at[part], values[0, part, 1], 3).deriv()(at[part][place])
            for part, place in ((slice(4), 0), (slice(-4, None), -1))
        ]
        clamped: Any = tuple((1, end) for end in ends)
        spline = CubicSpline(at, values[0, :, 1], bc_type=clamped)
        slopes = open_slopes(values)
        np.testing.assert_allclose(slopes[0, :, 1], spline(at, 1), rtol=0, atol=1e-12)


def test_open_table_interpolates_cubics_exactly_and_ends_with_its_samples() -> None:
    at = np.linspace(0.0, 1.0, 9)
    values = np.stack([at**3 - at, 2 - at**2, at], axis=1)[None]
    fraction = torch.linspace(0, 1, 31, dtype=torch.float64)[:, None]
    found = OpenTable(values)(fraction, torch.zeros(31, 1, dtype=torch.long)).numpy()
    x = fraction.numpy()
    expected = np.concatenate([x**3 - x, 2 - x**2, x], axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
