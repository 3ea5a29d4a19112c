"""Films of a walk: draw frames and write them to an MP4 file.

OpenGL is loaded on the first drawing, not on import.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.envs import StackEnv
from aslip.errors import ConfigurationError
from aslip.policy import add_memory
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost
from aslip.show.model_place import RomPlace
from aslip.walking import reset_walks, walk
from aslip.walking.record import commands_kept

with extras():
    from tqdm import tqdm

# policy steps of a film of an evaluation, and between its frames
_FILM_STEPS, _FILM_EVERY = 100, 3
# distance of the model from the robot in the picture [m], and factor of the camera's distance
_BESIDE, _FARTHER = 1.05, 1.15


@dataclass(frozen=True)
class Frame:
    """One instant to draw."""

    qpos: np.ndarray
    """(nq,) configuration of the robot."""
    ghost: Ghost
    """Reduced-order model."""

    @classmethod
    def of(cls, td: TensorDictBase, robot: int = 0) -> Frame:
        """Frame of one of the robots of a tensordict."""
        qpos = cast("torch.Tensor", td["truth", "qpos"])
        return cls(qpos[robot].numpy().copy(), Ghost.of(td, robot))


@dataclass(frozen=True)
class Look:
    """Camera, size and content of a film."""

    camera: str
    """Camera of the model: side, follow or front."""
    width: int
    """Width [pixels]."""
    height: int
    """Height [pixels]."""
    rom: RomPlace = "beside"
    """Place of the reduced-order model: to the left of the robot in the picture, in its place, or
    hidden."""


def check_look(look: Look) -> None:
    """Draw a frame, so that a film that cannot be drawn fails before the walk.

    Raises:
        RenderingError: OpenGL does not work.
        ConfigurationError: there is no such camera, or the size is out of range.
    """
    from aslip.show.render import render_frames

    qpos = load_model().key("standing").qpos
    try:
        next(render_frames(qpos, camera=look.camera, width=look.width, height=look.height))
    except ValueError as error:  # MuJoCo's
        raise ConfigurationError(f"the film cannot be drawn: {error}") from error


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
    shown = tqdm(draw(frames, look), total=len(frames), unit="frame")
    write_video(path, shown, rate, (look.width, look.height))


def draw(frames: Sequence[Frame], look: Look) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) uint8 of frames, each drawn when it is taken.

    Raises:
        RenderingError: OpenGL does not work.
    """
    from aslip.show.render import render_frames

    model, offset = camera_beside(look.camera) if look.rom == "beside" else (None, np.zeros(3))
    return render_frames(
        np.stack([frame.qpos for frame in frames]),
        camera=look.camera,
        width=look.width,
        height=look.height,
        model=model,
        ghosts=None if look.rom == "hidden" else [f.ghost.moved(offset) for f in frames],
    )


def film_evaluation(
    policy: TensorDictModuleBase, env: StackEnv, commands: Sequence[Any], path: Path
) -> tuple[np.ndarray, float]:
    """Film three seconds at the middle one of an evaluation's commands, until a fall.

    It is small and has every third policy step, because software takes 0.2 to 0.4 s to draw one.

    Args:
        policy: the policy.
        env: environment with one robot for each command; it is reset.
        commands: the commands, see `aslip.walking.evaluate`.
        path: film to write, ending in .mp4.

    Returns:
        The pictures (n, height, width, 3) uint8, and their number per second.

    Raises:
        RenderingError: OpenGL does not work.
    """
    robot, frames = len(commands) // 2, []
    with commands_kept(env):
        start = reset_walks(add_memory(env, policy), np.asarray(commands, dtype=np.float32))
        for i, td in enumerate(walk(policy, env, start, _FILM_STEPS)):
            if i % _FILM_EVERY == 0:
                frames.append(Frame.of(td["next"], robot))
            if td["next", "terminated"][robot]:
                break
    look, rate = Look("follow", 320, 240), 1 / (_FILM_EVERY * CASSIE.policy_period)
    pictures = np.stack([*draw(frames, look)])
    write_video(path, pictures, rate, (look.width, look.height))
    return pictures, rate


def camera_beside(camera: str) -> tuple[mujoco.MjModel, np.ndarray]:
    """Model whose camera shows the robot on the right, and the offset (3,) of what is left [m].

    Args:
        camera: camera that follows the robot without turning.
    """
    model = copy.deepcopy(load_model())
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    to_right = model.cam_mat0[index].reshape(3, 3)[:, 0].copy()
    to_right[2] = 0.0
    offset = -_BESIDE * to_right / np.linalg.norm(to_right)
    model.cam_poscom0[index] = _FARTHER * model.cam_poscom0[index] + offset / 2
    return model, offset


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
        ConfigurationError: the path does not end in .mp4, or the size is odd.
        MissingExtraError: imageio-ffmpeg is not installed.
    """
    path = user_path(path)
    if path.suffix != ".mp4":
        raise ConfigurationError(f"the name of a film must end in .mp4, got {str(path)!r}")
    if any(length % 2 for length in size):
        raise ConfigurationError(f"width and height of a film must be even, got {size}")
    with extras():
        import imageio_ffmpeg
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
