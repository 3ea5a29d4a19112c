"""Archives of which every byte is checked before any of it is used.

    FORMAT = ArchiveFormat("policy", 2)
    FORMAT.write(path, {"weights/0.npy": npy(weights), "card.json": as_json(card)})
    entries = FORMAT.read(path)

An archive is a ZIP file of arrays (`.npy`) and text, which NumPy reads as an `.npz`. Its entry
SHA256SUMS has the SHA-256 of every other entry; `sha256sum --check` understands it.

Guarantees: nothing is unpickled; an entry that is changed, missing, added or swapped is refused;
reading takes memory in proportion to the file's size, whatever sizes the file claims.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from aslip.errors import FileDamagedError
from aslip.files.writing import replacing

SUMS = "SHA256SUMS"
"""Entry with the hashes of all others."""

_FORMAT = "format"
# bytes of content per byte of file; compressed gaits have 2, a decompression bomb 1000
_LARGEST_RATIO = 10


@dataclass(frozen=True)
class ArchiveFormat:
    """A kind of file that is an archive."""

    kind: str
    """Name of this kind of file in messages."""
    version: int
    """Files of other versions are refused."""
    advice: str = ""
    """Advice to the owner of a file that is refused."""
    compressed: bool = False
    """Whether entries are compressed."""

    def write(self, path: Path, entries: Mapping[str, bytes]) -> None:
        """Write an archive as a whole or not at all; equal entries make equal files.

        Args:
            path: the file; replaced if it is there.
            entries: content by name.

        Raises:
            OSError: it cannot be written; a file that was there is as it was.
        """
        entries = {**entries, _FORMAT: self._name.encode()}
        method = zipfile.ZIP_DEFLATED if self.compressed else zipfile.ZIP_STORED
        with replacing(path) as file, zipfile.ZipFile(file, "w", method) as archive:
            for name, content in {**entries, SUMS: sums(entries)}.items():
                info = zipfile.ZipInfo(name)
                info.external_attr = 0o644 << 16
                archive.writestr(info, content, method)

    def read(self, path: Path) -> dict[str, bytes]:
        """Entries of an archive whose hashes are right.

        Raises:
            FileDamagedError: it is truncated, altered, of another kind or version, or unreadable.
        """
        try:
            with zipfile.ZipFile(path) as archive:
                entries = _entries(archive, path.stat().st_size)
            _check(entries)
        except Exception as error:  # one cause, a bad file, has many exceptions
            raise self.damaged(path, error) from error
        name = entries.pop(_FORMAT, b"").decode(errors="replace")
        if name != self._name:
            raise self.damaged(path, f"its format is {name!r}, not {self._name!r}")
        return entries

    def damaged(self, path: Path, why: str | Exception) -> FileDamagedError:
        """The error of a file that is not what it should be."""
        if isinstance(why, Exception):
            why = str(why) if type(why) is ValueError else f"{type(why).__name__}: {why}"
        advice = f"; {self.advice}" if self.advice else ""
        return FileDamagedError(f"{str(path)!r} is no intact {self.kind} ({why}){advice}")

    @property
    def _name(self) -> str:
        return f"aslip {self.kind} {self.version}"


def _entries(archive: zipfile.ZipFile, size: int) -> dict[str, bytes]:
    """Entries by name, of a file of so many bytes."""
    infos = archive.infolist()
    content = sum(info.file_size for info in infos)
    if content > _LARGEST_RATIO * size:
        raise ValueError(f"its {size} bytes claim to hold {content}")
    names = [info.filename for info in infos]
    if len(set(names)) < len(names):
        raise ValueError("it has two entries of the same name")
    return {info.filename: archive.read(info) for info in infos}


def _check(entries: dict[str, bytes]) -> None:
    """Take the hashes out, and compare them.

    Raises:
        ValueError: they are not those of the entries, or missing.
    """
    told = entries.pop(SUMS, None)
    if told is None:
        raise ValueError(f"it has no {SUMS}; files of earlier versions had none, and are not read")
    if odd := set(told.splitlines()) ^ set(sums(entries).splitlines()):
        names = sorted({line.split(b"  ", 1)[-1].decode(errors="replace") for line in odd})
        raise ValueError(f"the SHA-256 of {', '.join(names[:3])} is not as it should be")


def sums(entries: Mapping[str, bytes]) -> bytes:
    """Content of SHA256SUMS: a line for each entry."""
    lines = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in entries.items())
    return "".join(lines).encode()


# ------------------------------------------------------------------------- entries


def npy(array: Any) -> bytes:
    """An array in NumPy's own format, without pickle.

    Raises:
        ValueError: it holds Python objects.
    """
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asanyarray(array), allow_pickle=False)
    return buffer.getvalue()


def from_npy(data: bytes) -> np.ndarray:
    """The array that `npy` made bytes of.

    Raises:
        ValueError: it is none, holds Python objects, or has not as many bytes as its shape says.
    """
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"an array of NumPy's format {version}, not (1, 0)")
    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    expected, rest = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    # before NumPy allocates what the header asks for
    if expected != rest:
        raise ValueError(f"an array of shape {shape} has {rest} bytes in place of {expected}")
    return np.load(io.BytesIO(data), allow_pickle=False)


def as_json(value: Any) -> bytes:
    """A value of JSON types as text.

    Raises:
        TypeError: it is of others.
    """
    return (json.dumps(value, indent=1) + "\n").encode()
