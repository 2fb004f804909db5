"""The current between samples, where it is not the straight line that the integrals over a window assume.

While a sample's voltage is held, psi_s moves on a straight line in the stator frame, but for what R i and the drop
take, and the rotor turns on. With s from 0 to 1 over the sample, W(s) the integral of R i and the drop up to s minus s
times that up to 1, and f' the incremental inductances,

    i(s) = i_lin(s) + f'^-1 (e^{-j theta(s)} ((1 - s) psi_s(0) + s psi_s(1) - T W(s)) - psi_lin(s)),

where i_lin and psi_lin are linear between the measured samples. W depends on this current, so it is found by
iteration. At 15 degrees per sample, a machine with a short-circuit current of ten times i_max bows by 8 % of i_max.

At few degrees the current still is no straight line where it decays fast: while R i and the drop h rise by dv in a
sample, it bows by f'^-1 T dv s (1 - s) / 2. The integral of R i + h then exceeds that of a straight current by
T^2 (R + h') f'^-1 dv / 12, which adds up over a window: with R T / L = 0.35, to 1 % of the flux.
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.integrals import spacing
from drive_id.core.full.model import RESISTANCE, FullModel
from drive_id.core.full.windows import DECIMATED, Windows
from drive_id.core.numerics.compiled import compiled
from drive_id.types import TINY, FloatArray, IntArray

UNCERTAIN_SHARE = 0.1
"""Uncertain share of these integrals; compared with an integration of high order."""
_NEGLIGIBLE = 1e-3
"""Deviation of the current from a straight line, in i_max or in steps of the table, below which it is as good as
straight."""
_SETTLED = 1e-4
"""Relative change of drop and resistive voltage that ends the iterations: at 1e-3, R T / L = 0.3 left 0.1 % of the
flux."""
_LEAST_DECAY = 1e-4
"""Share of the flux, (R T / L)^2 / 12, from which on the decay of the current within a sample counts."""
_SPAN = 0.1
"""Half of the range of current, in i_max, over which the inductances are averaged: about what the current bows, and
wide enough that the noise of the map is not fed back through the bow. With the splines' own slopes, a machine at 15
degrees per sample reached 3.6 % of psi_q instead of 0.6 %."""
_TABLE = 4001
"""Currents at which the drop is tabulated."""
_PARTS = 6
"""Parts of a sample in which the current is straight. What it bows within them is 1 / 6^2 of what it bows over the
sample, and is added: on twelve drives, within 0.1 to 4 % of 32 parts, as 8 parts without it."""
_ROUNDS, _DAMPING, _OVERSHOOTS = 8, 0.6, 0.5
"""Most iterations for the current between samples; and the share of each change that is made once a change is that much
of the one before: a drop with a steep step overshoots with all of it, others converge twice as fast."""
_BEYOND = 2.0
"""Range of the tabulated drop, in i_max."""
_NODES = 9
"""Places over a window at which the decaying voltage is taken: some 7 degrees electrical apart."""


def between_samples(
    model: FullModel, estimate: FloatArray, windows: Windows, psi: ComplexArray, delay: float = 0.0
) -> ComplexArray:
    """Return the integral (N,), Vs, of resistive voltage and drop over the currents minus that over straight ones.

    Parameters
    ----------
    estimate : (size,) float
        See :class:`~drive_id.core.full.solver.FullSolution`.
    psi : (N, 2) complex
        Flux at both ends, Wb.
    delay : float
        Of the voltages, samples.

    Returns
    -------
    (N,) complex
        0 where the current hardly bows between samples, where the inductances are not known, and where they are so
        wrong that the iteration diverges.
    """
    out = np.zeros(len(windows), np.complex128)
    step = spacing(float(windows.period.min()))
    turned = np.angle(np.exp(1j * np.diff(windows.angle, axis=1)[:, 0]))
    samples = np.maximum(np.rint(windows.duration / windows.period), 1).astype(np.int64)
    fastest = np.max(np.abs(turned) / samples)
    mean = _mean_inductances(model, estimate, windows.i_dq.mean(axis=1))
    known, inductance = np.linalg.det(mean) > 0.0, _least(mean)
    bow = np.square(fastest * step) / 8 * np.abs(psi).max()  # of the flux
    most = inductance * model.i_max  # a current that bows by i_max and more diverges
    resistance = float(estimate[RESISTANCE])
    decays = (resistance * windows.period.max()) ** 2 / 12 > _LEAST_DECAY * inductance**2
    bows = bow >= _NEGLIGIBLE * most
    if not (known.any() and bow <= most and (bows or decays)):
        return out
    inverse = np.zeros_like(mean)
    inverse[known] = np.linalg.inv(mean[known])
    current = np.linspace(-_BEYOND, _BEYOND, _TABLE) * model.i_max
    drop = np.ascontiguousarray((model.shapes(current) @ estimate[model.phase_columns()]).T)
    if not bows:
        return _by_decay(windows, psi, turned, inverse, resistance, current, drop, delay)
    primitive = np.zeros_like(drop)
    primitive[:, 1:] = np.cumsum(0.5 * (drop[:, 1:] + drop[:, :-1]), axis=1) * (current[1] - current[0])
    i_dq = windows.measured
    settled = _SETTLED * (np.abs(drop).max() + abs(resistance) * np.abs(frames.as_pairs(i_dq)).max())
    _integrate(
        windows.angle[:, 0].copy(), turned, np.ascontiguousarray(i_dq), np.ascontiguousarray(psi), inverse, samples,
        windows.period, windows.drop_scale, resistance, step, current[0], current[1] - current[0], drop, primitive,
        np.exp(1j * frames.PHASE_SHIFTS), float(settled), out,
    )  # fmt: skip
    largest = np.abs(drop).max() + _BEYOND * abs(resistance) * model.i_max
    converged = np.abs(out) < largest * windows.duration  # else beyond the table and what it holds
    return np.where(known & converged, out, 0.0)


def _by_decay(
    windows: Windows, psi: ComplexArray, turned: FloatArray, inverse: FloatArray, resistance: float,
    current: FloatArray, drop: FloatArray, delay: float,
) -> ComplexArray:  # fmt: skip
    """Return the integral (N,), Vs, by which resistive voltage and drop exceed those of straight currents.

    A current with the second derivative i'' within a sample loses ``T^2 / 12`` times the integral of ``R i''``. It is
    ``-f'^-1 (R i + h)'`` by decay, and ``w^2 (f'^-1 psi - i) - 2 w (f'^-1 j psi' - j i')`` by the rotation. For the
    drop, changes of ``2 h`` stand for those of ``h`` in R and of ``R i`` in h; what is left lies within zero crossings,
    and the curve takes it. Voltages that step within samples bend the current there instead.
    """
    place, held, duration = np.linspace(0.0, 1.0, _NODES), _held(delay), windows.duration[:, None]
    speed = turned[:, None] / duration
    i_dq, flux = (x[:, :1] + place * np.diff(x, axis=1) for x in (windows.measured, psi))
    i_s = i_dq * np.exp(1j * (windows.angle[:, :1] + place * turned[:, None]))
    drops = [np.interp(i, current, own) for i, own in zip(np.moveaxis(frames.phases(i_s), -1, 0), drop, strict=True)]
    lost = frames.space_vector(np.stack(drops, axis=-1)) * windows.drop_scale[:, None]
    middle = np.exp(1j * (windows.angle[:, :1] + 0.5 * (place[1:] + place[:-1]) * turned[:, None]))

    def through(x: ComplexArray) -> ComplexArray:
        return np.asarray(np.einsum("nab,nkb->nka", inverse, frames.as_pairs(x)) @ np.array([1.0, 1j]))

    by_decay = through(np.diff(resistance * i_s + 2 * lost, axis=1) / middle)
    (i_mean, flux_mean), steps = (0.5 * (x[:, 1:] + x[:, :-1]) for x in (i_dq, flux)), duration / (_NODES - 1)
    rotated = speed**2 * steps * (through(flux_mean) - i_mean)
    rotated = rotated - 2 * speed * (through(1j * np.diff(flux, axis=1)) - 1j * np.diff(i_dq, axis=1))
    bent = held * np.sum(middle * (by_decay - rotated), axis=1) - (1 - held) * 1j * speed[:, 0] * (
        i_s[:, -1] - i_s[:, 0]
    )
    return np.asarray(resistance * windows.period**2 / 12 * bent)


def _held(delay: float) -> float:
    """Return which share of the decay voltages with a delay, samples, leave: 1 if they step at the samples.

    Of a log with every n-th sample, delayed by -(n - 1) / 2n, they step n times per sample, which leaves 1 / n^2.
    """
    if DECIMATED <= delay < 0:
        return 1 / round(1 / max(1 + 2 * delay, TINY)) ** 2
    step = delay % 1.0
    return 1 - 6 * step * (1 - step)


def decay(model: FullModel, estimate: FloatArray, windows: Windows) -> float:
    """Return the share R T / L of a current, by the least inductance, that decays within a sample."""
    least = _least(_mean_inductances(model, estimate, windows.i_dq.mean(axis=1)))
    return abs(float(estimate[RESISTANCE])) * float(windows.period.max()) / max(least, TINY)


def _least(inductances: FloatArray) -> float:
    """Return the median of the least inductance, H, of symmetric parts of (N, 2, 2), H."""
    return float(np.median(np.linalg.eigvalsh(0.5 * (inductances + np.swapaxes(inductances, 1, 2)))[:, 0]))


def _mean_inductances(model: FullModel, estimate: FloatArray, i_dq: FloatArray) -> FloatArray:
    """Return the inductances (N, 2, 2), H, of the map averaged over ``_SPAN`` around currents (N, 2), A."""
    span = _SPAN * model.i_max
    most = model.i_max - span
    inside = i_dq * (most / np.maximum(np.hypot(*i_dq.T), most))[:, None]
    sides = [
        [model.flux.rows(inside + sign * shift).dot(estimate[model.map]) for sign in (1, -1)]
        for shift in span * np.eye(2)
    ]
    return np.stack([(high - low) / (2 * span) for high, low in sides], axis=-1)


@compiled("const f8[::1], const f8[::1], f8, f8, f8")
def _primitive(drop: FloatArray, primitive: FloatArray, first: float, step: float, current: float) -> float:
    """Return the integral of the drop over the current, V A, up to a current, A, from its table."""
    place = (current - first) / step
    k = min(max(int(place), 0), len(drop) - 2)
    part = place - k
    return float(primitive[k] + step * part * (drop[k] + 0.5 * part * (drop[k + 1] - drop[k])))


@compiled("const f8[::1], f8, f8, f8, f8, f8")
def _mean_drop(drop: FloatArray, first: float, step: float, start: float, end: float, between: float) -> float:
    """Return the mean drop, V, over a current linear in time, A, from its integral ``between`` them, V A."""
    if abs(end - start) >= _NEGLIGIBLE * step:
        return between / (end - start)
    place = (0.5 * (start + end) - first) / step
    k = min(max(int(place), 0), len(drop) - 2)
    return float(drop[k] + (place - k) * (drop[k + 1] - drop[k]))


@compiled("const f8[:, ::1], const f8[:, ::1], f8, f8, const c16[::1], c16, c16, f8")
def _drop_between(
    drop: FloatArray, primitive: FloatArray, first: float, step: float, axes: ComplexArray,
    start: complex, end: complex, scale: float,
) -> complex:  # fmt: skip
    """Return the mean drop, V, over a current from one vector to another, A, in the stator frame."""
    out = 0j
    for phase in range(3):
        axis = axes[phase]
        one, other = (axis.conjugate() * start).real, (axis.conjugate() * end).real
        between = _primitive(drop[phase], primitive[phase], first, step, other)
        between -= _primitive(drop[phase], primitive[phase], first, step, one)
        out += 2.0 / 3.0 * scale * _mean_drop(drop[phase], first, step, one, other, between) * axis
    return out


@compiled(
    "const c16[::1], const c16[::1], const c16[::1], const f8[:, ::1], f8, f8, f8, f8, f8, "
    "const f8[:, ::1], const f8[:, ::1], const c16[::1], c16[::1], c16[::1], c16[::1], f8[:, ::1]"
)
def _follow(
    rotor: ComplexArray, straight: ComplexArray, bowed: ComplexArray, inverse: FloatArray, period: float,
    resistance: float, scale: float, first: float, step: float, drop: FloatArray, primitive: FloatArray,
    axes: ComplexArray, swing: ComplexArray, i: ComplexArray, summed: ComplexArray, before: FloatArray,
) -> None:  # fmt: skip
    """Evaluate the current ``i`` (K + 1,) over a sample for W = ``swing``, and the integral ``summed``.

    ``rotor`` (K + 1,) turns to the stator frame; in the rotor frame, ``straight`` is the current without a bow, and
    ``bowed`` the flux without W minus that without a bow. ``before`` (3, 2) is overwritten.
    """
    for j in range(_PARTS + 1):
        off = bowed[j] - rotor[j].conjugate() * period * swing[j]
        d = straight[j].real + inverse[0, 0] * off.real + inverse[0, 1] * off.imag
        q = straight[j].imag + inverse[1, 0] * off.real + inverse[1, 1] * off.imag
        i[j] = rotor[j] * complex(d, q)
        mean = 0j
        for phase in range(3):
            current = (axes[phase].conjugate() * i[j]).real
            so_far = _primitive(drop[phase], primitive[phase], first, step, current)
            if j > 0:
                last, between = before[phase, 0], so_far - before[phase, 1]
                mean += 2.0 / 3.0 * scale * _mean_drop(drop[phase], first, step, last, current, between) * axes[phase]
            before[phase, 0], before[phase, 1] = current, so_far
        if j > 0:
            summed[j] = summed[j - 1] + (mean + 0.5 * resistance * (i[j - 1] + i[j])) / _PARTS


@compiled(
    "const f8[::1], const f8[::1], const c16[:, ::1], const c16[:, ::1], const f8[:, :, ::1], const i8[::1], "
    "const f8[::1], const f8[::1], f8, i8, f8, f8, const f8[:, ::1], const f8[:, ::1], const c16[::1], f8, c16[::1]"
)
def _integrate(
    angle: FloatArray, turned: FloatArray, i_dq: ComplexArray, psi: ComplexArray, inverse: FloatArray,
    samples: IntArray, period: FloatArray, drop_scale: FloatArray, resistance: float, spaced: int, first: float,
    step: float, drop: FloatArray, primitive: FloatArray, axes: ComplexArray, settled: float, out: ComplexArray,
) -> None:  # fmt: skip
    """Write the integrals (N,), Vs, see :func:`between_samples`; ``drop`` (3, P) and its primitive are tables.

    The iterations end where W changes by less than ``settled``, V.
    """
    parts, pair = np.zeros(_PARTS + 1, np.complex128), np.empty(2, np.complex128)
    i, summed, swing, more, rotors, straight, bowed = [parts.copy() for _ in range(7)]
    ends, fluxes, chord, i_s = pair.copy(), pair.copy(), pair.copy(), pair.copy()
    before, phases = 0j, np.empty((3, 2))
    for n in range(len(angle)):
        turn = turned[n] / samples[n]
        onward = complex(math.cos(turn / _PARTS), math.sin(turn / _PARTS))
        swing[:] = 0.0
        for k in range(samples[n]):
            rotors[0] = complex(math.cos(angle[n] + k * turn), math.sin(angle[n] + k * turn))
            for j in range(_PARTS):
                rotors[j + 1] = rotors[j] * onward
            for side in range(2):
                share = (k + side) / samples[n]
                ends[side] = i_dq[n, 0] + share * (i_dq[n, 1] - i_dq[n, 0])
                fluxes[side] = psi[n, 0] + share * (psi[n, 1] - psi[n, 0])
                i_s[side], chord[side] = rotors[side * _PARTS] * ends[side], rotors[side * _PARTS] * fluxes[side]
            if k % spaced == 0:
                before = i_s[0]
            for j in range(_PARTS + 1):
                s = j / _PARTS
                straight[j] = ends[0] + s * (ends[1] - ends[0])
                bowed[j] = rotors[j].conjugate() * (chord[0] + s * (chord[1] - chord[0]))
                bowed[j] -= fluxes[0] + s * (fluxes[1] - fluxes[0])
            swing *= rotors[_PARTS] * rotors[0].conjugate()  # about that of the sample before
            last, made = math.inf, 1.0
            for _ in range(_ROUNDS):
                _follow(
                    rotors, straight, bowed, inverse[n], period[n], resistance, drop_scale[n],
                    first, step, drop, primitive, axes, swing, i, summed, phases,
                )  # fmt: skip
                change = 0.0
                for j in range(1, _PARTS):
                    more[j] = summed[j] - j / _PARTS * summed[_PARTS] - swing[j]
                    change = max(change, abs(more[j].real), abs(more[j].imag))
                if change < settled:
                    break
                made = _DAMPING if change > _OVERSHOOTS * last else made
                last = change
                swing += made * more
            mean = _drop_between(drop, primitive, first, step, axes, i_s[0], i_s[1], drop_scale[n])
            bowed_more = summed[_PARTS] - 0.5 * resistance * (i_s[0] + i_s[1]) - mean
            out[n] += period[n] * bowed_more * _PARTS**2 / (_PARTS**2 - 1.0)
            if spaced > 1:  # else both are of the same sample
                out[n] += period[n] * mean
                if (k + 1) % spaced == 0:
                    mean = _drop_between(drop, primitive, first, step, axes, before, i_s[1], drop_scale[n])
                    out[n] -= spaced * period[n] * mean
