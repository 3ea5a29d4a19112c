"""Films of a walk: draw frames, with command and time, and write them to an MP4 or WebP file.

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
from aslip.library.footholds import yaw_rotation
from aslip.policy import add_memory
from aslip.robot import CASSIE
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost
from aslip.show.model_place import BESIDE_STEPS, RomPlace
from aslip.show.palette import MODEL, ROBOT, rgba
from aslip.sim.course import Course
from aslip.sim.stones import course_model
from aslip.walking import reset_walks, walk
from aslip.walking.record import commands_kept

with extras():
    from PIL import Image, ImageDraw, ImageFont
    from tqdm import tqdm

# policy steps of a film of an evaluation, and between its frames
_FILM_STEPS, _FILM_EVERY = 100, 3
# distance of the model from the robot in the picture [m], and factor of the camera's distance
_BESIDE, _FARTHER = 1.05, 1.15
# lines on the floor [pixels]; height of the caption over that of the picture
_LINE_WIDTH, _CAPTION = 6.0, 0.04
_CODECS = {
    # not `quality`, a fixed quantiser, which writes six times as much
    ".mp4": ("libx264", ["-crf", "28"]),
    ".webp": ("libwebp_anim", ["-loop", "0", "-quality", "60"]),
}


@dataclass(frozen=True)
class Frame:
    """One instant to draw."""

    qpos: np.ndarray
    """(nq,) configuration of the robot."""
    ghost: Ghost
    """Reduced-order model."""
    push: np.ndarray
    """(3,) force on the pelvis [N, world]."""
    caption: str
    """Time and command."""

    @classmethod
    def of(
        cls, td: TensorDictBase, time: float, push: torch.Tensor | None = None, robot: int = 0
    ) -> Frame:
        """Frame of one of the robots of a tensordict.

        Args:
            td: entries `command`, `("reference", ...)` and `("truth", ...)`; `stand` if there is.
            time: time since the start of the walk [s].
            push: (n, 3) force on each pelvis [N, world].
            robot: index of the robot.
        """
        qpos = cast("torch.Tensor", td["truth", "qpos"])[robot].numpy().copy()
        force = np.zeros(3) if push is None else push[robot].double().numpy()
        stand = bool(cast("torch.Tensor", td["stand"])[robot]) if "stand" in td else False
        command = cast("torch.Tensor", td["command"])[robot].tolist()
        return cls(qpos, Ghost.of(td, robot), force, _caption(time, command, stand, force))


@dataclass(frozen=True)
class Look:
    """Camera, size and content of a film."""

    camera: str | mujoco.MjvCamera
    """Camera of the model, side, follow or front; or one that stands in the world."""
    width: int
    """Width [pixels]."""
    height: int
    """Height [pixels]."""
    rom: RomPlace = "beside"
    """Place of the reduced-order model: to the left of the robot in the picture, in its place, or
    hidden."""
    path: np.ndarray | None = None
    """(n, 2) path on the floor to draw, with the robot's own up to each frame [m]."""
    course: Course | None = None
    """Stones to draw."""

    def model(self) -> mujoco.MjModel:
        """Model of robot and stones."""
        return load_model() if self.course is None else course_model(self.course)


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
        path: film to write, ending in .mp4 or .webp.
        frames: frames to draw.
        rate: frames per second.
        look: camera, size and content.

    Raises:
        ConfigurationError: the path has another ending, or the size is odd.
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

    model, offset = look.model(), np.zeros(3)
    if look.rom == "beside" and isinstance(look.camera, str):
        model, offset = camera_beside(look.camera, model)
    pictures = render_frames(
        np.stack([frame.qpos for frame in frames]),
        camera=look.camera,
        width=look.width,
        height=look.height,
        model=model,
        add=lambda scene, i: _add_shapes(scene, frames[: i + 1], look, offset),
    )
    return (_write_caption(*pair) for pair in zip(pictures, frames, strict=True))


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
                time = (i + 1) * CASSIE.policy_period
                frames.append(Frame.of(td["next"], time, robot=robot))
            if td["next", "terminated"][robot]:
                break
    look, rate = Look("follow", 320, 240), 1 / (_FILM_EVERY * CASSIE.policy_period)
    pictures = np.stack([*draw(frames, look)])
    write_video(path, pictures, rate, (look.width, look.height))
    return pictures, rate


