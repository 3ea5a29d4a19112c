"""Layout of a packet: named fields, little-endian and without padding, as a NumPy record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from aslip.errors import ShapeError

FLOAT = "<f4"
FLAG = "?"


class Field(NamedTuple):
    """Named field of a packet, or a group of fields."""

    name: str
    kind: str | tuple[Field, ...]
    """Type of a number in NumPy's notation, or the fields of a group."""
    count: int = 1
    """Count of numbers of the field, or of repetitions of the group; 1 adds no axis."""
    meaning: str = ""
    """Content, with unit and frame."""


class Place(NamedTuple):
    """Field of a packet at its place in the payload."""

    offset: int
    """First byte."""
    path: str
    """Names of groups and field, joined by dots."""
    kind: str
    """Type of a number in NumPy's notation."""
    count: int
    """Number of numbers."""
    meaning: str
    """Content, with unit and frame."""


@dataclass(frozen=True, eq=False)
class Packet:
    """Kind of packet, the payload of a datagram."""

    name: str
    """Name in the public C headers."""
    fields: tuple[Field, ...]

    @cached_property
    def dtype(self) -> np.dtype:
        """Record of the fields."""
        return _dtype(self.fields)

    @property
    def size(self) -> int:
        """Bytes of a payload, without the datagram's header."""
        return self.dtype.itemsize

    def zeros(self, *shape: int) -> np.ndarray:
        """Records of an array's shape, all zero; one record by default."""
        return np.zeros(shape, self.dtype)

    def pack(self, records: np.ndarray) -> bytes:
        """Convert a record, or several one after the other, to bytes.

        Raises:
            ShapeError: the records are of another kind.
        """
        if records.dtype != self.dtype:
            raise ShapeError(f"a record of {self.name} is needed, got {records.dtype}")
        return records.tobytes()

    def unpack(self, payload: bytes) -> np.ndarray:
        """Convert a payload to a record of shape (); copies.

        Raises:
            ShapeError: the payload has another size.
        """
        if len(payload) != self.size:
            raise ShapeError(f"a payload of {self.name} has {self.size} bytes, got {len(payload)}")
        return self.decode(np.frombuffer(payload, np.uint8))

    def decode(self, payloads: np.ndarray) -> np.ndarray:
        """Convert bytes (*b, `size`) to records (*b); any nonzero byte is a true flag.

        Raises:
            ShapeError: the last axis has another size.
        """
        if payloads.dtype != np.uint8 or payloads.shape[-1:] != (self.size,):
            raise ShapeError(
                f"payloads of {self.name} are bytes (*b, {self.size}),"
                f" got {payloads.dtype} {payloads.shape}"
            )
        raw = payloads.copy()
        if self._flags.size:
            raw[..., self._flags] = raw[..., self._flags] != 0
        return raw.view(self.dtype)[..., 0]

    def is_finite(self, records: np.ndarray) -> np.ndarray:
        """(*b) bool, True if all floating-point numbers of a record are finite."""
        raw = np.asarray(records, order="C")[..., None].view(np.uint8)
        # take: its result is contiguous, as the view needs
        return np.asarray(np.isfinite(raw.take(self._floats, axis=-1).view(FLOAT)).all(-1))

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Fields in the order of their bytes; repeated groups are expanded."""
        return tuple(_places(self.fields, "", 0))

    @cached_property
    def _floats(self) -> np.ndarray:
        return self._bytes_of(FLOAT)

    @cached_property
    def _flags(self) -> np.ndarray:
        return self._bytes_of(FLAG)

    def _bytes_of(self, kind: str) -> np.ndarray:
        """Places of all bytes of numbers of a type."""
        width = np.dtype(kind).itemsize
        ranges = [
            np.arange(place.offset, place.offset + width * place.count)
            for place in self.places
            if place.kind == kind
        ]
        return np.concatenate([*ranges, np.zeros(0, dtype=int)])


def _dtype(fields: tuple[Field, ...]) -> np.dtype:
    """Unpadded record of fields."""
    entries = []
    for field in fields:
        kind = field.kind if isinstance(field.kind, str) else _dtype(field.kind)
        entries.append(
            (field.name, kind, (field.count,)) if field.count > 1 else (field.name, kind)
        )
    return np.dtype(entries)


def _places(fields: tuple[Field, ...], prefix: str, offset: int) -> Iterator[Place]:
    """Places of fields and of the fields in groups."""
    for field in fields:
        path = prefix + field.name
        if isinstance(field.kind, str):
            yield Place(offset, path, field.kind, field.count, field.meaning)
            offset += np.dtype(field.kind).itemsize * field.count
            continue
        for i in range(field.count):
            index = f"[{i}]" if field.count > 1 else ""
            yield from _places(field.kind, f"{path}{index}.", offset)
            offset += _dtype(field.kind).itemsize
