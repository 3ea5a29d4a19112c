"""Files that ship with the package, found from a checkout and from an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

from aslip.errors import AssetError

# a wheel carries the assets inside the package, a checkout beside it
_ROOTS = (Path(__file__).parent / "assets", Path(__file__).parent.parent / "assets")


def asset_path(name: str) -> Path:
    """Path of a shipped file.

    Args:
        name: path below `assets/`, such as `"cassie.xml"`.

    Raises:
        AssetError: no such file; the message lists the files there are.
    """
    for root in _ROOTS:
        if (root / name).exists():
            return root / name
    found = sorted(
        str(path.relative_to(root)) for root in _ROOTS for path in root.rglob("*") if path.is_file()
    )
    raise AssetError(f"no asset {name!r}; the package ships {found}")
