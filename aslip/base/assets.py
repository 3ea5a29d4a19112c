"""Paths of files that ship with the package, in a checkout or wheel, and that users name."""

from __future__ import annotations

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

from aslip.errors import AssetError

# a wheel has the assets inside the package, a checkout beside it
_PACKAGE = Path(__file__).parents[1]
_INSTALLED = _PACKAGE / "_assets"
_ROOT = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parent / "assets"


def asset_path(name: str) -> Path:
    """Path of a shipped file.

    Args:
        name: path below `assets/`, such as `"cassie.xml"`.

    Raises:
        AssetError: the file does not exist; the message lists the shipped files.
    """
    if (_ROOT / name).is_file():
        return _ROOT / name
    found = sorted(str(path.relative_to(_ROOT)) for path in _ROOT.rglob("*") if path.is_file())
    raise AssetError(f"no asset {name!r}; the package ships {found}")


def user_path(path: str | Path) -> Path:
    """Path that a user names; it may begin with `~`, the home folder, as in a shell."""
    return Path(os.path.expanduser(path))


class UserPaths:
    """Base of dataclasses whose fields hold paths that a user names, see `user_path`."""

    def __post_init__(self) -> None:
        """Replace `~` at the beginning of paths."""
        settings: Any = self
        for field in fields(settings):
            if isinstance(value := getattr(self, field.name), Path):
                object.__setattr__(self, field.name, user_path(value))
