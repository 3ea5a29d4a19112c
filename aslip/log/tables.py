"""Tables of a log: Parquet, CSV and HDF5 files for other programs."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Literal

from aslip.base.assets import user_path
from aslip.base.imports import extras
from aslip.base.writing import replacing
from aslip.errors import ConfigurationError
from aslip.log.reader import Recording, without_objects


def export(
    recording: Recording, to: Literal["parquet", "csv", "hdf5"], out: str | Path | None = None
) -> Path:
    """Write a log as tables; returns their folder or file.

    Parquet and CSV have a file per topic in a folder, with the columns of `Series.table`. HDF5 has
    all in one file: a group per topic, and a dataset per name of `Series.columns`, and `time`.
    Parquet and HDF5 keep the metadata of the log.

    Args:
        recording: log, or some topics of it.
        to: format.
        out: folder or file to create; by default the log's name without suffix, or with `.h5`.

    Raises:
        ConfigurationError: it exists.
        MissingExtraError: pyarrow or h5py is not installed.
        OSError: it cannot be written.
    """
    write = _write_hdf5 if to == "hdf5" else _write_files
    path = recording.path.with_suffix(".h5" if to == "hdf5" else "") if out is None else out
    path = user_path(path)
    if path.exists():
        raise ConfigurationError(f"{str(path)!r} exists; give the tables another name with --out")
    with extras():
        write(recording, to, path)
    return path


def _write_files(recording: Recording, to: str, folder: Path) -> None:
    """Write a file per topic."""
    import pyarrow
    from pyarrow.csv import write_csv
    from pyarrow.parquet import write_table

    folder.mkdir(parents=True)
    for topic, series in recording.series.items():
        table = pyarrow.table(series.table(), metadata=recording.metadata)
        with replacing(folder / f"{topic.strip('/').replace('/', '_')}.{to}") as file:
            (write_csv if to == "csv" else write_table)(table, file)


def _write_hdf5(recording: Recording, _: str, path: Path) -> None:
    """Write all topics to one file."""
    import h5py

    buffer = BytesIO()
    with h5py.File(buffer, "w") as content:
        content.attrs.update(recording.metadata)
        for topic, series in recording.series.items():
            for name, column in {"time": series.time, **series.columns}.items():
                column = without_objects(column)
                if column.dtype.kind == "U":
                    column = column.astype(h5py.string_dtype())
                content[f"{topic}/{name}"] = column
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as file:
        file.write(buffer.getbuffer())
