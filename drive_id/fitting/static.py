"""Fit slow logs and operating points by method ``static``: read, find the points, identify, and write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

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
from drive_id.messages import Message
from drive_id.types import GroundTruth, Progress, Samples, silent


@dataclass(frozen=True, eq=False)
class StaticSources:
    """Slow telemetry in memory, and where it is from.

    Parameters
    ----------
    data : sequence of OperatingData
        At least one.
    digests : dict of str to str
        File to its sha256.
    last_stamp : int
        ns, 0 when unknown.
    """

    data: Sequence[OperatingData]
    truth: GroundTruth | None = None
    digests: dict[str, str] = field(default_factory=dict)
    last_stamp: int = 0
    signals: SignalMap | None = None
    warnings: tuple[Message, ...] = ()

    @classmethod
    def in_memory(cls, recordings: Sequence[OperatingData | Samples]) -> StaticSources:
        """Take telemetry as it is, and average samples."""
        data = [averaged(entry) if isinstance(entry, Samples) else entry for entry in recordings]
        samples = [entry for entry in recordings if isinstance(entry, Samples)]
        truths = [entry.truth if isinstance(entry, Samples) else None for entry in recordings]
        last_stamp = max((int(entry.stamp[-1]) for entry in samples), default=0)
        return cls(data, common_truth(truths), last_stamp=last_stamp)

    @classmethod
    def read(cls, sources: Sources, tell: Progress = silent) -> StaticSources:
        """Read logs; raises DriveIdError when one cannot be read, unless ``skip_bad``; or when all cannot."""
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
        return cls(
            [log.data for log in logs],
            common_truth([log.truth for log in logs]),
            {file: digest for log in logs for file, digest in log.digests.items()},
            max(log.last_stamp for log in logs),
            sources.signals,
            (
                *(Message("left_out.recording", reason=str(error)) for error in refused),
                *(text for log in logs for text in log.warnings),
            ),
        )


def fit_static(sources: StaticSources, settings: FitSettings, tell: Progress = silent) -> Identification:
    """Identify a drive from slow telemetry.

    Raises DriveIdError when there are too few operating points, or they cannot give a trustworthy result.
    """
    tell("Solving", None)
    data = [_prepared(part, settings, number) for number, part in enumerate(sources.data)]
    with one_blas_thread():
        points = joined_points([operating_points(part) for part in data])
        drive = identify_static(points, settings)
    result = completed(
        drive,
        settings,
        excerpts=(),
        truth=sources.truth,
        signals=sources.signals,
        duration=sum(part.duration for part in data),
        last_stamp=sources.last_stamp,
        inputs=sources.digests,
        warnings=sources.warnings,
    )
    speeds = (float(points.speed.min()), float(points.speed.max()))
    return replace(result, provenance=replace(result.provenance, speed_range=speeds))


def _prepared(data: OperatingData, settings: FitSettings, number: int) -> OperatingData:
    """Apply the settings that concern one log: its temperature, and whether its samples are points."""
    if settings.temperatures and data.winding_temperature is None:
        heat = settings.of_recording(number).temperatures[0]
        data = replace(data, winding_temperature=np.full(len(data), heat))
    return replace(data, time=None) if settings.rows_are_points else data
