"""Records of an MCAP file, in order, up to the first damage.

Chunks, attachments, the data section and the summary have checksums, metadata has a hash in an
entry. Memory is bounded by the size of the file and `LARGEST_CHUNK`, even if the file states larger
lengths.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from io import BytesIO
from typing import IO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from aslip.errors import machine_failed

LARGEST_CHUNK: Final = 2**24
"""Size above which a chunk counts as damaged [bytes]; ours have a quarter of a megabyte."""
METADATA_HASH: Final = "sha256"
"""Key of the hash of all other entries in a metadata record."""

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
# opcode, length, starts of the summary and of its offsets, checksum of the summary
_FOOTER = struct.Struct("<BQQQI")
# largest ratio of all chunks to the file; constant packets reach 30
_DENSEST_FILE = 60
_BLOCK = 2**20


class FormatError(ValueError):
    """File of a format that this version does not read."""


def metadata_hash(metadata: Mapping[str, str]) -> str:
    """SHA-256 of the entries of a metadata record, without the entry of the hash."""
    entries = sorted((key, text) for key, text in metadata.items() if key != METADATA_HASH)
    return hashlib.sha256(json.dumps(entries).encode()).hexdigest()


def check_checksums(file: IO[bytes]) -> None:
    """Check the end of a finished file, and the checksums of its summary and data section.

    Raises:
        ValueError: the file was not finished, or is damaged.
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
    file.seek(start - 4)
    (data_crc,) = struct.unpack("<I", file.read(4))
    if zlib.crc32(file.read(size - start - len(_MAGIC) - 4)) != crc:
        raise ValueError("the summary is damaged: its checksum differs")
    file.seek(0)
    present = 0
    for first in range(0, data_end, _BLOCK):
        present = zlib.crc32(file.read(min(_BLOCK, data_end - first)), present)
    if present != data_crc:
        raise ValueError("the data section is damaged: its checksum differs")


def intact_records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Metadata, attachments, schemas, channels and messages of the data section, in order.

    Raises:
        FormatError: the file does not begin as an MCAP file.
        ValueError: the next record is damaged or cut off; all before it are intact.
    """
    size, content = os.fstat(file.fileno()).st_size, 0
    file.seek(0)
    if file.read(len(_MAGIC)) != _MAGIC:
        raise FormatError("it is not an MCAP file: wrong magic bytes")
    opcode = 0
    while opcode != Opcode.DATA_END:
        offset = file.tell()
        head = file.read(_HEAD.size)
        opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, size)
        if length > size - offset - _HEAD.size:
            raise ValueError(f"unfinished or cut off: it ends within the record at byte {offset}")
        data = file.read(length)
        try:
            if opcode == Opcode.CHUNK:
                chunk = Chunk.read(ReadDataStream(BytesIO(data)))
                content += chunk.uncompressed_size
                if content > max(LARGEST_CHUNK, _DENSEST_FILE * size):
                    raise ValueError(f"a file of {size} bytes would decompress to {content} bytes")
                records = _opened(chunk)
            else:
                records = _parsed(opcode, data)
        except Exception as error:  # any error of a parser
            if machine_failed(error):
                raise
            # messages of a parser need their type to be understood
            why = str(error) if type(error) is ValueError else f"{type(error).__name__}: {error}"
            raise ValueError(f"the record at byte {offset} is damaged: {why}") from error
        yield from records


def _parsed(opcode: int, data: bytes) -> list[McapRecord]:
    """Record outside of chunks, if it has content.

    Raises:
        ValueError: the record is damaged or unknown.
    """
    if opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(ReadDataStream(BytesIO(data)))
        if struct.pack("<I", zlib.crc32(data[:-4])) != data[-4:]:
            raise ValueError(f"the checksum of {attachment.name!r} differs")
        return [attachment]
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(ReadDataStream(BytesIO(data)))
        if metadata.metadata.get(METADATA_HASH) != metadata_hash(metadata.metadata):
            raise ValueError(f"the SHA-256 of the metadata {metadata.name!r} differs")
        return [metadata]
    if opcode not in (Opcode.HEADER, Opcode.MESSAGE_INDEX, Opcode.DATA_END):
        raise ValueError(f"its opcode {opcode} is unknown")
    return []


def _opened(chunk: Chunk) -> list[McapRecord]:
    """Decompress and check the schemas, channels and messages of a chunk.

    Raises:
        ValueError: the chunk is damaged.
    """
    size = chunk.uncompressed_size
    if chunk.compression != "zstd":
        raise ValueError(f"its compression is {chunk.compression!r}")
    # decompression allocates the size in the compressed bytes, not that in the chunk
    if size > LARGEST_CHUNK or zstandard.frame_content_size(chunk.data) != size:
        raise ValueError(f"it would decompress to {size} bytes, or to another size")
    data = zstandard.decompress(chunk.data)
    if zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum differs")
    records = breakup_chunk(replace(chunk, compression="", data=data))
    if not all(isinstance(record, Schema | Channel | Message) for record in records):
        raise ValueError("it has records other than messages")
    return records
