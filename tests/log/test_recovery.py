"""Recovery saves the intact part of damaged and truncated logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log import Recording, check, read, recover, replay
from tests.log.helpers import Alter, assert_subset


def test_flipped_bit_costs_one_chunk(
    log: Path, altered: Alter, tmp_path: Path, whole: Recording
) -> None:
    """Also in the first chunk, which defines the topics."""
    total = sum(map(len, whole.series.values()))
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    indexes = summary.chunk_indexes
    assert len(indexes) >= 4
    for i in (0, len(indexes) // 2, len(indexes) - 1):
        index = indexes[i]
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
    """One byte of invalid UTF-8."""
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
    """The new log is complete and intact."""
    place = log.read_bytes().index(inside)
    saved = recover(altered(lambda data: data.__setitem__(place, data[place] ^ 1)))
    assert saved.dropped == (name,)
    assert check(saved.path) == []
    rest = read(saved.path)
    assert rest.attachments.keys() == whole.attachments.keys() - {name}
    assert len(rest["/step"]) == len(whole["/step"])


@pytest.mark.parametrize("part", np.linspace(0.0, 0.999, 25).round(3))
def test_truncated_log_is_recovered_up_to_the_cut(
    log: Path, whole: Recording, tmp_path: Path, part: float
) -> None:
    """A cut in the first second leaves nothing to recover, and the error says so."""
    data = log.read_bytes()
    path = tmp_path / "walk.mcap.part"
    path.write_bytes(data[: int(part * len(data))])
    try:
        saved = recover(path)
    except FileDamagedError as error:
        assert "nothing to recover" in str(error)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["walk.mcap.part"]
        # nothing is written before the end of the first second
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
    # a log cut in its first second has only the first instant
    assert saved.until == 0.0 if "/step" not in rest.series else replay(rest).equal


def test_recovery_loses_at_most_a_second_before_the_cut(log: Path, tmp_path: Path) -> None:
    """A process that dies has written everything up to the last whole second."""
    whole = read(log)
    states = whole["/state"]
    path = tmp_path / "walk.mcap.part"
    # chunks end with a state; keep the file up to the chunk of the second second
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
