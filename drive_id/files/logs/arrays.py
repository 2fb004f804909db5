"""Named arrays: NumPy's ``.npz``, MATLAB files of version 5 by scipy, and HDF5 (MATLAB 7.3 among them) by h5py."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.quantity import counted
from drive_id.errors import NotABagError, TruncatedBagError
from drive_id.files.inputs.archive import read_arrays
from drive_id.files.inputs.input_file import open_input
from drive_id.files.inputs.matlab import read_matlab
from drive_id.files.logs.column_log import NUMBERS, UNIT_NAMES, Column, ColumnGroup, SlicedLog, typed
from drive_id.files.storage.container import UnpackBudget

_MOST_COLUMNS = 64  # of one array that are offered as signals
_DECODED = "MATLAB_object_decode"
"""Attribute of the datasets of version 7.3 that stand for objects."""
_FEWEST_SIGNALS = 5
"""Columns of a recording at least: two currents, two voltages, and an angle or a speed."""
_REMEDIES = {
    "table": "save a struct instead, s = table2struct(T, 'ToScalar', true).",
    "timetable": "save a struct instead, s = table2struct(timetable2table(T, 'ConvertRowTimes', false), 'ToScalar', "
    "true), and in it s.time = seconds(T.Properties.RowTimes - T.Properties.RowTimes(1)).",
}
"""What to do with objects of MATLAB, by their class."""
_NAMED_DATA = (("Name", "Data"), ("label", "values"))
"""Fields that hold name and values in the structs of measurement tools."""


class _HeldLog(SlicedLog):
    """Named arrays, held in memory as a whole; column k of a matrix is ``i[k]``."""

    bounded = False

    def __init__(self, path: Path, arrays: Mapping[str, Any]) -> None:
        self.path = path
        self._arrays: dict[str, NDArray[Any]] = {}
        self._units: dict[str, Any] = {}  # what the file says of them
        self.facts: dict[str, float] = {}
        for name, value in arrays.items():
            self._take(name, value)
        self.groups = grouped(
            {name: (typed(array.dtype, self._units.get(name, "")), len(array)) for name, array in self._arrays.items()}
        )

    def _take(self, name: str, value: Any) -> None:
        array = np.asarray(value)
        if array.dtype.names:
            for field in array.dtype.names:
                self._take(f"{name}.{field}", array[field])
            return
        self.facts |= _fact(name, array)
        if array.dtype.kind not in NUMBERS or array.ndim not in (1, 2):
            return
        if array.ndim == 1:
            self._arrays[name] = array
            return
        rows = array if array.shape[0] >= array.shape[1] else array.T
        for k in range(min(rows.shape[1], _MOST_COLUMNS)):
            self._arrays[f"{name}[{k}]"] = rows[:, k]

    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        return self._arrays[column.name][at]


class NpzLog(_HeldLog):
    """A file of ``numpy.savez``; fields of structured arrays are ``log.i_a``."""

    kind = "npz"

    def __init__(self, path: Path) -> None:
        with open_input(path) as stream:
            super().__init__(path, read_arrays(stream))


class MatLog(_HeldLog):
    """A MATLAB file of version 5; fields of structs are ``log.i_a``."""

    kind = "mat"

    def __init__(self, path: Path) -> None:
        self._objects: list[str] = []  # their classes
        found = read_matlab(path, limit=UnpackBudget(path.stat().st_size).limit)
        super().__init__(path, {name: value for name, value in found.items() if not name.startswith("__")})
        if self._objects and len(self._arrays) < _FEWEST_SIGNALS:
            raise _object_error(path, self._objects[0])

    def _take(self, name: str, value: Any) -> None:
        if _is_opaque(value):
            self._objects.append(_class_name(value["s2"].ravel()[0]))
            return
        if hasattr(value, "_fieldnames"):
            self._take_struct(name, value)
            return
        array = np.asarray(value)
        if array.dtype.kind == "O":
            for k, entry in enumerate(array.ravel()[:_MOST_COLUMNS]):
                self._take_struct(f"{name}[{k}]", entry, name)
            return
        super()._take(name, value)

    def _take_struct(self, name: str, value: Any, array: str = "") -> None:
        """Add the fields of a struct, which is an element of the array of structs ``array`` if that is given.

        Elements that name their data, as those of ControlDesk and of Simulink's scopes do, are columns of that name
        beside the array.
        """
        fields = {field: getattr(value, field) for field in getattr(value, "_fieldnames", ())}
        for said, data in _NAMED_DATA if array else ():
            label = str(fields.get(said, "")).rpartition("/")[2].strip()
            if label and data in fields:
                own = f"{array.rpartition('.')[0] or array}.{label}"
                own = own if own not in self._arrays else f"{name}.{label}"
                self._units[own] = next((fields[unit] for unit in UNIT_NAMES if unit in fields), "")
                self._take(own, fields[data])
                return
        for field, entry in fields.items():
            self._take(f"{name}.{field}", entry)


def _fact(name: str, value: Any) -> dict[str, float]:
    """Return a single number by its name; nothing for anything else."""
    array = np.asarray(value)
    return {name: float(array.item())} if array.size == 1 and array.dtype.kind in NUMBERS else {}


def _is_opaque(value: Any) -> bool:
    """Tell whether a variable is an object of MATLAB, such as a table, whose content scipy does not show."""
    return {"s0", "s1", "s2"} <= set(getattr(getattr(value, "dtype", None), "names", None) or ())


def _class_name(said: Any) -> str:
    text = said.decode("latin-1") if isinstance(said, bytes) else str(said)
    return "".join(sign for sign in text if sign.isalnum() or sign in "._")


def _object_error(path: Path, kind: str) -> NotABagError:
    remedy = _REMEDIES.get(kind, "save a struct of its time and data instead, as s.time = T.Time, s.i_a = T.Data.")
    return NotABagError(f"{path} holds an object of MATLAB's class {kind}, which only MATLAB reads: {remedy}")


class Hdf5Log(SlicedLog):
    """An HDF5 file; its groups and datasets are named by their path, ``log/i_a``, in MATLAB files ``log.i_a``."""

    def __init__(self, path: Path, *, matlab: bool) -> None:
        import h5py  # noqa: PLC0415  # takes as long to load as a bag

        self.kind = "mat73" if matlab else "hdf5"
        self.path = path
        self._file = h5py.File(path, "r")
        self._where: dict[str, tuple[str, int | None, int]] = {}  # dataset, its column or None, axis of time
        self._lengths: dict[str, tuple[str, int]] = {}
        self.facts: dict[str, float] = {}
        objects: list[str] = []
        separator, numbers = "." if matlab else "/", (h5py.h5t.INTEGER, h5py.h5t.FLOAT)

        def take(name: str, item: Any) -> None:
            for said in item.attrs:
                known = item.attrs.get_id(said)  # others may be of types that cannot be read
                if known.get_type().get_class() in numbers and known.get_space().get_simple_extent_npoints() == 1:
                    self.facts |= _fact(f"{name}/{said}", item.attrs[said])
            if isinstance(item, h5py.Dataset) and not name.startswith("#"):
                created = item.id.get_create_plist()  # the shape of a virtual dataset opens other files
                if created.get_layout() == h5py.h5d.VIRTUAL or created.get_external_count():
                    raise TruncatedBagError(
                        f"Dataset '{name:.60}' of {path} is stored in other files, which are not opened: write one "
                        "file that holds the samples itself."
                    )
                if _DECODED in item.attrs:
                    objects.append(_class_name(item.attrs.get("MATLAB_class", "")))
                else:
                    if item.size == 1:
                        self.facts |= _fact(name, item[()])
                    self._take(name, name.replace("/", separator), item)

        try:
            take("", self._file)
            self._file.visititems(take)
        except BaseException:
            self._file.close()
            raise
        self.groups = grouped(self._lengths)
        if objects and len(self._where) < _FEWEST_SIGNALS:
            self._file.close()
            raise _object_error(path, objects[0])

    def _take(self, dataset: str, name: str, item: Any) -> None:
        def add(own: str, kind: Any, k: int | None = None, axis: int = 0) -> None:
            self._where[own] = (dataset, k, axis)
            said = (item.attrs[name] for name in UNIT_NAMES if name in item.attrs)
            self._lengths[own] = (typed(kind, *said), item.shape[axis])

        if item.dtype.names:
            for field in item.dtype.names:
                if item.ndim == 1 and item.dtype[field].kind in NUMBERS:
                    add(f"{name}.{field}", item.dtype[field])
            return
        if item.dtype.kind not in NUMBERS or item.ndim not in (1, 2) or "MATLAB_empty" in item.attrs:
            return
        if item.ndim == 1:
            add(name, item.dtype)
            return
        axis = int(item.shape[1] > item.shape[0])  # time runs along the longer one
        count = item.shape[1 - axis]
        for k in range(min(count, _MOST_COLUMNS)):
            add(name if count == 1 else f"{name}[{k}]", item.dtype, k, axis)

    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        dataset, k, axis = self._where[column.name]
        item = self._file[dataset]
        if item.dtype.names:
            return np.asarray(item.fields(column.name.rpartition(".")[2])[at])
        if k is None:
            return np.asarray(item[at])
        return np.asarray(item[at, k] if axis == 0 else item[k, at])


def grouped(columns: dict[str, tuple[str, int]]) -> tuple[ColumnGroup, ...]:
    """Return the columns, name to type and length, as groups of equal length; the longest come first."""
    lengths = sorted({rows for _, rows in columns.values()}, reverse=True)
    groups = []
    for rows in lengths:
        members = {name: kind for name, (kind, length) in columns.items() if length == rows}
        groups.append(ColumnGroup("" if len(lengths) == 1 else counted(rows, "row"), members, rows))
    return tuple(groups)
