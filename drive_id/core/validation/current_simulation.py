"""Open-loop simulation of the current from an identified model, for the paper's second metric, the MAD.

The state is the flux linkage in the stator frame, where the held voltage is constant and the balance contains neither
the speed nor the rotor harmonics,

    d/dt psi_s = u_s - R i_s - drop(i_abc)_s,        f(i, theta) = e^{-j theta} psi_s,

so that Runge-Kutta's rule integrates only the small, slow loss; i follows from a search on the map at theta. Methods
``psm`` and ``joint`` are the case without harmonics (``eq:continous_dq_current_ODE_with_disturbance``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.numerics import bspline
from drive_id.core.numerics.compiled import compiled, inlined
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.3
"""Largest angle turned in one step, rad."""

_LARGEST_PHASE = 1.2
"""Largest phase that the highest harmonic passes in one step, rad."""

_FINEST = 32
"""Finest division of a step where the loss bends, that is, where a phase current changes its sign."""

_BEND = 1e-5
"""Error of a step above which it is divided, relative to the flux of the largest current."""

_DIVERGED = 5.0
"""Current at which a simulation is given up, over the largest current of the map."""

_DAMPING = 0.1
_SEARCH_STEPS = 20
_SEARCH_TOLERANCE = 3e-6
"""Last change of a search over the current of divergence: the steps are Newton's, so the next one is its square."""
_FOLDED = 0.1
"""Share of the typical Jacobian's determinant below which the search uses that one: it must not run to a far branch."""

_HALF_WINDOW = 5
"""Samples to each side over which the difference of the measured angle from the integral of the speed is averaged."""

_POWERS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6
"""Powers of the position in a cell (rows) in its four splines, see :mod:`drive_id.core.numerics.bspline`."""


