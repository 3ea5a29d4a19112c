"""Figures of gaits show their paths, modes and phases."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.patches import Rectangle

from aslip.library import GaitLibrary
from aslip.rom import Mode
from aslip.show.plots import MODE_COLORS, gait_figure, gait_sheet


def test_paths_are_continuous_and_coloured_by_mode(library: GaitLibrary) -> None:
    """Right, double, left, double, twice; each piece begins where the one before ends."""
    (axes,) = gait_figure(library.gaits[10], strides=2).axes
    styles = [line.get_linestyle() for line in axes.lines]
    modes = 2 * [Mode.RIGHT, Mode.DOUBLE, Mode.LEFT, Mode.DOUBLE]
    for style in ("-", "--", ":"):
        path = [line for line, other in zip(axes.lines, styles, strict=True) if other == style]
        assert [line.get_color() for line in path] == [MODE_COLORS[mode] for mode in modes]
        points = [np.array(line.get_data_3d()) for line in path]  # pyright: ignore[reportAttributeAccessIssue]
        for before, after in itertools.pairwise(points):
            np.testing.assert_array_equal(before[:, -1], after[:, 0])


def test_double_stance_is_shaded(library: GaitLibrary) -> None:
    """Shaded are exactly the phases at which both feet of the first gait are on the ground."""
    gaits = library.gaits[::20]
    phase = np.linspace(0, 1, 500, endpoint=False)
    double = gaits[0].sample(phase).mode == Mode.DOUBLE
    *rows, _ = gait_sheet(gaits).axes
    for axes in rows:
        spans = [patch for patch in axes.patches if isinstance(patch, Rectangle)]
        edges = [(span.get_x(), span.get_x() + span.get_width()) for span in spans]
        shaded = np.any([(phase >= low) & (phase < high) for low, high in edges], axis=0)
        # a sample on an edge may fall to either side
        assert np.mean(shaded != double) < 0.01
