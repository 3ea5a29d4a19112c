"""Recovery saves all that comes before the first damage of a log."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from aslip.errors import ConfigurationError, FileDamagedError
from aslip.log import Recording, read, recover, replay
from tests.log.helpers import Alter


def assert_beginning(rest: Recording, recording: Recording) -> None:
    """Check that a log is the beginning of another one, with the same attachments."""
    assert rest.attachments == recording.attachments
    for topic, series in rest.series.items():
        np.testing.assert_array_equal(series.time, recording[topic].time[: len(series)])
        for name, column in series.columns.items():
            np.testing.assert_array_equal(column, recording[topic][name][: len(series)])


@pytest.mark.parametrize("part", np.linspace(0.0, 0.999, 7).round(3))
def test_truncated_log_is_recovered_up_to_the_cut(
    log: Path, recording: Recording, tmp_path: Path, part: float
) -> None:
    """A cut in the first second leaves nothing to recover, and the error says so."""
    data = log.read_bytes()
    path = tmp_path / "walk.mcap.part"
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(FileDamagedError, match=r"unfinished|not an MCAP file"):
        read(path)
    try:
        saved = recover(path)
    except FileDamagedError as error:
        assert "nothing to recover" in str(error)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["walk.mcap.part"]
        # nothing is written before the end of the first second
        assert part < 0.5
        return
    assert saved.path == tmp_path / "walk.recovered.mcap"
    rest = read(saved.path)
    assert_beginning(rest, recording)
    assert sum(len(series) for series in rest.series.values()) == saved.messages
    # a log cut in its first second has only the first instant
    assert saved.until == 0.0 if "/step" not in rest.series else replay(rest).equal


def test_recovery_ends_at_the_first_damage(
    log: Path, altered: Alter, tmp_path: Path, recording: Recording
) -> None:
    """In a chunk, all chunks before it are saved; before the first chunk, nothing is."""
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    *_, middle, last = summary.chunk_indexes
    for i, (index, before) in enumerate(((middle, 1), (last, 2))):
        place = index.chunk_start_offset + index.chunk_length // 2
        path = altered(lambda data, at=place: data.__setitem__(at, data[at] ^ 1))
        saved = recover(path, tmp_path / f"{i}.mcap")
        assert f"byte {index.chunk_start_offset} is damaged" in saved.reason
        assert 0 < saved.until <= index.message_start_time / 1e9
        assert saved.until >= before - 0.04
        assert_beginning(read(saved.path), recording)
    place = log.read_bytes().index(b'"why": "a test"')
    path = altered(lambda data: data.__setitem__(place, data[place] ^ 1))
    with pytest.raises(FileDamagedError, match=r"nothing to recover: .*config\.json"):
        recover(path)


def test_recovery_never_overwrites(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(ConfigurationError, match=r"there\.mcap"):
        recover(log, out)
    assert out.read_bytes() == b"precious"


def test_complete_log_is_recovered_completely(
    log: Path, recording: Recording, tmp_path: Path
) -> None:
    saved = recover(log, tmp_path / "copy.mcap")
    assert saved.reason == ""
    copy = read(saved.path)
    assert_beginning(copy, recording)
    channels = []
    for path in (log, saved.path):
        with path.open("rb") as file:
            channels.append([*make_reader(file).get_summary().channels.values()])  # pyright: ignore
    assert channels[0] == channels[1]
    assert {t: len(s) for t, s in copy.series.items()} == {
        t: len(s) for t, s in recording.series.items()
    }
