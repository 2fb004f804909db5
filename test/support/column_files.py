"""The same columns as files of every container, written by independent writers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from drive_id.types import Samples

Columns = Mapping[str, np.ndarray]


def columns(samples: Samples, **changed: np.ndarray | None) -> dict[str, np.ndarray]:
    """Return samples with references as columns, some of them changed or, where None, left out."""
    phases = {f"{name}{phase}": x[:, k] for name, x in (("i", samples.i_abc), ("u", samples.u_abc))
              for k, phase in enumerate("abc")}  # fmt: skip
    rotor = {"theta": np.mod(samples.angle, 2 * np.pi), "omega": samples.speed}
    references = {"id_ref": samples.i_dq_reference[:, 0], "iq_ref": samples.i_dq_reference[:, 1]}
    found = {"time_s": samples.stamp * 1e-9, **phases, **rotor, **references} | changed
    return {name: x for name, x in found.items() if x is not None}


def write_csv(path: Path, columns: Columns) -> Path:
    import pandas as pd

    pd.DataFrame(dict(columns)).to_csv(path, index=False)
    return path


def write_parquet(path: Path, columns: Columns) -> Path:
    import pandas as pd

    pd.DataFrame(dict(columns)).to_parquet(path)
    return path


def write_mat(path: Path, columns: Columns) -> Path:
    from scipy.io import savemat

    savemat(path, {"log": dict(columns)})
    return path


def write_mat73(path: Path, columns: Columns) -> Path:
    """Write an HDF5 file with MATLAB's header, arrays transposed as MATLAB does."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file.create_dataset(f"log/{name}", data=values[None, :])
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(512))
    return path


def write_hdf5(path: Path, columns: Columns) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"log/{name}", data=values, chunks=True)
    return path


def write_mdf(path: Path, columns: Columns) -> Path:
    from asammdf import MDF, Signal

    time = columns["time_s"]
    with MDF(version="4.10") as file:
        file.append([Signal(x, time, name=name) for name, x in columns.items() if name != "time_s"], acq_name="bench")
        file.save(path, overwrite=True)
    return path


def write_tdms(path: Path, columns: Columns) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(str(path)) as file:
        file.write_segment([ChannelObject("bench", name, values) for name, values in columns.items()])
    return path


WRITERS: dict[str, tuple[Callable[[Path, Columns], Path], str]] = {
    "log.csv": (write_csv, ""),
    "log.parquet": (write_parquet, ""),
    "log.mat": (write_mat, "log."),
    "log73.mat": (write_mat73, "log."),
    "log.h5": (write_hdf5, "log/"),
    "log.mf4": (write_mdf, ""),
    "log.tdms": (write_tdms, ""),
}
"""File name to its writer, and what the names of the columns begin with there."""
