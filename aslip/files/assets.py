"""Files that ship with the package, in a checkout or an installed wheel."""

from __future__ import annotations

from pathlib import Path

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
