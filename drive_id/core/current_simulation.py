"""Open-loop simulation of the current from an identified model, for the paper's second metric."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drive_id.core import bspline, frames
from drive_id.core.compiled import COMPILING, compiled
from drive_id.core.flux_models import TensorSpline
from drive_id.core.frames import ComplexArray
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.15
"""Angle turned in one Runge-Kutta step at most, rad."""

_DIVERGED = 5.0
_DAMPING = 0.1
_SEARCH_STEPS = 20
_SEARCH_TOLERANCE = 1e-9
_FOLDED = 0.1
"""Share of the typical Jacobian's determinant below which the search takes that one, not to run to a far branch."""

_POWERS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6
"""Powers of the position in a cell (rows) in its four splines, see :mod:`drive_id.core.bspline`."""


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
        u, angle, speed = (quick(signal[run]) for signal in (u_dq, samples.angle, samples.speed))
        _simulate(u, angle, speed, samples.sample_period, electrical, table, complex(*i_dq[run.start]), out[run])
    out.imag[np.isnan(out.real)] = np.nan
    return frames.as_pairs(out)


def quick(values: np.ndarray) -> Any:
    """Return values as the kernels are quicker with them: as they are when compiled, otherwise as a list."""
    return values if COMPILING else values.tolist()


def typical_inductances(model: TensorSpline, gamma: FloatArray, i_dq: FloatArray) -> tuple[float, float]:
    """Return the means of the incremental self-inductances over currents (N, 2), A, in H."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq[:: max(1, len(i_dq) // 1000)]))
    return float(by_d[:, 0].mean()), float(by_q[:, 1].mean())


class FluxTable(NamedTuple):
    """A spline map as a polynomial per cell, continued beyond its range with the typical inductances."""

    cells: Mapping[tuple[int, int], Sequence[complex]] | ComplexArray
    """Cell in d and in q to the coefficients of t^0 s^0, t^0 s^1, ... t^3 s^3, Wb, real part d and imaginary part q."""
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
    table = cells if COMPILING else {cell: tuple(cells[cell].tolist()) for cell in np.ndindex(*cells.shape[:2])}
    range_d, range_q = (float(d.low), float(d.width), d.count - 3), (float(q.low), float(q.width), q.count - 3)
    return FluxTable(table, *range_d, *range_q, *inductances)


@compiled
def _simulate(
    u_dq: Sequence[complex],
    angle: Sequence[float],
    speed: Sequence[float],
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
        phi, omega, u = angle[k], speed[k], u_dq[k]
        steps = int(abs(omega) * period / _LARGEST_TURN) + 1
        step = period / steps
        for m in range(steps):
            tau = m * step
            k1 = _slope(psi, point.i, tau, u, phi, omega, electrical)
            point = _nearest(psi + 0.5 * step * k1, point, electrical, table)
            k2 = _slope(psi + 0.5 * step * k1, point.i, tau + 0.5 * step, u, phi, omega, electrical)
            point = _nearest(psi + 0.5 * step * k2, point, electrical, table)
            k3 = _slope(psi + 0.5 * step * k2, point.i, tau + 0.5 * step, u, phi, omega, electrical)
            point = _nearest(psi + step * k3, point, electrical, table)
            k4 = _slope(psi + step * k3, point.i, tau + step, u, phi, omega, electrical)
            psi += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            point = _nearest(psi, point, electrical, table)
        if not abs(point.i) < electrical.diverged:
            return
        out[k + 1] = point.i


@compiled
def _slope(
    psi: complex, i: complex, tau: float, u_start: complex, phi: float, omega: float, electrical: Electrical
) -> complex:
    """Return d psi_dq / dt at ``tau`` after a sample, ``u_start`` being the held voltage in that sample's dq frame."""
    turn = omega * tau
    u = u_start * complex(math.cos(turn), -math.sin(turn))
    if electrical.voltage_error != 0.0:
        rotation = complex(math.cos(phi + turn), math.sin(phi + turn))
        u -= electrical.voltage_error * _drop_vector(i * rotation, electrical.current_scale) * rotation.conjugate()
    return u - electrical.resistance * i - complex(0.0, omega) * psi


@compiled
def _nearest(psi: complex, guess: Point, electrical: Electrical, table: FluxTable) -> Point:
    """Return the point whose flux is nearest to ``psi``, by damped least squares from one nearby."""
    best, error = guess, psi - guess.psi
    damping, damping_least = 0.0, electrical.damping * electrical.damping
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
            if abs(change) < _SEARCH_TOLERANCE * electrical.diverged:
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
    return point_in_cell(i, table.cells[cell_d, cell_q], t, s, table)


@compiled
def point_in_cell(i: complex, c: Sequence[complex], t: float, s: float, table: FluxTable) -> Point:
    """Evaluate one cell's polynomial at its positions ``t`` in d and ``s`` in q, and continue it beyond the range."""
    r0 = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
    r1 = c[4] + s * (c[5] + s * (c[6] + s * c[7]))
    r2 = c[8] + s * (c[9] + s * (c[10] + s * c[11]))
    r3 = c[12] + s * (c[13] + s * (c[14] + s * c[15]))
    v0 = c[1] + s * (2.0 * c[2] + 3.0 * s * c[3])
    v1 = c[5] + s * (2.0 * c[6] + 3.0 * s * c[7])
    v2 = c[9] + s * (2.0 * c[10] + 3.0 * s * c[11])
    v3 = c[13] + s * (2.0 * c[14] + 3.0 * s * c[15])
    psi = r0 + t * (r1 + t * (r2 + t * r3))
    by_d = (r1 + t * (2.0 * r2 + 3.0 * t * r3)) / table.width_d
    by_q = (v0 + t * (v1 + t * (v2 + t * v3))) / table.width_q
    beyond_d = i.real - min(max(i.real, table.low_d), table.low_d + table.count_d * table.width_d)
    beyond_q = i.imag - min(max(i.imag, table.low_q), table.low_q + table.count_q * table.width_q)
    psi += complex(table.inductance_d * beyond_d, table.inductance_q * beyond_q)
    if beyond_d != 0.0:
        by_d = complex(table.inductance_d, 0.0)
    if beyond_q != 0.0:
        by_q = complex(0.0, table.inductance_q)
    return Point(i, psi, by_d, by_q)
