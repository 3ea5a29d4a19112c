"""The library's file: exact, whole or refused, and never a program."""

from __future__ import annotations

import io
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from aslip.assets import asset_path
from aslip.errors import AssetError, ConfigurationError, FileDamagedError, ShapeError
from aslip.library import GaitLibrary, build_library
from aslip.library.file import GaitTable, read_library, read_made_by, write_library
from aslip.rom import Gait
from tests.library.conftest import MADE_BY


def _assert_same(gaits: list[Gait], table: GaitTable, library: GaitLibrary) -> None:
    for field in fields(GaitTable):
        found, expected = getattr(table, field.name), getattr(library.table, field.name)
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected, err_msg=field.name)
    assert len(gaits) == len(library.gaits)
    for found, expected in zip(gaits, library.gaits, strict=True):
        a, b = found.to_arrays(), expected.to_arrays()
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def test_what_was_written_is_read_bit_for_bit(file: Path, small: GaitLibrary) -> None:
    _assert_same(*read_library(file), small)
    loaded = GaitLibrary.load(file)
    np.testing.assert_array_equal(loaded.speeds, small.speeds)
    assert GaitLibrary.load(str(file)).speeds.shape == (2,)


def test_arrays_are_read_only(small: GaitLibrary) -> None:
    for field in fields(GaitTable):
        with pytest.raises(ValueError, match="read-only"):
            getattr(small.table, field.name)[...] = 0


def test_the_file_tells_how_it_was_made(file: Path) -> None:
    assert read_made_by(file) == MADE_BY


def test_the_shipped_file_tells_how_it_was_made() -> None:
    made_by = read_made_by(asset_path("gaits.npz"))
    assert "recipes/gait_library.py" in made_by["command"]
    for package in ("aslip", "python", "casadi", "pin", "numpy"):
        assert made_by[package][0].isdigit(), package


def test_the_shipped_library_is_the_default(library: GaitLibrary) -> None:
    table = GaitLibrary.load().table
    np.testing.assert_array_equal(table.qpos, library.table.qpos)
    assert table.qpos.shape == (21, 128, 35)
    assert table.qvel.shape == (21, 128, 32)


# ------------------------------------------------------------------ damage


@pytest.mark.parametrize("read", [read_library, read_made_by, GaitLibrary.load])
def test_a_missing_file_is_named(read, tmp_path: Path) -> None:
    with pytest.raises(AssetError, match=r"nothing\.npz"):
        read(tmp_path / "nothing.npz")


def test_a_truncated_file_is_refused_wherever_it_ends(file: Path) -> None:
    whole = file.read_bytes()
    for share in np.linspace(0, 1, 41)[:-1]:
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FileDamagedError, match=r"gaits\.npz"):
            read_library(file)
    for missing in (1, 2, 21, 22, 23):
        file.write_bytes(whole[:-missing])
        with pytest.raises(FileDamagedError):
            read_library(file)


def _flip_and_read(file: Path, small: GaitLibrary, offsets: np.ndarray) -> list[int]:
    """Flip a bit of each byte in turn; offsets at which a wrong library or another error came."""
    whole, wrong = file.read_bytes(), []
    for offset in offsets.tolist():
        damaged = bytearray(whole)
        damaged[offset] ^= 1 << (offset % 8)
        file.write_bytes(damaged)
        try:
            _assert_same(*read_library(file), small)  # a byte that carries nothing, as a date
            read_made_by(file)
        except FileDamagedError:
            continue
        except Exception:
            wrong.append(offset)
    return wrong


def test_a_flipped_bit_is_refused_or_harmless(file: Path, small: GaitLibrary) -> None:
    """Never another gait, never another error."""
    size = file.stat().st_size
    offsets = np.random.default_rng(0).choice(size, 150, replace=False)
    assert _flip_and_read(file, small, offsets) == []


def test_a_flipped_bit_in_the_directory_is_refused_or_harmless(
    file: Path, small: GaitLibrary
) -> None:
    """The archive's directory names methods and sizes that the reader must not trip over."""
    whole = file.read_bytes()
    start = whole.index(b"PK\x01\x02")
    first_entry = np.arange(start, start + 46)
    trailer = np.arange(whole.index(b"PK\x05\x06"), len(whole))
    assert _flip_and_read(file, small, np.concatenate([first_entry, trailer])) == []


def _rewrite(file: Path, **changes: np.ndarray | None) -> None:
    """Replace or remove arrays without telling the hash."""
    with np.load(file) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, value in changes.items():
        if value is None:
            del arrays[name]
        else:
            arrays[name] = value
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    file.write_bytes(buffer.getvalue())


@pytest.mark.parametrize("name", ["table/qpos", "table/speeds", "gait00/body_position"])
def test_a_changed_array_is_refused(file: Path, name: str) -> None:
    with np.load(file) as archive:
        changed = archive[name].copy()
    changed.flat[0] += 1e-9
    _rewrite(file, **{name: changed})
    with pytest.raises(FileDamagedError, match="SHA-256"):
        read_library(file)


@pytest.mark.parametrize("name", ["table/qpos", "format", "sha256", "made_by"])
def test_a_missing_array_is_refused(file: Path, name: str) -> None:
    _rewrite(file, **{name: None})
    with pytest.raises(FileDamagedError):
        read_library(file)


