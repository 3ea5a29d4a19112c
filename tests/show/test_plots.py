"""Figures of gaits and of trainings show what their data says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.rom import Mode
from aslip.show.plots import MODE_COLORS, compare_learning, gait_figure, gait_sheet


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


def run(length: list[float], evaluation: list[float]) -> dict[str, list[float]]:
    steps = [1e6 * (i + 1) for i in range(len(length))]
    return {
        "step": steps, "episode_length": length, "episode_return": length, "eval_return": evaluation
    }  # fmt: skip


def test_trainings_are_compared_by_mean_and_range_up_to_the_shortest() -> None:
    nan = float("nan")
    groups = {
        "mine": [run([100.0, 200.0, 300.0], [nan, nan, 90.0]), run([300.0, 400.0], [nan, 50.0])],
        "other": [run([10.0, 20.0, 30.0], [nan, nan, nan])],
        "not begun": [{}],
    }
    figure = compare_learning(groups)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "training episode length", "training return", "evaluation return"
    ]  # fmt: skip
    lengths, _, evaluations = figure.axes
    mine, other = lengths.lines
    np.testing.assert_array_equal(mine.get_xydata(), [[1, 200], [2, 300]])
    np.testing.assert_array_equal(other.get_xydata(), [[1, 10], [2, 20], [3, 30]])
    assert mine.get_color() != other.get_color()
    (band,) = lengths.collections[0].get_paths()
    assert (band.get_extents().ymin, band.get_extents().ymax) == (100, 400)
    (line,) = evaluations.lines
    np.testing.assert_array_equal(line.get_xydata(), [[2, 70]])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["mine", "other"]


def test_panels_without_values_are_left_out() -> None:
    figure = compare_learning({"mine": [run([1.0, 2.0], [float("nan")] * 2)]})
    assert len(figure.axes) == 2
    with pytest.raises(ConfigurationError, match=r"mine.*no progress"):
        compare_learning({"mine": [{}]})
