"""One MCAP file, written so that a crash of the process costs at most a second of it.

Everything goes to `<name>.part`; chunks are closed and handed to the operating system once per
simulated second, without waiting for the disk. A file that is finished is flushed to the disk and
then renamed, so a name without `.part` is always a whole log. A crash of the process therefore
loses at most one simulated second, a crash of the machine whatever the system had not written yet.
"""

from __future__ import annotations

import contextlib
import hashlib
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO

from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer

import aslip
from aslip.errors import ConfigurationError
from aslip.files.writing import commit
from aslip.log.messages import MessageType
from aslip.log.records import METADATA_HASH, metadata_hash

METADATA = "aslip"
"""Name of the metadata record that tells how the log was made."""
END_METADATA = "aslip/end"
"""Name of the metadata record that tells how it ended."""
HASH_KEY = "sha256/"
"""Prefix of the attachments' hashes in the metadata."""

_CHUNK_SIZE = 2**18  # bytes
_MEDIA_TYPES = {".xml": "application/xml", ".json": "application/json", ".zip": "application/zip"}


class LogWriter:
    """Write a log.

    An error of the file system, such as a full disk, ends the log with one `RuntimeWarning`; later
    calls do nothing, and what was written stays in `<path>.part`, from which it can be recovered.

    Args:
        path: of the finished log.
        overwrite: replace a finished log of that name.

    Raises:
        ConfigurationError: there is a log of that name, or an unfinished one, or the file cannot be
            created.
    """

    def __init__(self, path: Path, *, overwrite: bool = False) -> None:
        self.path = path
        self.unfinished = path.with_name(path.name + ".part")
        refuse_existing(path, overwrite=overwrite)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = self.unfinished.open("xb")
        except OSError as error:
            reason = f"cannot write the log {str(path)!r}: {error}"
            if self.unfinished.exists():
                reason = (
                    f"{str(self.unfinished)!r} is a log that was not finished, or is being written;"
                    f" save what is in it with: python -m aslip.log recover {self.unfinished}"
                )
            raise ConfigurationError(reason) from error
        self._writer = open_writer(self._file)
        self._sequence: Counter[int] = Counter()
        self._failed = False

    def attach(self, files: Mapping[str, bytes], metadata: Mapping[str, str]) -> None:
        """Write attachments, and metadata that has the hash of each."""
        hashes = {HASH_KEY + name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        add_metadata(self._writer, METADATA, {**metadata, **hashes})
        for name, data in files.items():
            media = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media, data)

    def open_channel(self, topic: str, kind: MessageType) -> int:
        """Announce a topic; returns what `write` wants to know."""
        schema = self._writer.register_schema(kind.name, SchemaEncoding.ROS2, kind.text.encode())
        return self._writer.register_channel(topic, MessageEncoding.CDR, schema)

    def write(self, channel: int, time_ns: int, data: bytes) -> None:
        """Add a message; each topic counts its own, from 1."""
        self._sequence[channel] += 1
        add, sequence = self._writer.add_message, self._sequence[channel]
        self._attempt(lambda: add(channel, time_ns, data, time_ns, sequence))

    def flush(self) -> None:
        """Close the chunk, and hand everything to the operating system."""
        self._attempt(self._writer.flush)

    def discard(self) -> None:
        """Delete the unfinished file."""
        with contextlib.suppress(OSError):  # what is still buffered may not fit on the disk
            self._file.close()
        self.unfinished.unlink()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Complete the file and give it its name."""
        self._attempt(lambda: self._finish(metadata))

    def _finish(self, metadata: Mapping[str, str]) -> None:
        add_metadata(self._writer, END_METADATA, metadata)
        finish_file(self._writer, self._file, self.path)

    def _attempt(self, action: Callable[[], object]) -> None:
        """Do something to the file unless it has failed before; warn if it fails."""
        if self._failed:
            return
        try:
            action()
        except OSError as error:
            self._failed = True
            with contextlib.suppress(OSError):  # closing writes what is buffered, and fails again
                self._file.close()
            warnings.warn(
                f"the log {str(self.path)!r} ends here, its file cannot be written ({error}); the"
                f" simulation goes on. Free space and save what was written with: python -m"
                f" aslip.log recover {self.unfinished}",
                RuntimeWarning,
                stacklevel=2,
            )


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise ConfigurationError if there is a file that must not be overwritten."""
    if path.exists() and not overwrite:
        raise ConfigurationError(
            f"{str(path)!r} exists; give the log another name, or pass overwrite=True"
        )


def add_metadata(writer: Writer, name: str, metadata: Mapping[str, str]) -> None:
    """Write a metadata record, with its hash."""
    writer.add_metadata(name, {**metadata, METADATA_HASH: metadata_hash(metadata)})


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
    commit(file, path)
