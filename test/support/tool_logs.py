"""The same columns as logs of other tools: LabVIEW, PicoScope, TwinCAT, PlotJuggler, pandas, NI, Vector, VESC Tool."""

from __future__ import annotations

import gzip
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Columns = Mapping[str, np.ndarray]
"""``t`` in s, the phases, ``theta``, and whatever else."""


def table(
    columns: Columns, separator: str = ",", comma: bool = False, digits: Mapping[str, str] | None = None,
    blank: str = "",
) -> str:  # fmt: skip
    """Write the rows of a table; cells that are NaN are ``blank``."""
    formats = [(digits or {}).get(name, "%.9g") for name in columns]
    rows = (
        separator.join(blank if np.isnan(x) else form % x for form, x in zip(formats, row, strict=True))
        for row in np.column_stack(list(columns.values())).tolist()
    )
    text = "\n".join(rows) + "\n"
    return text.replace(".", ",") if comma else text


def csv(path: Path, columns: Columns, separator: str = ",", head: str = "", **how: object) -> Path:
    path.write_text(head + separator.join(columns) + "\n" + table(columns, separator, **how))  # type: ignore[arg-type]
    return path


def evented(path: Path, columns: Columns, row: int) -> Path:
    """Write a last column that is blank but for a text in one row."""
    lines = table(columns).splitlines()
    cells = ["TRIGGER" if k == row else "" for k in range(len(lines))]
    rows = [f"{line},{cell}" for line, cell in zip(lines, cells, strict=True)]
    path.write_text("\n".join([",".join([*columns, "event"]), *rows]) + "\n")
    return path


def dated(path: Path, columns: Columns, name: str, form: str, separator: str) -> Path:
    """Write dates for the times, in a column of this name."""
    times = np.datetime64("2026-01-02T12:54:58.123456", "us") + np.rint(columns["t"] * 1e6).astype("timedelta64[us]")
    rows = table({key: x for key, x in columns.items() if key != "t"}, separator).splitlines()
    lines = [f"{time:{form}}{separator}{row}" for time, row in zip(times.tolist(), rows, strict=True)]
    path.write_text("\n".join([separator.join([name, *list(columns)[1:]]), *lines]) + "\n")
    return path


def unit_row(path: Path, columns: Columns, units: list[str], separator: str, *, comma: bool) -> Path:
    """Write names, a row of units, and a blank line before the rows."""
    head = separator.join(columns) + "\n" + separator.join(units) + "\n\n"
    path.write_text(head + table(columns, separator, comma=comma))
    return path


def labview(
    path: Path, columns: Columns, *, times: bool = True, comma: bool = True, parts: int = 1, comments: bool = True
) -> Path:
    """Write a LabVIEW measurement file, with a header of the channels for each of its parts, with cells of comments."""
    sign = "," if comma else "."
    data = {name: x for name, x in columns.items() if name != "t"}
    count, step = len(data), columns["t"][1] - columns["t"][0]

    def line(key: str, cell: str) -> str:
        return "\t".join([key, *[cell] * count, ""])

    text = f"LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t{sign}\n"
    text += f"Multi_Headings\t{'Yes' if parts > 1 else 'No'}\nX_Columns\t{'One' if times else 'No'}\n"
    text += "***End_of_Header***\t\n\t\n"
    for rows in np.array_split(np.arange(len(columns["t"])), parts):
        header = [line("Channels", str(count)), line("Samples", str(len(rows))), line("Date", "2026/01/02")]
        header += [line("Time", f"12:54:08{sign}123"), line("X_Dimension", "Time"), line("X0", f"0{sign}0E+0")]
        header += [line("Delta_X", f"{step:E}".replace(".", sign)), line("***End_of_Header***", "")]
        text += "\n".join([*header, "\t".join(["X_Value", *data, "Comment"])]) + "\n"
        times_of = columns["t"][rows] - columns["t"][rows[0]] if times else np.full(len(rows), np.nan)
        body = {"t": times_of, **{name: x[rows] for name, x in data.items()}}
        text += table(body, "\t", comma=comma).replace("\n", "\t\n" if comments else "\n")
    path.write_text(text, encoding="latin-1")
    return path