def simulate_current(
    samples: Samples,
    model: TensorSpline,
    gamma: FloatArray,
    harmonics: Mapping[int, tuple[FloatArray, FloatArray]],
    resistance: float,
    drop: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Integrate ``u = R i + j omega f + df/dt + drop`` over a recording, each run from its first sample.

    The flux linkages are ``f(i, theta) = f_0(i) + sum_h a_h(i) cos(h theta) + b_h(i) sin(h theta)``. The commanded
    voltage is held in the stator frame over each sample. The measured angle is smoothed, guided by the integral of the
    speed, because a step of the angle turns the whole flux and acts on the current at once. The current is the one
    whose flux is nearest: the same equation where the Jacobian D_f is regular, and bounded where it is singular, as it
    can be in places of a fit that disregards the rotor harmonics. Beyond the model's range f_0 goes on with the typical
    inductances, and the harmonics stay as on its edge.

    Parameters
    ----------
    samples : Samples
    model : TensorSpline
        Of f_0 and of every harmonic.
    gamma : (P,) float
        Parameters of f_0, Wb.
    harmonics : mapping of int to ((P,) float, (P,) float)
        Electrical order h to the parameters of a_h and b_h, Wb; empty for methods ``psm`` and ``joint``.
    resistance : float
        Ohm.
    drop : (C,) float, (C,) float
        Phase currents, A, equally spaced and increasing, and the inverter's drop of the phase voltage there, V; linear
        in between and constant beyond.

    Returns
    -------
    (N, 2) float
        Simulated i_dq at the stamps, A; NaN from where a run diverged on.

    Raises
    ------
    ValueError
        When the currents of the drop are not equally spaced.
    """
    spacing = np.diff(drop[0])
    if not np.allclose(spacing, spacing[0], rtol=1e-6, atol=0.0):
        raise ValueError("the currents of the inverter's curve must be equally spaced")
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    u_s = frames.space_vector(samples.u_abc)
    largest = float(np.abs([model.d.low, model.d.high, model.q.low, model.q.high]).max())
    inductances = typical_inductances(model, gamma, i_dq)
    inductance = 0.5 * sum(inductances)
    circuit = Circuit(
        np.array(list(harmonics), np.float64),
        float(resistance),
        float(drop[0][0]),
        float(drop[0][1] - drop[0][0]),
        np.ascontiguousarray(drop[1], np.float64),
        samples.sample_period,
        max(1 / _LARGEST_TURN, max(harmonics, default=0) / _LARGEST_PHASE),
        _BEND * abs(inductance) * largest,
        _DIVERGED * largest,
        (_DAMPING * inductance) ** 2,
    )
    parts = [gamma, *(part for pair in harmonics.values() for part in pair)]
    table = flux_table(model, parts, inductances)
    out = np.full(len(i_dq), np.nan, np.complex128)
    for run in samples.runs():
        angle = _smooth_angle(samples.angle[run], samples.speed[run], samples.sample_period)
        slices = _slice(len(harmonics)), _slice(len(harmonics))
        _simulate(u_s[run], angle, circuit, table, *slices, complex(*i_dq[run.start]), out[run])
    out.imag[np.isnan(out.real)] = np.nan
    return frames.as_pairs(out)


def typical_inductances(model: TensorSpline, gamma: FloatArray, i_dq: FloatArray) -> tuple[float, float]:
    """Return the means of the incremental self-inductances over currents (N, 2), A, in H."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq[:: max(1, len(i_dq) // 1000)]))
    return float(by_d[:, 0].mean()), float(by_q[:, 1].mean())


def _smooth_angle(angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Return the angle (N,), rad, not wrapped, without the noise of the measured one."""
    turned = np.zeros(len(angle))
    np.cumsum(0.5 * period * (speed[1:] + speed[:-1]), out=turned[1:])
    left = np.unwrap(angle - turned)
    half = min(_HALF_WINDOW, len(left) - 1)
    padded = np.pad(left, half, mode="reflect", reflect_type="odd")
    return np.asarray(turned + np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid"))


class FluxTable(NamedTuple):
    """The map and its harmonics as polynomials per cell, continued beyond the range with the typical inductances."""

    coefficients: ComplexArray
    """Of t^0 s^0, t^0 s^1, ... t^3 s^3 in each cell, row-major in d and q, Wb, real part d and imaginary part q."""
    per_cell: int  # coefficients, 16 for each part: f_0, then a_h and b_h of each harmonic
    low_d: float  # A
    width_d: float  # of a cell, A
    count_d: int  # of cells
    low_q: float
    width_q: float
    count_q: int
    inductance_d: float  # H
    inductance_q: float


class Circuit(NamedTuple):
    """The constants of the voltage equation and of its integration."""

    orders: Any  # (H,) of the harmonics
    resistance: float  # ohm
    drop_low: float  # lowest current of the inverter's curve, A
    drop_width: float  # between its points, A
    drop_voltage: Any  # (C,) V
    period: float  # s
    steps_per_turn: float  # 1/rad
    bend: float  # error of a step above which it is divided, Wb
    diverged: float  # current, A
    damping: float  # of the search for a current, H^2


class Slice(NamedTuple):
    """The map at one angle of the rotor, in the cell where it was last evaluated; not used without harmonics."""

    factors: Any  # (2 H,) cosine and sine of each order's phase
    cell: Any  # (2,) int in d and q, -1 for none
    coefficients: Any  # (16,) complex, Wb


class Point(NamedTuple):
    """A current and the map there, real parts d and imaginary parts q."""

    i: complex  # A
    psi: complex  # Wb
    by_d: complex  # derivative of psi by i_d, H
    by_q: complex


def _slice(orders: int) -> Slice:
    return Slice(np.zeros(2 * orders), np.full(2, -1), np.zeros(16, np.complex128))


def flux_table(model: TensorSpline, parts: Sequence[FloatArray], inductances: tuple[float, float]) -> FluxTable:
    """Return the kernels' table, from the parameters (P,), Wb, of f_0 and of the amplitudes of each harmonic.

    ``inductances`` are the typical ones of d and q, H.
    """
    d, q = model.d, model.q
    cells = np.concatenate([_polynomials(model, part) for part in parts], axis=-1)
    range_d, range_q = (float(d.low), float(d.width), d.count - 3), (float(q.low), float(q.width), q.count - 3)
    return FluxTable(np.ascontiguousarray(cells).ravel(), cells.shape[-1], *range_d, *range_q, *inductances)


def _polynomials(model: TensorSpline, gamma: FloatArray) -> ComplexArray:
    """Return the map of parameters (P,), Wb, as (D - 3, Q - 3, 16) coefficients, see :class:`FluxTable`."""
    d, q = model.d, model.q
    gamma_d, gamma_q = gamma.reshape(2, d.count, q.count)
    windows = np.lib.stride_tricks.sliding_window_view(gamma_d + 1j * gamma_q, (4, 4))
    cells = np.einsum("ai,xyij,bj->xyab", _POWERS, windows, _POWERS)
    return np.asarray(cells.reshape(d.count - 3, q.count - 3, 16))


@compiled
def _simulate(
    u_s: Any,
    angle: Any,
    circuit: Circuit,
    table: FluxTable,
    middle: Slice,
    end: Slice,
    start: complex,
    out: ComplexArray,
) -> None:
    """Integrate over one run; steps are halved where the loss bends and doubled again behind."""
    _turn_to(angle[0], end, circuit)
    point = _at(start, end, table)
    turn = complex(math.cos(angle[0]), math.sin(angle[0]))
    psi = point.psi * turn
    out[0] = start
    size = _FINEST
    for k in range(len(u_s) - 1):
        by = angle[k + 1] - angle[k]
        ticks = _FINEST * (int(abs(by) * circuit.steps_per_turn) + 1)
        now = 0
        while now < ticks:
            since, until = now / ticks, (now + size) / ticks
            thetas = (angle[k] + 0.5 * (since + until) * by, angle[k] + until * by)
            step = (until - since) * circuit.period
            new_psi, new_point, new_turn, bend = _step(
                psi, point, turn, u_s[k], thetas, step, circuit, table, middle, end
            )
            if bend > circuit.bend and size > 1:
                size //= 2
                continue
            psi, point, turn = new_psi, new_point, new_turn
            now += size
            if bend < circuit.bend / 16 and size < _FINEST and now % (2 * size) == 0:
                size *= 2
        if not abs(point.i) < circuit.diverged:
            return
        out[k + 1] = point.i


@inlined
def _step(
    psi: complex,
    point: Point,
    turn: complex,
    u_s: complex,
    thetas: tuple[float, float],
    step: float,
    circuit: Circuit,
    table: FluxTable,
    middle: Slice,
    end: Slice,
) -> tuple[complex, Point, complex, float]:
    """Make one step of Runge-Kutta's rule of order 4; ``turn`` is e^{j theta} at its start, angles at middle and end.

    Returns flux, point and e^{j theta} at the end, and the error that the loss's curvature may have caused, Wb.
    """
    loss1 = _loss(point.i * turn, circuit)
    turn = complex(math.cos(thetas[0]), math.sin(thetas[0]))
    half = point
    if table.per_cell > 16:
        _turn_to(thetas[0], middle, circuit)
        half = _at(point.i, middle, table)
    half = _nearest((psi + 0.5 * step * (u_s - loss1)) * turn.conjugate(), half, middle, circuit, table)
    loss2 = _loss(half.i * turn, circuit)
    half = _nearest((psi + 0.5 * step * (u_s - loss2)) * turn.conjugate(), half, middle, circuit, table)
    loss3 = _loss(half.i * turn, circuit)
    turn = complex(math.cos(thetas[1]), math.sin(thetas[1]))
    if table.per_cell > 16:
        _turn_to(thetas[1], end, circuit)
    whole = _at(2.0 * half.i - point.i, end, table)
    whole = _nearest((psi + step * (u_s - loss3)) * turn.conjugate(), whole, end, circuit, table)
    loss4 = _loss(whole.i * turn, circuit)
    psi += step * (u_s - (loss1 + 2.0 * loss2 + 2.0 * loss3 + loss4) / 6.0)
    whole = _at(_nearest(psi * turn.conjugate(), whole, end, circuit, table).i, end, table)
    return psi, whole, turn, step / 6.0 * abs(loss1 - 2.0 * loss3 + loss4)


@inlined
def _loss(i_s: complex, circuit: Circuit) -> complex:
    """Return the space vector of R i + drop in the stator frame, V."""
    half_root3 = 0.8660254037844386
    low, width, voltage = circuit.drop_low, circuit.drop_width, circuit.drop_voltage
    a = _drop(i_s.real, low, width, voltage)
    b = _drop(-0.5 * i_s.real + half_root3 * i_s.imag, low, width, voltage)
    c = _drop(-0.5 * i_s.real - half_root3 * i_s.imag, low, width, voltage)
    return circuit.resistance * i_s + complex((2.0 * a - b - c) / 3.0, (b - c) * (half_root3 * 2.0 / 3.0))


@inlined
def _drop(i: float, low: float, width: float, voltage: Any) -> float:
    """Interpolate the inverter's curve, V."""
    cell, t = bspline.locate(i, low, width, len(voltage) - 1)
    return voltage[cell] + t * (voltage[cell + 1] - voltage[cell])  # type: ignore[no-any-return]


@compiled
def _nearest(psi: complex, guess: Point, here: Slice, circuit: Circuit, table: FluxTable) -> Point:
    """Return the point whose flux is nearest to ``psi``, by damped least squares from one nearby at the same angle.

    The last, small step of Newton's is not checked: flux and derivatives of the returned point are linear in it.
    """
    best, error = guess, psi - guess.psi
    damping, small = 0.0, _SEARCH_TOLERANCE * circuit.diverged
    for _ in range(_SEARCH_STEPS):
        change, regular, good = _search_step(best, error, damping, table)
        if not good:
            damping = max(circuit.damping, 10.0 * damping)
            continue
        tiny = change.real * change.real + change.imag * change.imag < small * small
        if tiny and regular and damping == 0.0:
            return Point(best.i + change, psi, best.by_d, best.by_q)
        trial = _at(best.i + change, here, table)
        left = psi - trial.psi
        if left.real * left.real + left.imag * left.imag <= error.real * error.real + error.imag * error.imag:
            best, error = trial, left
            damping = 0.1 * damping if damping > circuit.damping else 0.0
            if tiny:
                break
        else:
            damping = max(circuit.damping, 10.0 * damping)
    return best


@inlined
def _search_step(best: Point, error: complex, damping: float, table: FluxTable) -> tuple[complex, bool, bool]:
    """Return the change of the current, A, that cancels ``error``, Wb, and whether the map is regular and it exists."""
    dd, qd, dq, qq = best.by_d.real, best.by_d.imag, best.by_q.real, best.by_q.imag
    regular = dd * qq - qd * dq >= _FOLDED * table.inductance_d * table.inductance_q
    if not regular:
        dd, qd, dq, qq = table.inductance_d, 0.0, 0.0, table.inductance_q
    g_d, g_q = dd * error.real + qd * error.imag, dq * error.real + qq * error.imag
    h_dd, h_dq, h_qq = dd * dd + qd * qd + damping, dd * dq + qd * qq, dq * dq + qq * qq + damping
    determinant = h_dd * h_qq - h_dq * h_dq
    if determinant <= 0.0:
        return complex(0.0, 0.0), regular, False
    change = complex((h_qq * g_d - h_dq * g_q) / determinant, (h_dd * g_q - h_dq * g_d) / determinant)
    return change, regular, True


@inlined
def _turn_to(theta: float, here: Slice, circuit: Circuit) -> None:
    """Prepare the map at another angle."""
    for m in range(len(circuit.orders)):
        phase = circuit.orders[m] * theta
        here.factors[2 * m], here.factors[2 * m + 1] = math.cos(phase), math.sin(phase)
    here.cell[0] = -1


@inlined
def _at(i: complex, here: Slice, table: FluxTable) -> Point:
    """Evaluate the map at the angle of ``here``; polynomials of all harmonics are summed once per angle and cell."""
    cell_d, t = bspline.locate(i.real, table.low_d, table.width_d, table.count_d)
    cell_q, s = bspline.locate(i.imag, table.low_q, table.width_q, table.count_q)
    if table.per_cell == 16:
        return _point_in_cell(i, table.coefficients, _first_of(cell_d, cell_q, table), t, s, table)
    c = here.coefficients
    if here.cell[0] != cell_d or here.cell[1] != cell_q:
        here.cell[0], here.cell[1] = cell_d, cell_q
        parts, first = table.coefficients, _first_of(cell_d, cell_q, table)
        for j in range(16):
            part = parts[first + j]
            d, q = part.real, part.imag
            for m in range(len(here.factors)):
                part = parts[first + 16 * (m + 1) + j]
                d += here.factors[m] * part.real
                q += here.factors[m] * part.imag
            c[j] = complex(d, q)
    return _point_in_cell(i, c, 0, t, s, table)


@inlined
def _first_of(cell_d: int, cell_q: int, table: FluxTable) -> int:
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


@inlined
def _point_in_cell(i: complex, c: ComplexArray, k: int, t: float, s: float, table: FluxTable) -> Point:
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
