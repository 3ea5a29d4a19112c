"""Writing files as a whole."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

import pytest

from aslip.files import commit, replacing


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Syncs and renames, in the order in which they happen."""
    calls: list[str] = []
    fsync, replace = os.fsync, os.replace

    def syncing(descriptor: int) -> None:
        folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        calls.append("sync folder" if folder else f"sync {os.fstat(descriptor).st_size} bytes")
        fsync(descriptor)

    def replacing(*names: Any) -> None:
        calls.append("rename")
        replace(*names)

    monkeypatch.setattr(os, "fsync", syncing)
    monkeypatch.setattr(os, "replace", replacing)
    return calls


def test_content_is_on_the_disk_before_the_name(tmp_path: Path, calls: list[str]) -> None:
    with replacing(tmp_path / "file") as file:
        file.write(b"12345")
    assert calls == ["sync 5 bytes", "rename", "sync folder"]
    assert (tmp_path / "file").read_bytes() == b"12345"


def test_commit_syncs_what_is_still_in_the_buffer(tmp_path: Path, calls: list[str]) -> None:
    file = (tmp_path / "temporary").open("wb")
    file.write(b"123")
    commit(file, tmp_path / "file")
    assert calls == ["sync 3 bytes", "rename", "sync folder"]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("error", [OSError("no space left"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_the_file_that_was_there(
    tmp_path: Path, error: BaseException
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(type(error)), replacing(path) as file:
        file.write(b"half of the new")
        raise error
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"), replacing(tmp_path / "nowhere" / "file"):
        pass
