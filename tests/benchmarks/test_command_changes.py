"""Changes of the command slide the planted feet of the reference, and hardly load the motors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from aslip.errors import ConfigurationError
from aslip.ik import Kinematics
from aslip.library import GaitLibrary
from benchmarks import command_changes
from benchmarks.command_changes import Config, asked, walk_over


def test_a_change_ends_at_its_command_as_fast_as_the_rates_allow() -> None:
    library, config = GaitLibrary.load("directions"), Config(rates=(1.0, 0.5, 1.0))
    start, end = torch.tensor([[0.2, 0.0, 0.0], [1.0, 0.1, 0.0]]).double()
    phase, command = walk_over(library, config, start, end, torch.tensor([0.3]).double())
    assert len(phase) == len(command) == 81
    assert torch.equal(command[-1], end)
    stride = library.stride(command[:1]).item()
    assert (phase[-1] - phase[0]).item() % 1 == pytest.approx(0.8 / stride, abs=0.01)


def test_a_constant_command_slides_no_foot_and_asks_the_same_of_the_motors() -> None:
    library = GaitLibrary.load("directions")
    command = torch.tensor([0.5, 0.1, 0.3]).double().expand(21, 3)
    stride = library.stride(command[:1]).item()
    phase = 0.1 + torch.arange(21, dtype=torch.float64)[:, None] * 0.01 / stride
    constant, changing = asked(library, Kinematics(), phase, command)
    assert len(changing.slide) and changing.slide.max() < 1e-6
    # differences of 10 ms, one-sided at both ends
    np.testing.assert_allclose(changing.torque[1:-1], constant.torque[1:-1], atol=1.0)


def test_faster_changes_slide_feet_faster(capsys: pytest.CaptureFixture[str]) -> None:
    (_, slow), (_, fast) = (
        command_changes.main(Config(changes=3, rates=rates))
        for rates in ((1.0, 0.75, 1.0), (2.0, 1.5, 2.0))
    )
    assert fast.slide.mean() == pytest.approx(2 * slow.slide.mean(), rel=0.2)
    assert slow.torque.shape[1] == 10
    assert "planted feet of the reference slide by" in capsys.readouterr().out


def test_no_change_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="changes must be 1 or more, got 0"):
        Config(changes=0)
