"""What joining the signals of a recording found, in figures and in sentences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from drive_id.messages import Message

_LARGE_OFFSET = 0.25
"""Of stamps from those of the currents, in sample periods, that is reported."""
_FEW_JOINED = 0.9
"""Share of the samples that found partners below which that is reported."""


@dataclass(frozen=True)
class SignalReport:
    """What became of one signal.

    Parameters
    ----------
    read, used : int
        Samples found, and samples in the result.
    repeated, backward : int
        Samples cut out because their stamp repeats, or lies before, one seen earlier.
    lost, losses : int
        Samples missing by the messages' own count, and the number of places where they are.
    offset : float
        Constant distance of the stamps from those of the currents, s, within half a period.
    declared_period, measured_period : float or None
        s.
    not_finite : int
        Samples dropped because they are NaN or infinite.
    """

    topic: str
    read: int
    used: int
    repeated: int
    backward: int
    lost: int
    losses: int
    offset: float
    declared_period: float | None
    measured_period: float | None
    not_finite: int = 0


@dataclass(frozen=True)
class JoinReport:
    """What became of the signals of one recording.

    Parameters
    ----------
    signals : tuple of SignalReport
        Currents, voltages, resolver.
    sample_period : float
        s.
    samples : int
        In the result.
    runs : int
        Gap-free stretches in the result.
    time_lost : float
        Time between the runs, s.
    gaps : int
        Breaks found; more than ``runs - 1`` when stretches were too short to keep.
    """

    signals: tuple[SignalReport, ...]
    sample_period: float
    samples: int
    runs: int
    time_lost: float
    gaps: int
    warnings: tuple[Message, ...] = ()


def join_warnings(report: JoinReport) -> Iterator[Message]:
    """Yield what is missing, cut out or shifted in the joined samples."""
    for signal in report.signals:
        topic = signal.topic
        if signal.not_finite:
            yield Message("samples_not_finite", samples=signal.not_finite, topic=topic)
        if signal.repeated or signal.backward:
            yield Message("stamps_cut", repeated=signal.repeated, backward=signal.backward, topic=topic)
        if signal.lost:
            yield Message("samples_lost", samples=signal.lost, places=signal.losses, topic=topic)
        if abs(signal.offset) > _LARGE_OFFSET * report.sample_period:
            yield Message("stamps_shifted", offset=signal.offset, topic=topic)
    currents = report.signals[0]
    finite = currents.read - sum(signal.not_finite for signal in report.signals)
    if report.samples < _FEW_JOINED * finite:
        yield Message("samples_unused", samples=report.samples, read=currents.read, topic=currents.topic)
    if report.gaps:
        yield Message("gaps.join", gaps=report.gaps, runs=report.runs, time_lost=report.time_lost)
