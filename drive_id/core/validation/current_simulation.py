"""Open-loop simulation of the current from an identified model, for the paper's second metric, the MAD.

The state is the flux linkage in the stator frame, where the held voltage is constant and the balance contains neither
the speed nor the rotor harmonics,

    d/dt psi_s = u_s - R i_s - drop(i_abc)_s,        f(i, theta) = e^{-j theta} psi_s,

so that Runge-Kutta's rule integrates only the small, slow loss; i follows from a search on the map at theta. Methods
``psm`` and ``joint`` are the case without harmonics (``eq:continous_dq_current_ODE_with_disturbance``).
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.core import frames
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.numerics import bspline
from drive_id.core.numerics.compiled import compiled
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.3  # largest angle turned in one step, rad
_LARGEST_PHASE = 1.2  # largest phase that the highest harmonic passes in one step, rad
_FINEST = 32  # finest division of a step where the loss bends, that is, where a phase current changes its sign
_BEND = 1e-5  # error of a step above which it is divided, relative to the flux of the largest current
_DIVERGED = 5.0  # current at which a simulation is given up, over the largest current of the map
_DAMPING = 0.1  # least, of a search that leads away, over the typical inductance
_SEARCH_STEPS = 20  # at most
_SEARCH_TOLERANCE = 3e-6
"""Last change of a search over the current of divergence: the steps are Newton's, so the next one is its square."""
_MOST_KNOTS = 200  # along an axis, which bounds the memory of finer maps
_FOLDED = 0.1
"""Share of the typical Jacobian's determinant below which the search uses that one: it must not run to a far branch."""

Pair = tuple[float, float]

_HALF_WINDOW = 5
"""Samples to each side over which the difference of the measured angle from the integral of the speed is averaged."""

