"""Decode messages: flat ones of numbers by NumPy, others by the ROS 2 library, ten times slower."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

Decoder = Callable[[bytes], dict[str, Any]]
"""From a message to its entries; those of nested messages have dotted names."""

_FIELD = re.compile(r"float(32|64)(?:\[(\d+)\])? (\w+)")
# before the numbers of a message; they need no padding if all are of one size
_ENCAPSULATION = 4


def decoder_of(channel: Channel, schema: Schema | None) -> Decoder:
    """Decoder of a channel's messages.

    Raises:
        ValueError: the channel has no schema, or is not encoded as ROS 2 does.
    """
    if schema is None:
        raise ValueError(f"the topic {channel.topic!r} has no schema")
    if (channel.message_encoding, schema.encoding) != (MessageEncoding.CDR, SchemaEncoding.ROS2):
        raise ValueError(f"{channel.topic!r} is encoded in an unknown way")
    dtype = _flat_dtype(schema.data.decode())
    if dtype is not None:
        return lambda data: _flat(data, dtype)
    decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    assert decode is not None  # it knows this encoding
    return lambda data: _flattened(decode(data))


def _flat_dtype(definition: str) -> np.dtype | None:
    """The layout of a message of numbers of one size; None if it is something else."""
    matches = [_FIELD.fullmatch(line) for line in definition.split("\n")]
    fields = [match.groups() for match in matches if match is not None]
    if len(fields) != len(matches) or len({size for size, _, _ in fields}) != 1:
        return None
    number = f"<f{int(fields[0][0]) // 8}"
    return np.dtype([(name, number, (int(n),) if n else ()) for _, n, name in fields])


def _flat(data: bytes, dtype: np.dtype) -> dict[str, Any]:
    if len(data) != _ENCAPSULATION + dtype.itemsize:
        raise ValueError(f"a message of {len(data)} bytes does not fit its definition")
    row = np.frombuffer(data, dtype, offset=_ENCAPSULATION)[0]
    return dict(zip(dtype.names or (), row.item(), strict=True))


def _flattened(message: Any) -> dict[str, Any]:
    """A message's entries by dotted names; lists of messages become lists of their entries."""
    entries: dict[str, Any] = {}
    for name in message.__slots__:
        value = getattr(message, name)
        if hasattr(value, "__slots__") and not isinstance(value, str | bytes):
            nested = _flattened(value)
            entries |= {f"{name}.{key}": item for key, item in nested.items()}
        elif isinstance(value, list) and value and hasattr(value[0], "__slots__"):
            parts = [_flattened(item) for item in value]
            entries |= {f"{name}.{key}": [part[key] for part in parts] for key in parts[0]}
        else:
            entries[name] = value
    return entries
