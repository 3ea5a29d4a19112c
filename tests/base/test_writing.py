"""A folder has one writer at a time: claims exclude other processes, and end with their owner."""

import contextlib
import errno
import multiprocessing
import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import ablate
import pytest

from aslip.base.interval import Interval
from aslip.base.writing import claimed
from aslip.errors import ConfigurationError
from aslip.library import DirectionGrid, GaitFolder, solve_directions
from benchmarks.scorecard import record as record_module
from benchmarks.scorecard.record import ValueRecord
from benchmarks.scorecard.verdicts import Claim
from recipes import direction_library
from tests.training.run_folder import Settings, open_run

pytestmark = pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
OWNER = rf"is in use by process \d+ on {socket.gethostname()}; wait"


@contextlib.contextmanager
def owned(path: Path, *, grandchild: bool = False) -> Iterator[Callable[[], None]]:
    """Context in which another process claims a path; yields a function that kills it.

    Args:
        path: folder or file.
        grandchild: the other process leaves a fork behind when it is killed.
    """
    ready, hold = os.pipe(), os.pipe()
    child = os.fork()
    if not child:
        with claimed(path):
            if not grandchild or os.fork():
                os.write(ready[1], b"x")
            os.close(hold[1])
            os.read(hold[0], 1)
            os._exit(0)
    os.close(hold[0])
    os.read(ready[0], 1)

    def kill() -> None:
        os.kill(child, 9)
        os.waitpid(child, 0)

    try:
        yield kill
    finally:
        with contextlib.suppress(OSError):
            kill()
        for handle in (*ready, hold[1]):  # the grandchild ends
            os.close(handle)


def test_a_claim_ends_with_its_owner_however_it_ends(tmp_path: Path) -> None:
    """Also if a fork of the owner goes on."""
    with owned(tmp_path, grandchild=True) as kill:
        with pytest.raises(ConfigurationError, match=OWNER), claimed(tmp_path):
            pytest.fail("not reached")
        kill()
        with claimed(tmp_path):
            assert (tmp_path / ".lock").read_text().startswith(f"process {os.getpid()} on ")
    assert not [*tmp_path.iterdir()]


def test_a_process_does_not_exclude_itself_nor_does_its_fork_end_the_claim(tmp_path: Path) -> None:
    """A notebook resumes a run that failed; a moved folder is still claimed."""
    folder, moved = tmp_path / "a", tmp_path / "b"
    folder.mkdir()
    with claimed(folder):
        with claimed(folder):
            folder.rename(moved)
        if not (child := os.fork()):
            with contextlib.suppress(ConfigurationError), claimed(moved):
                os._exit(1)  # claimed by both
            os._exit(0)
        assert os.waitpid(child, 0)[1] == 0
        with claimed(moved):
            assert (moved / ".lock").exists()
        assert (moved / ".lock").exists()
    with owned(moved), pytest.raises(ConfigurationError, match=OWNER), claimed(moved):
        pytest.fail("not reached")


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOTSUP])
def test_a_file_system_without_locks_is_named_and_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    def refuse(*_: Any) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("fcntl.flock", refuse)
    with pytest.warns(RuntimeWarning, match="has no locks"), claimed(tmp_path):
        pass


def test_nothing_is_claimed_in_a_folder_that_is_read_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stored gaits can be read from there. Another error of the file system is raised."""
    codes = [errno.EROFS, errno.ENOENT, errno.ENOSPC]

    def refuse(*_: Any) -> None:
        raise OSError(codes.pop(0), "refused")

    monkeypatch.setattr("os.open", refuse)
    with claimed(tmp_path):
        pass
    with pytest.raises(OSError, match="refused"), claimed(tmp_path):
        pytest.fail("not reached")


@pytest.mark.parametrize("resume", [False, True])
def test_a_run_folder_in_use_is_refused(tmp_path: Path, resume: bool) -> None:
    settings = Settings(tmp_path)
    if resume:
        open_run(settings).close()
    before = sorted(tmp_path.rglob("*"))
    with owned(tmp_path), pytest.raises(ConfigurationError, match=OWNER):
        open_run(settings, resume=resume)
    assert [p for p in sorted(tmp_path.rglob("*")) if p.name != ".lock"] == before


def test_a_folder_of_gaits_or_ablations_in_use_is_refused(tmp_path: Path) -> None:
    grid = DirectionGrid((0.0,), (0.0,), (0.0,))
    config = replace(direction_library.Config(), out=tmp_path, forward=(0.0,))
    with owned(tmp_path):
        for work in (
            lambda: solve_directions(grid, GaitFolder(tmp_path), workers=1),
            lambda: direction_library.main(config),
            lambda: ablate.main(ablate.Config(variants=("default",), out=tmp_path)),
        ):
            with pytest.raises(ConfigurationError, match=OWNER):
                work()


def test_records_of_two_processes_keep_the_values_of_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second one waits until the first has read, added and written."""
    path, names = tmp_path / "record.json", ("straight", "robust")
    write, claims = record_module.write_text, [Claim("speed", "x", at_most=1.0)]

    def slow(*args: Any) -> None:
        time.sleep(0.2)
        write(*args)

    monkeypatch.setattr(record_module, "write_text", slow)
    context = multiprocessing.get_context("fork")
    records = [ValueRecord(path, {"a": 1}, claims) for _ in names]
    added = [
        context.Process(target=record.add, args=(name, {"speed": Interval(0.1, 0.1, 0.1)}))
        for record, name in zip(records, names, strict=True)
    ]
    for process in added:
        process.start()
    for process in added:
        process.join()
    assert {one["name"] for one in ValueRecord(path, {}, claims).policies} == set(names)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
