"""Logs that were cut off, altered, or are none: named, and saved as far as they go."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Message, Metadata, Schema

from aslip.errors import AssetError, ConfigurationError, FileDamagedError
from aslip.log import Recording, check, read, recover, replay
from aslip.log.messages import FORMAT
from aslip.log.writer import METADATA, add_metadata, open_writer
from benchmarks.faults.logs import put_together, taken_apart
from tests.log.helpers import MakeRecorded

Alter = Callable[[Callable[[bytearray], None]], Path]
MAGIC = b"\x89MCAP0\r\n"


@pytest.fixture(scope="module")
def log(make_recorded: MakeRecorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of 3 s in one episode after another."""
    from tests.log.helpers import run

    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    env = make_recorded(path)
    run(env, 100)
    env.close()
    return path


@pytest.fixture(scope="module")
def whole(log: Path) -> Recording:
    """The same, read."""
    return read(log)


@pytest.fixture
def altered(log: Path, tmp_path: Path) -> Alter:
    """A copy of the log with changed bytes."""

    def alter(change: Callable[[bytearray], None]) -> Path:
        data = bytearray(log.read_bytes())
        change(data)
        path = tmp_path / "altered.mcap"
        path.write_bytes(data)
        return path

    return alter


def _rewritten(
    log: Path, out: Path, metadata: dict[str, str] | None, drop: str = "", alter: str = ""
) -> Path:
    """The log with other attachments or metadata, otherwise whole."""
    records = []
    for record in taken_apart(log.read_bytes()):
        if isinstance(record, Metadata) and record.name == METADATA:
            record = replace(record, metadata=metadata or record.metadata)
        if isinstance(record, Attachment) and record.name == alter:
            record = replace(record, data=record.data.replace(b"9.81", b"9.80") + b" ")
        if not isinstance(record, Attachment) or record.name != drop:
            records.append(record)
    out.write_bytes(put_together(records))
    return out


def assert_same(one: Recording, other: Recording) -> None:
    """Equal to the bit."""
    assert one.metadata == other.metadata
    assert one.end == other.end
    assert one.attachments == other.attachments
    assert one.series.keys() == other.series.keys()
    for topic, series in one.series.items():
        np.testing.assert_array_equal(series.time, other[topic].time)
        assert series.columns.keys() == other[topic].columns.keys()
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, other[topic][name], err_msg=topic + name)


def assert_subset(rest: Recording, whole: Recording) -> None:
    """Every message is one of the whole log's."""
    for topic, series in rest.series.items():
        rows = np.searchsorted(whole[topic].time, series.time)
        np.testing.assert_array_equal(whole[topic].time[rows], series.time)
        for name, column in series.columns.items():
            if topic != "/log":  # has several lines of one time
                np.testing.assert_array_equal(column, whole[topic][name][rows], err_msg=name)
            assert set(map(str, column)) <= set(map(str, whole[topic][name]))


def test_complete_log_has_no_problems(log: Path) -> None:
    assert check(log) == []


@pytest.mark.parametrize("seed", range(40))
def test_flipped_byte_is_found(altered: Alter, whole: Recording, seed: int) -> None:
    """Anywhere, in data and summary."""
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
    """Names in the summary and words of the metadata, too."""
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
    """A chunk that is not there, or messages of another topic, with checksums that are right."""
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


def test_flipped_bit_costs_one_chunk(
    log: Path, altered: Alter, tmp_path: Path, whole: Recording
) -> None:
    """The first, where topics are described, as any other."""
    total = sum(map(len, whole.series.values()))
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    indexes = summary.chunk_indexes
    assert len(indexes) >= 4
    for i, index in enumerate(indexes):
        place = index.chunk_start_offset + index.chunk_length // 2
        path = altered(lambda data, at=place: data.__setitem__(at, data[at] ^ 1))
        saved = recover(path, tmp_path / f"{i}.mcap")
        held = sum(length > 0 for length in index.message_index_offsets.values())
        assert saved.skipped_chunks == 1
        assert not saved.complete
        assert held == 0 or total * 0.5 < saved.messages < total
        assert check(saved.path) == []
        assert_subset(read(saved.path), whole)


def test_damaged_metadata_costs_no_message(log: Path, altered: Alter, whole: Recording) -> None:
    """One byte that is no text."""
    place = log.read_bytes().index(b"Linux")
    saved = recover(altered(lambda data: data.__setitem__(place, 0xFF)))
    assert saved.messages == sum(map(len, whole.series.values()))
    rest = read(saved.path)
    assert rest.metadata.keys() - {"format"} == {f"sha256/{name}" for name in whole.attachments}
    assert rest.attachments == whole.attachments
    assert replay(rest, strict=False).equal


