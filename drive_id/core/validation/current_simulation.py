"""Open-loop simulation of the current from an identified model, for the paper's second metric."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.numerics import bspline
from drive_id.core.numerics.compiled import compiled, inlined
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.15
"""Angle turned in one Runge-Kutta step at most, rad."""

_DIVERGED = 5.0
_DAMPING = 0.1
_SEARCH_STEPS = 20
_SEARCH_TOLERANCE = 1e-6
"""Last change of a search over the largest current: the steps are Newton's, so that the next one is its square."""
_FOLDED = 0.1
"""Share of the typical Jacobian's determinant below which the search takes that one, not to run to a far branch."""

_POWERS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6
"""Powers of the position in a cell (rows) in its four splines, see :mod:`drive_id.core.numerics.bspline`."""


def simulate_current(
    samples: Samples,
    model: TensorSpline,
    gamma: FloatArray,
    resistance: float,
    voltage_error: float,
    current_scale: float,
) -> FloatArray:
    """Integrate ``eq:continous_dq_current_ODE_with_disturbance`` over a recording, each run from its first sample.

    The commanded voltage is held in the stator frame, the speed over each sample. The flux is the state and the
    current is the one whose flux is nearest, which is the same equation where the Jacobian D_f is regular, and stays
    bounded where it is singular, as it can be at places in a fit that disregards the rotor harmonics. Beyond the
    model's range the map goes on with the typical inductances.

    Parameters
    ----------
    samples : Samples
    model : TensorSpline
    gamma : (P,) float
        Flux parameters, Wb.
    resistance : float
        Ohm.
    voltage_error, current_scale : float
        u_e (drop convention), V, and i_s, A.

    Returns
    -------
    (N, 2) float
        Simulated i_dq at the stamps, A; NaN from where a run diverged on.
    """
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    u_dq = frames.space_vector(samples.u_abc) * np.exp(-1j * samples.angle)
    limit = _DIVERGED * float(np.abs([model.d.low, model.d.high, model.q.low, model.q.high]).max())
    inductances = typical_inductances(model, gamma, i_dq)
    electrical = Electrical(resistance, voltage_error, current_scale, limit, _DAMPING * 0.5 * sum(inductances))
    table = _flux_table(model, gamma, inductances)
    out = np.full(len(i_dq), np.nan, np.complex128)
    for run in samples.runs():
        u, angle, speed = u_dq[run], samples.angle[run], samples.speed[run]
        _simulate(u, angle, speed, samples.sample_period, electrical, table, complex(*i_dq[run.start]), out[run])
    out.imag[np.isnan(out.real)] = np.nan
    return frames.as_pairs(out)


def typical_inductances(model: TensorSpline, gamma: FloatArray, i_dq: FloatArray) -> tuple[float, float]:
    """Return the means of the incremental self-inductances over currents (N, 2), A, in H."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq[:: max(1, len(i_dq) // 1000)]))
    return float(by_d[:, 0].mean()), float(by_q[:, 1].mean())


class FluxTable(NamedTuple):
    """A spline map as a polynomial per cell, continued beyond its range with the typical inductances."""

    coefficients: ComplexArray
    """Of t^0 s^0, t^0 s^1, ... t^3 s^3 in each cell, row-major in d and q, Wb, real part d and imaginary part q."""
    per_cell: int  # coefficients, 16 for each map
    low_d: float  # A
    width_d: float  # of a cell, A
    count_d: int  # of cells
    low_q: float
    width_q: float
    count_q: int
    inductance_d: float  # H
    inductance_q: float


class Electrical(NamedTuple):
    """The constants of the voltage equation, and when to give up."""

    resistance: float  # ohm
    voltage_error: float  # V
    current_scale: float  # A
    diverged: float  # current, A
    damping: float  # of the search for a current, H


class Point(NamedTuple):
    """A current and what the map says there, real parts d and imaginary parts q."""

    i: complex  # A
    psi: complex  # Wb
    by_d: complex  # derivative of psi by i_d, H
    by_q: complex


def _flux_table(model: TensorSpline, gamma: FloatArray, inductances: tuple[float, float]) -> FluxTable:
    return table_of(model, polynomials(model, gamma), inductances)


def polynomials(model: TensorSpline, gamma: FloatArray) -> ComplexArray:
    """Return the map of parameters (P,), Wb, as (D - 3, Q - 3, 16) coefficients, see :class:`FluxTable`."""
    d, q = model.d, model.q
    gamma_d, gamma_q = gamma.reshape(2, d.count, q.count)
    windows = np.lib.stride_tricks.sliding_window_view(gamma_d + 1j * gamma_q, (4, 4))
    cells = np.einsum("ai,xyij,bj->xyab", _POWERS, windows, _POWERS)
    return np.asarray(cells.reshape(d.count - 3, q.count - 3, 16))


def table_of(model: TensorSpline, cells: ComplexArray, inductances: tuple[float, float]) -> FluxTable:
    """Return what the kernels read, from a map's polynomials and the typical inductances of d and q, H."""
    d, q = model.d, model.q
    range_d, range_q = (float(d.low), float(d.width), d.count - 3), (float(q.low), float(q.width), q.count - 3)
    return FluxTable(np.ascontiguousarray(cells).ravel(), cells.shape[-1], *range_d, *range_q, *inductances)


