"""Pictures of the robot, alone or with the reduced-order model that guides it.

MuJoCo draws through OpenGL; `aslip.robot.opengl` chooses how.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np

from aslip.errors import ConfigurationError, ShapeError
from aslip.robot.model import APPEARANCE_GROUP, load_model
from aslip.robot.opengl import make_renderer
from aslip.show.ghost import (
    BODY_COLOR,
    BODY_RADIUS,
    FOOT_RADIUS,
    LEG_COLORS,
    SWING_FADE,
    WIRE_RADIUS,
    Ghost,
)
from aslip.show.palette import ROBOT, rgba

# group of the collision geoms in the robot's MJCF
_COLLISION_GROUP = 3

_COIL_RADIUS = 0.027
_COILS = 7
_SEGMENTS_PER_COIL = 12
# share of a leg, at each end, that is drawn as a straight rod
_ROD_SHARE = 0.2

_ARROW_LENGTH, _ARROW_RADIUS = 0.6, 0.02
# height of lines above the floor [m]
_LINE_HEIGHT = 0.005


def render_frames(
    qpos: np.ndarray,
    *,
    camera: str | mujoco.MjvCamera = "side",
    width: int = 640,
    height: int = 480,
    model: mujoco.MjModel | None = None,
    add: Callable[[mujoco.MjvScene, int], object] | None = None,
    robot: bool = True,
    supersampling: int = 1,
) -> Iterator[np.ndarray]:
    """Draw a picture of the robot for each configuration; the cameras follow it.

    Args:
        qpos: (n, nq) configurations, MuJoCo's conventions.
        camera: camera of the model, or one of its own; shipped robots have "side", "follow" and
            "front".
        width: width of a picture [pixels].
        height: height of a picture [pixels].
        model: compiled model; `aslip.robot.model.load_model()` by default.
        add: function that adds shapes to the scene of the picture of an index, such as `add_ghost`.
        robot: draw the robot itself.
        supersampling: side of the squares of pixels averaged into one, for smooth edges.

    Returns:
        Iterator over pictures (height, width, 3) uint8, red, green, blue; each is drawn when it is
        taken.

    Raises:
        ShapeError: `qpos` does not fit the model.
        ConfigurationError: a size is less than 1, or exceeds the model's off-screen buffer.
        ValueError: the model has no such camera; raised by the first picture.
        RenderingError: OpenGL does not work.
    """
    drawn: mujoco.MjModel = load_model() if model is None else model
    qpos = np.atleast_2d(np.asarray(qpos, dtype=np.float64))
    if qpos.ndim != 2 or qpos.shape[1] != drawn.nq:
        raise ShapeError(f"qpos must be (n, {drawn.nq}), got {qpos.shape}")
    limits = drawn.vis.global_.offwidth, drawn.vis.global_.offheight
    sizes = width * supersampling, height * supersampling
    if min(sizes) < 1 or sizes[0] > limits[0] or sizes[1] > limits[1]:
        raise ConfigurationError(f"pictures have 1 x 1 to {limits} pixels, got {sizes}")
    return _frames(drawn, qpos, camera, (width, height, supersampling), add, robot)


def _frames(
    model: mujoco.MjModel,
    qpos: np.ndarray,
    camera: str | mujoco.MjvCamera,
    sizes: tuple[int, int, int],
    add: Callable[[mujoco.MjvScene, int], object] | None,
    robot: bool,
) -> Iterator[np.ndarray]:
    width, height, supersampling = sizes
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    option.geomgroup[_COLLISION_GROUP] = False
    option.geomgroup[APPEARANCE_GROUP] = robot
    option.sitegroup[:] = False
    with make_renderer(model, width * supersampling, height * supersampling) as renderer:
        for i, configuration in enumerate(qpos):
            data.qpos[:] = configuration
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera, option)
            if add is not None:
                add(renderer.scene, i)
            yield _shrink(renderer.render(), supersampling)


def add_ghost(scene: mujoco.MjvScene, ghost: Ghost) -> None:
    """Add a reduced-order model to a scene: a sphere and two coil springs with round feet.

    A leg in stance has its full colour (left blue, right red); in swing it is pale.

    Args:
        scene: scene before drawing; the next `update_scene` of a renderer clears it.
        ghost: positions of body and feet.
    """
    body = np.asarray(ghost.body, dtype=np.float64)
    _add_sphere(scene, body, BODY_RADIUS, np.array(BODY_COLOR))
    for foot, stance, color in (
        (ghost.left, ghost.left_stance, LEG_COLORS["left"]),
        (ghost.right, ghost.right_stance, LEG_COLORS["right"]),
    ):
        shade = np.array(color)
        if not stance:
            shade += SWING_FADE * (1.0 - shade)
        path = spring_path(body, np.asarray(foot, dtype=np.float64))
        for ends in itertools.pairwise(path):
            _connect(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, WIRE_RADIUS, ends, shade)
        _add_sphere(scene, path[-1], FOOT_RADIUS, shade)


def add_push(scene: mujoco.MjvScene, place: np.ndarray, force: np.ndarray) -> None:
    """Add an arrow that ends where a force pushes; none without a force.

    Args:
        scene: scene before drawing.
        place: (3,) [m].
        force: (3,) [N].
    """
    if size := float(np.linalg.norm(force)):
        start = place - _ARROW_LENGTH * force / size
        _connect(scene, mujoco.mjtGeom.mjGEOM_ARROW, _ARROW_RADIUS, (start, place), rgba(ROBOT))


def add_line(
    scene: mujoco.MjvScene, points: np.ndarray, width: float, color: Sequence[float]
) -> None:
    """Add a line on the floor.

    Args:
        scene: scene before drawing.
        points: (n, 2) corners [m].
        width: width [pixels].
        color: red, green, blue and opacity.
    """
    raised = np.column_stack([points, np.full(len(points), _LINE_HEIGHT)])
    for ends in itertools.pairwise(raised):
        _connect(scene, mujoco.mjtGeom.mjGEOM_LINE, width, ends, color)


def spring_path(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Corners of a coil spring between two points, with a straight rod at each end.

    The number of coils is fixed, so that a shorter leg looks compressed.

    Args:
        start: (3,) [m].
        end: (3,) [m].

    Returns:
        (k, 3) points from `start` to `end` [m].
    """
    axis = end - start
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        return np.stack([start, end])
    # two normals to the leg; a leg that walks forward is never parallel to the world's y axis
    first = np.cross(axis / length, [0.0, 1.0, 0.0])
    if np.linalg.norm(first) < 1e-6:
        first = np.array([1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis / length, first)
    turn = np.linspace(0.0, 2 * np.pi * _COILS, _COILS * _SEGMENTS_PER_COIL + 1)[:, None]
    along = np.linspace(_ROD_SHARE, 1.0 - _ROD_SHARE, len(turn))[:, None]
    coil = start + along * axis
    coil += _COIL_RADIUS * (np.cos(turn) * first + np.sin(turn) * second)
    rods = start + np.array([[0.0], [_ROD_SHARE], [1.0 - _ROD_SHARE], [1.0]]) * axis
    return np.concatenate([rods[:2], coil, rods[2:]])


def _shrink(image: np.ndarray, factor: int) -> np.ndarray:
    """Average an image over squares of pixels."""
    if factor == 1:
        return image
    height, width = image.shape[0] // factor, image.shape[1] // factor
    blocks = image.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    return np.rint(blocks).astype(np.uint8)


def _add_sphere(
    scene: mujoco.MjvScene, center: np.ndarray, radius: float, color: np.ndarray
) -> None:
    _next_geom(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, radius), center, color)


def _connect(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    width: float,
    ends: tuple[np.ndarray, np.ndarray],
    color: Sequence[float] | np.ndarray,
) -> None:
    geom = _next_geom(scene, kind, np.zeros(3), np.zeros(3), np.asarray(color))
    mujoco.mjv_connector(geom, kind, width, *ends)


def _next_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: np.ndarray,
    position: np.ndarray,
    color: np.ndarray,
) -> mujoco.MjvGeom:
    if scene.ngeom >= scene.maxgeom:
        raise ConfigurationError(f"the scene is full: it holds {scene.maxgeom} geoms")
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, position, np.eye(3).ravel(), color.astype(np.float32))
    # geoms of mjv_initGeom are decoration, which casts no shadow
    geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC
    scene.ngeom += 1
    return geom
