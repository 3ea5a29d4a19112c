"""Logs that were cut off, altered, or are none: named, and saved as far as they go."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Metadata
from mcap.stream_reader import StreamReader

from aslip.errors import AssetError, ConfigurationError, FileDamagedError
from aslip.log import check, read, recover, replay
from aslip.log.writer import METADATA, open_writer
from tests.log.conftest import MakeRecorded


@pytest.fixture(scope="module")
def log(make_recorded: MakeRecorded, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of 3 s in one episode after another."""
    from tests.log.conftest import run

    path = tmp_path_factory.mktemp("logs") / "walk.mcap"
    env = make_recorded(path)
    run(env, 100)
    env.close()
    return path


@pytest.fixture
def altered(log: Path, tmp_path: Path) -> Callable[[Callable[[bytearray], None]], Path]:
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
    with log.open("rb") as source, out.open("wb") as file:
        writer = open_writer(file)
        for record in StreamReader(source).records:
            if isinstance(record, Metadata):
                own = metadata if record.name == METADATA and metadata is not None else None
                writer.add_metadata(record.name, own or dict(record.metadata))
            elif isinstance(record, Attachment) and record.name != drop:
                data = bytes(record.data)
                if record.name == alter:
                    data = data.replace(b"9.81", b"9.80") + b" "
                writer.add_attachment(0, 0, record.name, record.media_type, data)
        with log.open("rb") as again:
            channels = {}
            for schema, channel, message in make_reader(again).iter_messages():
                assert schema is not None
                if channel.topic not in channels:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.topic] = writer.register_channel(
                        channel.topic, channel.message_encoding, kind
                    )
                time = message.log_time
                writer.add_message(channels[channel.topic], time, message.data, time)
        writer.finish()
    return out


def test_a_whole_log_has_no_problems(log: Path) -> None:
    assert check(log) == []


@pytest.mark.parametrize("seed", range(40))
def test_a_flipped_byte_is_found(
    altered: Callable[[Callable[[bytearray], None]], Path], seed: int
) -> None:
    """Anywhere, in data and summary."""
    rng = np.random.default_rng(seed)

    def flip(data: bytearray) -> None:
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))

    path = altered(flip)
    assert check(path)
    try:
        read(path)
    except FileDamagedError as error:
        assert "altered.mcap" in str(error)


def test_a_flipped_byte_in_a_message_is_told_as_such(
    altered: Callable[[Callable[[bytearray], None]], Path],
) -> None:
    def flip(data: bytearray) -> None:
        data[len(data) // 2] ^= 0x10

    path = altered(flip)
    assert any("checksum" in problem for problem in check(path))
    with pytest.raises(FileDamagedError, match="recover"):
        read(path)


def test_an_unfinished_log_is_told_as_such(
    altered: Callable[[Callable[[bytearray], None]], Path],
) -> None:
    def cut(data: bytearray) -> None:
        del data[len(data) // 2 :]

    path = altered(cut)
    unfinished = "it is unfinished: it does not end as an MCAP file"
    assert check(path)[0] == unfinished
    with pytest.raises(FileDamagedError, match=f"no whole, intact log: {unfinished}; .* recover"):
        read(path)


def test_attachments_that_are_missing_or_altered_are_named(log: Path, tmp_path: Path) -> None:
    missing = _rewritten(log, tmp_path / "missing.mcap", None, drop="config.json")
    assert check(missing) == ["the attachment 'config.json' is missing"]
    other = _rewritten(log, tmp_path / "other.mcap", None, alter="model.xml")
    assert check(other) == [
        "the attachment 'model.xml' is not what was attached: its SHA-256 differs"
    ]
    for path in (missing, other):
        with pytest.raises(FileDamagedError, match="attachment"):
            read(path)


def test_a_wrong_or_absent_hash_is_named(log: Path, tmp_path: Path) -> None:
    metadata = read(log, ["/log"]).metadata
    wrong = {**metadata, "sha256/config.json": "0" * 64}
    assert check(_rewritten(log, tmp_path / "wrong.mcap", wrong)) == [
        "the attachment 'config.json' is not what was attached: its SHA-256 differs"
    ]
    del wrong["sha256/config.json"]
    assert check(_rewritten(log, tmp_path / "absent.mcap", wrong)) == [
        "the attachment 'config.json' has no hash in the metadata"
    ]


def test_other_formats_and_files_are_refused(log: Path, tmp_path: Path) -> None:
    later = {**read(log, ["/log"]).metadata, "format": "99"}
    path = _rewritten(log, tmp_path / "later.mcap", later)
    with pytest.raises(FileDamagedError, match="format is '99'"):
        read(path)
    assert "its format is '99'" in check(path)[0]
    text = tmp_path / "notes.mcap"
    text.write_text("walked well")
    with pytest.raises(FileDamagedError, match=r"notes\.mcap' is no MCAP file"):
        read(text)
    assert "no MCAP file" in check(text)[0]
    for function in (read, check, recover):
        with pytest.raises(AssetError, match=r"gone\.mcap"):
            function(tmp_path / "gone.mcap")


@pytest.mark.parametrize("part", np.linspace(0.0, 0.999, 25).round(3))
def test_a_log_cut_anywhere_is_saved_up_to_the_cut(log: Path, tmp_path: Path, part: float) -> None:
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
    whole, rest = read(log), read(saved.path)
    assert rest.attachments == whole.attachments
    for topic, series in rest.series.items():
        np.testing.assert_array_equal(series.time, whole[topic].time[: len(series)])
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, whole[topic][name][: len(series)])
    assert sum(len(series) for series in rest.series.values()) == saved.messages
    # cut in its first second, it has but the first instant
    assert saved.until == 0.0 if "/step" not in rest.series else replay(rest).equal


def test_what_is_saved_ends_a_second_before_the_cut_at_most(log: Path, tmp_path: Path) -> None:
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


def test_a_damaged_middle_keeps_what_was_before(
    altered: Callable[[Callable[[bytearray], None]], Path], log: Path, tmp_path: Path
) -> None:
    def flip(data: bytearray) -> None:
        data[int(0.8 * len(data))] ^= 1

    saved = recover(altered(flip), tmp_path / "saved.mcap")
    assert not saved.complete
    assert 0.5 < saved.until < read(log).series["/step"].time[-1]
    assert saved.reason
    assert check(saved.path) == []


def test_recovering_never_overwrites(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match=r"there\.mcap"):
        recover(log, out)
    assert out.read_bytes() == b"precious"


def test_a_whole_log_can_be_recovered_too(log: Path, tmp_path: Path) -> None:
    saved = recover(log, tmp_path / "copy.mcap")
    assert saved.complete
    assert read(saved.path)["/step"].time.tolist() == read(log)["/step"].time.tolist()


def test_time_that_goes_back_is_found(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "back.mcap"
    with log.open("rb") as source, path.open("wb") as file:
        writer = open_writer(file)
        writer.add_metadata(METADATA, {"format": "1"})
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
