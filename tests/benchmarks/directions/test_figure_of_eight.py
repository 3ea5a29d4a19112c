"""Walks along a figure of eight."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from aslip.errors import ConfigurationError
from aslip.robot import CASSIE
from aslip.transforms.rotation import vertical_quaternion
from benchmarks.directions import figure_of_eight
from tests.helpers import limp


def test_places_in_the_world_are_those_of_the_frame_along_the_path() -> None:
    """The frame has a heading of 2 rad; the pelvis is 0.5 m ahead of it and 0.2 m to its left."""
    turned = vertical_quaternion(torch.tensor([[0.3]]))
    odometry = TensorDict(
        origin=torch.tensor([[3.0, -1.0, 0.0]]),
        pelvis_position=torch.tensor([[0.5, 0.2, 0.9]]),
        pelvis_orientation=turned,
        batch_size=1,
    )
    td = TensorDict(heading=torch.tensor([[2.0]]), odometry=odometry, batch_size=1)
    ahead, left = np.array([np.cos(2.0), np.sin(2.0)]), np.array([-np.sin(2.0), np.cos(2.0)])
    place = np.array([3.0, -1.0]) + 0.5 * ahead + 0.2 * left
    np.testing.assert_allclose(figure_of_eight.world_pose(td, "odometry"), [*place, 2.3], atol=1e-6)


@pytest.mark.parametrize("fails", [False, True])
def test_a_path_is_walked_over_the_estimate(
    gaits: str,
    tmp_path: Path,
    written: Callable[[str], Any],
    monkeypatch: pytest.MonkeyPatch,
    fails: bool,
) -> None:
    """A film that fails leaves the measurement."""
    film = Mock(side_effect=ConfigurationError("no OpenGL") if fails else None)
    monkeypatch.setattr(figure_of_eight, "make_film", film)
    config = figure_of_eight.Config(
        library=gaits, speed=0.5, duration=0.45, out=tmp_path, video=tmp_path / "eight.mp4"
    )
    if fails:
        with pytest.raises(ConfigurationError, match="no OpenGL"):
            figure_of_eight.main(config, limp())
    else:
        figure_of_eight.main(config, limp())
    # every fourth one of 15 policy steps, at double speed, with the eight on the floor
    _, filmed, rate, look = film.call_args.args
    assert len(filmed) == 4
    assert rate == pytest.approx(2 / (4 * CASSIE.policy_period))
    assert look.height == 720
    np.testing.assert_allclose(np.abs(look.path).max(axis=0), [3, 6], atol=1e-3)
    (row,) = written("figure_of_eight")["rows"]
    assert row["time"] == pytest.approx(0.45)
    assert not row["fell"]
    assert 0 < row["estimate"] <= row["estimate_most"] < 0.3
    # within half a second the estimate does not drift far
    assert row["truth"] == pytest.approx(row["estimate"], abs=0.1)


def test_films_end_in_mp4() -> None:
    with pytest.raises(ConfigurationError, match=r"must end in \.mp4, got 'eight\.gif'"):
        figure_of_eight.Config(video=Path("eight.gif"))
