"""Files that are whole or not there.

A file is written under a temporary name, its bytes are brought to the disk, and only then does it
take its name: neither a full disk, nor a killed process, nor a power cut leaves half a file, or
loses the one that was there before.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO


@contextmanager
def replacing(path: Path) -> Iterator[IO[bytes]]:
    """Open a temporary file that takes the place of `path` if the body ends without an error.

    Args:
        path: the file; a file that is there stays as it is until the body has ended.

    Raises:
        OSError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.part")
    try:
        with temporary.open("wb") as file:
            yield file
            commit(file, path)
    finally:
        temporary.unlink(missing_ok=True)


def commit(file: IO[bytes], path: Path) -> None:
    """Bring an open temporary file to the disk, close it, and rename it to `path`.

    Args:
        file: open for writing, with a name in the folder of `path`.
        path: the file; replaced if it is there.

    Raises:
        OSError: the disk is full or failed; the temporary file is still there.
    """
    file.flush()
    # some file systems write a rename to the disk before the content
    os.fsync(file.fileno())
    file.close()
    os.replace(file.name, path)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Bring the names in a folder to the disk, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):  # Windows
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