_POWERS = np.array([[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]) / 6
"""Powers of the position in a cell (rows) in its four splines, see :mod:`drive_id.core.numerics.bspline`."""


def simulate_current(
    samples: Samples,
    flux_map: FluxMap,
    resistance: float,
    drop: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Integrate ``u = R i + j omega f + df/dt + drop`` over a recording, each run from its first sample.

    The flux linkages are ``f(i, theta) = f_0(i) + sum_h a_h(i) cos(h theta) + b_h(i) sin(h theta)``. The commanded
    voltage is held in the stator frame over each sample. The measured angle is smoothed, guided by the integral of the
    speed, because a step of the angle turns the whole flux and acts on the current at once. The current is the one
    whose flux is nearest: the same equation where the Jacobian D_f is regular, and bounded where it is singular, as it
    can be in places of a fit that disregards the rotor harmonics. Beyond the map's axes f_0 goes on with the typical
    inductances, and the harmonics stay as on its edge.

    Parameters
    ----------
    flux_map : FluxMap
        On equally spaced axes; without harmonics for methods ``psm`` and ``joint``.
    resistance : float
        Ohm.
    drop : (C,) float, (C,) float
        Phase currents, A, equally spaced and increasing, and the inverter's drop of the phase voltage there, V; linear
        in between and constant beyond.

    Returns
    -------
    (N, 2) float
        Simulated i_dq at the stamps, A; NaN from where a run diverged on.
    """
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    u_s = frames.as_pairs(frames.space_vector(samples.u_abc))
    largest = float(max(np.abs(flux_map.i_d).max(), np.abs(flux_map.i_q).max()))
    inductance = 0.5 * sum(flux_map.typical_inductances)
    orders = np.array([h.order for h in flux_map.harmonics], np.float64)
    constants = np.array(
        [
            resistance,
            samples.sample_period,
            max(1 / _LARGEST_TURN, max(orders, default=0.0) / _LARGEST_PHASE),
            _BEND * abs(inductance) * largest,
            _DIVERGED * largest,
            (_DAMPING * inductance) ** 2,
        ]
    )
    curve = np.array([drop[0][0], drop[0][1] - drop[0][0], *drop[1]], np.float64)
    axes, table = flux_table(flux_map)
    out = np.full((len(i_dq), 2), np.nan)
    for run in samples.runs():
        angle = _smooth_angle(samples.angle[run], samples.speed[run], samples.sample_period)
        _simulate(u_s[run], angle, orders, constants, curve, axes, table, i_dq[run.start], out[run])
    return out


def _smooth_angle(angle: FloatArray, speed: FloatArray, period: float) -> FloatArray:
    """Return the angle (N,), rad, not wrapped, without the noise of the measured one."""
    turned = np.zeros(len(angle))
    np.cumsum(0.5 * period * (speed[1:] + speed[:-1]), out=turned[1:])
    left = np.unwrap(angle - turned)
    half = min(_HALF_WINDOW, len(left) - 1)
    padded = np.pad(left, half, mode="reflect", reflect_type="odd")
    return np.asarray(turned + np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid"))


def flux_table(flux_map: FluxMap) -> tuple[FloatArray, FloatArray]:
    """Return a map on equally spaced axes as polynomials per cell, by the splines through them.

    Returns
    -------
    axes : (2, 4) float
        For d and q: lower end and width of a cell, A, number of cells, and inductance beyond them, H.
    table : (cells, 1 + 2 H, 32) float
        Coefficients of t^0 s^0, t^0 s^1, ... t^3 s^3 in each cell, row-major in d and q: psi_d, then psi_q, Wb. Those
        of f_0 come before those of a_h and b_h of each harmonic.
    """
    d, q = (np.linspace(x[0], x[-1], min(len(x), _MOST_KNOTS)) for x in (flux_map.i_d, flux_map.i_q))
    axes = [[x[0], x[1] - x[0], len(x) - 1, own] for x, own in zip((d, q), flux_map.typical_inductances, strict=True)]
    parts = [flux_map.psi_d, flux_map.psi_q]
    for h in flux_map.harmonics:
        parts += [h.psi_d_cos, h.psi_q_cos, h.psi_d_sin, h.psi_q_sin]
    values = [flux_map.sampled(part, *np.meshgrid(d, q, indexing="ij")) for part in parts]
    of_d, of_q = _coefficients(len(d)), _coefficients(len(q))
    coefficients = (of_d @ np.array(values) @ of_q.T).reshape(-1, 2, len(of_d), len(of_q))
    windows = np.lib.stride_tricks.sliding_window_view(coefficients, (4, 4), axis=(2, 3))
    table = np.einsum("ai,pfxyij,bj->xypfab", _POWERS, windows, _POWERS)
    return np.array(axes), np.ascontiguousarray(table.reshape(-1, len(parts) // 2, 32))


@one_blas_thread()
def _coefficients(count: int) -> FloatArray:
    """Return the matrix (count + 2, count) from values at the knots to the coefficients of their not-a-knot spline."""
    conditions = np.zeros((count + 2, count + 2))
    for k in range(count):
        conditions[k, k : k + 3] = np.array([1.0, 4.0, 1.0]) / 6
    for row, first in ((-2, 0), (-1, count - 3)):
        conditions[row, first : first + 5] = [1.0, -4.0, 6.0, -4.0, 1.0]
    return np.asarray(np.linalg.inv(conditions)[:, :count])


@compiled("f8, f8, f8, const f8[::1]")
def loss(i_alpha: float, i_beta: float, resistance: float, curve: FloatArray) -> tuple[float, float]:
    """Return R i + drop in the stator frame, V; ``curve`` is the drop's first current, their spacing, and the drop."""
    half_root3 = 0.8660254037844386
    low, width, cells = curve[0], curve[1], len(curve) - 3
    cell_a, t_a = bspline.locate(i_alpha, low, width, cells)
    cell_b, t_b = bspline.locate(-0.5 * i_alpha + half_root3 * i_beta, low, width, cells)
    cell_c, t_c = bspline.locate(-0.5 * i_alpha - half_root3 * i_beta, low, width, cells)
    a = curve[cell_a + 2] + t_a * (curve[cell_a + 3] - curve[cell_a + 2])
    b = curve[cell_b + 2] + t_b * (curve[cell_b + 3] - curve[cell_b + 2])
    c = curve[cell_c + 2] + t_c * (curve[cell_c + 3] - curve[cell_c + 2])
    alpha, beta = (2.0 * a - b - c) / 3.0, (b - c) * (half_root3 * 2.0 / 3.0)
    return resistance * i_alpha + alpha, resistance * i_beta + beta


@compiled("f8, const f8[::1], f8[::1]")
def turn_to(theta: float, orders: FloatArray, here: FloatArray) -> None:
    """Prepare ``here``, a slice of the map at one angle of the rotor, for another angle.

    It holds the 32 coefficients of the cell where the map was needed last, the number of that cell, and cosine and sine
    of each harmonic's phase.
    """
    here[32] = -1.0
    for m in range(len(orders)):
        here[33 + 2 * m], here[34 + 2 * m] = math.cos(orders[m] * theta), math.sin(orders[m] * theta)


@compiled("f8, f8, f8[::1], const f8[:, ::1], const f8[:, :, ::1], f8[::1]")
def evaluate(i_d: float, i_q: float, here: FloatArray, axes: FloatArray, table: FloatArray, point: FloatArray) -> None:
    """Write the current, the flux and the inductances L_dd, L_dq, L_qd, L_qq to ``point`` (8,), A, Wb and H.

    The polynomials of all harmonics are summed once per angle and cell. Beyond its range the map is continued.
    """
    cell_d, t = bspline.locate(i_d, axes[0, 0], axes[0, 1], int(axes[0, 2]))
    cell_q, s = bspline.locate(i_q, axes[1, 0], axes[1, 1], int(axes[1, 2]))
    cell = cell_d * int(axes[1, 2]) + cell_q
    if here[32] != cell:
        here[32] = cell
        for j in range(32):
            total = table[cell, 0, j]
            for m in range(1, table.shape[1]):
                total += here[32 + m] * table[cell, m, j]
            here[j] = total
    point[0], point[1] = i_d, i_q
    beyond_d = i_d - min(max(i_d, axes[0, 0]), axes[0, 0] + axes[0, 2] * axes[0, 1])
    beyond_q = i_q - min(max(i_q, axes[1, 0]), axes[1, 0] + axes[1, 2] * axes[1, 1])
    for axis in range(2):
        psi = by_d = by_q = 0.0
        for a in range(3, -1, -1):  # Horner's rule
            k = 16 * axis + 4 * a
            row = here[k] + s * (here[k + 1] + s * (here[k + 2] + s * here[k + 3]))
            slope = here[k + 1] + s * (2.0 * here[k + 2] + 3.0 * s * here[k + 3])
            by_d = psi + t * by_d
            psi = row + t * psi
            by_q = slope + t * by_q
        point[2 + axis] = psi
        point[4 + 2 * axis] = by_d / axes[0, 1]
        point[5 + 2 * axis] = by_q / axes[1, 1]
    point[2] += axes[0, 3] * beyond_d
    point[3] += axes[1, 3] * beyond_q
    if beyond_d != 0.0:
        point[4], point[6] = axes[0, 3], 0.0
    if beyond_q != 0.0:
        point[5], point[7] = 0.0, axes[1, 3]


@compiled("f8, f8, f8, f8, f8[::1], const f8[:, ::1], const f8[:, :, ::1], f8[::1], f8[::1]")
def search(
    psi_d: float,
    psi_q: float,
    small: float,
    least_damping: float,
    here: FloatArray,
    axes: FloatArray,
    table: FloatArray,
    point: FloatArray,
    trial: FloatArray,
) -> None:
    """Move ``point`` to where the flux is nearest to psi, by damped least squares; ``trial`` (8,) is for its use.

    The last step of Newton's, below ``small``, is not checked: the inductances stay, the flux is taken for psi.
    """
    e_d, e_q = psi_d - point[2], psi_q - point[3]
    damping = 0.0
    for _ in range(_SEARCH_STEPS):
        dd, dq, qd, qq = point[4], point[5], point[6], point[7]
        regular = dd * qq - qd * dq >= _FOLDED * axes[0, 3] * axes[1, 3]
        if not regular:
            dd, dq, qd, qq = axes[0, 3], 0.0, 0.0, axes[1, 3]
        g_d, g_q = dd * e_d + qd * e_q, dq * e_d + qq * e_q
        h_dd, h_dq, h_qq = dd * dd + qd * qd + damping, dd * dq + qd * qq, dq * dq + qq * qq + damping
        determinant = h_dd * h_qq - h_dq * h_dq
        if determinant <= 0.0:
            damping = max(least_damping, 10.0 * damping)
            continue
        x, y = (h_qq * g_d - h_dq * g_q) / determinant, (h_dd * g_q - h_dq * g_d) / determinant
        tiny = x * x + y * y < small * small
        if tiny and regular and damping == 0.0:
            point[0] += x
            point[1] += y
            point[2], point[3] = psi_d, psi_q
            return
        evaluate(point[0] + x, point[1] + y, here, axes, table, trial)
        x, y = psi_d - trial[2], psi_q - trial[3]
        if x * x + y * y <= e_d * e_d + e_q * e_q:
            e_d, e_q = x, y
            for j in range(8):
                point[j] = trial[j]
            damping = 0.1 * damping if damping > least_damping else 0.0
            if tiny:
                return
        else:
            damping = max(least_damping, 10.0 * damping)


_STAGES = np.array([[1.0, 0.5, 1.0], [2.0, 0.5, 0.0], [2.0, 1.0, -2.0], [1.0, 1.0, 1.0]])
"""Of Runge-Kutta's stages: six times the weight, how far they lead, and factor in the error's estimate."""


@compiled(
    "UniTuple(f8, 2), UniTuple(f8, 2), UniTuple(f8, 2), UniTuple(f8, 2), f8, const f8[::1], const f8[::1], "
    "const f8[::1], const f8[:, ::1], const f8[:, :, ::1], f8[::1], f8[::1], f8[::1]"
)
def _step(
    psi: Pair,
    turn: Pair,
    u_s: Pair,
    thetas: Pair,
    step: float,
    orders: FloatArray,
    constants: FloatArray,
    curve: FloatArray,
    axes: FloatArray,
    table: FloatArray,
    here: FloatArray,
    work: FloatArray,
    trial: FloatArray,
) -> tuple[Pair, Pair, float]:
    """Make one step of Runge-Kutta's rule of order 4 from the point in ``work``, and leave the last point there.

    ``turn`` is cosine and sine of the angle at its start, ``thetas`` the angles at its middle and end. Returns flux
    (stator frame) and turn at the end, and the error that the loss's curvature may have caused, Wb.
    """
    small = _SEARCH_TOLERANCE * constants[4]
    i_d, i_q = work[0], work[1]
    c, s = turn
    loss_x = loss_y = bend_x = bend_y = 0.0
    new = psi
    for stage in range(4):
        x, y = loss(c * work[0] - s * work[1], s * work[0] + c * work[1], constants[0], curve)
        loss_x, loss_y = loss_x + _STAGES[stage, 0] * x, loss_y + _STAGES[stage, 0] * y
        bend_x, bend_y = bend_x + _STAGES[stage, 2] * x, bend_y + _STAGES[stage, 2] * y
        if stage % 2 == 0:  # the first stage leads to the middle of the step, the third to its end
            theta = thetas[stage // 2]
            c, s = math.cos(theta), math.sin(theta)
            if len(orders) > 0:
                turn_to(theta, orders, here)
            if stage == 2:
                evaluate(2.0 * work[0] - i_d, 2.0 * work[1] - i_q, here, axes, table, work)
            elif len(orders) > 0:
                evaluate(i_d, i_q, here, axes, table, work)
        if stage == 3:
            x, y = loss_x / 6.0, loss_y / 6.0
        reach = step * _STAGES[stage, 1]
        new = (psi[0] + reach * (u_s[0] - x), psi[1] + reach * (u_s[1] - y))
        search(c * new[0] + s * new[1], c * new[1] - s * new[0], small, constants[5], here, axes, table, work, trial)
    evaluate(work[0], work[1], here, axes, table, work)
    return new, (c, s), step / 6.0 * math.hypot(bend_x, bend_y)


@compiled(
    "const f8[:, ::1], const f8[::1], const f8[::1], const f8[::1], const f8[::1], const f8[:, ::1], "
    "const f8[:, :, ::1], const f8[::1], f8[:, ::1]"
)
def _simulate(
    u_s: FloatArray,
    angle: FloatArray,
    orders: FloatArray,
    constants: FloatArray,
    curve: FloatArray,
    axes: FloatArray,
    table: FloatArray,
    start: FloatArray,
    out: FloatArray,
) -> None:
    """Integrate over one run (N,); steps of Runge-Kutta are halved where the loss bends and doubled again behind.

    Takes the held voltage (N, 2) in the stator frame, V, the angle (N,), rad, not wrapped, the orders of the harmonics,
    constants (R, ohm; period, s; least steps per radian; error above which a step is divided, Wb; current at which the
    simulation has diverged, A; damping of the search, H^2), what :func:`loss` and :func:`flux_table` take, and the
    first current, A. Writes to ``out`` (N, 2), A, which stays as it is from where the simulation diverged on.
    """
    period, steps_per_turn, bend_limit, diverged = constants[1], constants[2], constants[3], constants[4]
    here = np.zeros(33 + 2 * len(orders))
    point, work, trial = np.zeros(8), np.zeros(8), np.zeros(8)
    turn_to(angle[0], orders, here)
    evaluate(start[0], start[1], here, axes, table, point)
    turn = (math.cos(angle[0]), math.sin(angle[0]))
    psi = (turn[0] * point[2] - turn[1] * point[3], turn[1] * point[2] + turn[0] * point[3])  # stator frame
    out[0, 0], out[0, 1] = start[0], start[1]
    size = _FINEST
    for k in range(len(u_s) - 1):
        by = angle[k + 1] - angle[k]
        ticks = _FINEST * (int(abs(by) * steps_per_turn) + 1)
        now = 0
        while now < ticks:
            since, until = now / ticks, (now + size) / ticks
            for j in range(8):
                work[j] = point[j]
            held, thetas = (u_s[k, 0], u_s[k, 1]), (angle[k] + 0.5 * (since + until) * by, angle[k] + until * by)
            new_psi, new_turn, bend = _step(
                psi, turn, held, thetas, (until - since) * period, orders, constants, curve, axes, table, here, work,
                trial,
            )  # fmt: skip
            if bend > bend_limit and size > 1:
                size //= 2
                continue
            for j in range(8):
                point[j] = work[j]
            psi, turn = new_psi, new_turn
            now += size
            if bend < bend_limit / 16 and size < _FINEST and now % (2 * size) == 0:
                size *= 2
        if not math.hypot(point[0], point[1]) < diverged:
            return
        out[k + 1, 0], out[k + 1, 1] = point[0], point[1]
