"""Vertical ground forces of robot and model."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.library import GaitLibrary
from benchmarks.common import Subject
from benchmarks.paper import ground_force
from benchmarks.paper.ground_force import Config

Written = Callable[[str], dict[str, Any]]


def test_force_of_robot_and_model(tmp_path: Path, written: Written) -> None:
    rows = ground_force.main(Config(out=tmp_path, speeds=(0.5,), settle=1.0, walk=3.0))
    ours, model = rows
    assert ours["method"] == "straight"
    assert 0.35 < ours["duration"] < 0.65
    # the two feet carry the weight over a stride of 0.8 s
    assert ours["impulse"] == pytest.approx(33.312 * 9.81 * 0.8025 / 2, rel=0.08)
    assert model["dip_ratio"] < 0.1
    written("ground_force")


def test_ground_reaction_names_methods_that_fell_at_the_first_speed(library: GaitLibrary) -> None:
    config = Config(speeds=(0.0, 1.0))
    curve = ground_force.curve(np.tile(np.repeat([0.0, 300.0], 800), 4))
    curves = {("single reference", 1.0): [curve], ("ASLIP", 0.0): [curve], ("ASLIP", 1.0): [curve]}
    figure = ground_force.picture(config, curves, library)
    legend = figure.axes[0].get_legend()
    assert legend is not None
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["model", "ASLIP", "single reference"]


@pytest.mark.parametrize(
    ("force", "failed"), [(None, "fell"), (np.full((4000, 2), 160.0), "did not step")]
)
def test_the_table_names_a_fall_and_a_robot_that_stands(
    force: np.ndarray | None, failed: str
) -> None:
    row = {"method": "ASLIP", "speed": 0.5, **ground_force.profile(force)}
    assert row["failed"] == failed
    assert f"| ASLIP | 0.5 | {failed} |" in ground_force.table([row])


@pytest.mark.usefixtures("made", "falling")
def test_a_fall_closes_the_environment() -> None:
    assert ground_force.vertical_forces(Config(), Subject.load("straight"), 1.0) is None
