"""Checks of angle, speed and time: units, jumps, standstill, and agreement of angle and speed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.frames import ComplexArray
from drive_id.types import Samples

_PERIODS = (5e-7, 0.02)
"""Shortest and longest plausible sample period, s."""
_UNITS = {1.0: "revolutions", 360.0: "degrees", 400.0: "gon"} | {2.0**n: "counts" for n in range(8, 25)}
_FEWEST_WRAPS = 3  # so that a median tells their step
_COARSE_TURN = np.deg2rad(40.0)  # per sample: the voltage within a sample is hardly known any more
_HELD_SHARE, _HELD_STEP = 0.5, 0.02
"""Of samples without a step, from which on the angle is held, and rad: smaller steps are those of an encoder at low
speed."""
_DRIFT = (0.03, 0.5)  # change over the recording, by the mean speed: a larger one is meant
_DRIFT_FIT = 0.9  # share of the variance that a straight line must explain
_DRIFT_PARTS = 6  # runs, of which that can be told
_MOST_POLE_PAIRS = 50  # of any machine
_MEANT = 0.006
"""Relative distance from a unit or a factor that is meant: neighbouring pole pairs differ by 2 %, and degrees that were
wrapped as if in radians are off by 0.5 %. Half of it for turns in rad: 256 counts are off 41 of them by 0.6 %."""
_SWINGING = 3.0  # way of a swinging rotor, by its range
_WHOLE, _TO_AND_FRO = 0.95, 10.0
"""Range of the angle, turns, and way by its range, from which on it was likely interpolated across its wraps."""
_LEAST_SWING = 0.05  # rad, least such range: angle noise travels far, too
_FASTEST_CHANGE = 200.0
"""Hz, above which a derivative of the angle is noise."""
_DELAYS = np.geomspace(1e-4, 2e-2, 54)  # s, of filters of the speed that are tried, 10 % apart
_DAMPINGS = (0.5, 0.7, 1.0)  # likewise
SPEED_TOLERANCE = 0.02  # of the ratio of angle and speed, which a poor time base may have
_UNEXPLAINED_SPEED = 0.01  # share of the energy that noise may take then


def time_findings(periods: Sequence[float]) -> Iterator[Message]:
    """Yield implausible sample periods, s."""
    for period in periods:
        if not _PERIODS[0] <= period <= _PERIODS[1]:
            yield Message("sample_period", sample_period=period, rate=1 / period)
            return


def unit_findings(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield an angle that is not in radians, detected from the step by which it wraps."""
    steps = np.concatenate([np.diff(run.angle) for run in runs])
    spread = float(np.ptp(np.concatenate([run.angle for run in runs])))
    wraps = np.abs(steps) > 0.6 * spread
    if wraps.sum() >= _FEWEST_WRAPS and spread > 0:
        turn = float(np.median(np.abs(steps[wraps]))) + float(np.median(np.abs(steps[~wraps])))
        whole = round(turn / (2 * np.pi))
        if 1 <= whole < _MOST_POLE_PAIRS and abs(turn / (2 * np.pi) / whole - 1) < 0.5 * _MEANT:
            return
        for unit, name in _UNITS.items():
            if abs(turn / unit - 1) < _MEANT:
                yield _in_unit(name, unit, f"wraps by {turn:.4g}")
                return
        return
    moved = sum(float(run.angle[-1] - run.angle[0]) for run in runs)
    expected = sum(float(run.speed[:-1].sum() * run.sample_period) for run in runs)
    if wraps.sum() == 0 and expected and abs(np.deg2rad(moved / expected) - 1) < SPEED_TOLERANCE and abs(expected) > 1:
        yield _in_unit("degrees", 360.0, f"advances {moved / expected:.4g} times as fast as the logged speed")


def rotation_finding(ratio: float) -> Message:
    """Return the finding for an angle that advances at ``ratio`` times its speed."""
    return Message("angle_speed", ratio=ratio, meaning=_ratio_meaning(ratio) or None)


def standstill_finding(turned: float, travelled: float) -> Message:
    """Return the finding for a rotor that stays within one revolution.

    Parameters
    ----------
    turned : float
        Range of the angle, electrical, rad.
    travelled : float
        Way there and back, electrical, rad.
    """
    revolutions = turned / (2 * np.pi)
    swings = turned >= _LEAST_SWING and travelled >= _SWINGING * turned
    wording = "standstill.swing" if swings else "standstill"
    if revolutions > _WHOLE and travelled > _TO_AND_FRO * turned:
        wording = "standstill.interpolated"
    return Message(wording, turned=turned, travelled=travelled, revolutions=revolutions)


