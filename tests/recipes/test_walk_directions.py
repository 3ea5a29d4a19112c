"""Schedules of three commands: walked, logged, replayed and read back."""

from pathlib import Path

import numpy as np
import pytest

from aslip.envs import shipped_library
from aslip.errors import ConfigurationError, SpeedOutOfRangeError
from aslip.log import Recording, read, replay
from aslip.log.walk import read_walk
from aslip.walking import Walker
from recipes import walk
from recipes.walk import Config
from tests.library.bent import symmetric_library
from tests.library.standing import policy_files


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Library and untrained policy for all directions."""
    return policy_files(tmp_path_factory.mktemp("directions"), symmetric_library(), "walking")


def _settings(files: tuple[Path, Path], **settings: object) -> Config:
    return Config(policy=str(files[1]), library=files[0], **settings)  # pyright: ignore


@pytest.fixture(scope="module")
def log(files: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    walk.main(_settings(files, command="0:0.4 0 0,0.3:0.4 0.1 0.8", duration=0.6, log=path))
    return read(path)


def test_command_and_heading_are_logged(log: Recording) -> None:
    step, place = log["/step"], log["/true_odometry"]
    names = [f"command_{name}" for name in ("forward", "sideways", "yaw_rate")]
    commands = np.stack([step[name] for name in names], axis=1)
    np.testing.assert_allclose(commands, [[0.4, 0, 0]] * 10 + [[0.4, 0.1, 0.8]] * 10, atol=1e-6)
    # the filtered yaw rate rises by 0.03 rad/s in a policy step
    filtered = step["filtered_command_yaw_rate"]
    np.testing.assert_allclose(np.diff(filtered)[10:19], 0.03, atol=1e-6)
    np.testing.assert_allclose(np.diff(place["heading"])[1:], 0.03 * filtered[1:], atol=1e-6)
    assert "path_error_sideways" in place.columns


def test_the_log_replays_and_gives_the_walk(log: Recording) -> None:
    assert replay(log).equal
    walks = read_walk(log)
    assert walks.command.shape == (20, 1, 3)
    # in the frame along the path, whose origin moves with the robot
    assert np.abs(walks.pelvis_position[..., 0]).max() < 0.31
    assert log["/truth"]["pelvis_position_x"][-1] > 0.1
    turn = log["/true_odometry"]["heading"]
    np.testing.assert_allclose(walks.frame[:, 0, 2], turn[-20:] - turn[-20], atol=1e-6)


def test_the_table_has_three_speeds_of_a_forward_speed(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    walk.main(_settings(files, command="0.4", duration=0.06))
    assert "| 0 | 0.40, 0.00, 0.00 |" in capsys.readouterr().out


def test_policies_for_all_directions_have_a_shipped_library(files: tuple[Path, Path]) -> None:
    assert Walker("directions", seed=0).library is shipped_library("directions")
    with pytest.raises(ConfigurationError, match=r"follows other gaits.* --library FILE"):
        Walker(files[1])
    # the fixture's library is smaller
    with pytest.raises(SpeedOutOfRangeError, match="outside the gait library"):
        walk.main(_settings(files, command="0:0.4 0 0,3:0.4 0.5 0"))
