"""Loggers of a training: settings, numbers and films, and what their failures do."""

import io
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torchrl.record.loggers import Logger

from aslip.errors import MissingExtraError
from aslip.training import loggers
from aslip.training import progress as progress_module
from aslip.training.progress import ProgressLog, read_progress
from tests.training.run_folder import Settings, fail_on_full_disk, open_run
from tests.training.trainings import quiet

_PICTURES = np.random.default_rng(0).integers(0, 255, (3, 24, 32, 3), dtype=np.uint8)
_RATE = 100 / 9


def _draw(path: Path) -> tuple[np.ndarray, float]:
    return _PICTURES, _RATE


class FakeLogger(Logger):
    """Logger that keeps what it gets."""

    def __init__(self) -> None:
        self.got: list[Any] = []
        super().__init__("fake", "nowhere")

    def _create_experiment(self) -> Any:
        return self

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        self.got.append((name, value, step))

    def log_hparams(self, cfg: Any) -> None:
        self.got.append(cfg)

    def log_video(self, *args: Any, **kwargs: Any) -> None: ...

    def log_histogram(self, *args: Any, **kwargs: Any) -> None: ...

    def close(self, timeout: float | None = None) -> None:
        self.got.append("closed")

    def __repr__(self) -> str:
        return "fake"


def test_a_named_logger_gets_settings_rows_and_films_and_is_closed(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is given as an object gets rows only, and its owner closes it."""
    named, given = FakeLogger(), FakeLogger()
    films: list[Any] = []
    monkeypatch.setattr(progress_module, "open_logger", lambda *about: named)
    monkeypatch.setattr(progress_module, "log_film", lambda *film: films.append(film))
    for folder, logger in (("named", "wandb"), ("given", given)):
        log = ProgressLog(settings.out / folder, logger)  # pyright: ignore[reportArgumentType]
        (settings.out / folder).mkdir(parents=True)
        log.open({"seed": 3})
        log.write(10, {"value": 1.5})
        log.film(10, _draw)
        log.close()
    assert named.got == [{"seed": 3}, ("value", 1.5, 10), "closed"]
    assert given.got == [("value", 1.5, 10)]
    path = settings.out / "named" / "films" / "000000000010.mp4"
    assert films == [(named, 10, path, _PICTURES, _RATE)]


def test_a_logger_or_film_that_fails_does_not_end_the_training(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    logger = FakeLogger()
    monkeypatch.setattr(logger, "log_scalar", fail_on_full_disk)
    monkeypatch.setattr(progress_module, "open_logger", lambda *about: logger)
    settings.out.mkdir()
    log = ProgressLog(settings.out, "mlflow")
    log.open({})
    drawn = []

    def draw(path: Path) -> tuple[np.ndarray, float]:
        drawn.append(path)
        raise RuntimeError("no OpenGL here")

    with quiet() as messages:
        for step in (10, 20):
            log.write(step, {"value": 1.0})
            log.film(step, draw)
    assert read_progress(settings.out)["step"] == [10, 20]
    assert len(drawn) == 1
    assert [("no OpenGL here" in line, "did not take" in line) for line in messages] == [
        (False, True), (True, False), (False, True),
    ]  # fmt: skip


def test_tensorboard_gets_settings_and_films_on_request(settings: Settings) -> None:
    settings.out.mkdir()
    log = ProgressLog(settings.out, "tensorboard")
    log.open({"seed": 3, "out": "here"})
    log.write(10, {"value": 1.5})
    log.film(10, _draw)
    log.close()
    folder = settings.out / "tensorboard"
    events = EventAccumulator(str(folder)).Reload()
    assert [(e.step, e.value) for e in events.Scalars("value")] == [(10, 1.5)]
    (film,) = events.Images("film")
    with Image.open(io.BytesIO(film.encoded_image_string)) as shown:
        assert (film.step, shown.size, shown.n_frames) == (10, (32, 24), 3)
        assert shown.info["duration"] == 90
    (of_settings,) = (path for path in folder.iterdir() if path.is_dir())
    given = EventAccumulator(str(of_settings)).Reload().PluginTagToContent("hparams")
    assert b"seed" in given["_hparams_/session_start_info"]


@pytest.mark.parametrize("kind", ["wandb", "mlflow"])
def test_a_logger_that_is_not_installed_names_its_extra(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setitem(sys.modules, kind, None)
    with pytest.raises(MissingExtraError, match=rf"{kind} is not installed.*aslip\[{kind}\]"):
        loggers.open_logger(kind, settings.out, False)
    open_run(settings)  # the folder stays free


def test_weights_and_biases_go_on_with_the_run_of_the_folder(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[dict[str, Any]] = []
    monkeypatch.setitem(sys.modules, "wandb", ModuleType("wandb"))
    monkeypatch.setattr(loggers, "WandbLogger", lambda name, **about: opened.append(about))
    folder = settings.out / "wandb" / "offline-run-20260101_000000-abc123"
    folder.mkdir(parents=True)
    folder.with_name("latest-run").symlink_to(folder.name)
    for resume in (False, True):
        loggers.open_logger("wandb", settings.out, resume)
    assert [about["id"] for about in opened] == [None, "abc123"]


def test_mlflow_writes_beside_the_run_or_to_its_server(
    settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Any] = []
    monkeypatch.setitem(sys.modules, "mlflow", ModuleType("mlflow"))
    monkeypatch.setattr(
        loggers, "_Mlflow", lambda *about, **more: opened.append((*about, *more.values()))
    )
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    loggers.open_logger("mlflow", settings.out, False)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://there")
    loggers.open_logger("mlflow", settings.out, False)
    here = settings.out.parent
    assert opened == [
        ("run", f"sqlite:///{here}/mlflow.db", f"file://{here}/run/mlflow"),
        ("run", "http://there", None),
    ]
