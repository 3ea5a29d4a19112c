"""The library's file: exact, whole or refused, and never a program."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from aslip.errors import AssetError, ConfigurationError, FileDamagedError, ShapeError
from aslip.files.archive import npy
from aslip.files.assets import asset_path
from aslip.library import GaitLibrary, build_library
from aslip.library.file import GaitTable, read_library, read_made_by
from aslip.rom import Gait
from benchmarks.faults.archives import forged, unzipped
from tests.helpers import MADE_BY


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


@pytest.mark.parametrize("name", ["table/qpos.npy", "made_by.json", "gait01/time.npy"])
def test_a_library_without_a_part_is_refused(file: Path, name: str) -> None:
    """However right its hashes are."""
    parts = unzipped(file.read_bytes())
    del parts[name]
    file.write_bytes(forged(parts))
    with pytest.raises(FileDamagedError, match=r"gaits\.npz.*rebuild it"):
        read_made_by(file) if "made_by" in name else read_library(file)


@pytest.mark.parametrize("name", ["table/qpos", "gait00/control", "gait01/cost"])
def test_numbers_that_are_not_finite_are_refused(file: Path, name: str) -> None:
    parts = unzipped(file.read_bytes())
    with np.load(file) as archive:
        changed = archive[name].copy()
    changed[changed.ndim * (0,)] = np.inf
    file.write_bytes(forged({**parts, f"{name}.npy": npy(changed)}))
    with pytest.raises(FileDamagedError, match=f"{name}' has entries that are not finite"):
        read_library(file)


def test_numpy_reads_the_file(file: Path, small: GaitLibrary) -> None:
    with np.load(file) as archive:
        np.testing.assert_array_equal(archive["table/qpos"], small.table.qpos)


# ---------------------------------------------------------------- writing


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
