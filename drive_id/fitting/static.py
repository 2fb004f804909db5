"""Fit slow logs and operating points by method ``static``: read, find the points, identify, and write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.result.static import identify_static
from drive_id.core.signals.pieces import common_truth
from drive_id.core.steady.averaging import averaged
from drive_id.core.steady.operating_data import OperatingData
from drive_id.core.steady.operating_points import joined_points, operating_points
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.operating_log import OperatingLog, read_operating_log
from drive_id.fitting.completion import completed
from drive_id.fitting.result import Identification
from drive_id.fitting.sources import Sources
from drive_id.types import Progress, Samples, silent


def fit_operating_data(
    recordings: Sequence[OperatingData | Samples], settings: FitSettings, tell: Progress = silent
) -> Identification:
    """Identify a drive from slow telemetry in memory; samples are averaged.

    Raises DriveIdError when there are too few operating points, or they cannot give a trustworthy result.
    """
    logs = [
        OperatingLog(averaged(entry), entry.truth, {}, int(entry.stamp[-1]), ())
        if isinstance(entry, Samples)
        else OperatingLog(entry, None, {}, 0, ())
        for entry in recordings
    ]
    return _fit(logs, settings, tell)


def fit_logs(sources: Sources, settings: FitSettings, tell: Progress = silent) -> Identification:
    """Identify a drive from logs.

    Raises DriveIdError as :func:`fit_operating_data` does, when a log cannot be read, unless ``skip_bad``, or when none
    can.
    """
    if sources.information:
        raise ConfigurationError(
            f"{sources.information[0]} is an information file, which holds no operating points: give the logs."
        )
    logs: list[OperatingLog] = []
    refused: list[DriveIdError] = []
    for number, path in enumerate(sources.paths):
        tell("Reading", number / len(sources.paths))
        try:
            logs.append(read_operating_log(path, sources.signals, namespace=sources.namespace))
        except DriveIdError as error:
            if not sources.skip_bad:
                raise
            refused.append(error)
    if not logs:
        raise refused[0]
    left_out = tuple(Message("left_out.recording", reason=str(error)) for error in refused)
    return _fit(logs, settings, tell, signals=sources.signals, warnings=left_out)


def _fit(
    logs: Sequence[OperatingLog],
    settings: FitSettings,
    tell: Progress,
    *,
    signals: SignalMap | None = None,
    warnings: tuple[Message, ...] = (),
) -> Identification:
    tell("Solving", None)
    data = [_prepared(log.data, settings, number) for number, log in enumerate(logs)]
    with one_blas_thread():
        points = joined_points([operating_points(part) for part in data])
        drive = identify_static(points, settings)
    result = completed(
        drive,
        settings,
        excerpts=(),
        truth=common_truth([log.truth for log in logs]),
        signals=signals,
        duration=sum(part.duration for part in data),
        last_stamp=max(log.last_stamp for log in logs),
        inputs={file: digest for log in logs for file, digest in log.digests.items()},
        warnings=(*warnings, *(text for log in logs for text in log.warnings)),
    )
    speeds = (float(points.speed.min()), float(points.speed.max()))
    return replace(result, provenance=replace(result.provenance, speed_range=speeds))


def _prepared(data: OperatingData, settings: FitSettings, number: int) -> OperatingData:
    """Apply the settings that concern one log: its temperature, and whether its samples are points."""
    if settings.temperatures and data.winding_temperature is None:
        heat = settings.of_recording(number).temperatures[0]
        data = replace(data, winding_temperature=np.full(len(data), heat))
    return replace(data, time=None) if settings.rows_are_points else data
