"""Data frames and files of tables have the numbers of the log."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from aslip.errors import MissingExtraError
from aslip.log import Recording, Series, read
from aslip.log.__main__ import main
from aslip.log.messages import LOGGED_JOINTS
from tests.log.golden import GOLDEN


@pytest.fixture(scope="module")
def golden() -> Recording:
    """The golden log in memory."""
    return read(GOLDEN)


def test_table_has_a_column_per_number(golden: Recording) -> None:
    joints = golden["/joint_states"]
    table = joints.table()
    assert [*table][:2] == ["time", "header.stamp.sec"]
    for i, name in enumerate(LOGGED_JOINTS):
        np.testing.assert_array_equal(table[f"position[{name}]"], joints["position"][:, i])
    assert not [name for name in table if name.startswith("name")]
    poses = golden["/tf"].table()
    assert poses["transforms.transform.translation.x[rom_body]"].shape == (19,)
    assert {*poses["transforms.header.frame_id[pelvis]"]} == {"world"}
    sensors = golden["/sensors"]
    np.testing.assert_array_equal(sensors.table()["gyro_x[9]"], sensors["gyro_x"][:, 9])


def test_bytes_and_arrays_of_several_lengths_fit_a_table() -> None:
    arrays = np.array([[1.0], []], dtype=object)
    packets = np.array([b"\x01\xff", b"\x02"])
    table = Series("/received", np.zeros(2), {"array": arrays, "packet": packets}).table()
    assert table["packet[1]"].tolist() == [255, 0]
    assert table["array"].tolist() == ["[1.0]", "[]"]


def test_frame_is_of_the_library_that_is_installed(
    golden: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    pandas = pytest.importorskip("pandas")
    frame = golden["/truth"].frame()
    assert isinstance(frame, pandas.DataFrame)
    assert len(frame) == 19
    assert frame["pelvis_position_x"][11] == golden["/truth"]["pelvis_position_x"][11]
    installed = {"polars": SimpleNamespace(DataFrame=len)}
    monkeypatch.setattr("aslip.log.reader.find_spec", installed.get)
    monkeypatch.setattr("aslip.log.reader.import_module", installed.__getitem__)
    assert golden["/truth"].frame() == 1 + 46  # what Polars is given


def test_lack_of_a_library_names_the_extra(
    golden: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "polars"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"pandas is not installed.*aslip\[tables\]"):
        golden["/truth"].frame()


@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_every_topic_is_a_file(
    golden: Recording, tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    reader = pytest.importorskip(f"pyarrow.{kind}")
    read_table = reader.read_table if kind == "parquet" else reader.read_csv
    arguments = ["export", str(GOLDEN), "--to", kind, "--out", str(tmp_path / "walk")]
    assert main(arguments) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'walk'}\n"
    files = {path.name for path in (tmp_path / "walk").iterdir()}
    assert files == {f"{topic[1:]}.{kind}" for topic in golden.series}
    for topic in ("/step", "/log", "/tf"):
        table = read_table(tmp_path / "walk" / f"{topic[1:]}.{kind}")
        expected = golden[topic].table()
        assert table.column_names == [*expected]
        for name, column in expected.items():
            if kind == "parquet" or column.dtype.kind != "U":
                found = table[name].to_numpy().astype(column.dtype)
                np.testing.assert_array_equal(found, column, err_msg=name)
    if kind == "parquet":
        assert table.schema.metadata[b"seed"] == golden.metadata["seed"].encode()
    assert main(arguments) == 2
    assert "walk' exists; give the tables another name" in capsys.readouterr().err


def test_hdf5_has_a_group_per_topic(golden: Recording, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "walk.mcap").write_bytes(GOLDEN.read_bytes())
    assert main(["export", str(tmp_path / "walk.mcap"), "--to", "hdf5"]) == 0
    with h5py.File(tmp_path / "walk.h5") as file:
        assert dict(file.attrs) == golden.metadata
        for topic, series in golden.series.items():
            assert {*file[topic]} == {"time", *series.columns}
            for name, column in series.columns.items():
                data = file[topic][name]
                data = data.asstr()[()] if column.dtype.kind == "U" else data[()]
                np.testing.assert_array_equal(data, column)
