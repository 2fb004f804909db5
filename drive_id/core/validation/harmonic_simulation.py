"""Open-loop simulation of the current from a model with rotor-position harmonics and an inverter curve.

The state is the flux linkage in the stator frame, where the held voltage is constant and the balance has neither the
speed nor the harmonics in it,

    d/dt psi_s = u_s - R i_s - drop(i_abc)_s,        f(i, theta) = e^{-j theta} psi_s,

so that Runge-Kutta's rule only has to integrate the small and slow loss; i follows from a search on the map at theta.
Polynomials of all harmonics are combined once per angle and cell, not once per evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.numerics import bspline
from drive_id.core.numerics.compiled import compiled
from drive_id.core.validation.current_simulation import (
    FluxTable,
    Point,
    cell_of,
    point_in_cell,
    polynomials,
    search_step,
    table_of,
    typical_inductances,
)
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.3
"""Angle turned in one step at most, rad."""

_LARGEST_PHASE = 1.2
"""Phase that the highest harmonic passes in one step at most, rad."""

_FINEST = 32
"""Parts into which a step is divided at most where the loss bends, that is, where a phase current changes its sign."""

_BEND = 1e-5
"""What a bend may cost in one step, relative to the flux that the largest current makes."""

_DIVERGED = 5.0
_DAMPING = 0.1
_SEARCH_STEPS = 20
_SEARCH_TOLERANCE = 1e-7
_HALF_WINDOW = 5
"""Samples to each side over which the difference of the measured angle from the integral of the speed is averaged."""


def simulate_harmonic_current(
    samples: Samples,
    model: TensorSpline,
    gamma: FloatArray,
    harmonics: Mapping[int, tuple[FloatArray, FloatArray]],
    resistance: float,
    drop: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Integrate ``u = R i + j omega f + df/dt + drop`` over a recording, each run from its first sample.

    The flux linkages are ``f(i, theta) = f_0(i) + sum_h a_h(i) cos(h theta) + b_h(i) sin(h theta)``. The commanded
    voltage is held in the stator frame over each sample. The measured angle is smoothed with the integral of the speed
    as a guide, for a step of the angle turns the whole flux and acts on the current at once. The current is the one
    whose flux is nearest, see ``simulate_current``; beyond the model's range f_0
    goes on with the typical inductances and the harmonics stay as on its edge.

    Parameters
    ----------
    samples : Samples
    model : TensorSpline
        Of f_0 and of every harmonic.
    gamma : (P,) float
        Parameters of f_0, Wb.
    harmonics : mapping of int to ((P,) float, (P,) float)
        Electrical order h to the parameters of a_h and b_h, Wb.
    resistance : float
        Ohm.
    drop : (C,) float, (C,) float
        Phase currents, A, strictly increasing, and what the inverter takes away from the phase voltage there, V;
        linear in between and constant beyond.

    Returns
    -------
    (N, 2) float
        Simulated i_dq at the stamps, A; NaN from where a run diverged on.
    """
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    u_s = frames.space_vector(samples.u_abc)
    largest = float(np.abs([model.d.low, model.d.high, model.q.low, model.q.high]).max())
    inductances = typical_inductances(model, gamma, i_dq)
    inductance = 0.5 * sum(inductances)
    plant = Plant(
        np.array(list(harmonics), np.float64),
        float(resistance),
        np.ascontiguousarray(drop[0], np.float64),
        np.ascontiguousarray(drop[1], np.float64),
        samples.sample_period,
        max(1 / _LARGEST_TURN, max(harmonics, default=0) / _LARGEST_PHASE),
        _BEND * abs(inductance) * largest,
        _DIVERGED * largest,
        (_DAMPING * inductance) ** 2,
    )
    parts = [gamma, *(part for pair in harmonics.values() for part in pair)]
    table = table_of(model, np.concatenate([polynomials(model, part) for part in parts], axis=-1), inductances)
    out = np.full(len(i_dq), np.nan, np.complex128)
    for run in samples.runs():
        angle = _smooth_angle(samples.angle[run], samples.speed[run], samples.sample_period)
        slices = _slice(len(harmonics)), _slice(len(harmonics))
        _simulate(u_s[run], angle, plant, table, *slices, complex(*i_dq[run.start]), out[run])
    out.imag[np.isnan(out.real)] = np.nan
    return frames.as_pairs(out)


