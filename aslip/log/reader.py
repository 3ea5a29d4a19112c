"""Read a log back as arrays.

Flat messages of numbers are decoded by NumPy, others by the ROS 2 library, ten times slower.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from aslip.errors import FileDamagedError, UnknownNameError, machine_failed
from aslip.files.archive import open_file
from aslip.files.assets import user_path
from aslip.log import messages
from aslip.log.records import METADATA_HASH, Records, begins_as_mcap, read_summary
from aslip.log.writer import END_METADATA, HASH_KEY, METADATA

Decoder = Callable[[bytes], dict[str, Any]]
"""Function from a message to its entries; those of nested messages have dotted names."""

_FIELD = re.compile(r"float(32|64)(?:\[(\d+)\])? (\w+)")
# bytes before the numbers of a message; numbers of one size need no padding
_ENCAPSULATION = 4


def decoder_of(channel: Channel, schema: Schema | None) -> Decoder:
    """Decoder of a channel's messages.

    Raises:
        ValueError: the channel has no schema, or is not encoded as ROS 2 does.
    """
    if schema is None:
        raise ValueError(f"the topic {channel.topic!r} has no schema")
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

    def vector(self, name: str, components: str = "xyz") -> np.ndarray:
        """Columns `name_x`, `name_y`, ... as (m, k); quaternions have components "wxyz"."""
        return np.stack([self[f"{name}_{component}"] for component in components], axis=1)

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
    damaged: tuple[str, ...] = ()
    """Reason for each damaged attachment that is left out of `attachments`."""

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
            FileDamagedError: the attachment is missing or damaged.
        """
        if name not in self.attachments:
            wrong = "; ".join(self.damaged) or f"it has {list(self.attachments)}"
            raise FileDamagedError(f"{str(self.path)!r} lacks the attachment {name!r}: {wrong}")
        return self.attachments[name]


def read(path: str | Path, topics: Collection[str] | None = None) -> Recording:
    """Read a log, or some topics of it.

    Every number is verified: a damaged chunk, metadata record or summary is an error. So is a
    damaged attachment if all topics are read; otherwise it is left out and named in
    `Recording.damaged`.

    Args:
        path: finished log.
        topics: topics to read; all by default.

    Raises:
        AssetError: there is no such file.
        FileDamagedError: the file is not a log, unfinished, damaged, or of another format.
    """
    path = user_path(path)
    with open_file(path) as file:
        if not begins_as_mcap(file):
            raise FileDamagedError(f"{str(path)!r} is not an MCAP file: wrong magic bytes")
        with _explained(path):
            statistics = read_summary(file).statistics
            records, content = Records(file), Content()
            for record in records:
                content.add(record, topics)
            metadata = check_metadata(content.metadata.get(METADATA))
            problems = records.problems or counts_differ(statistics, content)
            damaged = [*records.bad_attachments, *hash_problems(metadata, content.attachments)]
            if problems or (damaged and topics is None):
                raise ValueError("; ".join(problems or damaged))
            end = content.metadata.get(END_METADATA, {})
            series = {topic: _series(topic, *rows) for topic, rows in content.rows.items()}
    for entries in (metadata, end):
        entries.pop(METADATA_HASH, None)
    return Recording(path, metadata, end, content.intact(metadata), series, tuple(damaged))


