"""OpenGL for pictures: the first of EGL, OSMesa and a window that works.

The environment variable MUJOCO_GL, set before Python starts, chooses one: "egl", "osmesa" or
"glfw". A renderer belongs to the thread that made it.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import importlib
import os
import subprocess
import sys
import warnings
import weakref
from collections.abc import Iterator
from typing import Any

import mujoco

from aslip.base.imports import LIBRARIES, NO_OPENGL, loads, mujoco_gl_problem
from aslip.errors import RenderingError

_HINT = (
    "install Mesa's EGL (Debian: libegl1) or OSMesa (libosmesa6), or use a display; MUJOCO_GL=egl,"
    " MUJOCO_GL=osmesa or MUJOCO_GL=glfw chooses one before Python starts"
)

_open: weakref.WeakSet[mujoco.Renderer] = weakref.WeakSet()
_fatal = ""


def make_renderer(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    """Renderer of pictures of one size [pixels]; `close` frees it.

    Raises:
        RenderingError: OpenGL does not work, or not with the backend in MUJOCO_GL.
    """
    global _fatal
    context, problem = _working_context()
    if problem or _fatal:
        raise RenderingError(f"no pictures: {problem or _fatal}; {_HINT}")
    try:
        with _buffer(model, width, height):
            importlib.import_module("mujoco.rendering.classic.gl_context").GLContext = context
            renderer = mujoco.Renderer(model, height, width)
    except Exception as error:  # each backend raises its own error
        if isinstance(error, mujoco.FatalError):
            # the next attempt would abort the process
            _fatal = _line(error)
        raise RenderingError(f"no pictures: {_line(error)}; {_HINT}") from error
    _open.add(renderer)
    return renderer


@functools.cache
def _working_context() -> tuple[Any, str]:
    """Class of OpenGL contexts that works here, or a text that says why none does."""
    wanted = os.environ.get("MUJOCO_GL", "").strip().lower()
    if mujoco_gl_problem() or wanted in NO_OPENGL:
        return None, mujoco_gl_problem() or f"MUJOCO_GL is {wanted!r}"
    if sys.platform != "linux":
        return mujoco.GLContext, ""
    name = wanted if wanted in ("egl", "osmesa") else "glfw" if wanted else _first_backend()
    try:
        context = _context_class(name)
    except Exception as error:  # each backend raises its own error
        return None, f"{'MUJOCO_GL = ' if wanted else ''}{name} does not work ({_line(error)})"
    # after EGL's own function, hence called before it: no errors at exit
    atexit.register(_close_all)
    return context, ""


def _first_backend() -> str:
    """First of EGL, OSMesa and a window that works here."""
    others = ["osmesa"] if loads(LIBRARIES["osmesa"]) else []
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        others.append("glfw")
    # in another process: after EGL, MuJoCo could not use another one in this
    trial = "from mujoco.egl import GLContext; GLContext(8, 8).make_current()"
    if others and subprocess.run([sys.executable, "-c", trial], capture_output=True).returncode:
        return others[0]
    return "egl"


def _context_class(name: str) -> type:
    """Class of a backend's contexts, of which one could be made."""
    if name == "glfw":
        import glfw

        with warnings.catch_warnings(record=True) as reasons:
            warnings.simplefilter("always")
            if not glfw.init():
                raise RuntimeError("; ".join(str(reason.message) for reason in reasons))
    elif not loads(LIBRARIES[name]):
        raise RuntimeError(f"{LIBRARIES[name]} is not installed")
    context_class = importlib.import_module(f"mujoco.{name}").GLContext
    context = context_class(64, 64)
    try:
        if not context._context:
            raise RuntimeError("no context")
        context.make_current()
    finally:
        context.free()
    return context_class


def _close_all() -> None:
    for renderer in _open:
        renderer.close()


def _line(error: Exception) -> str:
    """Text of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


@contextlib.contextmanager
def _buffer(model: mujoco.MjModel, width: int, height: int) -> Iterator[None]:
    """Limit buffer, shadow map and facets to a picture's size, for speed in software rendering."""
    limits, quality = model.vis.global_, model.vis.quality
    size = max(width, height)
    less = (
        (limits, "offwidth", width),
        (limits, "offheight", height),
        (quality, "shadowsize", 8 * size),
        (quality, "numslices", max(size // 10, 16)),
        (quality, "numstacks", max(size // 20, 8)),
    )
    whole = [getattr(settings, name) for settings, name, _ in less]
    for (settings, name, most), value in zip(less, whole, strict=True):
        setattr(settings, name, min(most, value))
    try:
        yield
    finally:
        for (settings, name, _), value in zip(less, whole, strict=True):
            setattr(settings, name, value)
