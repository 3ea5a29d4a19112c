"""Files that ship with the package, found from a checkout and from an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

from aslip.errors import AssetError

# a wheel carries the assets inside the package, a checkout beside it; a stray pyproject.toml beside
# an installed package says nothing
_PACKAGE = Path(__file__).parents[1]
_INSTALLED = _PACKAGE / "_assets"
_ROOT = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parent / "assets"


def asset_path(name: str) -> Path:
    """Path of a shipped file.

    Args:
        name: path below `assets/`, such as `"cassie.xml"`.

    Raises:
        AssetError: no such file; the message lists the files there are.
    """
    if (_ROOT / name).is_file():
        return _ROOT / name
    found = sorted(str(path.relative_to(_ROOT)) for path in _ROOT.rglob("*") if path.is_file())
    raise AssetError(f"no asset {name!r}; the package ships {found}")