@pytest.mark.parametrize("name", ["format", "made_by", "sha256"])
@pytest.mark.parametrize("text", ["aslip gait library 99", ""])
def test_an_altered_description_is_refused(file: Path, name: str, text: str) -> None:
    _rewrite(file, **{name: np.array(text)})
    for read in (read_library, read_made_by):
        with pytest.raises(FileDamagedError):
            read(file)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04", b"\x93NUMPY\x01\x00v\x00{'"])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "gaits.npz"
    path.write_bytes(content)
    with pytest.raises(FileDamagedError):
        read_library(path)


def test_a_single_array_is_refused(tmp_path: Path) -> None:
    """What np.load reads without complaint, though it is no archive."""
    path = tmp_path / "gaits.npy"
    np.save(path, np.zeros(3))
    with pytest.raises(FileDamagedError):
        read_library(path)


def test_a_foreign_archive_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "gaits.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "not a gait")
    with pytest.raises(FileDamagedError):
        read_library(path)


class Program:
    """Something whose unpickling runs code."""

    ran = False

    def __reduce__(self):
        return (_run, ())


def _run() -> None:
    Program.ran = True


def test_pickled_objects_are_refused_and_not_run(file: Path) -> None:
    _rewrite(file, extra=np.array([Program()], dtype=object))
    with pytest.raises(FileDamagedError):
        read_library(file)
    assert not Program.ran


# ---------------------------------------------------------------- writing


def test_a_failed_write_leaves_the_old_file_untouched(
    file: Path, small: GaitLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when the disk is full halfway."""
    before = file.read_bytes()

    def fail(target, **arrays: np.ndarray) -> None:
        target.write(b"half a file")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(OSError, match="no space left"):
        write_library(file, small.gaits, small.table, MADE_BY)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["gaits.npz"]


def test_writing_into_no_folder_is_an_os_error(small: GaitLibrary, tmp_path: Path) -> None:
    with pytest.raises(OSError, match="nowhere"):
        write_library(tmp_path / "nowhere" / "gaits.npz", small.gaits, small.table, MADE_BY)


@pytest.mark.parametrize("speeds", [[0.5], [1.0, 0.5], [0.5, 0.5]])
def test_speeds_must_ascend(speeds: list[float]) -> None:
    with pytest.raises(ConfigurationError, match="ascending"):
        build_library(speeds)


def test_a_stride_needs_samples_to_interpolate() -> None:
    with pytest.raises(ConfigurationError, match="samples must be 4 or more, got 3"):
        build_library((0.5, 1.0), samples=3)


def test_a_table_with_holes_is_refused(small: GaitLibrary) -> None:
    qpos = small.table.qpos.copy()
    qpos[0, 0, 2] = np.nan
    with pytest.raises(ConfigurationError, match="qpos"):
        replace(small.table, qpos=qpos)
    with pytest.raises(ShapeError, match="qpos"):
        replace(small.table, qpos=qpos[:1])


@pytest.mark.parametrize("name", [f.name for f in fields(GaitTable)])
@pytest.mark.parametrize("change", ["column", "sample", "axis"])
def test_a_table_of_another_shape_is_refused(small: GaitLibrary, name: str, change: str) -> None:
    """With fewer columns, with one sample more than the others, as one number a gait or two."""
    array = getattr(small.table, name)
    flat = array.ndim == 1
    wrong = {
        "column": np.stack([array, array], -1) if flat else array[..., :-1],
        "sample": array[..., None] if flat else np.concatenate([array, array[:, :1]], 1),
        "axis": array[:, None, None] if flat else array[:, 0],
    }[change]
    with pytest.raises((ShapeError, ConfigurationError), match=r"must have shape|ascending speeds"):
        replace(small.table, **{name: wrong})


@pytest.mark.parametrize("stride", [0.0, -0.7])
def test_strides_must_be_positive(small: GaitLibrary, stride: float) -> None:
    with pytest.raises(ConfigurationError, match="strides must be positive"):
        replace(small.table, strides=np.array([0.7, stride]))


def test_a_table_of_too_few_samples_is_refused(small: GaitLibrary) -> None:
    table = {f.name: getattr(small.table, f.name) for f in fields(GaitTable)}
    thin = {name: array[:, :3] if array.ndim == 3 else array for name, array in table.items()}
    with pytest.raises(ShapeError, match="4 or more samples"):
        GaitTable(**thin)


def test_gaits_must_be_those_of_the_table(library: GaitLibrary, small: GaitLibrary) -> None:
    for gaits in (small.gaits, library.gaits[:3], library.gaits[::-1]):
        with pytest.raises(ConfigurationError, match="gaits must be those of the table's speeds"):
            GaitLibrary(gaits, library.table)


def test_a_built_library_is_the_shipped_one(library: GaitLibrary) -> None:
    _, table = build_library(library.speeds[:2].tolist(), samples=16)
    for field in fields(table):
        shipped = getattr(library.table, field.name)[:2]
        if shipped.ndim == 3:
            shipped = shipped[:, ::8]
        built = getattr(table, field.name)
        np.testing.assert_allclose(built, shipped, atol=1e-6, err_msg=field.name)