def picoscope(path: Path, columns: Columns, units: list[str], *, beyond: int = 0) -> Path:
    """Write a PicoScope export: channels by letters, units, a blank line, infinity signs in each ``beyond``-th row."""
    names = ["Time", *(f"Channel {chr(ord('A') + k)}" for k in range(len(columns) - 1))]
    lines = [",".join(row) for row in np.char.mod("%.9g", np.column_stack(list(columns.values())))]
    for k in range(beyond, len(lines), beyond) if beyond else ():
        cells = lines[k].split(",")
        lines[k] = ",".join([cells[0], "-∞" if k % 2 else "∞", *cells[2:]])
    head = ",".join(names) + "\n" + ",".join(f"({unit})" for unit in units) + "\n\n"
    path.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def twincat(path: Path, columns: Columns, groups: list[list[str]], *, comma: bool, late: float = 0.0) -> Path:
    """Write an export of TwinCAT Scope: a column of times, ms, before each group of channels, the last ``late`` s."""
    sep = "\t"
    names = [name for group in groups for name in ("Name", *group)]

    def line(key: str, cell: str) -> str:
        return sep.join(key if name == "Name" else cell for name in names)

    head = [f"Name{sep}Scope Project", f"File{sep}C:\\x.svdx", f"Starttime of export{sep}133000000000000000", ""]
    head += [sep.join(names), line("SymbolComment", ""), line("Data-Type", "REAL64"), line("SampleTime[ms]", "0.1")]
    head += [line("VariableSize", "8"), line("SymbolBased", "True"), line("IndexGroup", "16448")]
    head += [
        line("IndexOffset", "608"),
        line("SymbolName", "MAIN.x"),
        line("NetID", "1.2.3.4.1.1"),
        line("Port", "851"),
    ]
    head += [line("Offset", "0"), line("ScaleFactor", "1"), line("BitMask", "0xFFFFFFFFFFFFFFFF"), ""]
    times = [1e3 * (columns["t"] + late * (group is groups[-1])) for group in groups]
    body = [x for t, group in zip(times, groups, strict=True) for x in (t, *(columns[name] for name in group))]
    text = table({str(k): x for k, x in enumerate(body)}, sep)
    path.write_text("\n".join(head).replace("0.1", "0,1" if comma else "0.1") + "\n"
                    + (text.replace(".", ",") if comma else text) + "EOF\n")  # fmt: skip
    return path


def plotjuggler(path: Path, columns: Columns, topics: Mapping[str, list[str]]) -> Path:
    """Write one row per message of each topic, with blank cells for the others; topics arrive 11 us apart."""
    names = [f"{topic}/{name}" for topic, members in topics.items() for name in members]
    n = len(columns["t"])
    rows = []
    for number, (topic, members) in enumerate(topics.items()):
        cells = {name: np.full(n, np.nan) for name in names} | {f"{topic}/{m}": columns[m] for m in members}
        rows.append(np.column_stack([columns["t"] + 11e-6 * number, *cells.values()]))
    whole = np.concatenate(rows)
    whole = whole[np.argsort(whole[:, 0], kind="stable")]
    return csv(path, dict(zip(["__time", *names], whole.T, strict=True)), digits={"__time": "%.6f"})


def packed(path: Path, write: Callable[[Path, Columns], Path], columns: Columns) -> Path:
    """Write a log and pack it, by the ending of the name: ``.gz`` or ``.zip``."""
    plain = write(path.with_suffix(""), columns)
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(plain.read_bytes(), 1))
    else:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(plain, plain.name)
    return path


