"""Measurement files with channel groups: MDF by asammdf, and TDMS by npTDMS."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.files.logs.column_log import NUMBERS, OWN_TIME, Column, ColumnGroup, SlicedLog


class _StreamLog(SlicedLog):
    """A file that its library reads from a stream; both are closed here."""

    def _open(self, path: Path, library: Callable[[Any], Any]) -> None:
        self.path = path
        self._stream = path.open("rb")
        try:
            self._file = library(self._stream)
        except BaseException:
            self._stream.close()
            raise

    def close(self) -> None:
        """Release the file."""
        super().close()
        self._stream.close()


class MdfLog(_StreamLog):
    """An MDF file, version 3 or 4; each channel group has its own time, that of its master channel."""

    kind = "mdf"

    def __init__(self, path: Path) -> None:
        from asammdf import MDF  # noqa: PLC0415  # takes seconds to load

        self._open(path, MDF)
        self._numbers: dict[str, int] = {}
        self._channels: dict[Column, int] = {}
        groups = []
        for number, group in enumerate(self._file.groups):
            info = group.channel_group
            name = str(getattr(info, "acq_name", "") or getattr(info, "comment", "") or f"group {number}").strip()
            name = name if name not in self._numbers else f"{name} ({number})"
            master = self._file.masters_db.get(number)
            columns = {}
            for k, channel in enumerate(group.channels):
                if k != master and channel.name not in columns:
                    columns[channel.name] = str(getattr(channel, "dtype_fmt", "") or "number")
                    self._channels[Column(name, channel.name)] = k
            self._numbers[name] = number
            groups.append(ColumnGroup(name, columns, int(info.cycles_nr), master is not None))
        self.groups = tuple(groups)

    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        number, count = self._numbers[column.group], at.stop - at.start
        if column.name == OWN_TIME:
            seconds = self._file.get_master(number, record_offset=at.start, record_count=count)
            with np.errstate(invalid="ignore", over="ignore"):  # damaged stamps become values out of range
                return np.rint(np.asarray(seconds, np.longdouble) * 1_000_000_000).astype(np.int64)
        signal = self._file.get(group=number, index=self._channels[column], record_offset=at.start, record_count=count)
        return np.asarray(signal.samples)


class TdmsLog(_StreamLog):
    """A TDMS file; a group has its own time if its channels are waveforms."""

    kind = "tdms"

    def __init__(self, path: Path) -> None:
        from nptdms import TdmsFile  # noqa: PLC0415  # takes as long to load as a bag
        from nptdms.log import log_manager  # noqa: PLC0415

        log_manager.set_level(logging.CRITICAL)  # the reader itself reports missing data of truncated files
        self._open(path, TdmsFile.open)
        groups = []
        for group in self._file.groups():
            columns, rows, timed = {}, 0, False
            for channel in group.channels():
                if channel.dtype is not None and np.dtype(channel.dtype).kind in f"{NUMBERS}M":
                    columns[channel.name] = str(np.dtype(channel.dtype))
                    rows = max(rows, len(channel))
                    timed = timed or "wf_increment" in channel.properties
            groups.append(ColumnGroup(group.name, columns, rows, timed))
        self.groups = tuple(groups)

    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        group = self._file[column.group]
        if column.name == OWN_TIME:
            channel = next(item for item in group.channels() if "wf_increment" in item.properties)
            start = float(channel.properties.get("wf_start_offset", 0.0))
            step = float(channel.properties["wf_increment"])
            with np.errstate(invalid="ignore", over="ignore"):  # likewise
                return np.rint((start + np.arange(at.start, at.stop) * step) * 1e9).astype(np.int64)
        found = np.asarray(group[column.name][at.start : at.stop])
        return found.astype("datetime64[ns]").astype(np.int64) if found.dtype.kind == "M" else found