@compiled
def _simulate(
    u_dq: ComplexArray,
    angle: FloatArray,
    speed: FloatArray,
    period: float,
    electrical: Electrical,
    table: FluxTable,
    start: complex,
    out: ComplexArray,
) -> None:
    """Integrate by Runge-Kutta's rule of order 4; arrays when compiled, lists, which Python is quicker with, if not."""
    point = _at(start, table)
    psi = point.psi
    out[0] = start
    for k in range(len(u_dq) - 1):
        omega, u = speed[k], u_dq[k]
        steps = int(abs(omega) * period / _LARGEST_TURN) + 1
        step = period / steps
        rotor = complex(math.cos(angle[k]), math.sin(angle[k]))
        half_turn = complex(math.cos(0.5 * omega * step), math.sin(0.5 * omega * step))
        back = half_turn.conjugate()
        for _ in range(steps):
            k1 = _slope(psi, point.i, u, rotor, omega, electrical)
            u, rotor = u * back, rotor * half_turn
            point = _nearest(psi + 0.5 * step * k1, point, electrical, table)
            k2 = _slope(psi + 0.5 * step * k1, point.i, u, rotor, omega, electrical)
            point = _nearest(psi + 0.5 * step * k2, point, electrical, table)
            k3 = _slope(psi + 0.5 * step * k2, point.i, u, rotor, omega, electrical)
            u, rotor = u * back, rotor * half_turn
            point = _nearest(psi + step * k3, point, electrical, table)
            k4 = _slope(psi + step * k3, point.i, u, rotor, omega, electrical)
            psi += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            point = _nearest(psi, point, electrical, table)
        if not abs(point.i) < electrical.diverged:
            return
        out[k + 1] = point.i


@compiled
def _slope(psi: complex, i: complex, u: complex, rotor: complex, omega: float, electrical: Electrical) -> complex:
    """Return d psi_dq / dt under the voltage ``u``, ``rotor`` being the unit vector of the rotor's angle."""
    if electrical.voltage_error != 0.0:
        u -= electrical.voltage_error * _drop_vector(i * rotor, electrical.current_scale) * rotor.conjugate()
    return u - electrical.resistance * i - complex(0.0, omega) * psi


@compiled
def _nearest(psi: complex, guess: Point, electrical: Electrical, table: FluxTable) -> Point:
    """Return the point whose flux is nearest to ``psi``, by damped least squares from one nearby."""
    best, error = guess, psi - guess.psi
    damping, damping_least = 0.0, electrical.damping * electrical.damping
    small = _SEARCH_TOLERANCE * electrical.diverged
    for _ in range(_SEARCH_STEPS):
        change, good = search_step(best, error, damping, table)
        if not good:
            damping = max(damping_least, 10.0 * damping)
            continue
        trial = _at(best.i + change, table)
        left = psi - trial.psi
        if left.real * left.real + left.imag * left.imag <= error.real * error.real + error.imag * error.imag:
            best, error = trial, left
            damping = 0.1 * damping if damping > damping_least else 0.0
            if change.real * change.real + change.imag * change.imag < small * small:
                break
        else:
            damping = max(damping_least, 10.0 * damping)
    return best


