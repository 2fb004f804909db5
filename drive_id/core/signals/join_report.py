"""What joining the signals of a recording found, in figures and in sentences."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SignalReport:
    """What became of one signal.

    Parameters
    ----------
    topic : str
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
    warnings : tuple of str
        Sentences.
    """

    signals: tuple[SignalReport, ...]
    sample_period: float
    samples: int
    runs: int
    time_lost: float
    gaps: int
    warnings: tuple[str, ...] = ()


def join_warnings(report: JoinReport) -> tuple[str, ...]:
    """Say in sentences what is missing, cut out or shifted in the joined samples."""
    sentences = []
    for signal in report.signals:
        if signal.not_finite:
            sentences.append(
                f"{signal.not_finite} samples of {signal.topic} are NaN or infinite, so that a fit will be refused: "
                "repair the sensor or its driver."
            )
        if signal.repeated or signal.backward:
            sentences.append(
                f"{signal.repeated} repeated and {signal.backward} backward stamps of {signal.topic} were cut out."
            )
        if signal.lost:
            sentences.append(
                f"{signal.lost} samples of {signal.topic} are missing in {signal.losses} places by its own count."
            )
        if abs(signal.offset) > 0.25 * report.sample_period:
            sentences.append(
                f"The stamps of {signal.topic} lie {signal.offset * 1e6:+.1f} us from those of the currents: "
                "if they belong to the sample before or after, give stamp_offset in a signals file."
            )
    currents = report.signals[0]
    finite = currents.read - sum(signal.not_finite for signal in report.signals)
    if report.samples < 0.9 * finite:
        sentences.append(
            f"Only {report.samples} of {currents.read} samples of {currents.topic} have partners in voltages and "
            "resolver and could be used."
        )
    if report.gaps:
        sentences.append(
            f"The recording has {report.gaps} gaps; {report.runs} runs without gaps remain, "
            f"{report.time_lost:.6f} s apart in total."
        )
    return tuple(sentences)
