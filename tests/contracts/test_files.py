"""Files of every kind: written atomically, read completely or refused."""

import io
import os
import pickle
import stat
import threading
import tracemalloc
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aslip.base.archive import SUMS, ArchiveFormat, from_npy, npy
from aslip.base.writing import replacing
from aslip.errors import AslipError, FileDamagedError
from tests.contracts.archives import (
    Program,
    forge_archive,
    forgeries,
    programs,
    read_zip,
    write_zip,
)
from tests.contracts.kinds import KINDS, Kind
from tests.helpers import full_disk

every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))
every_archive = pytest.mark.parametrize(
    "kind", [kind for kind in KINDS.values() if kind.archive], ids=lambda kind: kind.name
)


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Content of an intact file of each kind, written once: a log takes a simulation."""
    folder, contents = tmp_path_factory.mktemp("intact"), {}
    for name, kind in KINDS.items():
        kind.write(folder / f"whole{kind.suffix}")
        contents[name] = (folder / f"whole{kind.suffix}").read_bytes()
    return contents


@pytest.fixture
def path(kind: Kind, intact: dict[str, bytes], tmp_path: Path) -> Path:
    """An intact file, alone in its folder."""
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / f"whole{kind.suffix}").write_bytes(intact[kind.name])
    return folder / f"whole{kind.suffix}"


def _step(kind: Kind) -> int:
    """Stride between damaged places: reading, checking and recovering a log takes a second."""
    return 1 if kind.archive else 20


@every_kind
def test_truncated_files_are_refused(kind: Kind, path: Path) -> None:
    data = path.read_bytes()
    ends = [int(share * len(data)) for share in np.linspace(0, 1, 41)[: -1 : _step(kind)]]
    for end in [*ends, *(len(data) - missing for missing in (1, 2, 21, 22, 23))]:
        path.write_bytes(data[:end])
        with pytest.raises(FileDamagedError, match=path.name):
            kind.load(path)


def _survives(kind: Kind, path: Path, data: bytes, whole: Any) -> str:
    """Empty string if data is refused or loads with the intact content, else the outcome."""
    path.write_bytes(data)
    try:
        return "" if kind.identical(kind.load(path), whole) else "other content"
    except AslipError as error:
        return "" if path.name in str(error) else f"a message without the file: {error}"
    except Exception as error:
        return repr(error)


@every_kind
def test_flipped_bits_are_refused_or_harmless(kind: Kind, path: Path) -> None:
    """At random offsets, and at all of the last bytes, where formats keep their directories."""
    data, whole, rng = path.read_bytes(), kind.load(path), np.random.default_rng(0)
    offsets = set(rng.choice(len(data), 150).tolist()[:: _step(kind)])
    offsets |= set(range(len(data) - 70, len(data), _step(kind)))
    if kind.archive:  # the directory's first entry names methods and sizes
        start = data.index(b"PK\x01\x02")
        offsets |= set(range(start, start + 46))
    wrong = {}
    for offset in sorted(offsets):
        spoilt = bytearray(data)
        spoilt[offset] ^= 1 << offset % 8
        wrong[offset] = _survives(kind, path, bytes(spoilt), whole)
    assert {offset: found for offset, found in wrong.items() if found} == {}


@every_archive
def test_forged_content_is_refused_or_loads(kind: Kind, path: Path) -> None:
    """The hashes are valid, so that other content may load; its numbers are finite."""
    data, whole = path.read_bytes(), kind.load(path)
    for content in forgeries(data, np.random.default_rng(2)):
        assert _survives(kind, path, content, whole) in ("", "other content")


@every_kind
def test_files_of_another_kind_or_format_are_refused(
    kind: Kind, path: Path, intact: dict[str, bytes]
) -> None:
    foreign = io.BytesIO()
    np.save(foreign, np.zeros(3))
    contents = [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01\x00v\x00{'", foreign.getvalue()]
    contents += [write_zip({"readme.txt": b"none"}), forge_archive({"a.npy": b""})]
    contents += [content for name, content in intact.items() if name != kind.name]
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(FileDamagedError, match=path.name):
            kind.load(path)


@every_kind
def test_missing_files_are_named(kind: Kind, path: Path) -> None:
    with pytest.raises(AslipError, match="gone"):
        kind.load(path.with_name(f"gone{path.suffix}"))


@every_kind
def test_pickles_are_refused_and_not_run(kind: Kind, path: Path, tmp_path: Path) -> None:
    mark = tmp_path / "ran"
    torch.save(Program(mark), path)
    with pytest.raises(FileDamagedError):
        kind.load(path)
    assert not mark.exists()


@every_archive
def test_pickles_in_an_archive_are_not_run(kind: Kind, path: Path, tmp_path: Path) -> None:
    """Pickles replace arrays, or have names that other libraries unpickle; hashes are valid."""
    mark, data = tmp_path / "ran", path.read_bytes()
    for content in programs(data, Program(mark)):
        path.write_bytes(content)
        with suppress(FileDamagedError):
            kind.load(path)
        assert not mark.exists()
    # a program that runs does leave its file
    pickle.loads(pickle.dumps(Program(mark)))
    assert mark.exists()


@every_archive
def test_archives_with_changed_removed_or_added_entries_are_refused(kind: Kind, path: Path) -> None:
    """The checksums of the ZIP file are valid."""
    parts = read_zip(path.read_bytes())
    rng = np.random.default_rng(0)
    names = sorted(parts.keys() - {SUMS})
    for name in rng.choice(names, min(12, len(names)), replace=False).tolist():
        spoilt = bytearray(parts[name])
        spoilt[-1 - len(spoilt) // 3] ^= 4
        for content in (bytes(spoilt), parts[name][:-1], b""):
            path.write_bytes(write_zip({**parts, name: content}))
            with pytest.raises(FileDamagedError, match="SHA-256"):
                kind.load(path)
        without = {other: content for other, content in parts.items() if other != name}
        for others in (without, {**parts, f"{name}.npy": parts[name]}, {**parts, SUMS: b""}):
            path.write_bytes(write_zip(others))
            with pytest.raises(FileDamagedError, match="SHA-256"):
                kind.load(path)


@every_archive
def test_other_versions_and_files_without_hashes_are_refused(kind: Kind, path: Path) -> None:
    parts = read_zip(path.read_bytes())
    own = parts["format"].decode().removeprefix("aslip ").rpartition(" ")[0]
    for name in ("", f"aslip {own} 99"):
        path.write_bytes(forge_archive({**parts, "format": name.encode()}))
        with pytest.raises(FileDamagedError, match=f"its format is {name!r}, not 'aslip "):
            kind.load(path)
    for other in {"policy", "checkpoint"} - {own}:
        path.write_bytes(forge_archive({**parts, "format": f"aslip {other} 2".encode()}))
        with pytest.raises(FileDamagedError, match=f"is a {other}, not a {own}"):
            kind.load(path)
    path.write_bytes(write_zip({name: parts[name] for name in parts if name != SUMS}))
    with pytest.raises(FileDamagedError, match=f"{SUMS} is missing"):
        kind.load(path)


@every_archive
def test_entries_of_equal_names_are_refused(kind: Kind, path: Path) -> None:
    """Readers of ZIP files differ in which of two equal names they take."""
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("format", archive.read("format"))
    with pytest.raises(FileDamagedError, match="two entries have the same name"):
        kind.load(path)


@every_archive
def test_decompression_bombs_are_refused(kind: Kind, path: Path) -> None:
    parts = read_zip(path.read_bytes())
    largest = max(parts, key=lambda name: len(parts[name]))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {**parts, largest: bytes(30 * len(path.read_bytes() or b"x"))}.items():
            archive.writestr(name, content + bytes(10**7 if name == largest else 0))
    with pytest.raises(FileDamagedError, match="claims to hold"):
        kind.load(path)


@every_archive
def test_memory_is_bounded_where_an_entry_is_larger_than_its_claim(kind: Kind, path: Path) -> None:
    """Sizes and checksums are those of the intact entry, whose content goes on for 64 MB."""
    parts, method = read_zip(path.read_bytes()), zipfile.ZIP_DEFLATED
    largest = max(parts, key=lambda name: len(parts[name]))
    with zipfile.ZipFile(path, "w", method, compresslevel=1) as archive:
        for name, content in parts.items():
            archive.writestr(name, content + bytes(2**26 if name == largest else 0))
        claimed = archive.getinfo(largest)
        claimed.file_size, claimed.CRC = len(parts[largest]), zlib.crc32(parts[largest])
    tracemalloc.start()
    with suppress(FileDamagedError):
        kind.load(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 20e6


@every_archive
@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compressions_are_refused(kind: Kind, path: Path, method: int) -> None:
    """They cannot be decompressed in part."""
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("format", b"x")
    with pytest.raises(FileDamagedError, match="the compression"):
        kind.load(path)


@every_kind
@pytest.mark.parametrize("endless", ["pipe", "device"])
def test_only_regular_files_are_read(kind: Kind, path: Path, endless: str) -> None:
    path.unlink()
    if endless == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    refused: list[Exception] = []

    def load() -> None:
        try:
            kind.load(path)
        except Exception as error:
            refused.append(error)

    thread = threading.Thread(target=load, daemon=True)
    thread.start()
    thread.join(10.0)
    assert isinstance(refused[0], AslipError)
    assert path.name in str(refused[0])


def test_what_compresses_well_is_read_again(tmp_path: Path) -> None:
    """Motions of robots that stand still are zeros, which compress a hundred times and more."""
    still = ArchiveFormat("gaits", 1, compressed=True)
    entries = {"qpos.npy": npy(np.zeros((2, 48, 35)))}
    still.write(tmp_path / "gaits.npz", entries)
    assert still.read(tmp_path / "gaits.npz") == entries


@every_archive
def test_huge_shapes_are_refused_before_memory_is_allocated(kind: Kind, path: Path) -> None:
    """The hashes are valid."""
    parts = read_zip(path.read_bytes())
    name = next(name for name in parts if name.endswith(".npy"))
    buffer = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
    np.lib.format.write_array_header_1_0(buffer, header)
    path.write_bytes(forge_archive({**parts, name: buffer.getvalue() + bytes(64)}))
    with pytest.raises(FileDamagedError, match="has 64 bytes, expected"):
        kind.load(path)


@pytest.mark.parametrize(("kind", "shape"), [("<f8", (10**9, 0)), ("|S0", (10**9,))])
def test_empty_arrays_of_huge_shapes_are_refused(kind: str, shape: tuple[int, ...]) -> None:
    """Users of an array allocate memory for its rows."""
    buffer = io.BytesIO()
    header = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, header)
    with pytest.raises(ValueError, match="empty array"):
        from_npy(buffer.getvalue())


@every_kind
def test_full_disk_keeps_the_old_file(kind: Kind, path: Path) -> None:
    """An OSError is raised, and only the old file is in the folder."""
    size, old = path.stat().st_size, b"what was there"
    for share in (0, 0.01, 0.5, 0.99):
        path.write_bytes(old)
        with pytest.raises(OSError, match="File too large"), full_disk(int(share * size)):
            kind.write(path)
        assert path.read_bytes() == old
        assert list(path.parent.iterdir()) == [path]


@every_kind
def test_writing_replaces_the_file(kind: Kind, path: Path) -> None:
    whole = kind.load(path)
    path.write_bytes(b"what was there")
    kind.write(path)
    assert kind.identical(kind.load(path), whole)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    "kind", [kind for kind in KINDS.values() if not kind.makes_folders], ids=lambda kind: kind.name
)
def test_writing_into_a_missing_folder_raises_os_error(kind: Kind, path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        kind.write(path.parent / "nowhere" / path.name)


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


@every_kind
def test_content_is_synced_before_the_rename(kind: Kind, path: Path, calls: list[str]) -> None:
    """Otherwise a power cut may leave an empty file."""
    kind.write(path)
    assert calls == [f"sync {path.stat().st_size} bytes", "rename", "sync folder"]


@pytest.mark.parametrize("error", [OSError("no space left"), KeyboardInterrupt()])
def test_interrupted_writes_keep_the_old_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    with pytest.raises(type(error)), replacing(path) as file:
        file.write(b"half of the new")
        raise error
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
