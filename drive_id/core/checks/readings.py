"""Check the declared meaning of the signals: phases, signs, pole pairs, direction, offset, decimation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import gcd

import numpy as np

from drive_id.common.messages import Message, Value
from drive_id.core import frames
from drive_id.core.checks.balance import DELAYS, Excerpt, Reading, RoughFit, residuals, rough_fit
from drive_id.core.numerics.largest import USUAL_QUANTILE
from drive_id.types import FloatArray, Samples

_BAD = 0.05
"""Unexplained share of the voltage above which other readings are tried."""
_BETTER = 1 / 3
"""Largest ratio of unexplained voltage, to that of the declared reading, at which another reading is proposed."""
_LITTLE_BETTER = 0.6
"""Likewise for voltages shifted in time or turned by odd multiples of 30 degrees, 0.96 at best on 34 random drives."""
_BETTER_MISTAKEN = 0.5
"""Likewise for currents and voltages exchanged: at most 0.36 where they are, 0.53 at best where voltages are late."""
_ALIKE = 1.02  # ratio of unexplained voltages within which the reading with the least factor is taken
_REFUSED = 0.1  # unexplained share of the voltage above which a far better reading is an error, below a warning
_CERTAIN = 0.005
"""Unexplained share of the voltage above which voltages between phases or exchanged signals are refused: below, what a
rough model misses at many degrees per sample may decide between readings."""
_BY_TURN = 1 / 24
"""The same by the square of the angle per sample, rad, half of what a straight line misses of a current that turns: a
good drive at 48 degrees per sample, of which the rough model missed 0.8 %, was refused."""
_HOPELESS = 0.35  # unexplained share above which no reading of a rough model explains the voltages
_FEW_RUNS = 3
"""Number of runs used to choose the likeliest of the other readings."""
_MULTIPLES = 24  # most pole pairs that are tried as a factor on the angle
_PARTS = (8, 4)  # largest numerator and denominator of other factors: wrong pole pairs
_LEAST_OFFSET = np.deg2rad(20.0)  # of the angle, from which on method full corrects it no more
_AGREEING = np.deg2rad(15.0)  # between the axes by magnet and by saliency
_LEAST_MAGNET = 0.3  # flux of the magnet over L i_max from which on it alone gives the axis
_WEAK_MAGNET = 0.05  # the same below which it does not even choose among the axes of the saliency
_LEAST_SALIENCY = 0.15  # difference of inductances over their sum that gives an axis
_DECIMATED_TURN = np.deg2rad(5.0)  # of the rotor per sample, below which it does no harm
_DECIMATED_SHARE = 1.05  # unexplained voltage without that delay over that with it
_LARGE_TURN = 0.2  # speed times sample period that only degrees have, as most drives turn by less, rad
_SLOW_RATE = 2100.0  # Hz, below which inverters rarely switch
_LATE = (0.02, 64, 256)
"""Delay that is tried both ways, s, and its least and most samples."""
_LATE_SHARE = 8  # part of a run that it may take
_LATE_TURN = 0.3  # rad by which the rotor turns between the delays that are tried first
_LATE_BETTER = 0.8
"""Largest ratio of unexplained voltage, to that without a delay, of a shift in time that is reported: 0.74 with one of
3 samples, 0.84 at least on 106 good random drives, and 0.77 on another one, whose current sensors are not linear
(no shift at all on 24 more of that kind)."""
_LATE_LEAST = 0.01
"""Share of the voltage left unexplained below which nothing is late: the rough model itself leaves half of it."""
_NARROW = 0.1
"""Extent of the currents in d and q across by that along their main direction, below which they move on a line: 0.02
with noise. At one speed, a shift in time then turns and bends the voltage as offset and saturation do."""
_CORRECTED = "unexplained_corrected"
_RESTING = 0.05
"""Mean phase current of a part at rest, relative to i_max."""
_PART, _FEWEST_PARTS = 0.2, 8
"""Duration of a part, s, in which a loose contact shows, and fewest parts for a median."""
_OUTLYING, _LEAST_OUTLYING = 30.0, 0.06
"""Squared residual of an outlying part over the median of all, and its unexplained voltage over the rms of all: less
does not distort a map."""
_RAMP = 0.3  # relative range of speeds beyond which the parts are not alike
_BETWEEN_PHASES = tuple(Reading(turned=half_turns) for half_turns in (-0.5, 0.5, -1.5, 1.5, -2.5, 2.5))
"""Voltages between two phases, 30 degrees ahead of those of a phase or so, in all their orders."""


def reading_findings(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield findings on the meaning of the signals, from excerpts of one run each and the largest usual current, A."""
    excerpts = [Excerpt.of(run, i_max) for run in runs]
    declared = rough_fit(excerpts)
    if declared is None:
        return
    better = _best_other(excerpts, declared)
    shift = _time_shift(excerpts, declared)
    other = _mistaken(runs, declared, better) or (None if better is None else _misread(declared, better))
    if other is not None:
        likelier = shift is not None and shift.values[_CORRECTED] < other.values[_CORRECTED]
        yield shift if shift is not None and likelier else other
        return
    if shift is not None or declared.unexplained > _HOPELESS:
        yield shift or Message("unexplained", unexplained=declared.unexplained)
        return
    yield from _offset(i_max, declared)
    yield from _decimation(declared, runs)
    yield from _outliers(declared, runs, i_max)