def json_lines(path: Path, columns: Columns) -> Path:
    """Write a message per line, with a stamp of seconds and nanoseconds, and phases in lists; NaN is null."""
    ns = np.rint(columns["t"] * 1e9).astype(np.int64) + 1_700_000_000_999_000_000
    phases = {kind: np.column_stack([columns[f"{kind}{phase}"] for phase in "abc"]).astype(object) for kind in "iu"}
    phases = {kind: np.where(x == x, x, None).tolist() for kind, x in phases.items()}  # noqa: PLR0124  # NaN is not
    with path.open("w") as stream:
        for k, stamp in enumerate(ns.tolist()):
            header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}}
            row = {"header": header, "i": phases["i"][k], "u": phases["u"][k], "theta": float(columns["theta"][k])}
            stream.write(json.dumps(row) + "\n")
    return path


def feather(path: Path, columns: Columns) -> Path:
    import pandas as pd

    pd.DataFrame(dict(columns)).to_feather(path)
    return path


def parquet(path: Path, columns: Columns, zone: str = "") -> Path:
    """Write a table in which values that are NaN are nulls, and times are dates of a time zone, if there is one."""
    import pandas as pd

    frame = pd.DataFrame(dict(columns)).convert_dtypes()
    if zone:
        frame["t"] = pd.to_datetime(1_790_000_000_000_000 + np.rint(1e6 * columns["t"]), unit="us", utc=True)
        frame["t"] = frame["t"].dt.tz_convert(zone)
    frame.to_parquet(path)
    return path


def nested(path: Path, columns: Columns, *, structs: bool) -> Path:
    """Write the phases of currents and voltages as one column each, of structs to Parquet and of lists to Feather.

    A column of categories is beside them.
    """
    import pyarrow as pa
    import pyarrow.parquet
    from pyarrow import feather as feather_file

    def together(phases: list[str]) -> pa.Array:
        arrays = [pa.array(columns[name]) for name in phases]
        if structs:
            return pa.StructArray.from_arrays(arrays, names=["a", "b", "c"])
        return pa.array(np.column_stack(arrays).tolist())

    names = {"i": ["ia", "ib", "ic"], "u": ["ua", "ub", "uc"]}
    plain = {name: pa.array(columns[name]) for name in ("t", "theta")}
    plain["mode"] = pa.array(["run"] * len(columns["t"])).dictionary_encode()
    table = pa.table(plain | {name: together(phases) for name, phases in names.items()})
    (pyarrow.parquet.write_table if structs else feather_file.write_feather)(table, path)
    return path


def hdf5(path: Path, columns: Columns, of_file: Mapping[str, float], of_each: Mapping[str, float]) -> Path:
    """Write a dataset for each column, with attributes."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs.update(of_file)
        for name, x in columns.items():
            file.create_dataset(f"log/{name}", data=x).attrs.update(of_each)
    return path


def npz(path: Path, columns: Columns) -> Path:
    with path.open("wb") as stream:
        np.savez_compressed(stream, **columns)
    return path


def structured_npz(path: Path, columns: Columns) -> Path:
    whole = np.zeros(len(columns["t"]), [(name, "f8") for name in columns])
    for name, x in columns.items():
        whole[name] = x
    with path.open("wb") as stream:
        np.savez(stream, log=whole)
    return path


def tdms(path: Path, columns: Columns, late: Mapping[str, dict[str, object]], *, groups: bool) -> Path:
    """Write waveforms with these properties in addition; with ``groups``, one group per letter of the names."""
    from nptdms import ChannelObject, TdmsWriter

    usual = {"wf_increment": float(columns["t"][1] - columns["t"][0]), "wf_start_offset": 0.0,
             "wf_start_time": np.datetime64("2026-01-02T12:00:00.000000", "us")}  # fmt: skip
    with TdmsWriter(str(path)) as file:
        file.write_segment([
            ChannelObject(name[0] if groups else "log", name, x, properties=usual | late.get(name, {}))
            for name, x in columns.items() if name != "t"
        ])  # fmt: skip
    return path


def mdf(path: Path, columns: Columns, invalid: Mapping[str, np.ndarray], version: str = "4.10") -> Path:
    """Write channels with invalidation bits, rows (M,) by name."""
    from asammdf import MDF, Signal

    channels = []
    for name, x in columns.items():
        if name != "t":
            bits = np.isin(np.arange(len(x)), invalid.get(name, ()))
            channels.append(Signal(x, columns["t"], name=name, invalidation_bits=bits if bits.any() else None))
    with MDF(version=version) as file:
        file.append(channels)
        return file.save(path.with_suffix(".mf4"), overwrite=True).rename(path)


def mdf_groups(path: Path, columns: Columns, late: float) -> Path:
    """Write a group per letter of the names, of which that of the voltages begins ``late`` s after the others."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for group in "iut":
            times = columns["t"] + late * (group == "u")
            file.append([
                Signal(x, times, name=name) for name, x in columns.items() if name[0] == group and name != "t"
            ])  # fmt: skip
        return file.save(path, overwrite=True)


