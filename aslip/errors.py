"""Every way a user can be wrong, under one root.

Each message names the offending value and says what would be right. Classes also derive from the
built-in exception a caller would expect, so `except ValueError` keeps working.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class AslipError(Exception):
    """Root of all errors raised on purpose by this package."""


class AssetError(AslipError, FileNotFoundError):
    """A file that ships with the package, or was named by the user, is not there."""


class FileDamagedError(AslipError, ValueError):
    """A file exists but is truncated, altered, or not of the kind it should be."""


class SpeedOutOfRangeError(AslipError, ValueError):
    """A walking speed outside the range of the gait library."""


class GaitOptimizationError(AslipError, RuntimeError):
    """The gait optimiser stopped without an optimal gait."""


class UnreachablePoseError(AslipError, ValueError):
    """A foot or pelvis pose that the robot's legs cannot reach."""


class UnknownNameError(AslipError, KeyError):
    """A joint, body, transform or policy name that does not exist."""

    @classmethod
    def among(cls, kind: str, name: object, known: Iterable[str]) -> UnknownNameError:
        """Of a name that is none of the known, with the nearest of them."""
        names = list(known)
        close = difflib.get_close_matches(str(name), names, n=1)
        hint = f", did you mean {close[0]!r}?" if close else ";"
        return cls(f"no {kind} {name!r}{hint} there are {names}")

    def __str__(self) -> str:
        # KeyError would print the repr of the message
        return str(self.args[0]) if self.args else ""


class ShapeError(AslipError, ValueError):
    """An array of the wrong shape."""


class ConfigurationError(AslipError, ValueError):
    """A setting of the wrong type or range, or a checkpoint that belongs to other settings."""


class RenderingError(AslipError, RuntimeError):
    """Pictures are asked for where no OpenGL works."""


class CollectorError(AslipError, RuntimeError):
    """A process that collects samples for a training has failed, or was ended."""


@contextmanager
def one_line_errors() -> Iterator[None]:
    """End a program with one line instead of a traceback where the user can mend what is wrong.

    Ctrl-C ends it with the usual exit status, 130.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except (AslipError, OSError) as error:
        raise SystemExit(f"error: {error}") from None
