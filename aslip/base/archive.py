"""Archives of arrays and text, checked in full before use.

    FORMAT = ArchiveFormat("policy", 2)
    FORMAT.write(path, {"weights/0.npy": npy(weights), "card.json": as_json(card)})
    entries = FORMAT.read(path)

An archive is a ZIP file of arrays (`.npy`) and text, which NumPy reads as an `.npz`. Its entry
SHA256SUMS lists the SHA-256 of every other entry, in the format of `sha256sum --check`.

Guarantees: nothing is unpickled; a changed, missing, added or swapped entry is refused; memory is
proportional to the size of the file, or 4 MiB, even if the file claims or has larger contents;
named pipes and devices are not opened.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from aslip.base.writing import replacing
from aslip.errors import AslipError, AssetError, FileDamagedError, machine_failed

SUMS = "SHA256SUMS"
"""Name of the entry with the hashes of all others."""

_FORMAT = "format"
# largest ratio of content to file size; compressed gaits have 2, a decompression bomb 1000
_LARGEST_RATIO = 10
# content that is read from any file [bytes]; robots that hardly move compress more than ten times
_HARMLESS = 2**22


@dataclass(frozen=True)
class ArchiveFormat:
    """Kind, version and compression of an archive."""

    kind: str
    """Name of this kind of file, in messages and in the file."""
    version: int
    """Version of the format; files of other versions are refused."""
    advice: str = ""
    """Advice at the end of error messages."""
    compressed: bool = False
    """Compress the entries."""
    instead: str = ""
    """Advice for those who give a file of another kind."""

    def write(self, path: Path, entries: Mapping[str, bytes]) -> None:
        """Write an archive atomically; equal entries make equal files.

        Args:
            path: file to create or replace.
            entries: name -> content.

        Raises:
            OSError: the file cannot be written; an old one is unchanged.
        """
        entries = {**entries, _FORMAT: self._name.encode()}
        method = zipfile.ZIP_DEFLATED if self.compressed else zipfile.ZIP_STORED
        with replacing(path) as file, zipfile.ZipFile(file, "w", method) as archive:
            for name, content in {**entries, SUMS: sums(entries)}.items():
                info = zipfile.ZipInfo(name)
                info.external_attr = 0o644 << 16
                archive.writestr(info, content, method)

    def read(self, path: Path) -> dict[str, bytes]:
        """Read an archive and check all hashes.

        Raises:
            FileDamagedError: the file is truncated, altered, or of another kind or version.
            OSError: there is no permission, or no handle, to read it.
        """
        try:
            with open_file(path) as file:
                entries = read_zip(file)
            _check(entries)
        except Exception as error:  # zipfile has many exceptions for a bad file
            raise self.damaged(path, error) from error
        name = entries.pop(_FORMAT, b"").decode(errors="replace")
        kind = name.removeprefix("aslip ").rpartition(" ")[0]
        if name.startswith("aslip ") and kind != self.kind:
            hint = f"; {self.instead}" if self.instead else ""
            raise FileDamagedError(f"{str(path)!r} is a {kind}, not a {self.kind}{hint}")
        if name != self._name:
            raise self.damaged(path, f"its format is {name!r}, not {self._name!r}")
        return entries

    def damaged(self, path: Path, why: str | Exception) -> FileDamagedError:
        """Build the error of a damaged file; an error of the machine is raised as it is."""
        if isinstance(why, Exception) and machine_failed(why):
            raise why
        if isinstance(why, Exception):
            own = type(why) is ValueError or isinstance(why, AslipError)
            why = str(why) if own else f"{type(why).__name__}: {why}"
        advice = f"; {self.advice}" if self.advice else ""
        return FileDamagedError(f"{str(path)!r} is not an intact {self.kind} file ({why}){advice}")

    @property
    def _name(self) -> str:
        return f"aslip {self.kind} {self.version}"


def open_file(path: Path) -> IO[bytes]:
    """Open a regular file for reading.

    Raises:
        AssetError: there is no such file, or it is a folder, a named pipe or a device; reading the
            last two may never end.
    """
    if path.exists() and not path.is_file():
        raise AssetError(f"{str(path)!r} is not a regular file")
    try:
        return path.open("rb")
    except FileNotFoundError as error:
        raise AssetError(f"there is no file {str(path)!r}") from error


def read_zip(file: IO[bytes]) -> dict[str, bytes]:
    """Read the entries of a ZIP file by name, no more of each than the directory claims.

    Raises:
        ValueError: the entries claim to be much larger than the file, two have the same name, or
            one has another compression than ours.
        Exception: the file is damaged or encrypted.
    """
    size, contents = file.seek(0, os.SEEK_END), {}
    with zipfile.ZipFile(file) as archive:
        infos = archive.infolist()
        claimed = sum(info.file_size for info in infos)
        if claimed > max(_LARGEST_RATIO * size, _HARMLESS):
            raise ValueError(f"a file of {size} bytes claims to hold {claimed} bytes")
        for info in infos:
            # the other methods cannot be decompressed in part
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"the compression {info.compress_type} of {info.filename!r}")
            if info.filename in contents:
                raise ValueError("two entries have the same name")
            with archive.open(info) as entry:
                contents[info.filename] = entry.read(info.file_size + 1)
    return contents


def _check(entries: dict[str, bytes]) -> None:
    """Remove the hashes from the entries and compare them.

    Raises:
        ValueError: a hash is missing or wrong.
    """
    lines = entries.pop(SUMS, None)
    if lines is None:
        raise ValueError(f"{SUMS} is missing")
    if differing := set(lines.splitlines()) ^ set(sums(entries).splitlines()):
        names = sorted({line.split(b"  ", 1)[-1].decode(errors="replace") for line in differing})
        raise ValueError(f"wrong SHA-256 of {', '.join(names[:3])}")


def sums(entries: Mapping[str, bytes]) -> bytes:
    """Content of SHA256SUMS: one line per entry."""
    lines = (f"{hashlib.sha256(data).hexdigest()}  {name}\n" for name, data in entries.items())
    return "".join(lines).encode()


# ------------------------------------------------------------------------- entries


def npy(array: Any) -> bytes:
    """Serialise an array in NumPy's own format, without pickle.

    Raises:
        ValueError: the array holds Python objects.
    """
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asanyarray(array), allow_pickle=False)
    return buffer.getvalue()


def from_npy(data: bytes) -> np.ndarray:
    """Deserialise an array from the bytes that `npy` made.

    Raises:
        ValueError: the bytes are not an array, hold Python objects, or do not match its shape.
    """
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"array in NumPy format {version}, expected (1, 0)")
    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    expected, rest = math.prod(shape) * dtype.itemsize, len(data) - stream.tell()
    # check before NumPy allocates memory for that shape
    if expected != rest:
        raise ValueError(f"array of shape {shape} has {rest} bytes, expected {expected}")
    # an empty array may have any number of rows, for which its users would allocate memory
    if expected == 0 and math.prod(number for number in shape if number) > _HARMLESS:
        raise ValueError(f"empty array of shape {shape}")
    return np.load(io.BytesIO(data), allow_pickle=False)


def as_json(value: Any) -> bytes:
    """Serialise a value as JSON text.

    Raises:
        TypeError: the value has other types than those of JSON.
    """
    return (json.dumps(value, indent=1) + "\n").encode()