def speed_lag(runs: Sequence[Samples]) -> float:
    """Return by how much the speed lags the angle, as a filter or an observer makes it, s; NaN if none explains it.

    A lag takes away amplitude as a wrong factor does, but the more, the faster the speed changes, and it turns the
    phase. So the speed must be that of the angle, at factor 1, after one of some filters of low order.

    Parameters
    ----------
    runs : sequence of Samples
        Excerpts of one gap-free run each.
    """
    spectra = [_slow_spectra(run) for run in runs]
    if not spectra:
        return float("nan")
    s, by_angle, given = (np.concatenate(parts) for parts in zip(*spectra, strict=True))
    best, found = _UNEXPLAINED_SPEED * float(np.vdot(given, given).real), float("nan")
    for delay in _DELAYS:
        x = s * delay
        for response in (np.exp(-x), 1 / (1 + x), *(1 / (1 + x + (0.5 * x / damping) ** 2) for damping in _DAMPINGS)):
            expected = response * by_angle
            energy = float(np.vdot(expected, expected).real)
            factor = float(np.vdot(expected, given).real) / energy if energy > 0 else 0.0
            left = float(np.sum(np.abs(given - factor * expected) ** 2))
            if left < best and abs(factor - 1) < SPEED_TOLERANCE:
                best, found = left, float(delay)
    return found


def _slow_spectra(run: Samples) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return j omega, rad/s, and the spectra of the speed by the angle and of the one given, each (K,)."""
    frequency = np.fft.rfftfreq(len(run), run.sample_period)
    slow = (frequency > 0) & (frequency < _FASTEST_CHANGE)
    by_angle = np.gradient(np.unwrap(run.angle), run.sample_period)
    both = [np.fft.rfft((x - x.mean()) * np.hanning(len(x)))[slow] for x in (by_angle, run.speed)]
    return np.asarray(2j * np.pi * frequency[slow]), both[0], both[1]


def motion_findings(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield coarse or held angles and a drifting speed."""
    turns = np.concatenate([run.speed * run.sample_period for run in runs])
    turn = float(np.sqrt(np.mean(turns**2)))
    if turn > _COARSE_TURN:
        yield Message("coarse_sampling", turn=turn)
    steps = np.concatenate([np.diff(run.angle) for run in runs])
    held = steps == 0
    if held.mean() > _HELD_SHARE and not held.all() and float(np.median(np.abs(steps[~held]))) > _HELD_STEP:
        yield Message("held_angle", share=held.mean(), every=1 / (1 - held.mean()))
    yield from _drift(runs)


def _drift(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield a steady change of speed over the recording, larger than noise and smaller than an intended one."""
    speed = np.array([float(run.speed.mean()) for run in runs])
    if len(runs) < _DRIFT_PARTS or not speed.all():
        return
    at = np.arange(len(runs)) - 0.5 * (len(runs) - 1)
    slope, middle = np.polyfit(at, speed, 1)
    drift = float(slope * len(runs))
    rest = float(np.sum((speed - middle - slope * at) ** 2))
    within = [np.polyfit(run.stamp - run.stamp[0], run.speed, 1)[0] for run in runs]
    expected = float(np.median(within) * (runs[-1].stamp[-1] - runs[0].stamp[0]))  # steps between runs are not drift
    steady = rest < (1 - _DRIFT_FIT) * float(np.sum((speed - middle) ** 2)) and 0.5 < expected / (drift or 1.0) < 2
    if steady and _DRIFT[0] < abs(drift / middle) < _DRIFT[1]:
        yield Message("speed_drift", drift=drift / abs(middle))


def _in_unit(name: str, unit: float, why: str) -> Message:
    short = {"degrees": "deg", "revolutions": "rev"}.get(name)
    wording = "angle_unit" if short else "angle_unit.scale"
    return Message(wording, factor=2 * np.pi / unit, unit=name, unit_short=short, why=why)


def _ratio_meaning(ratio: float) -> str:
    """Return a clause with the likely cause of a ratio of both speeds; empty if there is none."""
    against = " counted the other way" if ratio < 0 else ""
    if abs(ratio + 1) < SPEED_TOLERANCE:
        return "one of them counted the other way"
    degree = np.pi / 180
    meanings = [(1 / degree, "the angle were in degrees"), (degree, "the speed were in degrees per second")]
    meanings += [(10.0**power, "the unit of the time were wrong") for power in (-9, -6, -3, 3, 6, 9)]
    for count in range(2, _MOST_POLE_PAIRS):
        machine = f"mechanical and the machine had {count} pole pairs"
        meanings += [(float(count), f"the speed were {machine}"), (1 / count, f"the angle were {machine}")]
    for unit, name in ((np.pi / 30, "rpm"), (2 * np.pi, "revolutions per second")):
        said = f"the speed were in {name}"
        meanings += [(unit, said)]
        meanings += [(n * unit, f"{said} and the machine had {n} pole pairs") for n in range(2, _MOST_POLE_PAIRS)]
    away, meaning = min((abs(abs(ratio) / value - 1), meaning) for value, meaning in meanings)
    return f"{meaning}{against}" if away < _MEANT else ""
