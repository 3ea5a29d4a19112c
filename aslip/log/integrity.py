"""Check a log, and list every problem."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mcap.records import Channel, McapRecord, Message

from aslip.errors import machine_failed
from aslip.files.archive import open_file
from aslip.files.assets import user_path
from aslip.log.reader import Content, check_metadata, counts_differ, hash_problems
from aslip.log.records import Records, begins_as_mcap, read_summary
from aslip.log.writer import METADATA

_BLOCK = 2**20


def check(path: str | Path) -> list[str]:
    """List the problems of a log; the list is empty if the log is complete and intact.

    The check covers the end of the file, the checksums of attachments, chunks, data and summary,
    the hashes of attachments, the decoding of every message by its schema, the order of times
    within each topic, and the counts of the summary.

    Args:
        path: log to check.

    Raises:
        AssetError: there is no such file.
    """
    path = user_path(path)
    with open_file(path) as file:
        if not begins_as_mcap(file):
            return ["not an MCAP file: wrong magic bytes"]
        records, order, content = Records(file), _Order(), Content()
        for record in records:
            try:
                content.add(record)
            except Exception as error:  # any error of a decoder
                if machine_failed(error):
                    raise
                order.problems.append(str(error))
            order.add(record)
        problems = _summary_problems(file, content, path)
    problems += records.problems + records.bad_attachments + list(dict.fromkeys(order.problems))
    try:
        known = check_metadata(content.metadata.get(METADATA))
    except ValueError as error:
        return [*problems, str(error)]
    return problems + list(hash_problems(known, content.attachments))


def _summary_problems(file: IO[bytes], content: Content, path: Path) -> list[str]:
    """List the problems of the summary and of the data's checksum."""
    try:
        summary = read_summary(file)
    except Exception as error:  # any error of a parser, if the summary was forged
        return [f"{error}; save its content with: python -m aslip.log recover {path}"]
    crc, left = 0, summary.data_size
    file.seek(0)
    while left:
        block = file.read(min(_BLOCK, left))
        crc, left = zlib.crc32(block, crc), left - len(block)
    problems = [] if crc == summary.data_crc else ["data section: checksum differs"]
    return problems + counts_differ(summary.statistics, content)


@dataclass
class _Order:
    """Check that times never decrease within a topic."""

    problems: list[str] = field(default_factory=list)
    _topics: dict[int, str] = field(default_factory=dict)
    _latest: dict[int, int] = field(default_factory=dict)

    def add(self, record: McapRecord) -> None:
        """Check the next record."""
        if isinstance(record, Channel):
            self._topics[record.id] = record.topic
        if not isinstance(record, Message):
            return
        topic, time = self._topics.get(record.channel_id, ""), record.log_time
        if time < self._latest.get(record.channel_id, 0):
            self.problems.append(f"time goes back in {topic!r} at {time} ns")
        if record.publish_time != time:
            self.problems.append(f"{topic!r} has two messages at {time} ns")
        self._latest[record.channel_id] = time
