"""Recovery of the intact part of a truncated or damaged log."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.files.archive import open_file
from aslip.files.assets import user_path
from aslip.log import messages
from aslip.log.records import METADATA_HASH, Records, read_summary
from aslip.log.writer import (
    END_METADATA,
    HASH_KEY,
    METADATA,
    add_metadata,
    finish_file,
    open_writer,
)

RECOVERED_METADATA = "aslip/recovered"
"""Name of the metadata record that marks a recovered log."""


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    path: Path
    """Recovered log."""
    messages: int
    """Number of saved messages."""
    until: float
    """Simulated time of the last saved message [s]."""
    complete: bool
    """True if nothing was lost, except at most the summary at the end."""
    skipped_chunks: int
    """Number of damaged chunks left out; each holds at most a simulated second."""
    dropped: tuple[str, ...]
    """Names of damaged attachments left out."""
    reason: str
    """Damage found in the file, or an empty string."""


def recover(path: str | Path, out: str | Path | None = None) -> Recovery:
    """Write the intact part of a damaged log to a new, complete one.

    Damaged chunks, damaged attachments and the hashes of these attachments are left out, so that
    `read` accepts the new log. Recovery ends at the first record whose length is wrong.

    Args:
        path: damaged log, often `<name>.mcap.part`.
        out: new log; `<name>.recovered.mcap` by default.

    Raises:
        AssetError: there is no such file.
        ConfigurationError: `out` is the damaged file itself, or exists.
        FileDamagedError: no message can be read, or the log has another format.
    """
    path = user_path(path)
    out = path.with_name(path.name.split(".mcap")[0] + ".recovered.mcap") if out is None else out
    out = user_path(out)
    if out.exists():
        raise ConfigurationError(f"{str(out)!r} exists; give the recovered log another name")
    # the damaged log itself may have a name that ends in ".part"
    temporary = out.with_name(out.name + ".recovering")
    with open_file(path) as damaged:
        found = _look(damaged)
        with temporary.open("wb") as file:
            try:
                return _copy(damaged, found, file, out)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise


@dataclass
class _Found:
    """Intact content of a damaged file besides its messages."""

    records: Records
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: list[Attachment] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, record: McapRecord) -> None:
        """Add the next record."""
        if isinstance(record, Metadata) and METADATA_HASH in record.metadata:
            self.metadata[record.name] = dict(record.metadata)
        elif isinstance(record, Attachment):
            self.attachments.append(record)
        elif isinstance(record, Schema):
            self.schemas.setdefault(record.id, record)
        elif isinstance(record, Channel):
            self.channels.setdefault(record.id, record)

    def saved(self, record: McapRecord) -> bool:
        """True if a record is a message of a known channel and schema."""
        channel = self.channels.get(record.channel_id) if isinstance(record, Message) else None
        return channel is not None and channel.schema_id in self.schemas


def _look(damaged: IO[bytes]) -> _Found:
    """Read all records but messages.

    Raises:
        FileDamagedError: there is no message, or the log has another format.
    """
    found = _Found(Records(damaged))
    for record in found.records:
        found.add(record)
    # definitions from damaged chunks
    with suppress(Exception):
        for record in read_summary(damaged).definitions:
            found.add(record)
    if not any(found.saved(record) for record in Records(damaged)):
        problems = "; ".join(found.records.problems) or "it is empty"
        raise FileDamagedError(f"{damaged.name!r} has nothing to recover: {problems}")
    known = found.metadata.get(METADATA, {}).get("format", messages.FORMAT)
    if known != messages.FORMAT:
        raise FileDamagedError(
            f"{damaged.name!r} has format {known!r}, but this version of aslip recovers"
            f" {messages.FORMAT!r}"
        )
    return found


def _copy(damaged: IO[bytes], found: _Found, file: IO[bytes], out: Path) -> Recovery:
    writer = open_writer(file)
    _copy_attachments(writer, found)
    channels = _open_channels(writer, found)
    count, until = 0, 0
    for record in Records(damaged):
        if isinstance(record, Message) and found.saved(record):
            count, until = count + 1, max(until, record.log_time)
            channel, time = channels[record.channel_id], record.log_time
            writer.add_message(channel, time, record.data, record.publish_time, record.sequence)
    source = found.records
    reason = "; ".join([*source.problems, *source.bad_attachments])
    told = {
        "messages": str(count),
        "until_ns": str(until),
        "skipped_chunks": str(source.bad_chunks),
        "dropped_attachments": " ".join(found.dropped),
        "reason": reason,
    }
    add_metadata(writer, RECOVERED_METADATA, told)
    add_metadata(writer, END_METADATA, found.metadata.get(END_METADATA, {"recovered": "true"}))
    finish_file(writer, file, out)
    complete = source.whole and not reason and not found.dropped
    dropped = tuple(found.dropped)
    return Recovery(out, count, until / 1e9, complete, source.bad_chunks, dropped, reason)


def _copy_attachments(writer: Writer, found: _Found) -> None:
    """Write the metadata and the intact attachments."""
    metadata = found.metadata.get(METADATA, {"format": messages.FORMAT})
    metadata = {key: text for key, text in metadata.items() if key != METADATA_HASH}
    # without metadata there are no hashes; the checksums were verified on reading
    known = {key: metadata.pop(key) for key in list(metadata) if key.startswith(HASH_KEY)}
    kept = {}
    for attachment in found.attachments:
        key = HASH_KEY + attachment.name
        digest = hashlib.sha256(attachment.data).hexdigest()
        if known.pop(key, digest) == digest:
            kept[key] = attachment, digest
        else:
            found.dropped.append(attachment.name)
    found.dropped += [key.removeprefix(HASH_KEY) for key in known]
    hashes = {key: digest for key, (_, digest) in kept.items()}
    add_metadata(writer, METADATA, {**metadata, **hashes})
    for attachment, _ in kept.values():
        writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)


def _open_channels(writer: Writer, found: _Found) -> dict[int, int]:
    """Register the channels in the new file; map old ids to new ones."""
    schemas = {
        old: writer.register_schema(schema.name, schema.encoding, schema.data)
        for old, schema in found.schemas.items()
    }
    return {
        old: writer.register_channel(
            channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
        )
        for old, channel in found.channels.items()
        if channel.schema_id in schemas
    }