@compiled
def search_step(best: Point, error: complex, damping: float, table: FluxTable) -> tuple[complex, bool]:
    """Return the change of the current, A, that takes ``error``, Wb, off, and whether there is one."""
    dd, qd, dq, qq = best.by_d.real, best.by_d.imag, best.by_q.real, best.by_q.imag
    if dd * qq - qd * dq < _FOLDED * table.inductance_d * table.inductance_q:
        dd, qd, dq, qq = table.inductance_d, 0.0, 0.0, table.inductance_q
    g_d, g_q = dd * error.real + qd * error.imag, dq * error.real + qq * error.imag
    h_dd, h_dq, h_qq = dd * dd + qd * qd + damping, dd * dq + qd * qq, dq * dq + qq * qq + damping
    determinant = h_dd * h_qq - h_dq * h_dq
    if determinant <= 0.0:
        return complex(0.0, 0.0), False
    return complex((h_qq * g_d - h_dq * g_q) / determinant, (h_dd * g_q - h_dq * g_d) / determinant), True


@compiled
def _drop_vector(i_s: complex, scale: float) -> complex:
    """Return the stator-frame space vector of tanh(i_abc / scale)."""
    half_root3 = 0.8660254037844386
    a = math.tanh(i_s.real / scale)
    b = math.tanh((-0.5 * i_s.real + half_root3 * i_s.imag) / scale)
    c = math.tanh((-0.5 * i_s.real - half_root3 * i_s.imag) / scale)
    return complex((2.0 * a - b - c) / 3.0, (b - c) * (half_root3 * 2.0 / 3.0))


@compiled
def _at(i: complex, table: FluxTable) -> Point:
    """Evaluate the map."""
    cell_d, t = bspline.locate(i.real, table.low_d, table.width_d, table.count_d)
    cell_q, s = bspline.locate(i.imag, table.low_q, table.width_q, table.count_q)
    return point_in_cell(i, table.coefficients, cell_of(cell_d, cell_q, table), t, s, table)


@inlined
def cell_of(cell_d: int, cell_q: int, table: FluxTable) -> int:
    """Return where the coefficients of a cell begin."""
    return (cell_d * table.count_q + cell_q) * table.per_cell


@inlined
def _cubic(a: complex, b: complex, c: complex, d: complex, x: float) -> complex:
    """Return a + b x + c x^2 + d x^3; by parts, for a compiler takes a real factor for a complex one."""
    return complex(a.real + x * (b.real + x * (c.real + x * d.real)), a.imag + x * (b.imag + x * (c.imag + x * d.imag)))


@inlined
def _slope_of_cubic(b: complex, c: complex, d: complex, x: float) -> complex:
    """Return b + 2 c x + 3 d x^2."""
    twice, thrice = 2.0 * x, 3.0 * x * x
    return complex(b.real + twice * c.real + thrice * d.real, b.imag + twice * c.imag + thrice * d.imag)


@compiled
def point_in_cell(i: complex, c: ComplexArray, k: int, t: float, s: float, table: FluxTable) -> Point:
    """Evaluate the polynomial c[k] ... c[k + 15] of a cell at its positions ``t`` in d and ``s`` in q.

    Beyond the range of the map it is continued.
    """
    r0, v0 = _cubic(c[k], c[k + 1], c[k + 2], c[k + 3], s), _slope_of_cubic(c[k + 1], c[k + 2], c[k + 3], s)
    r1, v1 = _cubic(c[k + 4], c[k + 5], c[k + 6], c[k + 7], s), _slope_of_cubic(c[k + 5], c[k + 6], c[k + 7], s)
    r2, v2 = _cubic(c[k + 8], c[k + 9], c[k + 10], c[k + 11], s), _slope_of_cubic(c[k + 9], c[k + 10], c[k + 11], s)
    r3, v3 = _cubic(c[k + 12], c[k + 13], c[k + 14], c[k + 15], s), _slope_of_cubic(c[k + 13], c[k + 14], c[k + 15], s)
    psi = _cubic(r0, r1, r2, r3, t)
    by_d, by_q = _slope_of_cubic(r1, r2, r3, t), _cubic(v0, v1, v2, v3, t)
    by_d = complex(by_d.real / table.width_d, by_d.imag / table.width_d)
    by_q = complex(by_q.real / table.width_q, by_q.imag / table.width_q)
    beyond_d = i.real - min(max(i.real, table.low_d), table.low_d + table.count_d * table.width_d)
    beyond_q = i.imag - min(max(i.imag, table.low_q), table.low_q + table.count_q * table.width_q)
    psi += complex(table.inductance_d * beyond_d, table.inductance_q * beyond_q)
    if beyond_d != 0.0:
        by_d = complex(table.inductance_d, 0.0)
    if beyond_q != 0.0:
        by_q = complex(0.0, table.inductance_q)
    return Point(i, psi, by_d, by_q)