@dataclass
class Content:
    """Content of a log, collected record by record."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Records by name."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    """Contents by name."""
    rows: dict[str, tuple[list[int], list[dict[str, Any]]]] = field(default_factory=dict)
    """Times [ns] and decoded messages of the topics that are read."""
    counts: Counter[int] = field(default_factory=Counter)
    """Messages of every channel."""
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _topics: dict[int, tuple[str, Decoder]] = field(default_factory=dict)

    def add(self, record: object, topics: Collection[str] | None = None) -> None:
        """Add the next record; messages only of `topics`, if given.

        Raises:
            ValueError: the channel or schema of a record is unknown.
        """
        if isinstance(record, Metadata):
            self.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Attachment):
            self.attachments[record.name] = bytes(record.data)
        elif isinstance(record, Schema):
            self._schemas[record.id] = record
        elif isinstance(record, Channel):
            decoder = decoder_of(record, self._schemas.get(record.schema_id))
            self._topics[record.id] = record.topic, decoder
        elif isinstance(record, Message):
            self.counts[record.channel_id] += 1
            topic, decode = self._topic(record)
            if topics is None or topic in topics:
                time, rows = self.rows.setdefault(topic, ([], []))
                rows.append(decode(record.data))
                time.append(record.log_time)

    def _topic(self, message: Message) -> tuple[str, Decoder]:
        if message.channel_id not in self._topics:
            raise ValueError(f"the channel {message.channel_id} of a message is unknown")
        return self._topics[message.channel_id]

    def intact(self, metadata: Mapping[str, str]) -> dict[str, bytes]:
        """Attachments whose hash equals that in the metadata."""
        return {
            name: data
            for name, data in self.attachments.items()
            if metadata.get(HASH_KEY + name) == hashlib.sha256(data).hexdigest()
        }


def counts_differ(said: Any, content: Content) -> list[str]:
    """Compare the counts of a summary with the content of the file; list the differences.

    Args:
        said: `Statistics` of the summary.
        content: content of the file.
    """
    counted = {channel: n for channel, n in said.channel_message_counts.items() if n}
    if counted != dict(content.counts) or said.message_count != content.counts.total():
        total = content.counts.total()
        if said.message_count != total:
            return [f"its summary counts {said.message_count} messages, the file has {total}"]
        return ["its summary counts the messages of some topics wrongly"]
    if said.metadata_count != len(content.metadata):
        return [f"its summary counts {said.metadata_count} metadata, not {len(content.metadata)}"]
    return []


def check_metadata(metadata: dict[str, str] | None) -> dict[str, str]:
    """Check that this version of the package reads a log, and return its metadata.

    Raises:
        FormatError: the log has another format.
        ValueError: the metadata or its hash is missing.
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
    if METADATA_HASH not in metadata:
        raise ValueError("its metadata is damaged: it lacks its SHA-256")
    return metadata


class FormatError(ValueError):
    """Format of a log that this version does not read."""


def hash_problems(metadata: dict[str, str], attachments: dict[str, bytes]) -> Iterator[str]:
    """List attachments that are missing, altered, or without a hash."""
    hashes = {
        key.removeprefix(HASH_KEY): value
        for key, value in metadata.items()
        if key.startswith(HASH_KEY)
    }
    for name, expected in hashes.items():
        if name not in attachments:
            yield f"the attachment {name!r} is missing"
        elif hashlib.sha256(attachments[name]).hexdigest() != expected:
            yield f"the attachment {name!r} is altered: its SHA-256 differs"
    for name in sorted(attachments.keys() - hashes.keys()):
        yield f"the attachment {name!r} has no hash in the metadata"


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn every error of a parser into a FileDamagedError."""
    try:
        yield
    except FormatError as error:
        raise FileDamagedError(f"{str(path)!r} cannot be read: {error}") from error
    except Exception as error:  # a damaged file causes many kinds of exceptions
        if machine_failed(error):
            raise
        # messages of a parser need their type to be understood
        reason = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
        raise FileDamagedError(
            f"{str(path)!r} is not a complete, intact log: {reason}; save its intact part with:"
            f" python -m aslip.log recover {path}"
        ) from error


def _series(topic: str, time: list[int], rows: list[dict[str, Any]]) -> Series:
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        same = len({np.shape(value) for value in values}) == 1
        columns[name] = np.array(values) if same else np.array(values, dtype=object)
    return Series(topic, np.array(time, dtype=np.int64) / 1e9, columns)
