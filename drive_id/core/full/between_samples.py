"""The current between samples, where it is not the straight line that the integrals over a window assume.

While a sample's voltage is held, psi_s moves on a straight line in the stator frame, but for what R i and the drop
take, and the rotor turns on. With s from 0 to 1 over the sample, W(s) the integral of R i and the drop up to s minus s
times that up to 1, and f' the incremental inductances,

    i(s) = i_lin(s) + f'^-1 (e^{-j theta(s)} ((1 - s) psi_s(0) + s psi_s(1) - T W(s)) - psi_lin(s)),

where i_lin and psi_lin are linear between the measured samples. W depends on this current, so it is found by
iteration. At 15 degrees per sample, a machine with a short-circuit current of ten times i_max bows by 8 % of i_max.
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.model import RESISTANCE, FullModel
from drive_id.core.full.windows import Windows, spacing
from drive_id.core.numerics.compiled import compiled
from drive_id.types import TINY, FloatArray, IntArray

UNCERTAIN_SHARE = 0.1
"""Uncertain share of these integrals; compared with an integration of high order."""
_NEGLIGIBLE = 1e-3
"""Deviation of the current from a straight line, in i_max or in steps of the table, below which it is as good as
straight, and relative change of the drop that ends the iterations."""
_SPAN = 0.1
"""Half of the range of current, in i_max, over which the inductances are averaged: about what the current bows, and
wide enough that the noise of the map is not fed back through the bow. With the splines' own slopes, a machine at 15
degrees per sample reached 3.6 % of psi_q instead of 0.6 %."""
_TABLE = 4001
"""Currents at which the drop is tabulated."""
_PARTS = 8
"""Parts of a sample in which the current is straight."""
_ROUNDS, _DAMPING = 8, 0.6
"""Most iterations for the current between samples, and the share of each change that is made: a drop with a steep step
overshoots with all of it."""
_BEYOND = 2.0
"""Range of the tabulated drop, in i_max."""


def between_samples(model: FullModel, estimate: FloatArray, windows: Windows, psi: ComplexArray) -> ComplexArray:
    """Return the integral (N,), Vs, of resistive voltage and drop over the currents minus that over straight ones.

    Parameters
    ----------
    estimate : (size,) float
        See :class:`~drive_id.core.full.solver.FullSolution`.
    psi : (N, 2) complex
        Flux at both ends, Wb.

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
    known = np.linalg.det(mean) > 0.0
    inductance = np.median(np.linalg.eigvalsh(0.5 * (mean + np.swapaxes(mean, 1, 2)))[:, 0])
    bow = np.square(fastest * step) / 8 * np.abs(psi).max()  # of the flux
    most = inductance * model.i_max  # a current that bows by i_max and more diverges
    if not (known.any() and _NEGLIGIBLE * most <= bow <= most):
        return out
    inverse = np.zeros_like(mean)
    inverse[known] = np.linalg.inv(mean[known])
    current = np.linspace(-_BEYOND, _BEYOND, _TABLE) * model.i_max
    drop = np.ascontiguousarray((model.shapes(current) @ estimate[model.phase_columns()]).T)
    primitive = np.zeros_like(drop)
    primitive[:, 1:] = np.cumsum(0.5 * (drop[:, 1:] + drop[:, :-1]), axis=1) * (current[1] - current[0])
    resistance, i_dq = float(estimate[RESISTANCE]), windows.measured
    settled = _NEGLIGIBLE * (np.abs(drop).max() + abs(resistance) * np.abs(frames.as_pairs(i_dq)).max())
    _integrate(
        windows.angle[:, 0].copy(), turned, np.ascontiguousarray(i_dq), np.ascontiguousarray(psi), inverse, samples,
        windows.period, windows.drop_scale, resistance, step, current[0], current[1] - current[0], drop, primitive,
        np.exp(1j * frames.PHASE_SHIFTS), float(settled), out,
    )  # fmt: skip
    largest = np.abs(drop).max() + _BEYOND * abs(resistance) * model.i_max
    converged = np.abs(out) < largest * windows.duration  # else beyond the table and what it holds
    return np.where(known & converged, out, 0.0)


def _mean_inductances(model: FullModel, estimate: FloatArray, i_dq: FloatArray) -> FloatArray:
    """Return the inductances (N, 2, 2), H, of the map averaged over ``_SPAN`` around currents (N, 2), A."""
    span = _SPAN * model.i_max
    radius = np.maximum(np.hypot(*i_dq.T), TINY)
    inside = i_dq * np.minimum(1.0, (model.i_max - span) / radius)[:, None]
    sides = [
        [model.flux.rows(inside + sign * shift).dot(estimate[model.map]) for sign in (1, -1)]
        for shift in span * np.eye(2)
    ]
    return np.stack([(high - low) / (2 * span) for high, low in sides], axis=-1)


