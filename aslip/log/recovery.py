"""Recovery of a log that was cut off, such as by a crash of the process that wrote it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer

from aslip.base.archive import open_file
from aslip.base.assets import user_path
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log.reader import check_metadata
from aslip.log.records import intact_records
from aslip.log.writer import METADATA, add_metadata, finish_file, open_writer

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
    reason: str
    """Damage at which the recovery ended, or an empty string."""


def recover(path: str | Path, out: str | Path | None = None) -> Recovery:
    """Write all that comes before the first damage of a log to a new, complete one.

    Args:
        path: damaged log, often `<name>.mcap.part`.
        out: new log; `<name>.recovered.mcap` by default.

    Raises:
        AssetError: there is no such file.
        ConfigurationError: `out` is the damaged file itself, or exists.
        FileDamagedError: no message comes before the damage, or the log has another format.
    """
    path = user_path(path)
    out = path.with_name(path.name.split(".mcap")[0] + ".recovered.mcap") if out is None else out
    out = user_path(out)
    if out.exists():
        raise ConfigurationError(f"{str(out)!r} exists; give the recovered log another name")
    with open_file(path) as damaged:
        records, reason = _before_damage(damaged)
    _check_content(path, records, reason)
    times = [record.log_time for record in records if isinstance(record, Message)]
    # the damaged log itself may have a name that ends in ".part"
    temporary = out.with_name(out.name + ".recovering")
    try:
        with temporary.open("wb") as file:
            writer = open_writer(file)
            _copy(records, writer)
            facts = {"messages": str(len(times)), "until_ns": str(max(times)), "reason": reason}
            add_metadata(writer, RECOVERED_METADATA, facts)
            finish_file(writer, file, out)
    finally:
        temporary.unlink(missing_ok=True)
    return Recovery(out, len(times), max(times) / 1e9, reason)


def _before_damage(file: IO[bytes]) -> tuple[list[McapRecord], str]:
    """Records before the first damage, and the damage."""
    records: list[McapRecord] = []
    try:
        for record in intact_records(file):
            records.append(record)
    except ValueError as error:
        return records, str(error)
    return records, ""


def _check_content(path: Path, records: Sequence[McapRecord], reason: str) -> None:
    """Check that a log has this version's format, and messages.

    Raises:
        FileDamagedError: it has not.
    """
    metadata = {r.name: dict(r.metadata) for r in records if isinstance(r, Metadata)}
    if not any(isinstance(record, Message) for record in records):
        raise FileDamagedError(
            f"{str(path)!r} has nothing to recover: {reason or 'it has no messages'}"
        )
    try:
        check_metadata(metadata.get(METADATA))
    except ValueError as error:
        raise FileDamagedError(f"{str(path)!r} cannot be recovered: {error}") from error


def _copy(records: Sequence[McapRecord], writer: Writer) -> None:
    """Write records to a new file, in which schemas and channels may have other numbers."""
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for r in records:
        if isinstance(r, Metadata):
            add_metadata(writer, r.name, r.metadata)
        elif isinstance(r, Attachment):
            writer.add_attachment(r.create_time, r.log_time, r.name, r.media_type, r.data)
        elif isinstance(r, Schema):
            schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
        elif isinstance(r, Channel):
            schema, encoding = schemas[r.schema_id], r.message_encoding
            channels[r.id] = writer.register_channel(r.topic, encoding, schema, r.metadata)
        elif isinstance(r, Message):
            channel = channels[r.channel_id]
            writer.add_message(channel, r.log_time, r.data, r.publish_time, r.sequence)
