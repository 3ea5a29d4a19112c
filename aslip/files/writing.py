"""Atomic writing: a file is complete or not there.

Content is written to a temporary file, synced to the disk, and only then renamed. After a full
disk, a killed process or a power cut, the old file is therefore intact, never half overwritten.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


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