def vesc_tool(path: Path, i_dq: np.ndarray, u_dq: np.ndarray, erpm: np.ndarray, *, period: float = 0.02) -> Path:
    """Write a real-time log of VESC Tool, with odometers and a separator at the end of each line."""
    n = len(erpm)
    grows = np.linspace(0.1, 0.4, n)
    columns = {
        "ms_today": np.rint(36e6 + 1e3 * period * np.arange(n)), "input_voltage": 48 - grows,
        "temp_motor": 40 + 10 * grows,
        "d_axis_current": i_dq[:, 0], "q_axis_current": i_dq[:, 1], "erpm": erpm, "amp_hours_used": grows,
        "watt_hours_used": 48 * grows, "tachometer": np.rint(np.cumsum(erpm) * period / 10), "battery_level": 1 - grows,
        "encoder_position": np.full(n, 359.9), "vesc_id": np.full(n, 17.0),
        "d_axis_voltage": u_dq[:, 0], "q_axis_voltage": u_dq[:, 1],
    }  # fmt: skip
    text = ";".join(columns) + ";\n" + table(columns, ";", digits={"ms_today": "%.0f"}).replace("\n", ";\n")
    path.write_text(text)
    return path


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def _matrix(flags: int, *parts: bytes) -> bytes:
    return _element(14, _element(6, struct.pack("<II", flags, 0)) + b"".join(parts))


def _doubles(name: str, x: np.ndarray) -> bytes:
    return _matrix(6, _element(5, struct.pack("<ii", len(x), 1)), _element(1, name.encode()), _element(9, x.tobytes()))


def matlab_object(path: Path, kind: str, arrays: Columns) -> Path:
    """Write a file of MATLAB's version 7 with an object of a class, and arrays beside it.

    Of an object it holds its class and numbers that stand for it; the data are in bytes that only MATLAB reads.
    """
    numbers = np.array([0xDD000000, 2, 1, 1, 1, 1], "<u4").tobytes()
    stands = _matrix(13, _element(5, struct.pack("<ii", 6, 1)), _element(1, b""), _element(6, numbers))
    head = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(124, b" ") + b"\x00\x01IM"
    variables = [_matrix(17, _element(1, b"log"), _element(1, b"MCOS"), _element(1, kind.encode()), stands)]
    variables += [_doubles(name, np.asarray(x, "<f8")) for name, x in arrays.items()]
    packed = [zlib.compress(each) for each in variables]
    path.write_bytes(head + b"".join(struct.pack("<II", 15, len(each)) + each for each in packed))
    return path


def matlab_object_73(path: Path, kind: str, arrays: Columns) -> Path:
    """Write one of version 7.3."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        stands = file.create_dataset("log", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32))
        stands.attrs["MATLAB_class"] = np.bytes_(kind)
        stands.attrs["MATLAB_object_decode"] = np.int32(3)
        file.create_dataset("#refs#/a", data=np.zeros((1, 1000)))
        for name, x in arrays.items():
            file.create_dataset(name, data=x[None])
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124, b" ") + b"\x00\x02IM")
    return path
