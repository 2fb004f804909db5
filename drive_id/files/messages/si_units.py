"""Values as a log holds them, in SI units and electrical radians."""

from __future__ import annotations

import numpy as np

from drive_id.core import frames
from drive_id.files.messages.signal_sources import (
    ANGLE_UNITS,
    PhaseSource,
    ReferenceSource,
    RotorSource,
    ScalarSource,
    TimeSource,
)
from drive_id.types import FloatArray


def in_si_units(columns: list[FloatArray], source: TimeSource) -> FloatArray:
    """Return the values (N, K) in SI units and electrical radians.

    Parameters
    ----------
    columns : list of (N,) float
        By ``source.paths``.

    Returns
    -------
    (N, K) float
        Phase quantities (N, 3), or d and q (N, 2) in the frame of the resolver; angle and speed; one scalar.
    """
    if isinstance(source, PhaseSource):
        return _phases(columns, source)
    if isinstance(source, RotorSource):
        if not source.angle:
            return columns[0][:, None] * source.speed_factor
        scaled = [columns[0] * source.angle_factor + source.angle_offset]
        return np.column_stack([*scaled, *(column * source.speed_factor for column in columns[1:])])
    if isinstance(source, ScalarSource):
        return np.column_stack(columns) * source.scale + source.offset
    assert isinstance(source, ReferenceSource)
    if len(columns) == 2 and all(isinstance(entry, str) for entry in source.fields):
        return np.column_stack(columns) * source.scale
    return np.asarray(np.column_stack(columns) @ source.matrix.T)


def _phases(columns: list[FloatArray], source: PhaseSource) -> FloatArray:
    plain = source.frame == "abc" and all(isinstance(entry, str) for entry in source.fields)
    if plain:
        pairs = zip(columns, source.factors, source.offsets, strict=True)
        phases = [column * factor + offset if offset else column * factor for column, factor, offset in pairs]
        return np.column_stack(phases if len(phases) == 3 else [*phases, -phases[0] - phases[1]])
    values = columns[:-1] if source.angle else columns
    shift = source.to_phases @ np.array(source.offsets)
    found = np.column_stack(values) @ source.matrix.T + shift
    if not source.angle:
        return np.asarray(found)
    return frames.to_abc(found, columns[-1] * ANGLE_UNITS[source.angle_unit])