def _smooth_angle(angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Return the angle (N,), rad, not wrapped, without the noise of the measured one."""
    turned = np.zeros(len(angle))
    np.cumsum(0.5 * period * (speed[1:] + speed[:-1]), out=turned[1:])
    left = np.unwrap(angle - turned)
    half = min(_HALF_WINDOW, len(left) - 1)
    padded = np.pad(left, half, mode="reflect", reflect_type="odd")
    return np.asarray(turned + np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid"))


class Plant(NamedTuple):
    """The constants of the voltage equation and of its integration; arrays when compiled, otherwise lists."""

    orders: Any  # (H,) of the harmonics
    resistance: float  # ohm
    drop_current: Any  # (C,) A
    drop_voltage: Any  # (C,) V
    period: float  # s
    steps_per_turn: float  # 1/rad
    bend: float  # error of a step above which it is divided, Wb
    diverged: float  # current, A
    damping: float  # of the search for a current, H^2


class Slice(NamedTuple):
    """The map at one angle of the rotor, in the cell where it was last asked for."""

    factors: Any  # (2 H,) cosine and sine of each order's phase
    cell: Any  # (2,) int in d and q, -1 for none
    coefficients: Any  # (16,) complex, Wb


def _slice(orders: int) -> Slice:
    return Slice(np.zeros(2 * orders), np.full(2, -1), np.zeros(16, np.complex128))


@compiled
def _simulate(
    u_s: Any, angle: Any, plant: Plant, table: FluxTable, middle: Slice, end: Slice, start: complex, out: ComplexArray
) -> None:
    """Integrate over one run; steps are halved where the loss bends and doubled again behind."""
    _turn_to(angle[0], end, plant)
    point = _at(start, end, table)
    psi = point.psi * complex(math.cos(angle[0]), math.sin(angle[0]))
    out[0] = start
    size = _FINEST
    for k in range(len(u_s) - 1):
        turn = angle[k + 1] - angle[k]
        ticks = _FINEST * (int(abs(turn) * plant.steps_per_turn) + 1)
        now = 0
        while now < ticks:
            since, until = now / ticks, (now + size) / ticks
            thetas = (angle[k] + since * turn, angle[k] + 0.5 * (since + until) * turn, angle[k] + until * turn)
            step = (until - since) * plant.period
            new_psi, new_point, bend = _step(psi, point, u_s[k], thetas, step, plant, table, middle, end)
            if bend > plant.bend and size > 1:
                size //= 2
                continue
            psi, point = new_psi, new_point
            now += size
            if bend < plant.bend / 16 and size < _FINEST and now % (2 * size) == 0:
                size *= 2
        if not abs(point.i) < plant.diverged:
            return
        out[k + 1] = point.i


@compiled
def _step(
    psi: complex,
    point: Point,
    u_s: complex,
    thetas: tuple[float, float, float],
    step: float,
    plant: Plant,
    table: FluxTable,
    middle: Slice,
    end: Slice,
) -> tuple[complex, Point, float]:
    """Make one step of Runge-Kutta's rule of order 4; angles at its start, middle and end.

    Returns flux and point at the end and what the loss's curvature may have cost, Wb.
    """
    turn = complex(math.cos(thetas[0]), math.sin(thetas[0]))
    loss1 = _loss(point.i * turn, plant)
    turn = complex(math.cos(thetas[1]), math.sin(thetas[1]))
    _turn_to(thetas[1], middle, plant)
    half = _at(point.i, middle, table)
    half = _nearest((psi + 0.5 * step * (u_s - loss1)) * turn.conjugate(), half, middle, plant, table)
    loss2 = _loss(half.i * turn, plant)
    half = _nearest((psi + 0.5 * step * (u_s - loss2)) * turn.conjugate(), half, middle, plant, table)
    loss3 = _loss(half.i * turn, plant)
    turn = complex(math.cos(thetas[2]), math.sin(thetas[2]))
    _turn_to(thetas[2], end, plant)
    whole = _at(2.0 * half.i - point.i, end, table)
    whole = _nearest((psi + step * (u_s - loss3)) * turn.conjugate(), whole, end, plant, table)
    loss4 = _loss(whole.i * turn, plant)
    psi += step * (u_s - (loss1 + 2.0 * loss2 + 2.0 * loss3 + loss4) / 6.0)
    whole = _nearest(psi * turn.conjugate(), whole, end, plant, table)
    return psi, whole, step / 6.0 * abs(loss1 - 2.0 * loss3 + loss4)


@compiled
def _loss(i_s: complex, plant: Plant) -> complex:
    """Return the space vector of R i + drop in the stator frame, V."""
    half_root3 = 0.8660254037844386
    a = _drop(i_s.real, plant)
    b = _drop(-0.5 * i_s.real + half_root3 * i_s.imag, plant)
    c = _drop(-0.5 * i_s.real - half_root3 * i_s.imag, plant)
    return plant.resistance * i_s + complex((2.0 * a - b - c) / 3.0, (b - c) * (half_root3 * 2.0 / 3.0))


@compiled
def _drop(i: float, plant: Plant) -> float:
    """Interpolate the inverter's curve, V."""
    x, y = plant.drop_current, plant.drop_voltage
    low, high = 0, len(x) - 1
    if not i > x[low]:
        return float(y[low])
    if i >= x[high]:
        return float(y[high])
    while high - low > 1:
        between = (low + high) // 2
        if i < x[between]:
            high = between
        else:
            low = between
    return float(y[low] + (y[high] - y[low]) * ((i - x[low]) / (x[high] - x[low])))


@compiled
def _nearest(psi: complex, guess: Point, here: Slice, plant: Plant, table: FluxTable) -> Point:
    """Return the point whose flux is nearest to ``psi``, by damped least squares from one nearby at the same angle."""
    best, error = guess, psi - guess.psi
    damping = 0.0
    for _ in range(_SEARCH_STEPS):
        change, good = search_step(best, error, damping, table)
        if not good:
            damping = max(plant.damping, 10.0 * damping)
            continue
        trial = _at(best.i + change, here, table)
        left = psi - trial.psi
        if left.real * left.real + left.imag * left.imag <= error.real * error.real + error.imag * error.imag:
            best, error = trial, left
            damping = 0.1 * damping if damping > plant.damping else 0.0
            if abs(change) < _SEARCH_TOLERANCE * plant.diverged:
                break
        else:
            damping = max(plant.damping, 10.0 * damping)
    return best


@compiled
def _turn_to(theta: float, here: Slice, plant: Plant) -> None:
    """Ask for the map at another angle."""
    for m in range(len(plant.orders)):
        phase = plant.orders[m] * theta
        here.factors[2 * m], here.factors[2 * m + 1] = math.cos(phase), math.sin(phase)
    here.cell[0] = -1


@compiled
def _at(i: complex, here: Slice, table: FluxTable) -> Point:
    """Evaluate the map at the angle of ``here``."""
    cell_d, t = bspline.locate(i.real, table.low_d, table.width_d, table.count_d)
    cell_q, s = bspline.locate(i.imag, table.low_q, table.width_q, table.count_q)
    c = here.coefficients
    if here.cell[0] != cell_d or here.cell[1] != cell_q:
        here.cell[0], here.cell[1] = cell_d, cell_q
        parts, first = table.coefficients, cell_of(cell_d, cell_q, table)
        for j in range(16):
            part = parts[first + j]
            d, q = part.real, part.imag
            for m in range(len(here.factors)):
                part = parts[first + 16 * (m + 1) + j]
                d += here.factors[m] * part.real
                q += here.factors[m] * part.imag
            c[j] = complex(d, q)
    return point_in_cell(i, c, 0, t, s, table)
