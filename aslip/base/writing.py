"""Atomic writing: a file is complete or not there. Claims: a folder has one writer at a time.

Content is written to a temporary file, synced to the disk, and only then renamed. After a full
disk, a killed process or a power cut, the old file is therefore intact, never half overwritten.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from aslip.errors import ConfigurationError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file that replaces `path` once the body has ended without an error.

    Args:
        path: file to create or replace; an old one stays as it is until the body has ended.

    Raises:
        OSError: the file cannot be written.
    """
    # another process may write the same file
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with temporary.open("wb") as file:
            yield file
            commit(file, path)
    finally:
        temporary.unlink(missing_ok=True)


def commit(file: IO[bytes], path: Path) -> None:
    """Sync an open temporary file to the disk, close it, and rename it to `path`.

    Args:
        file: temporary file, open for writing, in the folder of `path`.
        path: file to create or replace.

    Raises:
        OSError: the disk is full or failed; the temporary file is still there.
    """
    file.flush()
    # some file systems store the rename before the content
    os.fsync(file.fileno())
    file.close()
    os.replace(file.name, path)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Sync the names in a folder to the disk, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# ---------------------------------------------------------------------------- claims

_CLAIMS: dict[tuple[int, int], list[int]] = {}  # device and inode -> handle, users


@contextmanager
def claimed(path: Path, *, wait: bool = False) -> Iterator[None]:
    """Context in which no other process claims a folder or file.

    The system ends the claim when this process ends, however it does; forks do not inherit it.
    Within a process several claims of one path do not exclude each other. Nothing is claimed where
    the folder is read-only, and, with a warning, where the file system has no locks.

    Args:
        path: existing folder, or file in an existing folder. Meanwhile a file `.lock`, or one of
            the file's name, holds process and host.
        wait: wait for another process instead of raising an error.

    Raises:
        ConfigurationError: another process has claimed it.
        OSError: the lock cannot be created.
    """
    name = path / ".lock" if path.is_dir() else path.with_name(f".{path.name}.lock")
    key = _lock(path, name, wait)
    try:
        yield
    finally:
        if key in _CLAIMS:  # a fork must not release its parent's claim
            claim = _CLAIMS[key]
            claim[1] -= 1
            if not claim[1]:
                with contextlib.suppress(OSError):  # it may be another user's
                    if _is_at(claim[0], name):  # a folder may have been moved
                        name.unlink()
                os.close(_CLAIMS.pop(key)[0])


def _lock(path: Path, name: Path, wait: bool) -> tuple[int, int] | None:
    """Lock a file, and write process and host into it; returns its key among the claims."""
    if fcntl is None:
        return None
    while True:
        handle = _open_lock(name)
        if handle is None:
            return None
        status = os.fstat(handle)
        key = status.st_dev, status.st_ino
        if key in _CLAIMS:
            os.close(handle)
            _CLAIMS[key][1] += 1
            return key
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            owner = os.read(handle, 1000).decode(errors="replace").strip()
            os.close(handle)
            raise ConfigurationError(
                f"{str(path)!r} is in use by {owner or 'another process'}; wait until it ends, or"
                " choose another place"
            ) from None
        except OSError as error:
            os.close(handle)
            warnings.warn(
                f"no other process may write to {str(path)!r} now; its file system has no locks to"
                f" make sure of it ({error})",
                RuntimeWarning,
                stacklevel=4,
            )
            return None
        if _is_at(handle, name):
            break
        os.close(handle)  # its owner ended and removed it in between
    with contextlib.suppress(OSError):  # a full disk
        os.ftruncate(handle, 0)
        os.write(handle, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    _CLAIMS[key] = [handle, 1]
    return key


def _open_lock(name: Path) -> int | None:
    """Open a lock, which may be another user's; None in a folder that is read-only."""
    for flags in (os.O_RDWR | os.O_CREAT, os.O_RDONLY):
        try:
            return os.open(name, flags, 0o666)
        except OSError as error:
            if error.errno not in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOENT):
                raise
    return None


def _is_at(handle: int, name: Path) -> bool:
    """Whether an open file still has a name."""
    try:
        return os.path.samestat(os.fstat(handle), name.stat())
    except OSError:
        return False


def _forget_claims() -> None:
    """Close the handles in a fork; otherwise a claim would last until the fork ends, too."""
    for handle, _ in _CLAIMS.values():
        os.close(handle)
    _CLAIMS.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_claims)