@pytest.mark.parametrize(
    ("name", "inside"), [("model.xml", b"<worldbody"), ("config.json", b"WeightedReward")]
)
def test_recovery_leaves_out_a_damaged_attachment(
    log: Path, altered: Alter, name: str, inside: bytes, whole: Recording
) -> None:
    """So that the new log is read by all that read the old one."""
    place = log.read_bytes().index(inside)
    saved = recover(altered(lambda data: data.__setitem__(place, data[place] ^ 1)))
    assert saved.dropped == (name,)
    assert check(saved.path) == []
    rest = read(saved.path)
    assert rest.attachments.keys() == whole.attachments.keys() - {name}
    assert len(rest["/step"]) == len(whole["/step"])


def test_flipped_byte_in_a_message_is_reported(
    altered: Alter,
) -> None:
    def flip(data: bytearray) -> None:
        data[len(data) // 2] ^= 0x10

    path = altered(flip)
    assert any("checksum" in problem for problem in check(path))
    with pytest.raises(FileDamagedError, match="recover"):
        read(path)


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
    """Because it unfolds to thousands of times its size, or is too large in itself."""
    records = taken_apart(log.read_bytes())
    first = next(i for i, record in enumerate(records) if isinstance(record, Message))
    bomb = records[first]
    assert isinstance(bomb, Message)
    records[first] = replace(bomb, data=content)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(put_together(records))
    assert any("it would take" in problem for problem in check(path))
    with pytest.raises(FileDamagedError, match=r"bomb\.mcap"):
        read(path)
    saved = recover(path)
    assert saved.skipped_chunks == 1
    assert_subset(read(saved.path), whole)


@pytest.mark.parametrize("count", ["7", "100000", "99999999999", "9" * 5000])
def test_schema_with_forged_array_sizes_is_refused(log: Path, tmp_path: Path, count: str) -> None:
    """However much memory it asks for."""
    records = taken_apart(log.read_bytes())
    at = next(i for i, r in enumerate(records) if isinstance(r, Schema) and "Sensors" in r.name)
    schema = records[at]
    assert isinstance(schema, Schema)
    data, found = re.subn(rb"\[\d+\]", f"[{count}]".encode(), schema.data, count=1)
    assert found
    records[at] = replace(schema, data=data)
    path = tmp_path / "sizes.mcap"
    path.write_bytes(put_together(records))
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


@pytest.mark.parametrize("part", np.linspace(0.0, 0.999, 25).round(3))
def test_truncated_log_is_recovered_up_to_the_cut(
    log: Path, whole: Recording, tmp_path: Path, part: float
) -> None:
    """Or there is nothing to save, and that is said."""
    data = log.read_bytes()
    path = tmp_path / "walk.mcap.part"
    path.write_bytes(data[: int(part * len(data))])
    try:
        saved = recover(path)
    except FileDamagedError as error:
        assert "nothing to recover" in str(error)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["walk.mcap.part"]
        # a log's first second: nothing had been handed to the system before
        assert part < 0.4
        return
    assert saved.path == tmp_path / "walk.recovered.mcap"
    assert check(saved.path) == []
    rest = read(saved.path)
    assert rest.attachments == whole.attachments
    for topic, series in rest.series.items():
        np.testing.assert_array_equal(series.time, whole[topic].time[: len(series)])
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, whole[topic][name][: len(series)])
    assert sum(len(series) for series in rest.series.values()) == saved.messages
    # cut in its first second, it has but the first instant
    assert saved.until == 0.0 if "/step" not in rest.series else replay(rest).equal


def test_recovery_loses_at_most_a_second_before_the_cut(log: Path, tmp_path: Path) -> None:
    """A process that dies has handed on all but what happened since the last whole second."""
    whole = read(log)
    states = whole["/state"]
    path = tmp_path / "walk.mcap.part"
    # chunks end with a state; the file up to the end of the one of the second second
    data = log.read_bytes()
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    second = next(index for index in summary.chunk_indexes if index.message_end_time >= 2e9)
    end = second.chunk_start_offset + second.chunk_length
    path.write_bytes(data[:end])
    saved = recover(path)
    assert saved.until >= 1.9
    assert saved.until in states.time


def test_recovery_never_overwrites(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match=r"there\.mcap"):
        recover(log, out)
    assert out.read_bytes() == b"precious"


def test_complete_log_is_recovered_completely(log: Path, tmp_path: Path) -> None:
    saved = recover(log, tmp_path / "copy.mcap")
    assert saved.complete
    assert read(saved.path)["/step"].time.tolist() == read(log)["/step"].time.tolist()


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
    assert "two times" in problems
    assert "'/bare' has no schema" in problems
