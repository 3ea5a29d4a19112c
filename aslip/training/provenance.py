"""What made a file: to be kept with it."""

from __future__ import annotations

import platform
import shlex
import subprocess
import sys
from collections.abc import Iterable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# what no program reads; a record of results among it is written by those that are compared
_DOCUMENTS = [":(exclude,top)docs", ":(exclude,top)*.md"]

# whose versions a result may depend on
_NAMED_PACKAGES = ("aslip", "mujoco", "numpy", "tensordict", "torch", "torchrl")


def provenance() -> dict[str, Any]:
    """What made a file: command line, commit of the checkout if there is one, and versions."""
    return {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "versions": versions(_NAMED_PACKAGES),
    }


def versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Of Python and of packages."""
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


def _version(package: str) -> str | None:
    """Of an installed package; None where a checkout is on the path instead."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def commit() -> str | None:
    """Commit that the package is of; None if not known.

    A plus follows if files, other than documents, have changed since.
    """
    checkout = Path(__file__).parents[2]
    if not (checkout / ".git").exists():
        return None
    git = partial(subprocess.run, cwd=checkout, capture_output=True, text=True, check=True)
    try:
        head = git(["git", "rev-parse", "--short=12", "HEAD"]).stdout.strip()
        status = ["git", "status", "--porcelain", "--untracked-files=no", "--", *_DOCUMENTS]
        changed = git(status).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return f"{head}+" if changed else head
