"""Measurement files with channel groups: MDF by asammdf, and TDMS by npTDMS."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.files.inputs.input_file import open_input
from drive_id.files.logs.column_log import NUMBERS, OWN_TIME, Column, ColumnGroup, SlicedLog, typed


class _StreamLog(SlicedLog):
    """A file that its library reads from a stream; both are closed here."""

    def _open(self, path: Path, library: Callable[[Any], Any]) -> None:
        self.path = path
        self._stream = open_input(path)
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
                    said = (getattr(entry, "unit", "") for entry in (channel, channel.conversion))
                    columns[channel.name] = typed(getattr(channel, "dtype_fmt", "") or "number", *said)
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
        signal = self._file.get(
            group=number, index=self._channels[column], record_offset=at.start, record_count=count,
            ignore_invalidation_bits=True,
        )  # fmt: skip
        values, invalid = np.asarray(signal.samples), signal.invalidation_bits
        if invalid is None or not np.any(invalid) or values.dtype.kind not in NUMBERS:
            return values
        return np.where(np.asarray(invalid, np.bool_), np.nan, values)  # missing, as a blank cell of a table


class TdmsLog(_StreamLog):
    """A TDMS file; waveforms have their own time. A group is divided if its channels begin at different times."""

    kind = "tdms"

    def __init__(self, path: Path) -> None:
        from nptdms import TdmsFile  # noqa: PLC0415  # takes as long to load as a bag
        from nptdms.log import log_manager  # noqa: PLC0415

        log_manager.set_level(logging.CRITICAL)  # the reader itself reports missing data of truncated files
        self._open(path, TdmsFile.open)
        self._channels: dict[Column, Any] = {}
        self._timing: dict[str, _Timing] = {}
        every = (channel for group in self._file.groups() for channel in group.channels() if channel.dtype is not None)
        channels = [channel for channel in every if np.dtype(channel.dtype).kind in f"{NUMBERS}M"]
        starts = [x for channel in channels if (x := _start_time(channel)) is not None]
        first = min(starts, default=np.datetime64(0, "ns"))
        members: dict[tuple[str, _Timing | None], list[Any]] = {}
        for channel in channels:
            members.setdefault((channel.group_name, _Timing.of(channel, first)), []).append(channel)
        self.groups = tuple(self._group(name, timing, found) for (name, timing), found in members.items())

    def _group(self, name: str, timing: _Timing | None, channels: list[Any]) -> ColumnGroup:
        """Return the channels of a group that begin at one time."""
        taken = {column.group for column in self._channels}
        own = name
        if timing is not None and own in taken:
            own = f"{name} (from {timing.start * 1e-9:.9g} s, every {timing.step:.6g} s)"
        own = own if own not in taken else f"{name} ({len(taken)})"
        if timing is not None:
            self._timing[own] = timing
        self._channels |= {Column(own, channel.name): channel for channel in channels}
        columns = {
            channel.name: typed(np.dtype(channel.dtype), channel.properties.get("unit_string", ""))
            for channel in channels
        }
        return ColumnGroup(own, columns, max(map(len, channels)), timing is not None, name if own != name else "")

    def _slice(self, column: Column, at: slice) -> NDArray[Any]:
        if column.name == OWN_TIME:
            timing = self._timing[column.group]
            with np.errstate(invalid="ignore", over="ignore"):  # likewise
                steps = np.rint(np.arange(at.start, at.stop) * (timing.step * 1e9))
                return (timing.start + steps).astype(np.int64)
        found = np.asarray(self._channels[column][at.start : at.stop])
        return found.astype("datetime64[ns]").astype(np.int64) if found.dtype.kind == "M" else found


@dataclass(frozen=True)
class _Timing:
    """Time of the samples of a waveform."""

    start: float  # ns, after the first channel of the file
    step: float  # s

    @classmethod
    def of(cls, channel: Any, first: np.datetime64) -> _Timing | None:
        """Return the time of a channel by its properties; None if it is no waveform."""
        if "wf_increment" not in channel.properties:
            return None
        start = _start_time(channel)
        since = 0.0 if start is None else float((start - first) / np.timedelta64(1, "ns"))
        offset = float(channel.properties.get("wf_start_offset", 0.0))
        return cls(since + np.rint(offset * 1e9), float(channel.properties["wf_increment"]))


def _start_time(channel: Any) -> np.datetime64 | None:
    start = channel.properties.get("wf_start_time")
    return start.astype("datetime64[ns]") if isinstance(start, np.datetime64) and not np.isnat(start) else None
