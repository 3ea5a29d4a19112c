"""Films: frames to an MP4 file."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from aslip.errors import ConfigurationError


def write_video(
    path: Path, frames: Iterable[np.ndarray], rate: float, size: tuple[int, int]
) -> None:
    """Write a film (H.264), as a whole or not at all.

    Args:
        path: of the film, ending in .mp4.
        frames: (height, width, 3) uint8 each.
        rate: frames a second.
        size: width and height [pixels], even numbers.

    Raises:
        ConfigurationError: another ending or size, or imageio-ffmpeg is not installed.
    """
    if path.suffix != ".mp4":
        raise ConfigurationError(f"a film's name ends in .mp4, got {str(path)!r}")
    if any(length % 2 for length in size):
        raise ConfigurationError(f"a film's width and height must be even, got {size}")
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
        quality=8,
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
