"""Films of a walk: draw frames and write them to an MP4 file.

OpenGL is loaded on the first drawing, not on import.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import torch
from tensordict import TensorDictBase
from tqdm import tqdm

from aslip.errors import ConfigurationError
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost


@dataclass(frozen=True)
class Frame:
    """One instant to draw."""

    qpos: np.ndarray
    """(nq,) configuration of the robot."""
    ghost: Ghost
    """Reduced-order model."""

    @classmethod
    def of(cls, td: TensorDictBase) -> Frame:
        """Frame of a tensordict of one robot."""
        qpos = cast("torch.Tensor", td["truth", "qpos"])
        return cls(qpos[0].numpy().copy(), Ghost.of(td))


@dataclass(frozen=True)
class Look:
    """Camera, size and content of a film."""

    camera: str
    """Camera of the model: side, follow or front."""
    width: int
    """Width [pixels]."""
    height: int
    """Height [pixels]."""
    ghost: bool = True
    """Draw the reduced-order model, too."""


def seconds_per_frame(look: Look) -> float:
    """Measure the time to draw a frame [s], after a first frame that sets up OpenGL.

    Raises:
        RenderingError: OpenGL does not work.
        UnknownNameError: there is no such camera.
        ConfigurationError: the size is out of range.
    """
    from aslip.show.render import render_frames

    qpos = np.tile(load_model().key("standing").qpos, (2, 1))
    pictures = render_frames(qpos, camera=look.camera, width=look.width, height=look.height)
    next(pictures)
    start = time.perf_counter()
    next(pictures)
    return time.perf_counter() - start


def make_film(path: Path, frames: Sequence[Frame], rate: float, look: Look) -> None:
    """Draw frames and write them as a film.

    Args:
        path: film to write, ending in .mp4.
        frames: frames to draw.
        rate: frames per second.
        look: camera, size and content.

    Raises:
        ConfigurationError: the path does not end in .mp4, or the size is odd.
        RenderingError: OpenGL does not work.
    """
    from aslip.show.render import render_frames

    pictures = render_frames(
        np.stack([frame.qpos for frame in frames]),
        camera=look.camera,
        width=look.width,
        height=look.height,
        ghosts=[frame.ghost for frame in frames] if look.ghost else None,
    )
    shown = tqdm(pictures, total=len(frames), unit="frame")
    write_video(path, shown, rate, (look.width, look.height))


def write_video(
    path: Path, frames: Iterable[np.ndarray], rate: float, size: tuple[int, int]
) -> None:
    """Write pictures as an H.264 film; a failure leaves no file.

    Args:
        path: film to write, ending in .mp4.
        frames: pictures (height, width, 3), uint8.
        rate: frames per second.
        size: width and height [pixels], even numbers.

    Raises:
        ConfigurationError: the path does not end in .mp4, the size is odd, or imageio-ffmpeg is not
            installed.
    """
    if path.suffix != ".mp4":
        raise ConfigurationError(f"the name of a film must end in .mp4, got {str(path)!r}")
    if any(length % 2 for length in size):
        raise ConfigurationError(f"width and height of a film must be even, got {size}")
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ConfigurationError("films need imageio-ffmpeg: pip install 'aslip[train]'") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.part.mp4")
    writer = imageio_ffmpeg.write_frames(
        str(temporary),
        size,
        fps=rate,  # pyright: ignore[reportArgumentType]
        codec="libx264",
        # not `quality`, a fixed quantiser, which writes six times as much
        quality=None,  # pyright: ignore[reportArgumentType]
        output_params=["-crf", "28"],
        macro_block_size=2,
    )
    try:
        writer.send(None)
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
        writer.close()
        os.replace(temporary, path)
    finally:
        writer.close()
        temporary.unlink(missing_ok=True)
