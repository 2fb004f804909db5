"""Checks of currents and voltages: duty cycles, scale, offsets, and clipped, stuck or quantized phases."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.temperature import COLDEST, HOTTEST
from drive_id.core import frames
from drive_id.core.checks.balance import Excerpt, rough_fit
from drive_id.core.numerics.largest import USUAL_QUANTILE
from drive_id.types import FloatArray, Samples

_LARGEST_DUTY = 2 / np.sqrt(3) * 1.005  # of half the DC link: the corner of the hexagon, and rounding
_LEAST_DROP = 0.15
"""Resistive drop at the largest current below which the voltages are taken for duty cycles, V."""
_CURRENTS = (0.5, 5000.0)  # plausible amplitudes, A: drives up to 500 A in kA lie outside
_LARGEST_VOLTAGE = 5000.0  # V, above which the voltages are taken for mV
_SAME_SCALE = 1.3  # ratio of currents to references that a poor controller may have
_LEAST_CORRELATION = 0.97  # of both, below which the controller does not follow and their ratio says nothing
_ZERO_SEQUENCE = 0.02  # rms sum of the phase currents, by i_max: gains of sensors usually agree within 1 %
_WHITE = 0.3  # correlation of successive sums, and share of their mean, below which they are noise
_AS_LARGE = 0.5
"""Rms sum, or constant part, of the currents by i_max, from which on they are no amperes of a machine."""
_ODD_PHASE = 0.3  # difference of two phases' weights in the sum that is zero, by that of the third, which is odd then
_REVERSED = 0.2  # distance of its gain from -1
_AT_LIMIT = 2e-6  # relative width of a limit: float32 rounds to 6e-8
_CLIPPED = 0.015  # share of samples there: a sinusoid is that close to its peak for 0.06 %
_CLAMPED = 0.9  # share of samples with one phase at the limit: of a sinusoid near it, each phase is there by itself
_AT_CORNER = 0.01  # angle to a corner of the hexagon, rad, and length of no vector, by the longest: digits of a log
_SINGLE = 0.98  # share of samples there: of a modulated voltage, a few percent pass by
_LIKE_VECTORS = 0.5  # range of their lengths by the longest: a link that varies by more feeds no drive
_STUCK = 50  # equal samples in a row, more than a coarse converter repeats while the others move
_MOVED = 0.3  # range of the other phases meanwhile, by the largest value
_UNBALANCED = 0.1
"""Range of the sum of all phases meanwhile, likewise: at the crest of a slow wave in coarse steps, it stays."""
_NEAR_LIMIT = 0.999  # of the largest value, where a phase that stands still is clipped
_FEW_LEVELS = 100  # values of a phase: 7 bits, whose steps exceed the noise of any drive
_CURRENT_OFFSET = 0.03  # by i_max: method full corrects smaller ones
_VOLTAGE_OFFSET = 0.05  # by the rms voltage, likewise
_FEWEST_TURNS = 20  # so that the scatter of their means is known to a sixth
_SCATTER = 5.0  # standard errors of a mean over turns, as the turns of a trajectory are not independent
_MOST_REVERSING = 2
"""Runs with turns both ways, as from one speed to the next in the other direction, in a recording that is no swing."""


def waveform_findings(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield findings on the phases, from excerpts of one run each and the largest usual current, A."""
    i_abc, u_abc = (np.concatenate([getattr(run, name) for run in runs]) for name in ("i_abc", "u_abc"))
    if not np.abs(frames.space_vector(u_abc)).max() > 0:
        yield Message("no_voltage")
        return
    duty_cycles = [*_duty_cycles(runs, u_abc, i_max)]
    yield from duty_cycles or _voltage_scale(u_abc)
    single = [*_single_vectors(u_abc)]
    yield from single
    signals = [("current", i_abc)] if single else [("current", i_abc), ("voltage", u_abc)]
    quantized = [finding for name, x in signals for finding in _quantized(name, x)]
    yield from quantized
    if not quantized:
        yield from _stuck(runs)
        yield from _clipped_currents(i_abc)
    yield from _scale(runs, i_max)
    yield from _temperatures(runs)
    yield from _zero_sequence(i_abc, i_max)
    if not single:
        yield from _clipped_voltages(u_abc)
    yield from _offsets(runs, i_max)


def _duty_cycles(runs: Sequence[Samples], u_abc: FloatArray, i_max: float) -> Iterator[Message]:
    low, high = float(u_abc.min()), float(u_abc.max())
    if max(-low, high) > _LARGEST_DUTY:
        return
    fit = rough_fit([Excerpt.of(run, i_max) for run in runs])
    drop = 0.0 if fit is None else fit.resistance * i_max
    if low >= 0 or drop < _LEAST_DROP:
        factor = "u_dc" if low >= 0 else "u_dc / 2"
        yield Message("duty_cycles", low=low, high=high, resistive_voltage=drop, i_max=i_max, factor=factor)


