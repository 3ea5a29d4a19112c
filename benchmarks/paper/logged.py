"""Logged walks, straight ahead."""

from __future__ import annotations

from pathlib import Path

from aslip.errors import ConfigurationError
from aslip.log import read, read_walk
from aslip.walking import Walks


def logged_walk(path: Path) -> Walks:
    """Read the walk of a log, straight ahead.

    Raises:
        ConfigurationError: the walk is commanded sideways, or to turn.
    """
    walk = read_walk(read(path))
    if walk.command.ndim == 3 and walk.command[..., 1:].any():
        raise ConfigurationError(
            f"{str(path)!r} is commanded sideways or to turn, and the benchmark measures walks"
            ' straight ahead: record with recipes/walk.py --command "0:0.5,4:1.0"'
        )
    return walk
