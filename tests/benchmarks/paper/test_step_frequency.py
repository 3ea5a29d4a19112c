"""Step frequency of robot and model."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.paper import step_frequency

Written = Callable[[str], dict[str, Any]]


def test_step_frequency_is_that_of_the_model(tmp_path: Path, written: Written) -> None:
    rows = step_frequency.main(
        step_frequency.Config(out=tmp_path, speeds=(0.5,), settle=1.0, walk=3.0)
    )
    assert rows[0]["mean"] == pytest.approx(rows[0]["model"], rel=0.05)
    assert written("step_frequency")["rows"][0]["duty"] > 0.5
