"""Figures of trainings show what their data says."""

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.show.plots import compare_learning


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
        "not started": [{}],
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
