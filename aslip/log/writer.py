"""Writer of MCAP files that loses at most a second in a crash of the process.

Records go to `<name>.part`; once per simulated second the chunk is closed and handed to the
operating system, without waiting for the disk. A finished file is flushed to the disk and then
renamed, so that a name without `.part` is always a complete log. A crash of the process loses at
most one simulated second; a crash of the machine also loses data not yet on the disk.
"""

from __future__ import annotations

import contextlib
import hashlib
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer

import aslip
from aslip.base.provenance import commit as commit_of_package
from aslip.base.provenance import versions
from aslip.base.writing import commit
from aslip.errors import ConfigurationError
from aslip.log.messages import FORMAT, MessageType
from aslip.log.records import METADATA_HASH, metadata_hash

METADATA = "aslip"
"""Name of the metadata record about the origin of the log."""
END_METADATA = "aslip/end"
"""Name of the metadata record with the counts at the end."""
HASH_KEY = "sha256/"
"""Prefix of the attachments' hashes in the metadata."""

_CHUNK_SIZE = 2**18  # bytes
# the profile of ROS 2 asks for it; an empty list lets `ros2 bag play` take its defaults
_CHANNEL = {"offered_qos_profiles": "[]"}
_MEDIA_TYPES = {".xml": "application/xml", ".json": "application/json", ".zip": "application/zip"}


class LogWriter:
    """Write a log.

    An error of the file system, such as a full disk, ends the log with one `RuntimeWarning`; later
    calls do nothing, and `<path>.part` can be recovered.

    Args:
        path: log to write.
        overwrite: replace an existing log.

    Raises:
        ConfigurationError: a log or an unfinished log of that name exists, or the file cannot be
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
                    f"{str(self.unfinished)!r} is an unfinished log, or is being written; save its"
                    f" content with: python -m aslip.log recover {self.unfinished}"
                )
            raise ConfigurationError(reason) from error
        self._writer = open_writer(self._file)
        self._sequence: Counter[int] = Counter()
        self._failed = False

    def attach(
        self, files: Mapping[str, bytes], metadata: Mapping[str, str], packages: Iterable[str]
    ) -> None:
        """Write attachments, and metadata with their hashes and about the origin of the log.

        Args:
            files: contents by name.
            metadata: further metadata.
            packages: packages whose versions are written.
        """
        origin = {
            "format": FORMAT,
            "version/aslip": aslip.__version__,
            "commit": commit_of_package() or "",
            **{f"version/{name}": text or "" for name, text in versions(packages).items()},
            "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        hashes = {HASH_KEY + name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        add_metadata(self._writer, METADATA, {**origin, **metadata, **hashes})
        for name, data in files.items():
            media = _MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
            self._writer.add_attachment(0, 0, name, media, data)

    def open_channel(self, topic: str, kind: MessageType) -> int:
        """Register a topic; returns its channel id."""
        schema = self._writer.register_schema(kind.name, SchemaEncoding.ROS2, kind.text.encode())
        return self._writer.register_channel(topic, MessageEncoding.CDR, schema, _CHANNEL)

    def write(self, channel: int, time_ns: int, data: bytes) -> None:
        """Write a message; each topic has its own sequence numbers, from 1."""
        self._sequence[channel] += 1
        add, sequence = self._writer.add_message, self._sequence[channel]
        self._attempt(lambda: add(channel, time_ns, data, time_ns, sequence))

    def flush(self) -> None:
        """Close the chunk and hand all bytes to the operating system."""
        self._attempt(self._writer.flush)

    def discard(self) -> None:
        """Delete the unfinished file."""
        with contextlib.suppress(OSError):  # the buffer may not fit on the disk
            self._file.close()
        self.unfinished.unlink()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Finish the file and rename it."""
        self._attempt(lambda: self._finish(metadata))

    def _finish(self, metadata: Mapping[str, str]) -> None:
        add_metadata(self._writer, END_METADATA, metadata)
        finish_file(self._writer, self._file, self.path)

    def _attempt(self, action: Callable[[], object]) -> None:
        """Run an action on the file unless one has failed before; warn if it fails."""
        if self._failed:
            return
        try:
            action()
        except OSError as error:
            self._failed = True
            with contextlib.suppress(OSError):  # closing writes the buffer, and fails again
                self._file.close()
            warnings.warn(
                f"the log {str(self.path)!r} ends here, its file cannot be written ({error}); the"
                f" simulation continues. Free space, and save the written part with: python -m"
                f" aslip.log recover {self.unfinished}",
                RuntimeWarning,
                stacklevel=2,
            )


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise ConfigurationError if a file exists and must not be overwritten."""
    if path.exists() and not overwrite:
        raise ConfigurationError(
            f"{str(path)!r} exists; give the log another name, or pass overwrite=True"
        )


def add_metadata(writer: Writer, name: str, metadata: Mapping[str, str]) -> None:
    """Write a metadata record, with its hash."""
    writer.add_metadata(name, {**metadata, METADATA_HASH: metadata_hash(metadata)})


def open_writer(file: IO[bytes]) -> Writer:
    """Start an MCAP writer with the settings of all logs."""
    writer = Writer(
        file, chunk_size=_CHUNK_SIZE, compression=CompressionType.ZSTD, enable_data_crcs=True
    )
    writer.start(profile=Profile.ROS2, library=f"aslip {aslip.__version__}")
    return writer


def finish_file(writer: Writer, file: IO[bytes], path: Path) -> None:
    """Finish a temporary file and rename it."""
    writer.finish()
    commit(file, path)
