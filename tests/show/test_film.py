"""Films have their frames, or are refused."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import aslip
from aslip.errors import ConfigurationError
from aslip.library import GaitLibrary
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show import film
from aslip.show.film import Frame, _write_caption, camera_beside, write_video
from tests.show.test_ghost import instant


def decoded_film(path: Path) -> tuple[dict, np.ndarray]:
    """Header and pictures of a film."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    stream = ffmpeg.read_frames(str(path))
    about = next(stream)
    width, height = about["size"]
    return about, np.array([np.frombuffer(f, np.uint8).reshape(height, width, 3) for f in stream])


# imageio-ffmpeg leaves its pipes to the garbage collector
leaves_pipes = pytest.mark.filterwarnings(
    "ignore:unclosed file:ResourceWarning",
    "ignore::pytest.PytestUnraisableExceptionWarning",
)


@pytest.fixture
def frames() -> Callable[[int], list[np.ndarray]]:
    """Frames that get brighter."""

    def make(count: int) -> list[np.ndarray]:
        return [np.full((48, 64, 3), 20 * i, dtype=np.uint8) for i in range(count)]

    return make


@leaves_pipes
def test_film_has_its_frames(tmp_path: Path, frames: Callable[[int], list[np.ndarray]]) -> None:
    write_video(tmp_path / "film.mp4", frames(10), 100 / 3, (64, 48))
    about, decoded = decoded_film(tmp_path / "film.mp4")
    assert about["size"] == (64, 48)
    assert about["fps"] == pytest.approx(33.33, abs=0.01)
    np.testing.assert_allclose(decoded.mean(axis=(1, 2, 3)), 20 * np.arange(10), atol=6)
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


@leaves_pipes
def test_the_film_of_an_evaluation_shows_its_middle_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[list[film.Frame]] = []

    def draw(frames: list[film.Frame], look: film.Look) -> list[np.ndarray]:
        drawn.append(frames)
        return [np.zeros((look.height, look.width, 3), np.uint8)] * len(frames)

    monkeypatch.setattr(film, "draw", draw)
    monkeypatch.setattr(film, "_FILM_STEPS", 7)
    path, speeds = tmp_path / "films" / "1.mp4", [0.0, 2.0, 0.5]
    with closing(aslip.make_env(num_envs=3, seed=0)) as env:
        pictures, rate = film.film_evaluation(aslip.load_policy("straight"), env, speeds, path)
    assert decoded_film(path)[0]["fps"] == pytest.approx(rate, abs=0.01)
    assert len(pictures) == len(drawn[0]) == 3
    assert drawn[0][-1].qpos[0] == pytest.approx(2.0 * 7 * CASSIE.policy_period, abs=0.05)


def test_films_of_pages_are_webp(tmp_path: Path, frames: Callable[[int], list[np.ndarray]]) -> None:
    write_video(tmp_path / "film.webp", frames(3), 100 / 6, (64, 48))
    with Image.open(tmp_path / "film.webp") as image:
        assert (image.format, image.size, image.info["loop"]) == ("WEBP", (64, 48), 0)
        assert getattr(image, "n_frames", 1) == 3


def test_a_frame_names_time_command_and_push(library: GaitLibrary) -> None:
    td = instant(library, 0.2, 0.5, 0.0).set("command", torch.tensor([[0.5]]))
    td["truth", "qpos"] = torch.zeros(1, 35)
    assert Frame.of(td, 3.0).caption == " 3.00 s    forward 0.50 m/s"
    push = torch.tensor([[0.0, -60.0, 0.0]])
    stands = td.clone().set("stand", torch.ones(1, 1))
    assert Frame.of(stands, 3.0, push).caption == " 3.00 s    stand   push 60 N"
    black = np.zeros((120, 320, 3), np.uint8)
    corner = _write_caption(black, Frame.of(td, 3.0))[:12, :200]
    assert corner.max() > 60
    assert not _write_caption(black, Frame.of(td, 3.0))[24:].any()


@pytest.mark.parametrize("camera", ["side", "follow", "front"])
def test_the_model_is_beside_the_robot_in_the_picture(camera: str) -> None:
    """The model is on the left, as far from the middle of the picture as the robot on the right."""
    usual = load_model()
    model, offset = camera_beside(camera, load_model())
    index = usual.camera(camera).id
    right, _, back = usual.cam_mat0[index].reshape(3, 3).T
    assert offset @ right < -0.8
    assert offset[2] == 0
    # from the camera to the robot, and to the model
    robot = -model.cam_poscom0[index]
    assert robot @ right == pytest.approx(-(robot + offset) @ right, abs=0.1)
    assert robot @ back < -2.5
    assert not np.array_equal(model.cam_poscom0, usual.cam_poscom0)


def test_failed_film_leaves_no_file(
    tmp_path: Path, frames: Callable[[int], list[np.ndarray]]
) -> None:
    def broken():
        yield from frames(2)
        raise RuntimeError("the renderer died")

    with pytest.raises(RuntimeError, match="renderer"):
        write_video(tmp_path / "film.mp4", broken(), 30, (64, 48))
    assert not list(tmp_path.iterdir())


def test_films_of_wrong_type_or_size_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"\.mp4 or \.webp, got .*film\.gif"):
        write_video(tmp_path / "film.gif", [], 30, (64, 48))
    with pytest.raises(ConfigurationError, match="even"):
        write_video(tmp_path / "film.mp4", [], 30, (63, 48))
