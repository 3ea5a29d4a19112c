"""Is a log whole and intact? Every problem by name."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from pathlib import Path
from typing import IO

from mcap.reader import make_reader
from mcap.records import Attachment, Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from aslip.log.reader import (
    FOOTER,
    MAGIC,
    begins_as_mcap,
    check_metadata,
    ending_problem,
    hash_problems,
    open_log,
)
from aslip.log.writer import METADATA

_DATA_END_SIZE = 1 + 8 + 4


def check(path: str | Path) -> list[str]:
    """Problems of a log; empty if it is as it was written.

    Checks that it was finished; every checksum, of each attachment and chunk, of all data and of
    the summary; attachments against their hashes; that messages decode, each by a schema; that time
    does not go back within a topic; and that the summary counts what there is.

    Args:
        path: of a log.

    Raises:
        AssetError: there is no such file.
    """
    path = Path(path)
    with open_log(path) as file:
        if not begins_as_mcap(file):
            return ["it is no MCAP file: it does not begin as one"]
        problem = ending_problem(file)
        file.seek(0)
        data = file.read()
    problems = [problem] if problem else []
    try:
        if not problem:
            problems += _checksum_problems(data)
        problems += _content_problems(path, finished=not problems)
    except Exception as error:  # one cause, a bad file, has many exceptions
        problems.append(f"cannot be read to its end ({type(error).__name__}: {error})")
    return problems


def _checksum_problems(data: bytes) -> list[str]:
    """Checksums over the data section and over the summary."""
    tail = FOOTER.size + len(MAGIC)
    _, _, start, _, summary_crc = FOOTER.unpack(data[-tail : -len(MAGIC)])
    problems = []
    (data_crc,) = struct.unpack("<I", data[start - 4 : start])
    if zlib.crc32(data[: start - _DATA_END_SIZE]) != data_crc:
        problems.append("a byte of the data is wrong: their checksum differs")
    if zlib.crc32(data[start : -len(MAGIC) - 4]) != summary_crc:
        problems.append("a byte of the summary is wrong: its checksum differs")
    return problems


def _content_problems(path: Path, *, finished: bool) -> list[str]:
    """What is in the records."""
    problems: list[str] = []
    metadata: dict[str, dict[str, str]] = {}
    attachments: dict[str, bytes] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    latest: dict[int, int] = {}
    counts: Counter[int] = Counter()
    decoders = DecoderFactory()
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, DataEnd):
                break
            if isinstance(record, Metadata):
                metadata[record.name] = dict(record.metadata)
            elif isinstance(record, Attachment):
                attachments[record.name] = bytes(record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                if record.schema_id not in schemas:
                    problems.append(f"the topic {record.topic!r} has no schema")
            elif isinstance(record, Message):
                channel, counts[record.channel_id] = (
                    channels[record.channel_id],
                    (counts[record.channel_id] + 1),
                )
                if record.log_time < latest.get(channel.id, 0):
                    problems.append(f"time goes back in {channel.topic!r} at {record.log_time} ns")
                if record.publish_time != record.log_time:
                    problems.append(f"{channel.topic!r} has two times at {record.log_time} ns")
                latest[channel.id] = record.log_time
                decoder = decoders.decoder_for(
                    channel.message_encoding, schemas.get(channel.schema_id)
                )
                if decoder is None:
                    problems.append(f"{channel.topic!r} is encoded in an unknown way")
                else:
                    decoder(record.data)
        if finished:
            file.seek(0)
            problems += _summary_problems(file, counts)
    try:
        known = check_metadata(metadata.get(METADATA))
    except ValueError as error:
        return [*problems, str(error)]
    return problems + list(hash_problems(known, attachments))


def _summary_problems(file: IO[bytes], counts: Counter[int]) -> list[str]:
    summary = make_reader(file, validate_crcs=True).get_summary()
    if summary is None or summary.statistics is None:
        return ["its summary is missing"]
    if dict(summary.statistics.channel_message_counts) != dict(counts):
        return ["its summary counts other messages than there are"]
    return []