@dataclass(frozen=True)
class LikelyReading(Reading):
    """What explains the voltages best, tried on signals of unknown meaning."""

    angle_offset: float = 0.0  # to add to the angle then, rad
    certain_offset: bool = False  # whether a magnet shows it; without one it is known up to multiples of 90 degrees
    unexplained: float = 0.0  # share of the voltage that a rough model leaves unexplained, 0 to 1


def likely_reading(runs: Sequence[Samples], i_max: float, ratios: Sequence[int] | None = None) -> LikelyReading | None:
    """Find the factor on the angle and its offset that explain the voltages best; None if nothing can be said.

    Parameters
    ----------
    runs : sequence of Samples
        Excerpts of one gap-free run each.
    i_max : float
        A.
    ratios : sequence of int, optional
        To try; default: 1 to 24 both ways.
    """
    excerpts = [Excerpt.of(run, i_max) for run in runs]
    some = [excerpt.coarse() for excerpt in excerpts]
    tried = ratios or [sign * k for k in range(1, _MULTIPLES + 1) for sign in (1, -1)]
    best = _least([Reading((ratio, 1)) for ratio in tried], some, excerpts)
    if best is not None and best.unexplained > _HOPELESS:
        orders = [(turned, mirrored) for turned in range(6) for mirrored in (False, True)][1:]
        few = [ratio for ratio in tried if abs(ratio) <= _MULTIPLES // 2]
        other = _least([Reading((ratio, 1), *order) for ratio in few for order in orders], some[:2], excerpts)
        best = other if other is not None and other.unexplained < _BETTER * best.unexplained else best
    if best is None:
        return None
    certain = abs(best.magnet) > _LEAST_MAGNET * best.inductance * i_max
    return LikelyReading(
        **vars(best.reading),
        angle_offset=_offset_of(best, i_max),
        certain_offset=certain,
        unexplained=best.unexplained,
    )


def _least(readings: Sequence[Reading], some: Sequence[Excerpt], every: Sequence[Excerpt]) -> RoughFit | None:
    """Return the fit to all excerpts of the reading that explains some best; of equal ones, with the least factor."""
    fits = [fit for reading in readings if (fit := rough_fit(some, reading, (0.0, 1.0, -1.0))) is not None]
    if not fits:
        return None
    least = min(fit.unexplained for fit in fits)
    alike = [fit for fit in fits if fit.unexplained <= _ALIKE * least]
    return rough_fit(every, min(alike, key=lambda fit: abs(fit.reading.ratio[0])).reading)


def degree_findings(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield a finding if angle and speed are both in degrees, according to the voltages."""
    if max(float(np.abs(run.speed).max()) * run.sample_period for run in runs) < _LARGE_TURN:
        return
    declared = rough_fit([Excerpt.of(run, i_max) for run in runs])
    found = rough_fit([Excerpt.of(replace(run, angle=np.deg2rad(run.angle)), i_max) for run in runs])
    if declared and found and found.unexplained < _BETTER * declared.unexplained and declared.unexplained > _REFUSED:
        yield Message("angle_unit.voltages", **_compared(declared, found))


def _best_other(runs: Sequence[Excerpt], declared: RoughFit) -> RoughFit | None:
    """Return the fit of the reading that explains the most, if it explains far more than the declared one."""
    some = [run.coarse() for run in runs[:: -(-len(runs) // _FEW_RUNS)]]
    others = [*_others()] if declared.unexplained > _BAD else []  # voltages between phases may leave little
    fits = (rough_fit(some, reading, (0.0, 1.0, -1.0)) for reading in (*others, *_BETWEEN_PHASES))
    likely = min((fit for fit in fits if fit is not None), key=lambda fit: fit.unexplained, default=declared)
    best = rough_fit(runs, likely.reading)
    limit = _LITTLE_BETTER if likely.reading in _BETWEEN_PHASES else _BETTER
    return best if best is not None and best.unexplained < limit * declared.unexplained else None


def _mistaken(runs: Sequence[Samples], declared: RoughFit, better: RoughFit | None) -> Message | None:
    """Return a finding if the signals explain far more when taken for others, see :func:`_mistakes`."""
    turn = float(np.median([abs(float(np.mean(run.speed))) * run.sample_period for run in runs]))
    if declared.unexplained < _CERTAIN + _BY_TURN * turn**2:
        return None
    some = runs[:: -(-len(runs) // _FEW_RUNS)]
    found: list[tuple[RoughFit, str, str | None]] = []
    for code, signals, taken in _mistakes(pairs=declared.unexplained > _BAD):
        others = [taken(run) for run in some]
        largest = max(float(np.quantile(np.abs(run.i_abc), USUAL_QUANTILE)) for run in others)
        fit = rough_fit([Excerpt.of(run, largest).coarse() for run in others]) if largest > 0 else None
        found += [] if fit is None else [(fit, code, signals)]
    fit, code, signals = min(found, key=lambda each: each[0].unexplained, default=(declared, "", None))
    limit = _BETTER_MISTAKEN * declared.unexplained if better is None else better.unexplained
    if fit.unexplained > limit:
        return None
    return Message(code, **_compared(declared, fit), signals=signals)


def _mistakes(*, pairs: bool) -> Iterator[tuple[str, str | None, Callable[[Samples], Samples]]]:
    """Yield code, signals and cure of mistakes: exchanged signals, and, with ``pairs``, alpha and beta for a and b."""
    yield "exchanged", None, lambda run: replace(run, i_abc=run.u_abc, u_abc=run.i_abc)
    if pairs:
        yield "alpha_beta", "voltages", lambda run: replace(run, u_abc=_of_pair(run.u_abc))
        yield "alpha_beta", "currents", lambda run: replace(run, i_abc=_of_pair(run.i_abc))
        both = "currents and voltages"
        yield "alpha_beta", both, lambda run: replace(run, i_abc=_of_pair(run.i_abc), u_abc=_of_pair(run.u_abc))


def _of_pair(x_abc: FloatArray) -> FloatArray:
    """Return the phase quantities (N, 3) whose components alpha and beta were taken for phases a and b."""
    return frames.phases(x_abc[:, 0] + 1j * x_abc[:, 1])


def _others() -> Iterator[Reading]:
    """Yield all readings that differ from the declared one by a single mistake."""
    for turned, mirrored, direction in product(range(6), (False, True), (1, -1)):
        if (turned, mirrored, direction) != (0, False, 1):
            yield Reading((direction, 1), turned, mirrored)
    for phase in range(3):
        yield Reading(reversed_current=phase)
        yield Reading(reversed_voltage=phase)
    fractions = [(over, 1) for over in range(2, _MULTIPLES + 1)]
    fractions += [
        (over, under)
        for under, over in product(range(2, _PARTS[1] + 1), range(1, _PARTS[0] + 1))
        if gcd(over, under) == 1
    ]
    yield from (Reading((direction * over, under)) for direction in (1, -1) for over, under in fractions)


def _compared(declared: RoughFit, better: RoughFit) -> dict[str, float]:
    return {"unexplained": declared.unexplained, _CORRECTED: better.unexplained}


def _misread(declared: RoughFit, better: RoughFit) -> Message:
    certain = declared.unexplained > (_CERTAIN if better.reading in _BETWEEN_PHASES else _REFUSED)
    wording, values = _meaning(better.reading)
    over, under = better.reading.ratio
    compared = _compared(declared, better) | {"angle_factor": over / under}
    return Message(wording, "error" if certain else "warning", **compared, **values)


def _meaning(reading: Reading) -> tuple[str, dict[str, Value]]:
    """Return code and values for a reading other than the declared one."""
    for phase, name in ((reading.reversed_current, "current"), (reading.reversed_voltage, "voltage")):
        if phase >= 0:
            return "phase_reversed", {"phase": phase, "signal": name}
    if reading in _BETWEEN_PHASES:
        return "line_voltages", {}
    return _of_phases(reading) if reading.turned or reading.mirrored else _of_angle(*reading.ratio)


def _of_phases(reading: Reading) -> tuple[str, dict[str, Value]]:
    """Describe a wrong order or sign of the phases; half a turn is a sign."""
    negative, order, against = reading.voltage_sign < 0, reading.voltage_order, reading.ratio[0] < 0
    if reading.mirrored:
        phases = " and ".join("abc"[k] for k, at in enumerate(order) if at != k)
        signal = "currents" if against else "voltages"
        return "phases_swapped", {"phases": phases, "signal": signal, "negative": negative}
    remedies = ["make the scale of the currents negative, which are positive into the machine"] if negative else []
    remedies += ["change the sign of angle and speed"] if against else []
    remedy: dict[str, Value] = {"remedy": " and ".join(remedies)} if remedies else {}
    if order == (0, 1, 2):
        return "current_sign", remedy
    return "phases_shifted", {"order": ", ".join("abc"[k] for k in order), **remedy}


def _of_angle(over: int, under: int) -> tuple[str, dict[str, Value]]:
    """Describe an angle that must be multiplied by a fraction."""
    if (over, under) == (-1, 1):
        return "direction", {}
    against, over = over < 0, abs(over)
    if under == 1:
        return "pole_pairs", {"over": over, "against": against}
    example = max(1, 8 // under)
    examples = {"right": over * example, "wrong": under * example}
    return "pole_pairs.ratio", {"over": over, "under": under, "against": against, **examples}


def _time_shift(runs: Sequence[Excerpt], declared: RoughFit) -> Message | None:
    """Return a finding if the voltages are many samples early or late; None if a shift explains no more, or any may."""
    if _on_a_line(runs):
        return None
    period = float(np.median([excerpt.run.sample_period for excerpt in runs]))
    longest = max(len(excerpt.i_s) for excerpt in runs)
    reach = min(int(np.clip(_LATE[0] / period, *_LATE[1:])), longest // _LATE_SHARE)
    turn = float(np.median([abs(float(np.mean(np.diff(excerpt.angle)))) for excerpt in runs]))
    step = int(np.clip(_LATE_TURN / max(turn, 1e-9), 1, 4))
    some = [run.coarse() for run in runs[:: -(-len(runs) // _FEW_RUNS)]]
    near = rough_fit(some, delays=np.arange(-reach, reach + 1, step).tolist())
    if near is None:
        return None
    shifted = rough_fit(runs, delays=(near.delay + np.arange(-step, step + 1)).tolist())
    if (
        shifted is None
        or declared.without_delay < _LATE_LEAST
        or shifted.unexplained > _LATE_BETTER * declared.without_delay
        or abs(shifted.delay) <= max(DELAYS)
    ):
        return None
    return Message("time_shift", delay=shifted.delay, late=shifted.delay * period, **_compared(declared, shifted))


def _on_a_line(runs: Sequence[Excerpt]) -> bool:
    """Tell whether the currents move along a line in d and q only, at one speed."""
    speed = np.concatenate([excerpt.run.speed for excerpt in runs])
    i_r = np.concatenate([excerpt.i_s * np.exp(-1j * excerpt.angle) for excerpt in runs])
    extents = np.linalg.svd(np.cov(i_r.real, i_r.imag), compute_uv=False) ** 0.5
    return bool(np.ptp(speed) < _RAMP * np.abs(speed).mean() and extents[1] < _NARROW * extents[0])


def _offset(i_max: float, fit: RoughFit) -> Iterator[Message]:
    """Yield an angle offset too large for method full to correct."""
    offset = _offset_of(fit, i_max)
    reluctance = abs(fit.magnet) < _WEAK_MAGNET * fit.inductance * i_max
    if abs(offset) >= _LEAST_OFFSET:
        yield Message("angle_offset", angle_offset=offset, unexplained=fit.unexplained, reluctance=reluctance)


def _offset_of(fit: RoughFit, i_max: float) -> float:
    """Return the offset of the d axis, rad, from the magnet or else from the saliency; 0 if neither shows it.

    The saliency gives it up to multiples of 90 degrees, because the d axis of a reluctance machine is a convention. The
    magnet flux, if there is any, resolves the ambiguity.
    """
    reach = fit.inductance * i_max
    by_magnet, by_saliency = float(np.angle(fit.magnet)), float(np.angle(fit.saliency**2)) / 4
    salient = abs(fit.saliency) > _LEAST_SALIENCY * fit.inductance
    strong = abs(fit.magnet) > _LEAST_MAGNET * reach
    if not salient:
        return by_magnet if strong else 0.0
    quarter = np.pi / 2
    if abs(fit.magnet) > _WEAK_MAGNET * reach:
        nearest = by_saliency + quarter * round((by_magnet - by_saliency) / quarter)
        agrees = abs(nearest - by_magnet) < _AGREEING
        return by_magnet if strong and (agrees or abs(by_magnet) > quarter / 2) else nearest if agrees else 0.0
    return by_saliency


def _decimation(fit: RoughFit, runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield the sign of a decimated log (every n-th sample): voltages early by (n - 1)/(2 n), 1/4 to 1/2, samples."""
    turn = float(np.sqrt(np.mean(np.concatenate([run.speed * run.sample_period for run in runs]) ** 2)))
    early = -0.5 <= fit.delay < 0.0 and fit.without_delay > _DECIMATED_SHARE * fit.unexplained
    rate = 1 / max(run.sample_period for run in runs)
    if turn > _DECIMATED_TURN and (early or rate < _SLOW_RATE):
        wording = "decimated.early" if early else "decimated"
        yield Message(wording, delay=fit.delay, early=-fit.delay, turn=turn, rate=rate)


def _outliers(fit: RoughFit, runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield the part, not at rest, whose voltages are explained far worse than those of all others, at one speed."""
    count = [round(_PART / run.sample_period) for run in runs]
    parts = [run.part(at, at + n) for run, n in zip(runs, count, strict=True) for at in range(0, len(run) - n + 1, n)]
    parts = [part for part in parts if np.abs(part.i_abc).mean() > _RESTING * i_max]
    speeds = np.array([part.speed.mean() for part in parts])
    if len(parts) < _FEWEST_PARTS or np.ptp(speeds) > _RAMP * np.abs(speeds).mean():
        return
    left, square = residuals([Excerpt.of(part, i_max) for part in parts], fit)
    worst = int(left.argmax())
    usual, share = float(np.median(left)), float(np.sqrt(left[worst] / max(square.mean(), 1e-300)))
    if left[worst] > _OUTLYING * usual and share > _LEAST_OUTLYING:
        at = 0.5e-9 * float(parts[worst].stamp[0] + parts[worst].stamp[-1] - 2 * runs[0].stamp[0])
        yield Message("outlier", time=at, share=share, times=np.sqrt(left[worst] / usual))
