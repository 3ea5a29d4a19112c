"""Read a log back as arrays."""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from aslip.errors import AssetError, FileDamagedError, UnknownNameError
from aslip.log import messages
from aslip.log.writer import END_METADATA, HASH_KEY, METADATA

MAGIC = b"\x89MCAP0\r\n"
"""A file's first and last bytes."""
FOOTER = struct.Struct("<BQQQI")
"""The record before them: opcode, length, where the summary and its offsets start, checksum."""
_FOOTER_OPCODE = 0x02


@dataclass(frozen=True)
class Series:
    """The messages of one topic as arrays of m rows."""

    topic: str
    time: np.ndarray
    """(m,) simulated time [s]."""
    columns: dict[str, np.ndarray]
    """Name -> (m, ...); entries of nested messages have dotted names."""

    def __getitem__(self, name: str) -> np.ndarray:
        """A column.

        Raises:
            UnknownNameError: the topic has no such column.
        """
        if name not in self.columns:
            raise UnknownNameError(f"{self.topic} has no {name!r}; it has {list(self.columns)}")
        return self.columns[name]

    def vector(self, name: str, components: str = "xyz") -> np.ndarray:
        """(m, k) of columns `name_x`, `name_y`, ...; quaternions have components "wxyz"."""
        return np.stack([self[f"{name}_{component}"] for component in components], axis=1)

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class Recording:
    """A log in memory."""

    path: Path
    metadata: dict[str, str]
    """How it was made: versions, hashes, seed."""
    end: dict[str, str]
    """How it ended."""
    attachments: dict[str, bytes]
    """Name -> contents, with hashes that are right."""
    series: dict[str, Series]
    """Topic -> its messages."""

    def __getitem__(self, topic: str) -> Series:
        """The messages of a topic.

        Raises:
            UnknownNameError: the log has no such topic.
        """
        if topic not in self.series:
            name = str(self.path)
            raise UnknownNameError(f"{name!r} has no topic {topic!r}; it has {list(self.series)}")
        return self.series[topic]


def read(path: str | Path, topics: list[str] | None = None) -> Recording:
    """Read a whole log.

    Args:
        path: of a finished log.
        topics: only these; all by default.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: it is no log, not finished, damaged, or of another format.
    """
    path = Path(path)
    with open_log(path) as file, _explained(path):
        if not begins_as_mcap(file):
            raise FileDamagedError(f"{str(path)!r} is no MCAP file: it does not begin as one")
        problem = ending_problem(file)
        if problem:
            raise ValueError(problem)
        file.seek(0)
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        if reader.get_summary() is None:
            raise ValueError("it has no summary")
        records = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        metadata = check_metadata(records.get(METADATA))
        attachments = {a.name: bytes(a.data) for a in reader.iter_attachments()}
        for problem in hash_problems(metadata, attachments):
            raise ValueError(problem)
        rows: dict[str, list[Any]] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages(topics):
            rows.setdefault(channel.topic, []).append((message.log_time, decoded))
    series = {topic: _series(topic, entries) for topic, entries in rows.items()}
    return Recording(path, metadata, records.get(END_METADATA, {}), attachments, series)


def open_log(path: Path) -> IO[bytes]:
    """The file, open for reading.

    Raises:
        AssetError: there is no such file.
    """
    try:
        return path.open("rb")
    except (FileNotFoundError, IsADirectoryError) as error:
        raise AssetError(f"no log {str(path)!r}: {error.strerror}") from None


def begins_as_mcap(file: IO[bytes]) -> bool:
    """Whether a file may be an MCAP file at all."""
    file.seek(0)
    return file.read(len(MAGIC)) == MAGIC


def ending_problem(file: IO[bytes]) -> str | None:
    """Why an MCAP file was not finished; None if it was."""
    size = file.seek(0, os.SEEK_END)
    tail = FOOTER.size + len(MAGIC)
    file.seek(max(size - tail, 0))
    ending = file.read()
    if not ending.endswith(MAGIC) or size < tail + len(MAGIC):
        return "it is unfinished: it does not end as an MCAP file"
    opcode, length, start, _, _ = FOOTER.unpack(ending[: -len(MAGIC)])
    if opcode != _FOOTER_OPCODE or length != FOOTER.size - 1 - 8 or not 0 < start < size:
        return "its footer is damaged"
    return None


def check_metadata(metadata: dict[str, str] | None) -> dict[str, str]:
    """The metadata, if it is of a log that this version of the package reads.

    Raises:
        ValueError: it is not.
    """
    if metadata is None:
        raise ValueError(f"it is no log of this package: it has no metadata {METADATA!r}")
    if metadata.get("format") != messages.FORMAT:
        raise ValueError(
            f"its format is {metadata.get('format')!r}, this version of aslip reads"
            f" {messages.FORMAT!r}"
        )
    return metadata


def hash_problems(metadata: dict[str, str], attachments: dict[str, bytes]) -> Iterator[str]:
    """Attachments that are missing, altered, or without a hash."""
    hashes = {
        key.removeprefix(HASH_KEY): value
        for key, value in metadata.items()
        if key.startswith(HASH_KEY)
    }
    for name, expected in hashes.items():
        if name not in attachments:
            yield f"the attachment {name!r} is missing"
        elif hashlib.sha256(attachments[name]).hexdigest() != expected:
            yield f"the attachment {name!r} is not what was attached: its SHA-256 differs"
    for name in sorted(attachments.keys() - hashes.keys()):
        yield f"the attachment {name!r} has no hash in the metadata"


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn whatever a parser trips over into one error."""
    try:
        yield
    except FileDamagedError:
        raise
    except Exception as error:  # one cause, a bad file, has many exceptions
        # our own say what is wrong; a parser's say little without their kind
        reason = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
        raise FileDamagedError(
            f"{str(path)!r} is no whole, intact log: {reason}; what is left of it can be saved"
            f" with: python -m aslip.log recover {path}"
        ) from error


def _series(topic: str, entries: list[tuple[int, Any]]) -> Series:
    time = np.array([time for time, _ in entries], dtype=np.int64) / 1e9
    rows = [_flattened(message) for _, message in entries]
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        same = len({np.shape(value) for value in values}) == 1
        columns[name] = np.array(values) if same else np.array(values, dtype=object)
    return Series(topic, time, columns)


def _flattened(message: Any) -> dict[str, Any]:
    """A message's entries by dotted names; lists of messages become lists of their entries."""
    entries: dict[str, Any] = {}
    for name in message.__slots__:
        value = getattr(message, name)
        if hasattr(value, "__slots__") and not isinstance(value, str | bytes):
            nested = _flattened(value)
            entries |= {f"{name}.{key}": item for key, item in nested.items()}
        elif isinstance(value, list) and value and hasattr(value[0], "__slots__"):
            parts = [_flattened(item) for item in value]
            entries |= {f"{name}.{key}": [part[key] for part in parts] for key in parts[0]}
        else:
            entries[name] = value
    return entries
