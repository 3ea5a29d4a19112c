"""Pictures: their size, content and errors."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from aslip.base import imports
from aslip.errors import RenderingError
from aslip.robot import opengl
from aslip.robot.model import load_model
from aslip.show.ghost import Ghost
from aslip.show.palette import ROBOT, rgba
from aslip.show.render import add_ghost, add_line, add_push, render_frames, spring_path

SIZE: dict[str, Any] = {"width": 96, "height": 72}


@pytest.fixture(scope="module")
def standing(model: mujoco.MjModel, pictures: None) -> np.ndarray:
    """(1, 35)."""
    return model.key("standing").qpos[None].copy()


def drawn(qpos: np.ndarray, **options: Any) -> np.ndarray:
    """(n, height, width, 3)."""
    return np.stack(list(render_frames(qpos, **options)))


def ghost(qpos: np.ndarray, **stance: bool) -> Ghost:
    x, y, z = qpos[0, :3]
    return Ghost(np.array([x, y, z]), np.array([x, 0.13, 0]), np.array([x, -0.13, 0]), **stance)


@pytest.mark.parametrize("camera", ["side", "follow", "front"])
def test_robot_is_in_the_middle_of_every_camera(model, standing, camera):
    frames = drawn(standing, camera=camera, model=model, **SIZE)
    empty = drawn(standing, camera=camera, model=model, robot=False, **SIZE)
    assert frames.shape == (1, 72, 96, 3)
    assert frames.dtype == np.uint8
    rows, columns = np.nonzero((frames[0].astype(int) - empty[0]).any(-1))
    assert 2 < rows.min() < 36 < rows.max() < 70
    assert columns.min() < 48 < columns.max()


def test_collision_geoms_and_sites_are_hidden(standing):
    garish = load_model()
    visible = drawn(standing, model=garish, **SIZE)
    for i in range(garish.ngeom):
        if garish.geom_group[i] == 3:
            garish.geom_rgba[i] = 1, 0, 1, 1
    garish.site_rgba[:] = 1, 0, 1, 1
    np.testing.assert_array_equal(drawn(standing, model=garish, **SIZE), visible)


def test_ghosts_are_drawn_and_show_stance(model, standing):
    alone = drawn(standing, model=model, robot=False, **SIZE)
    stance, swing = (
        drawn(standing, model=model, robot=False, add=lambda s, _, g=g: add_ghost(s, g), **SIZE)
        for g in (ghost(standing), ghost(standing, right_stance=False))
    )
    assert (stance != alone).any()
    assert (stance != swing).any()


def test_pushes_and_paths_are_drawn(model, standing):
    def orange(add) -> int:
        (picture,) = drawn(standing, model=model, robot=False, add=add, **SIZE)
        return int(((picture[..., 0] > 150) & (picture[..., 2] < 90)).sum())

    place, path = standing[0, :3], np.array([[-0.5, 0.0], [0.0, 0.3], [0.5, 0.0]])
    assert orange(lambda scene, _: add_push(scene, place, np.zeros(3))) == 0
    assert orange(lambda scene, _: add_push(scene, place, np.array([0, 60, 0]))) > 5
    assert orange(lambda scene, _: add_line(scene, path, 4.0, rgba(ROBOT))) > 20


@pytest.mark.parametrize("end", [[0.2, 0.1, 0.0], [0.0, 0.0, 0.1], [0.0, 1.0, 0.9]])
def test_spring_connects_body_and_foot_along_the_leg(end):
    start, end = np.array([0.0, 0.0, 0.9]), np.array(end)
    path = spring_path(start, end)
    np.testing.assert_allclose(path[[0, -1]], [start, end], atol=1e-12)
    axis = (end - start) / np.linalg.norm(end - start)
    off = path - start
    off -= (off @ axis)[:, None] * axis
    assert np.linalg.norm(off, axis=1).max() == pytest.approx(0.027, abs=1e-9)


def test_without_opengl_the_error_says_what_to_set():
    code = (
        "from aslip.robot.model import load_model\n"
        "from aslip.errors import RenderingError\n"
        "from aslip.robot.opengl import make_renderer\n"
        "for _ in range(4):\n"
        "    try:\n"
        "        make_renderer(load_model(visual=False), 8, 8)\n"
        "    except RenderingError as error:\n"
        "        print(error)\n"
    )
    environment = os.environ | {"MUJOCO_GL": "OSMsea "}
    for display in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(display, None)
    root = Path(__file__).parents[2]
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=root, capture_output=True, text=True
    )
    assert result.returncode == 0, result
    (line,) = set(result.stdout.splitlines())
    problem = "no pictures: the environment variable MUJOCO_GL = 'OSMsea ' must"
    assert line.startswith(problem)
    assert all(f"MUJOCO_GL={name}" in line for name in ("egl", "osmesa", "glfw"))
    assert result.stderr.startswith(problem)


def test_a_failure_of_opengl_is_not_tried_again(model, monkeypatch):
    """At the second, MuJoCo aborts the process."""
    calls = []

    def fail(*_):
        calls.append(1)
        raise mujoco.FatalError("gladLoadGL error")

    monkeypatch.setattr(mujoco, "Renderer", fail)
    monkeypatch.setattr(opengl, "_fatal", "")
    monkeypatch.setattr(opengl, "_working_context", lambda: (None, ""))
    for _ in range(2):
        with pytest.raises(RenderingError, match="FatalError: gladLoadGL error; install"):
            opengl.make_renderer(model, 8, 8)
    assert calls == [1]


@pytest.mark.parametrize(
    ("value", "loads", "left", "problem"),
    [
        ("osmesa", False, "disable", "MUJOCO_GL = 'osmesa' needs libOSMesa, which is not"),
        ("egl", False, "disable", "MUJOCO_GL = 'egl' needs libEGL"),
        (" EGL", True, "egl", ""),
        ("glx", False, "glfw", ""),
        ("off", False, "off", ""),
    ],
)
def test_a_library_that_is_missing_leaves_mujoco_without_opengl(
    value: str, loads: bool, left: str, problem: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(imports, "loads", lambda _: loads)
    monkeypatch.setenv("MUJOCO_GL", value)
    monkeypatch.delitem(sys.modules, "mujoco")
    assert problem in imports.mujoco_gl_problem.__wrapped__()
    assert os.environ["MUJOCO_GL"] == left
