"""Truncated, altered and foreign logs are refused, and their damage is named."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.records import Attachment, Message, Metadata, Schema

from aslip.errors import FileDamagedError
from aslip.log import Recording, read, recover
from aslip.log.records import intact_records
from aslip.log.writer import METADATA, open_writer
from tests.log.helpers import Alter, read_records, write_records


def _rewritten(
    log: Path, out: Path, metadata: dict[str, str], drop: str = "", alter: str = ""
) -> Path:
    """Rewrite the log with other attachments or metadata, otherwise intact."""
    records = []
    for record in read_records(log.read_bytes()):
        if isinstance(record, Metadata) and record.name == METADATA:
            record = replace(record, metadata=metadata)
        if isinstance(record, Attachment) and record.name == alter:
            record = replace(record, data=record.data + b" ")
        if not isinstance(record, Attachment) or record.name != drop:
            records.append(record)
    out.write_bytes(write_records(records))
    return out


def test_every_flipped_bit_is_found(log: Path, altered: Alter) -> None:
    """In data, summary or footer, also if a topic is read that it does not affect."""
    rng, size = np.random.default_rng(0), log.stat().st_size
    for place in [*rng.integers(size, size=8), *range(size - 80, size, 10)]:
        path = altered(lambda data, at=place: data.__setitem__(at, data[at] ^ 1 << at % 8))
        with pytest.raises(FileDamagedError, match=r"altered\.mcap"):
            read(path, ["/log"])


@pytest.mark.parametrize("function", [read, recover])
def test_a_lack_of_memory_is_no_damage(
    log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, function: Callable[..., object]
) -> None:
    """Recovery would leave out intact chunks."""
    monkeypatch.setattr("zstandard.decompress", Mock(side_effect=MemoryError))
    with pytest.raises(MemoryError):
        function(log, *([tmp_path / "saved.mcap"] if function is recover else []))


def test_error_of_a_damaged_log_names_the_damage_and_the_remedy(altered: Alter) -> None:
    def flip(data: bytearray) -> None:
        data[len(data) // 2] ^= 0x10

    path = altered(flip)
    damage = r"the record at byte \d+ is damaged: its checksum differs"
    with pytest.raises(FileDamagedError, match=f"{damage}; .*recover {re.escape(str(path))}"):
        read(path)


def test_attachments_that_the_metadata_does_not_name_are_refused(
    log: Path, recording: Recording, tmp_path: Path
) -> None:
    """The attachment, or its hash, is missing or another one; all checksums are valid."""
    key = "sha256/config.json"
    about = recording.metadata
    unnamed = {name: text for name, text in about.items() if name != key}
    other = {**about, key: "0" * 64}
    name = "config.json"
    for metadata, drop, alter in (
        (about, name, ""), (about, "", name), (other, "", ""), (unnamed, "", "")
    ):  # fmt: skip
        path = _rewritten(log, tmp_path / "other.mcap", metadata, drop, alter)
        with pytest.raises(FileDamagedError, match=r"attachment 'config\.json' is not the one"):
            read(path)


def test_chunk_of_excessive_size_is_refused(log: Path, tmp_path: Path) -> None:
    records = read_records(log.read_bytes())
    first = next(i for i, record in enumerate(records) if isinstance(record, Message))
    large = records[first]
    assert isinstance(large, Message)
    records[first] = replace(large, data=bytes(2**24))
    path = tmp_path / "bomb.mcap"
    path.write_bytes(write_records(records))
    with pytest.raises(FileDamagedError, match=r"bomb\.mcap.* would decompress to"):
        read(path)


def test_memory_is_bounded_by_the_size_of_the_file(tmp_path: Path) -> None:
    """These messages compress 400 times; constant packets of a robot 30 times."""
    rng = np.random.default_rng(0)
    with (tmp_path / "dense.mcap").open("w+b") as file:
        writer = open_writer(file)
        channel = writer.register_channel(
            "/zeros", "cdr", writer.register_schema("Z", "ros2msg", b"")
        )
        for i in range(100):
            writer.add_message(channel, i, rng.bytes(600) + bytes(2**18 - 600), i)
        writer.finish()
        count = 0
        with pytest.raises(ValueError, match="would decompress to"):
            for record in intact_records(file):
                count += isinstance(record, Message)
        assert count == 2**24 // 2**18 - 1


@pytest.mark.parametrize("count", ["7", "99999999999", "9" * 5000])
def test_schema_with_forged_array_sizes_is_refused(log: Path, tmp_path: Path, count: str) -> None:
    records = read_records(log.read_bytes())
    at = next(i for i, r in enumerate(records) if isinstance(r, Schema) and "Sensors" in r.name)
    schema = records[at]
    assert isinstance(schema, Schema)
    data, found = re.subn(rb"\[\d+\]", f"[{count}]".encode(), schema.data, count=1)
    assert found
    records[at] = replace(schema, data=data)
    path = tmp_path / "sizes.mcap"
    path.write_bytes(write_records(records))
    with pytest.raises(FileDamagedError, match=r"sizes\.mcap"):
        read(path)


def test_other_formats_are_refused(log: Path, recording: Recording, tmp_path: Path) -> None:
    later = {**recording.metadata, "format": "99"}
    path = _rewritten(log, tmp_path / "later.mcap", later)
    for function in (read, recover):
        with pytest.raises(
            FileDamagedError, match=r"format is '99'.*wrote it, aslip 0\."
        ) as raised:
            function(path)
        assert "python -m aslip.log recover" not in str(raised.value)
