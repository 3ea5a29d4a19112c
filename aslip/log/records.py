"""Sequential reading of MCAP records that skips damaged ones.

Every part of a log has a checksum: chunks, attachments and the summary in MCAP's fields, metadata
in an entry. Damaged parts are skipped and reported, so that a flipped bit costs one chunk and not
the rest of the file. Memory is bounded by the size of the file and `LARGEST_CHUNK`, even if the
file states larger lengths.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO
from typing import IO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    DataEnd,
    McapRecord,
    Message,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, breakup_chunk

from aslip.errors import machine_failed

LARGEST_CHUNK: Final = 2**24
"""Size above which a chunk counts as damaged [bytes]; ours have a quarter of a megabyte."""
METADATA_HASH: Final = "sha256"
"""Key of the hash of all other entries in a metadata record."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
# opcode, length, starts of the summary and of its offsets, checksum of the summary
_FOOTER = struct.Struct("<BQQQI")
# largest ratio of a chunk's size to its compressed size
_DENSEST = 1000
# largest ratio of all chunks to the file; constant packets reach 30
_DENSEST_FILE = 60
_IGNORED = (Opcode.HEADER, Opcode.MESSAGE_INDEX)


def begins_as_mcap(file: IO[bytes]) -> bool:
    """True if a file starts with the magic bytes of MCAP."""
    file.seek(0)
    return file.read(len(_MAGIC)) == _MAGIC


def metadata_hash(metadata: Mapping[str, str]) -> str:
    """SHA-256 of the entries of a metadata record, without the entry of the hash."""
    entries = sorted((key, text) for key, text in metadata.items() if key != METADATA_HASH)
    return hashlib.sha256(json.dumps(entries).encode()).hexdigest()


@dataclass
class Summary:
    """Summary section at the end of a finished file."""

    statistics: Statistics
    """Counts of messages, channels and other records."""
    definitions: list[Schema | Channel]
    """Schemas and channels, repeated."""
    data_crc: int
    """Checksum of the data section."""
    data_size: int
    """Size of the data section [bytes]."""


def read_summary(file: IO[bytes]) -> Summary:
    """Read the summary of a finished file.

    Raises:
        ValueError: the file was not finished, or its summary is damaged.
    """
    size = file.seek(0, os.SEEK_END)
    tail = _FOOTER.size + len(_MAGIC)
    file.seek(max(size - tail, 0))
    ending = file.read()
    if not ending.endswith(_MAGIC) or size < tail + len(_MAGIC):
        raise ValueError("unfinished: no magic bytes of MCAP at the end")
    opcode, length, start, _, crc = _FOOTER.unpack(ending[: -len(_MAGIC)])
    data_end = start - _HEAD.size - 4
    if opcode != Opcode.FOOTER or length != _FOOTER.size - _HEAD.size or not 0 < data_end < size:
        raise ValueError("the footer is damaged")
    file.seek(data_end)
    end = file.read(start - data_end)
    summary = file.read(size - start - len(_MAGIC))
    if zlib.crc32(summary[:-4]) != crc:
        raise ValueError("the summary is damaged: its checksum differs")
    records = list(StreamReader(BytesIO(summary + _MAGIC), skip_magic=True).records)
    counts = [record for record in records if isinstance(record, Statistics)]
    if not counts:
        raise ValueError("the summary has no statistics")
    definitions = [record for record in records if isinstance(record, Schema | Channel)]
    return Summary(counts[0], definitions, *struct.unpack("<I", end[-4:]), data_end)


@dataclass
class Records:
    """Records of the data section of a file, without indexes; iterate once.

    Yields `Metadata`, `Attachment`, `Schema`, `Channel` and `Message` records that are intact.
    """

    file: IO[bytes]
    """File, open for reading."""
    problems: list[str] = field(default_factory=list)
    """Damage, skipped or at the end of what can be read, except in attachments."""
    bad_attachments: list[str] = field(default_factory=list)
    """Damage of skipped attachments."""
    bad_chunks: int = 0
    """Number of skipped chunks."""
    whole: bool = False
    """True once the end of the data section is reached."""
    _content: int = 0

    def __iter__(self) -> Iterator[McapRecord]:
        if not begins_as_mcap(self.file):
            self.problems.append("not an MCAP file: wrong magic bytes")
            return
        size = os.fstat(self.file.fileno()).st_size
        while not self.whole:
            offset = self.file.tell()
            head = self.file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, size)
            if length > size - offset - _HEAD.size:
                self.problems.append(
                    f"the record at byte {offset} is cut off, or its length is wrong"
                )
                return
            content = self.file.read(length)
            try:
                yield from self._intact(opcode, content)
            except Exception as error:  # any error of a parser
                if machine_failed(error):
                    raise
                self._skip(opcode, offset, error)

    def _intact(self, opcode: int, content: bytes) -> list[McapRecord]:
        """Records of one record at the top level, such as the messages of a chunk."""
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.CHUNK:
            chunk = Chunk.read(stream)
            records = _opened(chunk)
            self._content += chunk.uncompressed_size
            size = os.fstat(self.file.fileno()).st_size
            if self._content > max(LARGEST_CHUNK, _DENSEST_FILE * size):
                raise ValueError(
                    f"a file of {size} bytes would decompress to {self._content} bytes"
                )
            return records
        if opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream)
            if struct.pack("<I", zlib.crc32(content[:-4])) != content[-4:]:
                raise ValueError(f"the checksum of {attachment.name!r} differs")
            return [attachment]
        if opcode == Opcode.METADATA:
            return [_checked(Metadata.read(stream))]
        if opcode == Opcode.DATA_END:
            DataEnd.read(stream)
            self.whole = True
        elif opcode not in _IGNORED:
            raise ValueError(f"its opcode {opcode} is unknown")
        return []

    def _skip(self, opcode: int, offset: int, error: Exception) -> None:
        kinds = {int(Opcode.CHUNK): "chunk", int(Opcode.ATTACHMENT): "attachment"}
        reason = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
        to = self.bad_attachments if opcode == Opcode.ATTACHMENT else self.problems
        to.append(f"the {kinds.get(opcode, 'record')} at byte {offset} is damaged: {reason}")
        self.bad_chunks += opcode == Opcode.CHUNK


def _opened(chunk: Chunk) -> list[McapRecord]:
    """Decompress and check the schemas, channels and messages of a chunk.

    Raises:
        ValueError: the chunk is damaged.
    """
    size = chunk.uncompressed_size
    if chunk.compression != "zstd":
        raise ValueError(f"its compression is {chunk.compression!r}")
    if size > min(LARGEST_CHUNK, _DENSEST * len(chunk.data)):
        raise ValueError(f"it would decompress to {size} bytes")
    # decompression allocates the size in the compressed bytes, not that in the chunk
    if zstandard.frame_content_size(chunk.data) != size:
        raise ValueError("its size differs from that in its compressed data")
    data = zstandard.decompress(chunk.data)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum differs")
    records = breakup_chunk(replace(chunk, compression="", data=data))
    if not all(isinstance(record, Schema | Channel | Message) for record in records):
        raise ValueError("it has records other than messages")
    return records


def _checked(metadata: Metadata) -> Metadata:
    """Check the hash of a metadata record, if it has one.

    Raises:
        ValueError: the hash differs.
    """
    known = metadata.metadata.get(METADATA_HASH)
    if known is not None and known != metadata_hash(metadata.metadata):
        raise ValueError(f"the SHA-256 of the metadata {metadata.name!r} differs")
    return metadata
