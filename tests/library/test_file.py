"""Library files: exact, or refused; never executed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from aslip.base.archive import npy
from aslip.base.assets import asset_path
from aslip.errors import ConfigurationError, FileDamagedError
from aslip.library import GaitLibrary, pendulum_library
from aslip.library.table import ARRAYS
from aslip.rom import SampledMotion
from tests.contracts.archives import forge_archive, read_zip


def _assert_same(loaded: GaitLibrary, library: GaitLibrary) -> None:
    for name in ARRAYS:
        found, expected = getattr(loaded.table, name), getattr(library.table, name)
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected, err_msg=name)
    np.testing.assert_equal(loaded.table.axes, library.table.axes)
    assert loaded.table.torque_jumps == library.table.torque_jumps
    assert loaded.made_by == library.made_by
    assert len(loaded.motions) == len(library.motions)


def test_saved_library_is_loaded_bit_for_bit(file: Path, small: GaitLibrary) -> None:
    for path in (file, str(file)):
        loaded = GaitLibrary.load(path)
        _assert_same(loaded, small)
        for found, expected in zip(loaded.gaits, small.gaits, strict=True):
            np.testing.assert_equal(found.to_arrays(), expected.to_arrays())


def test_loaded_library_can_be_saved_again(file: Path, tmp_path: Path) -> None:
    GaitLibrary.load(file).save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == file.read_bytes()


def test_motions_other_than_gaits_are_stored_as_samples(
    library: GaitLibrary, tmp_path: Path
) -> None:
    """A saved library of pendulum walks keeps its table and its flag of jumping torques."""
    pendulums = pendulum_library(library.gaits[5:7], samples=16)
    pendulums.save(tmp_path / "pendulums.npz")
    loaded = GaitLibrary.load(tmp_path / "pendulums.npz")
    _assert_same(loaded, pendulums)
    assert loaded.table.torque_jumps
    phase = np.arange(16) / 16
    for found, expected in zip(loaded.motions, pendulums.motions, strict=True):
        assert isinstance(found, SampledMotion)
        assert (found.stride, *found.command) == (expected.stride, *expected.command)
        exact = SampledMotion.from_motion(expected, 16)
        np.testing.assert_equal(found.to_arrays(), exact.to_arrays())
        np.testing.assert_allclose(
            found.sample(phase).feet.position, expected.sample(phase).feet.position, atol=1e-14
        )
    with pytest.raises(ConfigurationError, match=r"must be optimal gaits, .* SampledMotion"):
        _ = loaded.gaits


def test_shipped_file_names_its_origin(library: GaitLibrary) -> None:
    made_by = library.made_by
    assert "recipes/gait_library.py" in made_by["command"]
    for package in ("aslip", "python", "casadi", "pin", "numpy"):
        assert made_by[package][0].isdigit(), package


def test_shipped_library_is_the_default(library: GaitLibrary) -> None:
    table = GaitLibrary.load().table
    np.testing.assert_array_equal(table.qpos, library.table.qpos)
    assert table.qpos.shape == (21, 128, 35)
    assert table.qvel.shape == (21, 128, 32)


def test_the_library_of_all_directions_is_small() -> None:
    library = GaitLibrary.load("directions")
    assert len(library.table.commands) > 2000
    assert sum(buffer.nbytes for buffer in library.buffers()) <= 15e6
    assert asset_path("directions.npz").stat().st_size <= 15e6


# ------------------------------------------------------------------ damage


@pytest.mark.parametrize("name", ["table/axis0.npy", "made_by.json", "motion00/certificate.npy"])
def test_library_with_a_missing_entry_is_refused(file: Path, name: str) -> None:
    """Also with correct hashes."""
    parts = read_zip(file.read_bytes())
    del parts[name]
    file.write_bytes(forge_archive(parts))
    with pytest.raises(FileDamagedError, match=r"gaits\.npz.*rebuild it"):
        GaitLibrary.load(file)


@pytest.mark.parametrize("name", ["table/qpos", "motion00/control", "motion01/cost"])
def test_non_finite_numbers_are_refused(file: Path, name: str) -> None:
    parts = read_zip(file.read_bytes())
    with np.load(file) as archive:
        changed = archive[name].copy()
    changed[changed.ndim * (0,)] = np.inf
    file.write_bytes(forge_archive({**parts, f"{name}.npy": npy(changed)}))
    with pytest.raises(FileDamagedError, match=f"{name}' has non-finite entries"):
        GaitLibrary.load(file)


def test_motions_must_match_the_commands_of_the_table(
    library: GaitLibrary, small: GaitLibrary
) -> None:
    wrong: tuple[Any, ...] = (small.gaits, library.gaits[:3], library.gaits[::-1], ())
    for gaits in wrong:
        with pytest.raises(
            ConfigurationError, match="commands of motions must be those of the table"
        ):
            GaitLibrary(gaits, library.table)
