"""The recipe that plays a policy: to a table, a log, a film."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from aslip.errors import (
    AslipError,
    AssetError,
    ConfigurationError,
    RenderingError,
    SpeedOutOfRangeError,
    UnknownNameError,
)
from aslip.log import read, replay
from aslip.log.__main__ import main as log_main
from aslip.render import render_robot
from aslip.video import write_video
from recipes import walk
from recipes.walk import Config


def test_it_walks_the_schedule_and_logs_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "walk.mcap"
    walk.main(
        Config(command="0:0.5,0.9:1.0", duration=1.8, push=("0.3:0,30,0:0.06",), log=path, seed=3)
    )
    table = capsys.readouterr().out
    assert "| 0 | 0.50 |" in table
    assert "| 0.9 | 1.00 |" in table
    log = read(path)
    assert len(log["/step"]) == 60
    np.testing.assert_array_equal(log["/step"]["command"], [0.5] * 30 + [1.0] * 30)
    np.testing.assert_array_equal(np.flatnonzero(log["/step"]["push_y"]), [10, 11])
    assert '"command": "0:0.5,0.9:1.0"' in log.attachments["config.json"].decode()
    assert "policy.zip" in log.attachments
    assert log_main(["replay", "--verify", str(path)]) == 0


def test_both_backends_and_the_truth_can_walk(tmp_path: Path) -> None:
    for name, settings in {"dm": {"backend": "dm_control"}, "truth": {"truth": True}}.items():
        path = tmp_path / f"{name}.mcap"
        walk.main(Config(command="0.5", duration=0.3, log=path, **settings))  # pyright: ignore
        assert replay(path).equal
    estimate, truth = (read(tmp_path / "truth.mcap")[topic] for topic in ("/estimate", "/truth"))
    np.testing.assert_array_equal(estimate["height"], truth["pelvis_position_z"])


def test_a_fall_ends_the_walk_and_the_log_is_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fall.mcap"
    walk.main(Config(command="0.5", push=("0.2:0,2500,0:0.3",), log=path))
    assert "fell after" in capsys.readouterr().out
    assert "terminated" in read(path)["/log"]["msg"][-1]
    assert replay(path).equal


@pytest.mark.parametrize(
    ("settings", "error", "names"),
    [
        ({"policy": "nobody"}, AssetError, "nobody"),
        ({"command": "0:3.0"}, SpeedOutOfRangeError, "speed 3 m/s"),
        ({"command": "4:1.0"}, ConfigurationError, "from 0"),
        ({"push": ("1",)}, ConfigurationError, "push is"),
        ({"duration": -1.0}, ConfigurationError, "duration"),
        ({"push": ("9:0,5,0",), "duration": 2.0}, ConfigurationError, "from 0 to 2 s.* at 9 s"),
        ({"push": ("-1:0,5,0",)}, ConfigurationError, "no push at -1 s"),
        (
            {"push": ("1.05:0,5,0", "1:5,0,0")},
            ConfigurationError,
            "1.05 s begins before.*1.14 s",
        ),
        ({"live": True, "viewer": True}, ConfigurationError, "--live"),
        ({"log": Path(".")}, ConfigurationError, "--log"),
        # told with or without OpenGL
        ({"video": Path("walk.mp4"), "camera": "nose"}, UnknownNameError, "nose.*side"),
        ({"video": Path("walk.mp4"), "width": 10**5}, ConfigurationError, "100000"),
    ],
)
def test_mistakes_are_named_before_anything_is_written(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    settings: dict,
    error: type[AslipError],
    names: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=names):
        walk.main(Config(**{"log": Path("walk.mcap"), **settings}))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="how to tell is another matter elsewhere")
def test_a_viewer_without_a_display_is_told_what_to_use(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RenderingError, match="use --video"):
        walk.main(Config(duration=0.3, viewer=True))


# ---------------------------------------------------------------------- films


@pytest.fixture
def frames() -> Callable[[int], list[np.ndarray]]:
    """Frames that get brighter."""

    def make(count: int) -> list[np.ndarray]:
        return [np.full((48, 64, 3), 20 * i, dtype=np.uint8) for i in range(count)]

    return make


def _decoded(path: Path) -> tuple[dict, np.ndarray]:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    stream = ffmpeg.read_frames(str(path))
    about = next(stream)
    width, height = about["size"]
    return about, np.array([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in stream])


def test_a_film_has_its_frames(tmp_path: Path, frames: Callable[[int], list[np.ndarray]]) -> None:
    write_video(tmp_path / "film.mp4", frames(10), 100 / 3, (64, 48))
    about, decoded = _decoded(tmp_path / "film.mp4")
    assert about["size"] == (64, 48)
    assert about["fps"] == pytest.approx(33.33, abs=0.01)
    np.testing.assert_allclose(decoded.mean(axis=(1, 2, 3)), 20 * np.arange(10), atol=6)
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_a_film_that_fails_leaves_no_file(
    tmp_path: Path, frames: Callable[[int], list[np.ndarray]]
) -> None:
    def broken():
        yield from frames(2)
        raise RuntimeError("the renderer died")

    with pytest.raises(RuntimeError, match="renderer"):
        write_video(tmp_path / "film.mp4", broken(), 30, (64, 48))
    assert not list(tmp_path.iterdir())


def test_films_of_other_kinds_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"\.mp4"):
        write_video(tmp_path / "film.gif", [], 30, (64, 48))
    with pytest.raises(ConfigurationError, match="even"):
        write_video(tmp_path / "film.mp4", [], 30, (63, 48))


def test_a_walk_can_be_filmed(tmp_path: Path) -> None:
    try:
        render_robot(np.zeros((1, 35)), width=16, height=16)
    except RenderingError as error:
        pytest.skip(str(error))
    path = tmp_path / "walk.mp4"
    walk.main(Config(command="1.0", duration=0.15, video=path, width=160, height=120))
    about, decoded = _decoded(path)
    assert about["size"] == (160, 120)
    assert len(decoded) == 6
    assert decoded.std() > 10  # something is seen
