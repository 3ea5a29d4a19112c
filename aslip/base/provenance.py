"""Provenance of files: command, commit, versions; and the memory of this process."""

from __future__ import annotations

import contextlib
import math
import platform
import re
import subprocess
import sys
from collections.abc import Iterable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from aslip.base.command_line import this_command

try:
    import resource
except ImportError:  # not on Windows
    resource = None

# files that no program reads; records of results in them are outputs of the compared programs
_DOCUMENTS = [":(exclude,top)docs", ":(exclude,top)*.md"]

# packages whose versions may change a result
_NAMED_PACKAGES = ("aslip", "mujoco", "numpy", "tensordict", "torch", "torchrl")


def provenance() -> dict[str, Any]:
    """Provenance of a file: command line, commit of the checkout if there is one, and versions."""
    return {
        "command": this_command(),
        "commit": commit(),
        "versions": versions(_NAMED_PACKAGES),
    }


def made_by(packages: Iterable[str]) -> dict[str, str]:
    """Provenance of a library of gaits, as text: command, commit and versions of packages."""
    about = {"command": this_command(), "commit": commit(), **versions(packages)}
    return {name: value or "" for name, value in about.items()}


def versions(packages: Iterable[str]) -> dict[str, str | None]:
    """Versions of Python and of packages."""
    return {"python": platform.python_version(), **{name: _version(name) for name in packages}}


def _version(package: str) -> str | None:
    """Version of an installed package; None if it is a checkout on the path."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def commit() -> str | None:
    """Commit of the checkout, with a plus if files other than documents have changed since.

    None without a checkout.
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


def peak_memory() -> float:
    """Peak memory of this process [GiB]; NaN where the system does not report it."""
    # on Linux, getrusage includes the peak of the process from which this one was forked
    with contextlib.suppress(OSError):
        status = Path("/proc/self/status").read_text()
        if peak := re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE):
            return int(peak[1]) / 2**20
    if resource is None:
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # bytes on macOS, kibibytes elsewhere
    return peak / 2**30 if sys.platform == "darwin" else peak / 2**20
