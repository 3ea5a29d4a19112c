"""Schedules with standing: walked, logged, replayed and read back."""

from pathlib import Path

import numpy as np
import pytest

from aslip.errors import ConfigurationError
from aslip.library import WalkMode
from aslip.log import Recording, read, replay
from aslip.log.walk import read_walk
from recipes import walk
from recipes.walk import Config
from tests.library.standing import policy_files, standing_library


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return policy_files(tmp_path_factory.mktemp("standing"), standing_library())


def _walk(files: tuple[Path, Path], command: str, duration: float, log: Path | None = None) -> None:
    library, policy = files
    settings = {"policy": str(policy), "library": str(library), "log": log}
    walk.main(Config(command=command, duration=duration, **settings))  # pyright: ignore


@pytest.fixture(scope="module")
def log(files: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    _walk(files, "0:stand,0.15:0.1 0 0,0.6:stand", 0.75, path)
    return read(path)


def test_stand_command_and_mode_are_logged_and_replayed(log: Recording) -> None:
    step, reference = log["/step"], log["/reference"]
    np.testing.assert_array_equal(step["stand"], [1] * 5 + [0] * 15 + [1] * 5)
    np.testing.assert_array_equal(step["mode"][:5], WalkMode.STAND)
    # the mode during a step is that at its beginning
    np.testing.assert_array_equal(reference["mode"][:25], step["mode"])
    assert {WalkMode.STAND, WalkMode.START, WalkMode.WALK} <= set(reference["mode"].tolist())
    assert not step["filtered_command_forward"][:5].any()
    assert replay(log).equal
    assert read_walk(log).command.shape == (25, 1, 3)


def test_the_table_names_standing(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    _walk(files, "0:0.1 0 0.2,0.06:stand", 0.15)
    table = capsys.readouterr().out
    assert "| 0 | 0.10, 0.00, 0.20 |" in table
    assert "| 0.06 | stand |" in table


def test_policies_that_only_walk_do_not_stand() -> None:
    with pytest.raises(ConfigurationError, match="'straight' was not trained to stand"):
        walk.main(Config("straight", command="0:0.5,3:stand"))
