"""Layout of a packet: named fields, little-endian and without padding, as a NumPy record."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from aslip.errors import ShapeError, UnknownNameError

FLOAT = "<f4"
FLAG = "?"


class Field(NamedTuple):
    """Named field of a packet, or a group of fields."""

    name: str
    kind: str | tuple[Field, ...]
    """Type of a number in NumPy's notation, or the fields of a group."""
    count: int = 1
    """Number of numbers in the field, or of repetitions of the group; 1 adds no axis."""
    meaning: str = ""
    """Content, with unit and frame."""


class Place(NamedTuple):
    """Field of a packet with its offset in the payload."""

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
        """Zero records of a given shape; one record by default."""
        return np.zeros(shape, self.dtype)

    def pack(self, records: np.ndarray) -> bytes:
        """Convert a record, or several one after the other, to bytes.

        Raises:
            ShapeError: the records are of another kind.
        """
        if records.dtype != self.dtype:
            raise ShapeError(f"a record of {self.name} is needed, got {records.dtype}")
        return records.tobytes()

    def unpack(self, payload: bytes | bytearray) -> np.ndarray:
        """Convert a payload to a record of shape (); copies.

        Raises:
            ShapeError: the payload has another size.
        """
        if len(payload) != self.size:
            raise ShapeError(f"a payload of {self.name} has {self.size} bytes, got {len(payload)}")
        raw = bytearray(payload)
        for flag in self._flags:
            raw[flag] = raw[flag] != 0
        return np.ndarray((), self.dtype, raw)

    def is_finite(self, records: np.ndarray) -> np.ndarray:
        """(*b) bool, True if all floating-point numbers of a record are finite."""
        return np.asarray(np.isfinite(self._floats.read(records)).all(-1))

    def numbers(self, *paths: str) -> Numbers:
        """Select floating-point numbers to be read or written together.

        Args:
            paths: paths of `places` without indices: "left_leg.drives.position" selects five.

        Raises:
            UnknownNameError: there is no floating-point number at a path.
        """
        all_offsets: dict[str, list[int]] = {}
        for place in self.places:
            if place.kind == FLOAT:
                offsets = all_offsets.setdefault(re.sub(r"\[\d+\]", "", place.path), [])
                offsets.extend(range(place.offset, place.offset + 4 * place.count, 4))
        for path in paths:
            if path not in all_offsets:
                raise UnknownNameError(
                    f"{self.name} has no numbers at {path!r}; there are {list(all_offsets)}"
                )
        return Numbers(np.array([offset for path in paths for offset in all_offsets[path]]))

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """Fields in the order of their bytes; repeated groups are expanded."""
        return tuple(_places(self.fields, "", 0))

    @cached_property
    def _floats(self) -> Numbers:
        """All floating-point numbers."""
        floats = [place for place in self.places if place.kind == FLOAT]
        offsets = [np.arange(place.offset, place.offset + 4 * place.count, 4) for place in floats]
        return Numbers(np.concatenate(offsets))

    @cached_property
    def _flags(self) -> list[int]:
        """Bytes of all flags in the payload."""
        flags = [place for place in self.places if place.kind == FLAG]
        return [flag.offset + i for flag in flags for i in range(flag.count)]


class Numbers:
    """Floating-point numbers of a packet that are read or written together.

    Args:
        offsets: (k,) first bytes of the numbers.
    """

    def __init__(self, offsets: np.ndarray) -> None:
        self._bytes = (offsets[:, None] + np.arange(4)).reshape(-1)

    def read(self, records: np.ndarray) -> np.ndarray:
        """(*b, k) copy of the numbers of records (*b)."""
        # take: its result is contiguous, as the view needs
        return _raw(np.asarray(records, order="C")).take(self._bytes, axis=-1).view(FLOAT)

    def write(self, records: np.ndarray, values: np.ndarray) -> None:
        """Write (*b, k) numbers, rounded to single precision, to contiguous records (*b)."""
        single = np.asarray(values, dtype=FLOAT, order="C")
        _raw(records)[..., self._bytes] = single.view(np.uint8)


def _raw(records: np.ndarray) -> np.ndarray:
    """Bytes (*b, size) of contiguous records (*b), as a view."""
    return records[..., None].view(np.uint8)


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
