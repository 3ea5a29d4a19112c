"""Truncated, altered and foreign logs are refused, and their damage is named."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Message, Metadata, Schema

from aslip.errors import AssetError, FileDamagedError
from aslip.log import Recording, check, read, recover, replay
from aslip.log.messages import FORMAT
from aslip.log.records import Records
from aslip.log.writer import METADATA, add_metadata, open_writer
from tests.log.helpers import Alter, assert_subset, read_records, write_records

MAGIC = b"\x89MCAP0\r\n"


def _rewritten(
    log: Path, out: Path, metadata: dict[str, str] | None, drop: str = "", alter: str = ""
) -> Path:
    """Rewrite the log with other attachments or metadata, otherwise intact."""
    records = []
    for record in read_records(log.read_bytes()):
        if isinstance(record, Metadata) and record.name == METADATA:
            record = replace(record, metadata=metadata or record.metadata)
        if isinstance(record, Attachment) and record.name == alter:
            record = replace(record, data=record.data.replace(b"9.81", b"9.80") + b" ")
        if not isinstance(record, Attachment) or record.name != drop:
            records.append(record)
    out.write_bytes(write_records(records))
    return out


def assert_same(one: Recording, other: Recording) -> None:
    """Check that two logs are bit-equal."""
    assert one.metadata == other.metadata
    assert one.end == other.end
    assert one.attachments == other.attachments
    assert one.series.keys() == other.series.keys()
    for topic, series in one.series.items():
        np.testing.assert_array_equal(series.time, other[topic].time)
        assert series.columns.keys() == other[topic].columns.keys()
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, other[topic][name], err_msg=topic + name)


def test_complete_log_has_no_problems(log: Path) -> None:
    assert check(log) == []


@pytest.mark.parametrize("seed", range(40))
def test_flipped_byte_is_found(altered: Alter, whole: Recording, seed: int) -> None:
    """A flipped bit anywhere, in data or summary."""
    rng = np.random.default_rng(seed)

    def flip(data: bytearray) -> None:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))

    path = altered(flip)
    assert check(path)
    try:
        found = read(path)
    except FileDamagedError as error:
        assert "altered.mcap" in str(error)
    else:
        assert_same(found, whole)


def test_reading_verifies_summary_and_metadata(log: Path, altered: Alter) -> None:
    """A changed topic name in the summary, a changed word in the metadata."""
    data = log.read_bytes()
    places = {"summary is damaged": data.rindex(b"phase"), "metadata": data.index(b"Linux")}
    for message, place in places.items():
        path = altered(lambda d, at=place: d.__setitem__(at, d[at] ^ 1))
        with pytest.raises(FileDamagedError, match=message):
            read(path)


def test_topics_are_read_beside_a_damaged_attachment(
    log: Path, altered: Alter, whole: Recording
) -> None:
    place = log.read_bytes().index(b"WeightedReward")
    path = altered(lambda data: data.__setitem__(place, data[place] ^ 1))
    with pytest.raises(FileDamagedError, match=r"attachment.*config\.json"):
        read(path)
    some = read(path, ["/step", "/state", "/dynamics"])
    assert some["/step"]["reward"].tolist() == whole["/step"]["reward"].tolist()
    assert "config.json" not in some.attachments
    assert "config.json" in some.damaged[0]
    assert replay(some).equal
    with pytest.raises(FileDamagedError, match=r"config\.json"):
        some.attachment("config.json")


@pytest.mark.parametrize("of_topics", [False, True])
def test_wrong_counts_of_the_summary_are_found(log: Path, tmp_path: Path, of_topics: bool) -> None:
    """Too few messages, or messages of another topic, with correct checksums."""
    path = tmp_path / "fewer.mcap"
    data = bytearray(log.read_bytes())
    footer = len(data) - len(MAGIC) - 4
    (start,) = struct.unpack_from("<Q", data, footer - 16)
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    said = summary.statistics
    counts = [struct.pack("<Q", said.message_count)]
    wrong = [struct.pack("<Q", said.message_count - 1)]
    if of_topics:  # with the right sum
        (one, most), (other, least) = (
            choose(said.channel_message_counts.items(), key=lambda item: item[1])
            for choose in (max, min)
        )
        counts = [struct.pack("<HQ", *item) for item in ((one, most), (other, least))]
        wrong = [struct.pack("<HQ", *item) for item in ((one, most - 1), (other, least + 1))]
    for old, new in zip(counts, wrong, strict=True):
        place = data.index(old, start)
        data[place : place + len(old)] = new
    struct.pack_into("<I", data, footer, zlib.crc32(bytes(data[start:footer])))
    path.write_bytes(data)
    assert [problem for problem in check(path) if "counts" in problem] == check(path) != []
    with pytest.raises(FileDamagedError, match="summary counts"):
        read(path)


def test_flipped_byte_in_a_message_is_reported(
    altered: Alter,
) -> None:
    def flip(data: bytearray) -> None:
        data[len(data) // 2] ^= 0x10

    path = altered(flip)
    assert any("checksum" in problem for problem in check(path))
    with pytest.raises(FileDamagedError, match="recover"):
        read(path)


@pytest.mark.parametrize("function", [check, read, recover])
def test_a_lack_of_memory_is_no_damage(
    log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, function: Callable[..., object]
) -> None:
    """Recovery would leave out intact chunks."""
    monkeypatch.setattr("zstandard.decompress", Mock(side_effect=MemoryError))
    with pytest.raises(MemoryError):
        function(log, *([tmp_path / "saved.mcap"] if function is recover else []))


def test_unfinished_log_is_reported(
    altered: Alter,
) -> None:
    def cut(data: bytearray) -> None:
        del data[len(data) // 2 :]

    path = altered(cut)
    unfinished = "unfinished: no magic bytes of MCAP at the end"
    assert check(path)[0].startswith(f"{unfinished}; save its content with: python -m aslip.log")
    assert f"recover {path}" in check(path)[0]
    with pytest.raises(
        FileDamagedError, match=f"not a complete, intact log: {unfinished}; .* recover"
    ):
        read(path)


def test_attachments_that_are_missing_or_altered_are_named(log: Path, tmp_path: Path) -> None:
    missing = _rewritten(log, tmp_path / "missing.mcap", None, drop="config.json")
    assert check(missing) == ["the attachment 'config.json' is missing"]
    other = _rewritten(log, tmp_path / "other.mcap", None, alter="model.xml")
    assert check(other) == ["the attachment 'model.xml' is altered: its SHA-256 differs"]
    for path in (missing, other):
        with pytest.raises(FileDamagedError, match="attachment"):
            read(path)


@pytest.mark.parametrize("content", [bytes(2**23), np.random.default_rng(0).bytes(2**24)])
def test_chunk_of_excessive_size_is_skipped(
    log: Path, whole: Recording, tmp_path: Path, content: bytes
) -> None:
    """The chunk would decompress to thousands of times its size, or is too large itself."""
    records = read_records(log.read_bytes())
    first = next(i for i, record in enumerate(records) if isinstance(record, Message))
    bomb = records[first]
    assert isinstance(bomb, Message)
    records[first] = replace(bomb, data=content)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(write_records(records))
    assert any("it would decompress to" in problem for problem in check(path))
    with pytest.raises(FileDamagedError, match=r"bomb\.mcap"):
        read(path)
    saved = recover(path)
    assert saved.skipped_chunks == 1
    assert_subset(read(saved.path), whole)


@pytest.mark.parametrize("count", ["7", "100000", "99999999999", "9" * 5000])
def test_schema_with_forged_array_sizes_is_refused(log: Path, tmp_path: Path, count: str) -> None:
    """Small and huge array sizes."""
    records = read_records(log.read_bytes())
    at = next(i for i, r in enumerate(records) if isinstance(r, Schema) and "Sensors" in r.name)
    schema = records[at]
    assert isinstance(schema, Schema)
    data, found = re.subn(rb"\[\d+\]", f"[{count}]".encode(), schema.data, count=1)
    assert found
    records[at] = replace(schema, data=data)
    path = tmp_path / "sizes.mcap"
    path.write_bytes(write_records(records))
    assert check(path)
    with pytest.raises(FileDamagedError, match=r"sizes\.mcap"):
        read(path)


def test_wrong_or_missing_hash_is_named(log: Path, whole: Recording, tmp_path: Path) -> None:
    metadata = whole.metadata
    wrong = {**metadata, "sha256/config.json": "0" * 64}
    assert check(_rewritten(log, tmp_path / "wrong.mcap", wrong)) == [
        "the attachment 'config.json' is altered: its SHA-256 differs"
    ]
    del wrong["sha256/config.json"]
    assert check(_rewritten(log, tmp_path / "absent.mcap", wrong)) == [
        "the attachment 'config.json' has no hash in the metadata"
    ]


def test_other_formats_and_files_are_refused(log: Path, tmp_path: Path) -> None:
    later = {**read(log, ["/log"]).metadata, "format": "99"}
    path = _rewritten(log, tmp_path / "later.mcap", later)
    with pytest.raises(FileDamagedError, match=r"format is '99'.*wrote it, aslip 0\.") as raised:
        read(path)
    assert "recover" not in str(raised.value)
    with pytest.raises(FileDamagedError, match="format '99'"):
        recover(path)
    assert "its format is '99'" in check(path)[0]
    text = tmp_path / "notes.mcap"
    text.write_text("walked well")
    with pytest.raises(FileDamagedError, match=r"notes\.mcap' is not an MCAP file"):
        read(text)
    assert "not an MCAP file" in check(text)[0]
    for function in (read, check, recover):
        with pytest.raises(AssetError, match=r"gone\.mcap"):
            function(tmp_path / "gone.mcap")


def test_decreasing_time_is_found(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "back.mcap"
    with log.open("rb") as source, path.open("wb") as file:
        writer = open_writer(file)
        add_metadata(writer, METADATA, {"format": FORMAT})
        schema, channel, message = next(make_reader(source).iter_messages(["/log"]))
        assert schema is not None
        kind = writer.register_schema(schema.name, schema.encoding, schema.data)
        topic = writer.register_channel(channel.topic, channel.message_encoding, kind)
        for time in (5, 3):
            writer.add_message(topic, time, message.data, time)
        writer.add_message(topic, 6, message.data, 7)
        bare = writer.register_channel("/bare", "cdr", 0)
        writer.add_message(bare, 6, struct.pack("<I", 1), 6)
        writer.finish()
    problems = " ".join(check(path))
    assert "time goes back" in problems
    assert "two messages" in problems
    assert "'/bare' has no schema" in problems


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
        records = Records(file)
        assert sum(isinstance(record, Message) for record in records) == 2**24 // 2**18 - 1
    assert "would decompress to" in records.problems[0]
