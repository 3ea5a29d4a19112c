"""Figures of trainings show what their data says."""

from pathlib import Path

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.show.palette import LEFT, RIGHT, SERIES
from aslip.show.plots import compare_learning, gait_figure
from aslip.training.progress import ProgressLog
from aslip.training.settings import SETTINGS_FILE, settings_text


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


def test_axes_fit_the_curves_and_returns_of_different_rewards_are_marked(tmp_path: Path) -> None:
    folders = {}
    for name, weight in (("mine", 1.0), ("same", 1.0), ("other", 3.0)):
        folders[name] = tmp_path / name
        log = ProgressLog(folders[name])
        folders[name].mkdir()
        numbers = {"episode_length": 40.0, "episode_return": -500 * weight, "eval_return": 0.0}
        log.write(1, numbers)
        log.write(2, numbers)
        log.close()
        transforms = {"reward": f"WeightedReward(weights={weight})", "noise": f"{name}"}
        (folders[name] / SETTINGS_FILE).write_text(settings_text({}, transforms, ""))
    figure = compare_learning({"mine": [folders["mine"]], "same": [folders["same"]]})
    lengths, returns, _ = figure.axes
    assert returns.get_ylabel() == "training return"
    assert lengths.get_ylim()[0] == 0
    assert 40 < lengths.get_ylim()[1] < 50
    figure = compare_learning({name: [folder] for name, folder in folders.items()})
    lengths, returns, _ = figure.axes
    assert lengths.get_ylabel() == "training episode length"
    assert returns.get_ylabel() == "training return, each of its own reward"
    assert returns.get_ylim()[0] < -1500


def test_the_left_foot_is_blue_and_the_right_one_red_in_all_modes(library: GaitLibrary) -> None:
    (axes,) = gait_figure(library.gaits[10]).axes
    feet = {line.get_linestyle(): line.get_color() for line in axes.lines if line.get_lw() < 2}
    assert feet == {"--": LEFT, ":": RIGHT}


def test_at_most_five_colours_compare_trainings() -> None:
    groups = {str(i): [run([100.0, 200.0], [50.0, 60.0])] for i in range(7)}
    lines = compare_learning(groups).axes[0].lines
    assert [line.get_linestyle() for line in lines] == [*5 * ["-"], *2 * ["--"]]
    assert {line.get_color() for line in lines} == {*SERIES}
    assert not {*SERIES} & {LEFT, RIGHT}
