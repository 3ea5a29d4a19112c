"""Imports on first use, and imports of libraries that not everybody installs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import lazy_loader

from aslip.errors import MissingExtraError

_EXTRAS = {
    "gymnasium": "gym",
    "imageio_ffmpeg": "train",
    "matplotlib": "train",
    "onnx": "export",
    "onnxruntime": "control",
    "onnxscript": "export",
    "pydrake": "drake",
    "ray": "ray",
    "rerun": "dev",
    "tensorboard": "train",
    "tqdm": "train",
    "tyro": "train",
    "viser": "live",
}


@contextmanager
def extras() -> Iterator[None]:
    """Let the import of a missing library name the extra that installs it.

    Raises:
        MissingExtraError: a library of an extra is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in _EXTRAS:
            raise
        raise MissingExtraError(
            f"{name} is not installed: pip install 'aslip[{_EXTRAS[name]}]'"
        ) from error


def attach(
    package: str, names: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package that imports its modules on first use.

    Args:
        package: name of the package.
        names: module -> names that the package has from it.

    Raises:
        ImportError: from `__getattr__`: a module raised an `AttributeError` on import. Python would
            hide it behind "cannot import name".
        MissingExtraError: from `__getattr__`: a library of an extra is not installed.
    """
    load, list_names, _ = lazy_loader.attach(package, submod_attrs=names)
    homes = {name: module for module, own in names.items() for name in own}

    def get(name: str) -> Any:
        if name not in homes:
            known = list_names()
            raise AttributeError(f"module {package!r} has no attribute {name!r}; there are {known}")
        try:
            with extras():
                return load(name)
        except AttributeError as error:
            raise ImportError(
                f"{package}.{homes[name]} cannot be imported: AttributeError: {error}"
            ) from error

    return get, list_names