def _scale(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield currents far from their references, or of implausible size."""
    given = [run for run in runs if run.i_dq_reference is not None]
    wanted = np.concatenate([np.zeros((0, 2)), *(run.i_dq_reference for run in given)])
    found = np.concatenate([np.zeros((0, 2)), *(frames.to_dq(run.i_abc, run.angle) for run in given)])
    known = np.isfinite(wanted).all(axis=1)
    squares, product = [float(np.sum(x[known] ** 2)) for x in (wanted, found)], float(np.sum((wanted * found)[known]))
    if min(squares) > 0:
        gain, correlation = product / squares[0], product / np.sqrt(squares[0] * squares[1])
        if correlation > _LEAST_CORRELATION and not 1 / _SAME_SCALE < gain < _SAME_SCALE:
            yield Message("current_scale", gain=gain, unit=_unit_of(gain) or None)
            return
    if not _CURRENTS[0] < i_max < _CURRENTS[1]:
        unit = "mA" if i_max > 1 else "kA or per unit"
        yield Message("current_scale.size", i_max=i_max, unit=unit)


def _temperatures(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield temperatures that no winding or magnet has, such as those in kelvin or degrees Fahrenheit."""
    for part in ("winding", "magnet"):
        known = np.concatenate([run.or_unknown(f"{part}_temperature") for run in runs])
        far = known[(known < COLDEST) | (known > HOTTEST)]
        if len(far):
            yield Message("temperature_range", part=part, temperature=far[0])


def _voltage_scale(u_abc: FloatArray) -> Iterator[Message]:
    """Yield voltages too large for volts; too small ones look like duty cycles."""
    largest = float(np.quantile(np.abs(u_abc), USUAL_QUANTILE))
    if largest > _LARGEST_VOLTAGE:
        yield Message("voltage_scale", largest=largest)


def _unit_of(gain: float) -> str:
    for value, text in ((1e3, "mA for A"), (1e-3, "kA for A"), (np.sqrt(0.5), "rms for peak")):
        if abs(gain / value - 1) < 0.1:
            return text
    return "per unit for A" if gain < 0.1 else ""


def _zero_sequence(i_abc: FloatArray, i_max: float) -> Iterator[Message]:
    """Yield phase currents whose sum is not zero, with the phase that does not match the others."""
    total = i_abc.sum(axis=1)
    rms = float(np.sqrt(np.mean(total**2)))
    if rms <= _ZERO_SEQUENCE * i_max:
        return
    apart = total - total.mean()
    white = abs(float(apart[1:] @ apart[:-1])) < _WHITE * float(apart @ apart)
    if white and abs(total.mean()) < _WHITE * rms:  # noise of the sensors is no fault of their gains
        return
    size, vectors = np.linalg.eigh(i_abc.T @ i_abc / len(i_abc))
    weight = vectors[:, 0]
    values: dict[str, float] = {"zero_sequence": rms}
    if size[0] < 0.1 * float(np.mean(total**2)) / 3:
        phase = int(np.abs(weight - np.median(weight)).argmax())
        one, other = np.delete(weight, phase)
        mean = 0.5 * (one + other)
        if abs(one - other) < _ODD_PHASE * abs(mean - weight[phase]) and weight[phase]:
            values |= {"gain": mean / weight[phase], "phase": phase}
            if abs(values["gain"] + 1) < _REVERSED:
                yield Message("phase_reversed.sum", **values)
                return
    if abs(total.mean()) > 0.7 * rms:
        values = {"zero_sequence": rms, "constant": total.mean()}
    large = {"i_max": i_max} if rms > _AS_LARGE * i_max else {}
    yield Message("zero_sequence.large" if large else "zero_sequence", **values, **large)


def _stuck(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield a phase that holds one value while the others move; not at its limits, where it is clipped."""
    for name, unit, attribute in (("current", "A", "i_abc"), ("voltage", "V", "u_abc")):
        largest = max(float(np.abs(getattr(run, attribute)).max()) for run in runs)
        for run in runs:
            found = _held_phase(getattr(run, attribute), largest)
            if found is None:
                continue
            phase, start, count, value = found
            at = float(run.stamp[start] - runs[0].stamp[0]) * 1e-9
            yield Message("phase_stuck", phase=phase, samples=count, time=at, value=value, signal=name, unit=unit)
            return


def _held_phase(x_abc: FloatArray, largest: float) -> tuple[int, int, int, float] | None:
    """Return phase, first sample, number of samples and value of a stretch in which one phase stands still."""
    for phase in range(3):
        same = np.concatenate([[0], np.diff(x_abc[:, phase]) == 0, [0]]).astype(np.int8)
        edges = np.diff(same)
        for start, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
            value = float(x_abc[start, phase])
            if end - start < _STUCK or abs(value) > _NEAR_LIMIT * largest:
                continue
            part = x_abc[start : end + 1]
            moved = np.ptp(np.delete(part, phase, axis=1), axis=0).max() > _MOVED * largest
            if moved and np.ptp(part.sum(axis=1)) > _UNBALANCED * largest:
                return phase, int(start), int(end - start), value
    return None


def _quantized(name: str, x_abc: FloatArray) -> Iterator[Message]:
    """Yield a phase with few levels."""
    for phase, x in enumerate(x_abc.T):
        some = len(np.unique(x[: 10 * _FEW_LEVELS]))
        levels = some if some >= _FEW_LEVELS else len(np.unique(x))
        if 1 < levels < _FEW_LEVELS and len(x) > 10 * _FEW_LEVELS:
            step = float(np.ptp(x)) / (levels - 1)
            unit = "A" if name == "current" else "V"
            yield Message("phase_quantized", phase=phase, levels=levels, step=step, signal=name, unit=unit)
            return


def _clipped_currents(i_abc: FloatArray) -> Iterator[Message]:
    for phase, x in enumerate(i_abc.T):
        for limit in (float(x.max()), float(x.min())):
            share = float(np.mean(np.abs(x - limit) <= _AT_LIMIT * abs(limit)))
            if share > _CLIPPED:
                yield Message("current_clipped", phase=phase, limit=limit, share=share)
                return


def _single_vectors(u_abc: FloatArray) -> Iterator[Message]:
    """Yield voltages that are one vector of the inverter in each sample: one of six directions, or none."""
    u_s = frames.space_vector(u_abc)
    size = np.abs(u_s)
    active = u_s[size > _AT_CORNER * float(size.max())]
    share = float(np.mean(np.abs(np.angle(active**6)) / 6 < _AT_CORNER))
    all_used = len(np.unique(np.rint(np.angle(active) * 3 / np.pi) % 6)) == 6  # pulses along one axis are none
    if share > _SINGLE and all_used and np.ptp(np.abs(active)) < _LIKE_VECTORS * size.max():
        yield Message("single_vectors", share=share)


def _clipped_voltages(u_abc: FloatArray) -> Iterator[Message]:
    magnitude = np.abs(u_abc)
    largest = float(magnitude.max())
    if np.mean((magnitude >= (1 - _AT_LIMIT) * largest).sum(axis=1) == 1) > _CLAMPED:
        yield Message("voltage_clipped.clamped", limit=largest)
        return
    between = np.ptp(u_abc, axis=1) / np.sqrt(3)  # of two phases, as far as a side of the hexagon from the centre
    kinds = [("amplitude", np.abs(frames.space_vector(u_abc))), ("hexagon", between)]
    kinds += [(f"phase {name}", np.abs(u)) for name, u in zip("abc", u_abc.T, strict=True)]
    for kind, size in kinds:
        limit = float(size.max())
        share = float(np.mean(size >= (1 - _AT_LIMIT) * limit))
        if share > _CLIPPED:
            yield Message("voltage_clipped", limit=limit, share=share, of=kind)
            return


def _offsets(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield constant parts of currents and voltages: means over whole turns of the rotor that agree with each other.

    The means are over the angle, so that a turning vector leaves none where the speed changes within a turn. Turns that
    a reversal breaks off do not count. Where the rotor swings to and fro again and again, the current depends on the
    position and has a constant part, so that nothing is said.
    """
    means: list[FloatArray] = []
    reversing = 0
    for run in runs:
        angle = np.unwrap(run.angle)
        starts = np.flatnonzero(np.diff(np.floor(angle / (2 * np.pi))) != 0) + 1
        if len(starts) > 2:
            signals = np.stack([frames.space_vector(run.i_abc), frames.space_vector(run.u_abc)])
            sums = np.add.reduceat(signals * np.gradient(angle), starts, axis=1)[:, :-1]
            turned = np.diff(angle[starts])
            whole = np.abs(turned) > np.pi
            means.append(sums[:, whole] / turned[whole])
            reversing += abs(np.sign(turned[whole]).sum()) < whole.sum()
    if reversing > _MOST_REVERSING or not any(found.size for found in means):
        return
    i, u = np.concatenate(means, axis=1)
    u_rms = float(np.sqrt(np.mean([np.mean(np.abs(frames.space_vector(run.u_abc)) ** 2) for run in runs])))
    for name, x, least in (("current", i, _CURRENT_OFFSET * i_max), ("voltage", u, _VOLTAGE_OFFSET * u_rms)):
        offset, spread = complex(x.mean()), float(x.std())
        if len(x) >= _FEWEST_TURNS and abs(offset) > max(least, _SCATTER * spread / np.sqrt(len(x))):
            large = name == "current" and abs(offset) > _AS_LARGE * i_max
            code = f"{name}_offset.counts" if large else f"{name}_offset"
            yield Message(code, alpha=offset.real, beta=offset.imag, size=abs(offset))