@compiled("const f8[::1], const f8[::1], f8, f8, f8, f8")
def _mean_drop(drop: FloatArray, primitive: FloatArray, first: float, step: float, start: float, end: float) -> float:
    """Return the mean drop, V, over a current that is linear in time from ``start`` to ``end``, A, from its table."""
    last = len(drop) - 2
    if abs(end - start) < _NEGLIGIBLE * step:
        place = (0.5 * (start + end) - first) / step
        k = min(max(int(place), 0), last)
        return float(drop[k] + (place - k) * (drop[k + 1] - drop[k]))
    total = 0.0
    for sign, x in ((1.0, end), (-1.0, start)):
        place = (x - first) / step
        k = min(max(int(place), 0), last)
        part = place - k
        total += sign * (primitive[k] + step * part * (drop[k] + 0.5 * part * (drop[k + 1] - drop[k])))
    return float(total / (end - start))


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
        out += 2.0 / 3.0 * scale * _mean_drop(drop[phase], primitive[phase], first, step, one, other) * axis
    return out


@compiled(
    "f8, f8, const c16[::1], const c16[::1], const c16[::1], const f8[:, ::1], f8, f8, f8, f8, f8, "
    "const f8[:, ::1], const f8[:, ::1], const c16[::1], c16[::1], c16[::1], c16[::1]"
)
def _follow(
    angle: float, turn: float, ends: ComplexArray, fluxes: ComplexArray, chord: ComplexArray, inverse: FloatArray,
    period: float, resistance: float, scale: float, first: float, step: float, drop: FloatArray, primitive: FloatArray,
    axes: ComplexArray, swing: ComplexArray, i: ComplexArray, summed: ComplexArray,
) -> float:  # fmt: skip
    """Evaluate the current ``i`` (K + 1,) over a sample for W = ``swing``, the integral ``summed``, and W.

    Currents ``ends`` and ``fluxes`` (2,) are in the rotor frame, the fluxes ``chord`` (2,) in the stator frame. Returns
    the largest change of W, V.
    """
    for j in range(_PARTS + 1):
        s = j / _PARTS
        rotor = complex(math.cos(angle + s * turn), math.sin(angle + s * turn))
        flux = rotor.conjugate() * (chord[0] + s * (chord[1] - chord[0]) - period * swing[j])
        off = flux - fluxes[0] - s * (fluxes[1] - fluxes[0])
        straight = ends[0] + s * (ends[1] - ends[0])
        d = straight.real + inverse[0, 0] * off.real + inverse[0, 1] * off.imag
        q = straight.imag + inverse[1, 0] * off.real + inverse[1, 1] * off.imag
        i[j] = rotor * complex(d, q)
    for j in range(_PARTS):
        mean = _drop_between(drop, primitive, first, step, axes, i[j], i[j + 1], scale)
        summed[j + 1] = summed[j] + (mean + 0.5 * resistance * (i[j] + i[j + 1])) / _PARTS
    change = 0.0
    for j in range(1, _PARTS):
        more = summed[j] - j / _PARTS * summed[_PARTS] - swing[j]
        change = max(change, abs(more.real), abs(more.imag))
        swing[j] += _DAMPING * more
    return change


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
    i, summed, swing = parts.copy(), parts.copy(), parts.copy()
    ends, fluxes, chord, i_s = pair.copy(), pair.copy(), pair.copy(), pair.copy()
    before = 0j
    for n in range(len(angle)):
        turn = turned[n] / samples[n]
        for k in range(samples[n]):
            for side in range(2):
                share = (k + side) / samples[n]
                rotor = complex(math.cos(angle[n] + share * turned[n]), math.sin(angle[n] + share * turned[n]))
                ends[side] = i_dq[n, 0] + share * (i_dq[n, 1] - i_dq[n, 0])
                fluxes[side] = psi[n, 0] + share * (psi[n, 1] - psi[n, 0])
                i_s[side], chord[side] = rotor * ends[side], rotor * fluxes[side]
            if k % spaced == 0:
                before = i_s[0]
            swing[:] = 0.0
            for _ in range(_ROUNDS):
                change = _follow(
                    angle[n] + k * turn, turn, ends, fluxes, chord, inverse[n], period[n], resistance, drop_scale[n],
                    first, step, drop, primitive, axes, swing, i, summed,
                )  # fmt: skip
                if change < settled:
                    break
            out[n] += period[n] * (summed[_PARTS] - 0.5 * resistance * (i_s[0] + i_s[1]))
            if (k + 1) % spaced == 0:
                mean = _drop_between(drop, primitive, first, step, axes, before, i_s[1], drop_scale[n])
                out[n] -= spaced * period[n] * mean
