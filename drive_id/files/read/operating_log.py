"""Read slow telemetry for method ``static``: d and q quantities with a speed, or fast phase quantities averaged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.signals.signal import Signal
from drive_id.core.steady.averaging import averaged
from drive_id.core.steady.operating_data import OperatingData
from drive_id.errors import ConfigurationError, NoOverlapError
from drive_id.files.logs.open_log import open_log
from drive_id.files.messages.signal_sources import NAMED_STAMPS, SignalMap
from drive_id.files.read.reader import naming, read_signals_only
from drive_id.files.read.several import digests_of, read_recording
from drive_id.types import BoolArray, FloatArray, GroundTruth, IntArray

_TEMPERATURE = "winding_temperature"


@dataclass(frozen=True, eq=False)
class OperatingLog:
    """The content of one log, with the truth of a simulation, the sha256 of each file, and the last stamp, ns."""

    data: OperatingData
    truth: GroundTruth | None
    digests: dict[str, str]
    last_stamp: int
    warnings: tuple[Message, ...]


def read_operating_log(path: Path, signals: SignalMap | None = None, *, namespace: str = "") -> OperatingLog:
    """Read the log of a drive as slow telemetry.

    Currents and voltages in frame ``dq`` are taken as they are, and need a speed but no angle. Phase quantities must be
    sampled so fast that the rotor turns by less than 0.5 rad per sample; they are averaged. Where a log of columns has
    no time, and its signals file names none, each row is an operating point.

    For ``signals`` and ``namespace``, see :func:`~drive_id.files.read.several.read_recording`. Raises BagError,
    DataError or ConfigurationError when the log cannot be read, or its signals do not fit together.
    """
    known = signals or SignalMap()
    frames = {known.currents.frame, known.voltages.frame}
    if "dq" not in frames:
        recording = read_recording(path, known, namespace=namespace)
        last_stamp = int(recording.samples.stamp[-1])
        return OperatingLog(
            averaged(recording.samples), recording.truth, recording.digests, last_stamp, recording.warnings
        )
    if len(frames) > 1:
        raise ConfigurationError(
            "Currents and voltages are in different frames, and method static takes d and q of both or phases of both: "
            "set frame: dq for both."
        )
    if not known.resolver.own_speed:
        raise ConfigurationError(
            "Method static needs the speed of the rotor: name it by speed in section 'resolver', from the same topic "
            "or group."
        )
    plain = {name: replace(getattr(known, name), angle="", angle_advance=0.0) for name in ("currents", "voltages")}
    needed = replace(known, **plain, reference=None)
    timed = not known.of_columns or _names_time(path, needed)
    if not timed:  # the number of the row is the time, for all sections alike
        numbered: Any = partial(replace, stamp="index", sample_period=1.0)
        rows = {name: numbered(getattr(needed, name)) for name in ("currents", "voltages", "resolver")}
        optional = {name: numbered(entry) for name, entry in needed.optional.items()}
        needed = replace(needed, **rows, optional=optional)
    found, warnings = read_signals_only(path, needed, namespace=namespace)
    with naming(path):
        data, last_stamp = _joined(found, known)
    data, off = (data if timed else replace(data, time=None)).without_coasting()
    said = (Message("inverter_off", rows=off),) if off else ()
    return OperatingLog(data, None, digests_of([path]), last_stamp if timed else 0, (*warnings, *said))


def _names_time(path: Path, signals: SignalMap) -> bool:
    """Tell whether the signals file names a time, or the log of columns has its own."""
    sections = (signals.currents, signals.voltages, signals.resolver)
    if any(entry.stamp not in NAMED_STAMPS or entry.sample_period is not None for entry in sections):
        return True
    with open_log(path) as log:
        return any(group.own_time for group in log.groups)


def _joined(found: dict[str, Signal], signals: SignalMap) -> tuple[OperatingData, int]:
    """Return the signals at the times of the currents, interpolated linearly, and the last stamp."""
    currents = found["currents"]
    increasing = _increasing(currents.stamp)
    stamp, i_dq = currents.stamp[increasing], currents.values[increasing]
    needed = [found["voltages"], found["resolver"]]
    start = max(int(signal.stamp.min()) for signal in needed)
    end = min(int(signal.stamp.max()) for signal in needed)
    common = (stamp >= start) & (stamp <= end)
    if not common.any():
        raise NoOverlapError("Currents, voltages and speed have no time in common: check stamps and their units.")
    stamp, i_dq = stamp[common], i_dq[common]
    u_dq = _interpolated(found["voltages"], stamp, slice(None))
    if name := signals.voltages.scaled_by:
        if name not in found:
            raise NoOverlapError("The signal that scales the voltages holds no sample: record it.")
        u_dq *= _interpolated(found[name], stamp, slice(0, 1))
    temperature = _interpolated(found[_TEMPERATURE], stamp, slice(0, 1))[:, 0] if _TEMPERATURE in found else None
    data = OperatingData(
        i_dq=i_dq,
        u_dq=u_dq,
        speed=_interpolated(found["resolver"], stamp, slice(-1, None))[:, 0],
        time=(stamp - stamp[0]) * 1e-9,
        winding_temperature=temperature,
    )
    return data, int(stamp[-1])


def _interpolated(signal: Signal, stamp: IntArray, columns: slice) -> FloatArray:
    """Return some columns of a signal (N, K), linear between its samples, at stamps (N,), ns; it bridges NaN."""
    kept = _increasing(signal.stamp) & np.isfinite(signal.values[:, columns]).all(axis=1)
    if not kept.any():
        raise NoOverlapError(f"{signal.name} holds no number: check its field.")
    own = (signal.stamp[kept] - stamp[0]).astype(np.float64)
    wanted = (stamp - stamp[0]).astype(np.float64)
    values = signal.values[kept][:, columns]
    return np.column_stack([np.interp(wanted, own, column) for column in values.T])


def _increasing(stamp: IntArray) -> BoolArray:
    """Tell (N,) which stamps are later than all before."""
    before = np.maximum.accumulate(np.concatenate([[stamp[0] - 1], stamp[:-1]]))
    return np.asarray(stamp > before)
