"""Save what is left of a log that was cut off or damaged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log.reader import open_log
from aslip.log.writer import END_METADATA, finish_file, open_writer

RECOVERED_METADATA = "aslip/recovered"
"""Name of the metadata record of a log that was recovered."""


@dataclass(frozen=True)
class Recovery:
    """What was saved."""

    path: Path
    """Of the recovered log."""
    messages: int
    """How many were saved."""
    until: float
    """Simulated time of the last one [s]."""
    complete: bool
    """Whether the damaged file turned out to have everything but its end."""
    reason: str
    """What stopped reading."""


def recover(path: str | Path, out: str | Path | None = None) -> Recovery:
    """Write a whole log of what can be read from the beginning of a damaged one.

    Reading stops at the first thing that is wrong; nothing before it is left out.

    Args:
        path: of the damaged log, often `<name>.mcap.part`.
        out: of the new log; `<name>.recovered.mcap` by default.

    Raises:
        AssetError: there is no such file.
        ConfigurationError: `out` is the damaged file itself, or exists.
        FileDamagedError: not one message can be read.
    """
    path = Path(path)
    out = path.with_name(path.name.split(".mcap")[0] + ".recovered.mcap") if out is None else out
    out = Path(out)
    if out.exists():
        raise ConfigurationError(f"{str(out)!r} exists; give the recovered log another name")
    # not ".part", which the damaged log, or one that is being written, may be called
    temporary = out.with_name(out.name + ".recovering")
    with open_log(path) as damaged, temporary.open("wb") as file:
        try:
            recovery = _copy(damaged, file, out)
        except BaseException:
            temporary.unlink()
            raise
    return recovery


def _copy(damaged: IO[bytes], file: IO[bytes], out: Path) -> Recovery:
    writer = open_writer(file)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    count, until, whole = 0, 0, False
    source = _Records(damaged)
    for record in source:
        if isinstance(record, DataEnd):
            whole = True
            break
        if isinstance(record, Metadata):
            writer.add_metadata(record.name, dict(record.metadata))
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            channels[record.id] = writer.register_channel(
                record.topic,
                record.message_encoding,
                schemas.get(record.schema_id, 0),
                dict(record.metadata),
            )
        elif isinstance(record, Message):
            count, until = count + 1, max(until, record.log_time)
            writer.add_message(
                channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
    if count == 0:
        reason = source.reason or "it is empty"
        raise FileDamagedError(f"{damaged.name!r} has nothing to recover: {reason}")
    reason = source.reason or "nothing"
    writer.add_metadata(
        RECOVERED_METADATA, {"messages": str(count), "until_ns": str(until), "stopped_by": reason}
    )
    if not whole:
        writer.add_metadata(END_METADATA, {"recovered": "true"})
    finish_file(writer, file, out)
    return Recovery(out, count, until / 1e9, whole, reason)


class _Records:
    """Records of a stream up to the first that is wrong; then `reason` tells what was."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.reason = ""

    def __iter__(self) -> Iterator[McapRecord]:
        records = None
        while True:
            try:
                if records is None:
                    records = iter(StreamReader(self._file, validate_crcs=True).records)
                record = next(records)
            except StopIteration:
                return
            except Exception as error:  # whatever a parser trips over
                self.reason = f"{type(error).__name__}: {error}"
                return
            yield record
