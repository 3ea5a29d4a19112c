"""Read a log back as arrays.

Flat messages of numbers are decoded by NumPy, others by the ROS 2 library, ten times slower.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from aslip.base.archive import open_file
from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.errors import FileDamagedError, UnknownNameError, machine_failed
from aslip.log import messages
from aslip.log.records import METADATA_HASH, FormatError, check_checksums, intact_records
from aslip.log.writer import END_METADATA, HASH_KEY, METADATA
from aslip.robot import CASSIE

Decoder = Callable[[bytes], dict[str, Any]]
"""Function from a message to its entries; those of nested messages have dotted names."""

_FIELD = re.compile(r"float(32|64)(?:\[(\d+)\])? (\w+)")
# bytes before the numbers of a message; numbers of one size need no padding
_ENCAPSULATION = 4


def _decoder(channel: Channel, schema: Schema) -> Decoder:
    """Decoder of a channel's messages.

    Raises:
        ValueError: the channel is not encoded as ROS 2 does.
    """
    if (channel.message_encoding, schema.encoding) != (MessageEncoding.CDR, SchemaEncoding.ROS2):
        raise ValueError(f"the topic {channel.topic!r} has an unknown encoding")
    dtype = _flat_dtype(schema.data.decode())
    if dtype is not None:
        return lambda data: _flat(data, dtype)
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode is not None  # the encoding was checked
    return lambda data: _flattened(decode(data))


def _flat_dtype(definition: str) -> np.dtype | None:
    """NumPy type of a message of numbers of one size; None for other messages."""
    matches = [_FIELD.fullmatch(line) for line in definition.split("\n")]
    fields = [match.groups() for match in matches if match is not None]
    if len(fields) != len(matches) or len({size for size, _, _ in fields}) != 1:
        return None
    number = f"<f{int(fields[0][0]) // 8}"
    return np.dtype([(name, number, (int(n),) if n else ()) for _, n, name in fields])


def _flat(data: bytes, dtype: np.dtype) -> dict[str, Any]:
    if len(data) != _ENCAPSULATION + dtype.itemsize:
        raise ValueError(f"a message of {len(data)} bytes does not fit its definition")
    row = np.frombuffer(data, dtype, offset=_ENCAPSULATION)[0]
    return dict(zip(dtype.names or (), row.item(), strict=True))


def _flattened(message: Any) -> dict[str, Any]:
    """Entries of a message by dotted names; lists of messages become lists of their entries."""
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


def without_objects(column: np.ndarray) -> np.ndarray:
    """Column whose arrays of several lengths, if it has such, are text."""
    return np.array([str(row) for row in column]) if column.dtype == object else column


@dataclass(frozen=True)
class Series:
    """Messages of one topic as arrays of m rows."""

    topic: str
    time: np.ndarray
    """(m,) simulated time [s]."""
    columns: dict[str, np.ndarray]
    """Name -> (m, ...); entries of nested messages have dotted names."""

    def __getitem__(self, name: str) -> np.ndarray:
        """Column of a name.

        Raises:
            UnknownNameError: the topic has no such column.
        """
        if name not in self.columns:
            raise UnknownNameError(f"{self.topic} has no {name!r}; it has {list(self.columns)}")
        return self.columns[name]

    @property
    def ticks(self) -> np.ndarray:
        """(m,) policy steps since the log began; times of a log are multiples of the period."""
        return np.rint(self.time / CASSIE.policy_period).astype(int)

    def numbers(self, name: str) -> np.ndarray:
        """Column (m,) of numbers.

        Raises:
            FileDamagedError: the column has other values.
            UnknownNameError: the topic has no such column.
        """
        column = self[name]
        if column.dtype.kind != "f" or column.ndim != 1:
            raise FileDamagedError(f"{self.topic} must have one number per message as {name!r}")
        return column

    def vector(self, name: str, components: str = "xyz") -> np.ndarray:
        """Columns `name_x`, `name_y`, ... as (m, k); quaternions have components "wxyz"."""
        return np.stack([self[f"{name}_{component}"] for component in components], axis=1)

    def table(self) -> dict[str, np.ndarray]:
        """Columns (m,) by name, beginning with `time`.

        An array becomes a column per item, `position[left_knee]`. Items have the names of the
        topic's joints or frames if it has such, otherwise numbers from 0. Bytes become numbers.
        """
        texts = {n: c for n, c in self.columns.items() if c.dtype.kind == "U" and c.ndim == 2}
        names = {
            name: column[0].tolist()
            for name, column in texts.items()
            if (column == column[0]).all() and len({*column[0]}) == len(column[0])
        }
        labels = {len(items): items for items in names.values()}
        table = {"time": self.time}
        for name, column in self.columns.items():
            if name in names:
                continue
            if column.dtype.kind == "S":
                column = column[:, None].view(np.uint8)
            column = without_objects(column)
            if column.ndim == 1:
                table[name] = column
                continue
            items = column.reshape(len(self), -1).T
            for item, values in zip(labels.get(len(items), range(len(items))), items, strict=True):
                table[f"{name}[{item}]"] = values
        return table

    def frame(self) -> Any:
        """Data frame of `table`: pandas, or Polars where only that is installed.

        Raises:
            MissingExtraError: neither is installed.
        """
        polars = find_spec("pandas") is None and find_spec("polars") is not None
        with extras():
            return import_module("polars" if polars else "pandas").DataFrame(self.table())

    def __len__(self) -> int:
        return len(self.time)


@dataclass(frozen=True)
class Recording:
    """A log in memory."""

    path: Path
    metadata: dict[str, str]
    """Origin of the log: versions, hashes, seed."""
    end: dict[str, str]
    """Counts at the end of the log."""
    attachments: dict[str, bytes]
    """Name -> contents, verified by their hashes."""
    series: dict[str, Series]
    """Topic -> its messages."""

    def __getitem__(self, topic: str) -> Series:
        """Messages of a topic.

        Raises:
            UnknownNameError: the log has no such topic.
        """
        if topic not in self.series:
            name = str(self.path)
            raise UnknownNameError(f"{name!r} has no topic {topic!r}; it has {list(self.series)}")
        return self.series[topic]

    def attachment(self, name: str) -> bytes:
        """Contents of an attached file.

        Raises:
            FileDamagedError: there is no such attachment.
        """
        if name not in self.attachments:
            raise FileDamagedError(
                f"{str(self.path)!r} lacks the attachment {name!r}: it has {list(self.attachments)}"
            )
        return self.attachments[name]


def read(path: str | Path, topics: Collection[str] | None = None) -> Recording:
    """Read a log, or some topics of it.

    Every byte is verified by a checksum, also where only some topics are read.

    Args:
        path: finished log.
        topics: topics to read; all by default.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is not a log, unfinished, damaged, or of another format.
    """
    path = user_path(path)
    with open_file(path) as file:
        try:
            return _read(path, file, topics)
        except FormatError as error:
            raise FileDamagedError(f"{str(path)!r} cannot be read: {error}") from error
        except Exception as error:  # a damaged file causes many kinds of exceptions
            if machine_failed(error):
                raise
            reason = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
            raise FileDamagedError(
                f"{str(path)!r} is not a complete, intact log: {reason}; save what comes before the"
                f" damage with: python -m aslip.log recover {path}"
            ) from error


def _read(path: Path, file: IO[bytes], topics: Collection[str] | None) -> Recording:
    """Content of an open log; raises many kinds of exceptions if it is damaged."""
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Decoder]] = {}
    rows: dict[str, tuple[list[int], list[dict[str, Any]]]] = {}
    for record in intact_records(file):
        if isinstance(record, Metadata):
            metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Attachment):
            attachments[record.name] = bytes(record.data)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            decode = _decoder(record, schemas[record.schema_id])
            channels[record.id] = record.topic, decode
        elif isinstance(record, Message):
            topic, decode = channels[record.channel_id]
            if topics is None or topic in topics:
                times, messages_of = rows.setdefault(topic, ([], []))
                times.append(record.log_time)
                messages_of.append(decode(record.data))
    check_checksums(file)
    about, end = check_metadata(metadata.get(METADATA)), metadata.get(END_METADATA, {})
    hashes = {HASH_KEY + n: hashlib.sha256(data).hexdigest() for n, data in attachments.items()}
    named = {key: text for key, text in about.items() if key.startswith(HASH_KEY)}
    for key, _ in sorted(hashes.items() ^ named.items()):
        raise ValueError(
            f"the attachment {key.removeprefix(HASH_KEY)!r} is not the one that its metadata names"
        )
    for entries in (about, end):
        entries.pop(METADATA_HASH, None)
    series = {topic: _series(topic, *part) for topic, part in rows.items()}
    return Recording(path, about, end, attachments, series)


def check_metadata(metadata: dict[str, str] | None) -> dict[str, str]:
    """Check that this version of the package reads a log, and return its metadata.

    Raises:
        FormatError: the log has another format.
        ValueError: there is no metadata.
    """
    if metadata is None:
        raise ValueError(f"not a log of this package: no metadata {METADATA!r}")
    if metadata.get("format") != messages.FORMAT:
        by = metadata.get("version/aslip", "another version")
        raise FormatError(
            f"its format is {metadata.get('format')!r}, but this version of aslip reads"
            f" {messages.FORMAT!r}; read it with the version that wrote it, aslip {by}"
            f" (commit {metadata.get('commit') or 'unknown'})"
        )
    return metadata


def _series(topic: str, time: list[int], rows: list[dict[str, Any]]) -> Series:
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        same = len({np.shape(value) for value in values}) == 1
        columns[name] = np.array(values) if same else np.array(values, dtype=object)
    return Series(topic, np.array(time, dtype=np.int64) / 1e9, columns)
