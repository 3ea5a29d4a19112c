"""Exceptions of the package, under one root.

Each message names the offending value and a valid one. Each class also derives from the built-in
exception that a caller would expect, so `except ValueError` works, too.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


class AslipError(Exception):
    """Root of all exceptions that this package raises on purpose."""


class AssetError(AslipError, FileNotFoundError):
    """Missing file, shipped with the package or named by the user."""


class FileDamagedError(AslipError, ValueError):
    """Truncated or altered file, or a file of another kind than expected."""


class SpeedOutOfRangeError(AslipError, ValueError):
    """Walking speed outside the range of the gait library."""


class GaitOptimizationError(AslipError, RuntimeError):
    """Gait optimisation without a certified optimum."""


class SolverError(AslipError, RuntimeError):
    """Solver that ended by an accident, which says nothing about its problem."""


class UnreachablePoseError(AslipError, ValueError):
    """Foot or pelvis pose out of reach of the robot's legs."""


class UnknownNameError(AslipError, KeyError):
    """Unknown name of a joint, body, transform, policy and so on."""

    @classmethod
    def among(cls, kind: str, name: object, known: Iterable[str]) -> UnknownNameError:
        """Build the error of an unknown name; its message suggests the closest known one."""
        names = list(known)
        close = difflib.get_close_matches(str(name), names, n=1)
        hint = f", did you mean {close[0]!r}?" if close else ";"
        return cls(f"no {kind} {name!r}{hint} there are {names}")

    def __str__(self) -> str:
        # KeyError would print the repr of the message
        return str(self.args[0]) if self.args else ""


class ShapeError(AslipError, ValueError):
    """Array of the wrong shape."""


class ConfigurationError(AslipError, ValueError):
    """Setting of the wrong type or range, or checkpoint of a run with other settings."""


class MissingExtraError(ConfigurationError, ImportError):
    """Library of an extra, such as `aslip[train]`, that is not installed."""


class RenderingError(AslipError, RuntimeError):
    """Rendering on a machine without a working OpenGL."""


class CollectorError(AslipError, RuntimeError):
    """Failure or unexpected end of a process that collects samples."""


class NetworkError(AslipError, OSError):
    """Port in use, or a robot or controller that does not answer."""


def machine_failed(error: BaseException) -> bool:
    """True for an error that says nothing about a file: no memory, no permission, no handle."""
    codes = errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EACCES, errno.EPERM, errno.ESTALE
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in codes)


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn errors that the user can fix into one line and an exit status, without a traceback.

    Ctrl-C exits with the usual status, 130.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    except (AslipError, OSError) as error:
        raise SystemExit(f"error: {error}") from None
