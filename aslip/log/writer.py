"""One MCAP file, written so that a crash costs at most a second of it.

Everything goes to `<name>.part`; chunks are closed and handed to the system once per simulated
second; a file that is finished is renamed. So a name without `.part` is always a whole log.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

import aslip
from aslip.errors import ConfigurationError
from aslip.log.messages import MessageType

METADATA = "aslip"
"""Name of the metadata record that tells how the log was made."""
END_METADATA = "aslip/end"
"""Name of the metadata record that tells how it ended."""
HASH_KEY = "sha256/"
"""Prefix of the attachments' hashes in the metadata."""

_CHUNK_SIZE = 2**18  # bytes
_MEDIA_TYPES = {".xml": "application/xml", ".json": "application/json", ".zip": "application/zip"}


class LogWriter:
    """A log that is being written.

    Args:
        path: of the finished log.

    Raises:
        ConfigurationError: there is an unfinished log of that name.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.unfinished = path.with_name(path.name + ".part")
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file: IO[bytes] = self.unfinished.open("xb")
        except FileExistsError:
            raise ConfigurationError(
                f"{str(self.unfinished)!r} is a log that was not finished, or is being written;"
                f" save what is in it with: python -m aslip.log recover {self.unfinished}"
            ) from None
        self._writer = open_writer(self._file)
        self._channels: dict[str, int] = {}
        self._sequence = 0

    def attach(self, files: Mapping[str, bytes], metadata: Mapping[str, str]) -> None:
        """Write attachments, and metadata that has the hash of each."""
        hashes = {HASH_KEY + name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        self._writer.add_metadata(METADATA, {**metadata, **hashes})
        for name, data in files.items():
            media = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media, data)

    def open_channel(self, topic: str, kind: MessageType) -> int:
        """Announce a topic; returns what `write` wants to know."""
        schema = self._writer.register_schema(kind.name, SchemaEncoding.ROS2, kind.text.encode())
        return self._writer.register_channel(topic, MessageEncoding.CDR, schema)

    def write(self, channel: int, time_ns: int, data: bytes) -> None:
        """Add a message."""
        self._sequence += 1
        self._writer.add_message(channel, time_ns, data, time_ns, self._sequence)

    def flush(self) -> None:
        """Close the chunk, and hand all that there is to the system."""
        self._writer.flush()

    def discard(self) -> None:
        """Take the unfinished file away."""
        self._file.close()
        self.unfinished.unlink()

    def finish(self, metadata: Mapping[str, str]) -> Path:
        """Complete the file and give it its name."""
        self._writer.add_metadata(END_METADATA, dict(metadata))
        finish_file(self._writer, self._file, self.path)
        return self.path


def open_writer(file: IO[bytes]) -> Writer:
    """An MCAP writer with the settings of all our logs, started."""
    writer = Writer(
        file, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD, enable_data_crcs=True
    )
    writer.start(profile="", library=f"aslip {aslip.__version__}")
    return writer


def finish_file(writer: Writer, file: IO[bytes], path: Path) -> None:
    """Complete what was written under a temporary name, and rename it."""
    writer.finish()
    file.flush()
    os.fsync(file.fileno())
    file.close()
    os.replace(file.name, path)
