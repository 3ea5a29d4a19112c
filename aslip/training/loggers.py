"""Loggers of trainings besides the CSV: TensorBoard, Weights & Biases, MLflow, through TorchRL.

Films are MP4 files that the run keeps. TorchRL's own films need moviepy below 2 for TensorBoard,
and for MLflow a torchcodec that fits FFmpeg, PyTorch and, even on machines without a GPU, CUDA.
"""

from __future__ import annotations

import importlib
import io
import os
from pathlib import Path

import numpy as np
from torchrl.record.loggers import Logger, MLFlowLogger, TensorboardLogger, WandbLogger

from aslip.base.imports import extras

with extras():
    from tensorboard.compat.proto.summary_pb2 import Summary
    from torch.utils.tensorboard import SummaryWriter


class RunTensorboard(TensorboardLogger):
    """TensorBoard in the folder of a run, without points that a resumed run writes again.

    Args:
        folder: folder of the run.
        step: policy steps from which on earlier points are dropped.
    """

    def __init__(self, folder: Path, step: int) -> None:
        self._first_step = step
        super().__init__("tensorboard", str(folder))

    def _create_experiment(self) -> SummaryWriter:
        folder = os.path.join(self.log_dir, self.exp_name)
        return SummaryWriter(folder, purge_step=self._first_step)


class _Mlflow(MLFlowLogger):
    """MLflow run that ends when the logger is closed, as those of other loggers do."""

    def shutdown(self, timeout: float | None = None) -> None:
        importlib.import_module("mlflow").end_run()
        super().shutdown(timeout)


def open_logger(kind: str, folder: Path, resume: bool) -> Logger:
    """Logger of a run: "wandb", or "mlflow" at MLFLOW_TRACKING_URI or in `mlflow.db` beside it.

    Args:
        kind: name of the library.
        folder: folder of the run; its name is that of the experiment.
        resume: go on with the last run of Weights & Biases in the folder; MLflow gets a new run.

    Raises:
        MissingExtraError: the library is not installed.
    """
    with extras():
        importlib.import_module(kind)
    folder = folder.resolve()
    if kind == "mlflow":
        where = f"sqlite:///{folder.parent / 'mlflow.db'}"
        files = (folder / "mlflow").as_uri()
        if server := os.environ.get("MLFLOW_TRACKING_URI"):
            where, files = server, None
        return _Mlflow(folder.name, where, artifact_location=files)
    last = folder / "wandb" / "latest-run"
    name = last.resolve().name.rpartition("-")[2] if resume and last.exists() else None
    project = os.environ.get("WANDB_PROJECT", "aslip")
    return WandbLogger(folder.name, log_dir=str(folder), id=name, project=project)


def log_film(logger: Logger, step: int, path: Path, pictures: np.ndarray, rate: float) -> None:
    """Give a film to a logger.

    Args:
        logger: logger of `open_logger`, or a TensorBoard.
        step: policy steps.
        path: the film.
        pictures: its pictures (n, height, width, 3), uint8.
        rate: number of pictures per second.
    """
    if isinstance(logger, MLFlowLogger):
        importlib.import_module("mlflow").log_artifact(str(path), "films")
    elif isinstance(logger, WandbLogger):
        video = importlib.import_module("wandb").Video(str(path), format="mp4")
        logger.log_metrics({"film": video}, step)
    elif isinstance(logger, TensorboardLogger):
        height, width = pictures.shape[1:3]
        image = Summary.Image(
            height=height, width=width, colorspace=3, encoded_image_string=_gif(pictures, rate)
        )
        summary = Summary(value=[Summary.Value(tag="film", image=image)])
        logger.experiment.file_writer.add_summary(summary, step)


def _gif(pictures: np.ndarray, rate: float) -> bytes:
    with extras():
        from PIL import Image  # matplotlib brings it
    first, *rest = (Image.fromarray(picture) for picture in pictures)
    buffer = io.BytesIO()
    duration = round(1000 / rate)  # of a picture [ms]
    first.save(buffer, "GIF", save_all=True, append_images=rest, duration=duration, loop=0)
    return buffer.getvalue()
