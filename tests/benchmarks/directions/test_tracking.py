"""Errors of the mean velocity over random commands."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.directions import tracking
from tests.helpers import limp


def test_errors_are_mapped_over_the_region(
    gaits: str, tmp_path: Path, written: Callable[[str], Any]
) -> None:
    config = tracking.Config(library=gaits, commands=6, settle=0.15, walk=0.15, out=tmp_path)
    (row,) = tracking.main(config, limp())
    assert row["falls"] == 0
    numbers = written("tracking")
    command, twist = np.array(numbers["command"]), np.array(numbers["twist"][0])
    assert command.shape == twist.shape == (6, 3)
    assert np.ptp(command, axis=0).min() > 0.1
    assert row["speed"]["mean"] == pytest.approx(
        np.linalg.norm((twist - command)[:, :2], axis=1).mean(), abs=1e-9
    )