def _add_shapes(
    scene: mujoco.MjvScene, frames: Sequence[Frame], look: Look, offset: np.ndarray
) -> None:
    """Add model, push and paths of the last of the frames."""
    from aslip.show.render import add_ghost, add_line, add_push

    frame = frames[-1]
    if not isinstance(look.camera, str):
        offset = yaw_rotation(frame.qpos[CASSIE.indices.pelvis_orientation]) @ BESIDE_STEPS
        # from afar a shadow is a few pixels, and takes most of the time
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
    if look.rom != "hidden":
        add_ghost(scene, frame.ghost.moved(offset))
    add_push(scene, frame.qpos[:3], frame.push)
    if look.path is not None:
        add_line(scene, look.path, _LINE_WIDTH / 2, rgba(MODEL))
        walked = np.stack([each.qpos[:2] for each in frames])
        add_line(scene, walked, _LINE_WIDTH, rgba(ROBOT))


def _caption(time: float, command: Sequence[float], stand: bool, force: np.ndarray) -> str:
    names = ("forward {:.2f} m/s", "sideways {:.2f} m/s", "turn {:.2f} rad/s")
    parts = [name.format(value) for name, value in zip(names, command, strict=False)]
    if stand:
        parts = ["stand"]
    if force.any():
        parts.append(f"push {np.linalg.norm(force):.0f} N")
    return f"{time:5.2f} s    " + "   ".join(parts)


def _write_caption(picture: np.ndarray, frame: Frame) -> np.ndarray:
    """Picture with time and command in its upper left corner."""
    image = Image.fromarray(picture)
    size = max(round(_CAPTION * len(picture)), 8)
    font = ImageFont.load_default(size)
    ImageDraw.Draw(image).text((size, size / 2), frame.caption, fill=MODEL, font=font)
    return np.asarray(image)


def camera_beside(camera: str, model: mujoco.MjModel) -> tuple[mujoco.MjModel, np.ndarray]:
    """Model whose camera shows the robot on the right, and the offset (3,) of what is left [m].

    Args:
        camera: camera that follows the robot without turning.
        model: model with that camera, which is copied.
    """
    model = copy.deepcopy(model)
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    to_right = model.cam_mat0[index].reshape(3, 3)[:, 0].copy()
    to_right[2] = 0.0
    offset = -_BESIDE * to_right / np.linalg.norm(to_right)
    model.cam_poscom0[index] = _FARTHER * model.cam_poscom0[index] + offset / 2
    return model, offset


def write_video(
    path: Path, frames: Iterable[np.ndarray], rate: float, size: tuple[int, int]
) -> None:
    """Write pictures as an H.264 or WebP film; a failure leaves no file.

    Args:
        path: film to write, ending in .mp4 or .webp.
        frames: pictures (height, width, 3), uint8.
        rate: frames per second.
        size: width and height [pixels], even numbers.

    Raises:
        ConfigurationError: the path has another ending, or the size is odd.
        MissingExtraError: imageio-ffmpeg is not installed.
    """
    path = user_path(path)
    if path.suffix not in _CODECS:
        raise ConfigurationError(f"the name of a film must end in .mp4 or .webp, got {str(path)!r}")
    if any(length % 2 for length in size):
        raise ConfigurationError(f"width and height of a film must be even, got {size}")
    with extras():
        import imageio_ffmpeg
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.part{path.suffix}")
    codec, options = _CODECS[path.suffix]
    writer = imageio_ffmpeg.write_frames(
        str(temporary),
        size,
        fps=rate,  # pyright: ignore[reportArgumentType]
        codec=codec,
        quality=None,  # pyright: ignore[reportArgumentType]
        output_params=options,
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
