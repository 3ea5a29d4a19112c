"""Imports on first use, of libraries that not everybody has, and of MuJoCo."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import lazy_loader

from aslip.errors import MissingExtraError

# library -> extra that installs it, or why the package is installed without it
_EXTRAS = {
    "dm_control": "its labmaze has wheels for Python 3.11 and 3.12 only",
    "gymnasium": "gym",
    "h5py": "tables",
    "huggingface_hub": "hub",
    "imageio_ffmpeg": "train",
    "matplotlib": "train",
    "mlflow": "mlflow",
    "mujoco_warp": "gpu",
    "omegaconf": "mlflow",
    "onnx": "control",
    "onnxruntime": "control",
    "onnxscript": "export",
    "pandas": "tables",
    "pinocchio": "pip install 'pin>=4.1,<5'; on Windows, conda install -c conda-forge pinocchio",
    "pyarrow": "tables",
    "pydrake": "drake",
    "ray": "ray",
    "rerun": "dev",
    "tensorboard": "train",
    "tqdm": "train",
    "tyro": "train",
    "viser": "live",
    "wandb": "wandb",
    "warp": "gpu",
}


@contextmanager
def extras() -> Iterator[None]:
    """Let the import of a missing library name the extra that installs it, or why it is missing.

    Raises:
        MissingExtraError: a library of an extra, or one that lacks wheels here, is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in _EXTRAS:
            raise
        known = _EXTRAS[name]
        advice = known if " " in known else f"pip install 'aslip[{known}]'"
        raise MissingExtraError(f"{name} is not installed: {advice}") from error


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package that imports its modules on first use.

    Its names, and the module of each, stand in the stub `__init__.pyi` beside its `__init__.py`.

    Args:
        package: `__name__` of the package.
        file: its `__file__`.

    Raises:
        ValueError: there is no stub.
        ImportError: from `__getattr__`: a module raised an `AttributeError` on import. Python would
            hide it behind "cannot import name".
        MissingExtraError: from `__getattr__`: a library of an extra is not installed.
    """
    load, _, names = lazy_loader.attach_stub(package, file)

    def get(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; there are {names}")
        try:
            with extras():
                return load(name)
        except AttributeError as error:
            raise ImportError(
                f"{package}.{name} cannot be imported: AttributeError: {error}"
            ) from error

    return get, lambda: sorted({*vars(sys.modules[package]), *names}), names


LIBRARIES = {"egl": "libEGL", "osmesa": "libOSMesa"}
"""Value of MUJOCO_GL -> shared library that it needs."""
NO_OPENGL = ("disable", "disabled", "off", "false", "0")
"""Values of MUJOCO_GL with which MuJoCo loads no OpenGL."""
_WINDOW = ("glfw", "enable", "enabled", "on", "true", "1")


@functools.cache
def mujoco_gl_problem() -> str:
    """Why the environment variable MUJOCO_GL does not work here; empty if nothing is known.

    MuJoCo and dm_control would raise errors on import, which do not name the variable. With a
    warning, they are imported without OpenGL instead, of which only those who draw take notice.
    """
    value = os.environ.get("MUJOCO_GL", "")
    # GLX is the window's; dm_control knows neither this name nor capitals
    name = value.strip().lower().replace("glx", "glfw")
    if not name or sys.platform != "linux" or "mujoco" in sys.modules:
        return ""
    os.environ["MUJOCO_GL"] = name
    if name not in (*LIBRARIES, *_WINDOW, *NO_OPENGL):
        problem = "must be egl, osmesa, glfw or disable"
    elif name in LIBRARIES and not loads(LIBRARIES[name]):
        problem = f"needs {LIBRARIES[name]}, which is not installed"
    else:
        return ""
    problem = f"the environment variable MUJOCO_GL = {value!r} {problem}"
    import logging

    logging.getLogger(__name__).warning("no pictures: %s", problem)
    os.environ["MUJOCO_GL"] = "disable"
    return problem


def loads(library: str) -> bool:
    """Check that a shared library can be loaded, by the names that PyOpenGL tries."""
    import ctypes

    for suffix in ("", *(f".{version}" for version in range(10))):
        with suppress(OSError):
            ctypes.CDLL(f"{library}.so{suffix}")
            return True
    return False
