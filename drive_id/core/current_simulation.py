"""Open-loop simulation of the current from an identified model, for the paper's second metric."""

from __future__ import annotations

import numpy as np

from drive_id.core import bspline, frames
from drive_id.core.compiled import compiled
from drive_id.core.flux_models import TensorSpline
from drive_id.core.frames import ComplexArray
from drive_id.types import FloatArray, Samples

_LARGEST_TURN = 0.15
"""Angle turned in one Runge-Kutta step at most, rad."""

_DIVERGED = 5.0
_DAMPING = 0.1
_SEARCH_STEPS = 20
_SEARCH_TOLERANCE = 1e-9


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
    axes = np.array([[model.d.low, model.d.width], [model.q.low, model.q.width]])
    coefficients = np.ascontiguousarray(np.moveaxis(gamma.reshape(2, model.d.count, model.q.count), 0, -1))
    limit = _DIVERGED * float(np.abs([model.d.low, model.d.high, model.q.low, model.q.high]).max())
    typical_d, typical_q = typical_inductances(model, gamma, i_dq)
    damping = _DAMPING * 0.5 * (typical_d + typical_q)
    out = np.full_like(i_dq, np.nan)
    for run in samples.runs():
        _simulate(
            u_dq[run],
            samples.angle[run],
            samples.speed[run],
            samples.sample_period,
            np.array([resistance, voltage_error, current_scale, limit, damping, typical_d, typical_q]),
            axes,
            coefficients,
            i_dq[run.start],
            out[run],
        )
    return out


def typical_inductances(model: TensorSpline, gamma: FloatArray, i_dq: FloatArray) -> tuple[float, float]:
    """Return the means of the incremental self-inductances over currents (N, 2), A, in H."""
    by_d, by_q = (rows.dot(gamma) for rows in model.slope_rows(i_dq[:: max(1, len(i_dq) // 1000)]))
    return float(by_d[:, 0].mean()), float(by_q[:, 1].mean())


@compiled
def _simulate(
    u_dq: ComplexArray,
    angle: FloatArray,
    speed: FloatArray,
    period: float,
    electrical: FloatArray,
    axes: FloatArray,
    coefficients: FloatArray,
    start: FloatArray,
    out: FloatArray,
) -> None:
    """Fourth-order Runge-Kutta; ``electrical``: R, u_e, i_s, diverged current, damping, d and q inductance."""
    work = np.empty((4, 4))
    i = complex(start[0], start[1])
    flux = _flux(i.real, i.imag, axes, coefficients, electrical[4:], work)
    psi = complex(flux[0], flux[1])
    out[0] = start
    for k in range(len(u_dq) - 1):
        phi, omega, u = angle[k], speed[k], u_dq[k]
        steps = int(abs(omega) * period / _LARGEST_TURN) + 1
        step = period / steps
        for m in range(steps):
            tau = m * step
            k1 = _slope(psi, i, tau, u, phi, omega, electrical)
            i = _current(psi + 0.5 * step * k1, i, axes, coefficients, electrical, work)
            k2 = _slope(psi + 0.5 * step * k1, i, tau + 0.5 * step, u, phi, omega, electrical)
            i = _current(psi + 0.5 * step * k2, i, axes, coefficients, electrical, work)
            k3 = _slope(psi + 0.5 * step * k2, i, tau + 0.5 * step, u, phi, omega, electrical)
            i = _current(psi + step * k3, i, axes, coefficients, electrical, work)
            k4 = _slope(psi + step * k3, i, tau + step, u, phi, omega, electrical)
            psi += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            i = _current(psi, i, axes, coefficients, electrical, work)
        if not abs(i) < electrical[3]:
            return
        out[k + 1, 0], out[k + 1, 1] = i.real, i.imag


@compiled
def _slope(
    psi: complex, i: complex, tau: float, u_start: complex, phi: float, omega: float, electrical: FloatArray
) -> complex:
    """Return d psi_dq / dt at ``tau`` after a sample, ``u_start`` being the held voltage in that sample's dq frame."""
    turn = omega * tau
    u = u_start * complex(np.cos(turn), -np.sin(turn))
    if electrical[1] != 0.0:
        rotation = complex(np.cos(phi + turn), np.sin(phi + turn))
        u -= electrical[1] * _drop_vector(i * rotation, electrical[2]) * rotation.conjugate()
    return complex(u - electrical[0] * i - complex(0.0, omega) * psi)


@compiled
def _current(
    psi: complex, guess: complex, axes: FloatArray, coefficients: FloatArray, electrical: FloatArray, work: FloatArray
) -> complex:
    """Return the current whose flux is nearest to ``psi``, by damped least squares from a guess nearby."""
    i = guess
    damping, damping_least = 0.0, electrical[4] * electrical[4]
    psi_d, psi_q, dd, dq, qd, qq = _flux(i.real, i.imag, axes, coefficients, electrical[4:], work)
    e_d, e_q = psi.real - psi_d, psi.imag - psi_q
    for _ in range(_SEARCH_STEPS):
        g_d, g_q = dd * e_d + qd * e_q, dq * e_d + qq * e_q
        h_dd, h_dq, h_qq = dd * dd + qd * qd + damping, dd * dq + qd * qq, dq * dq + qq * qq + damping
        determinant = h_dd * h_qq - h_dq * h_dq
        if determinant <= 0.0:
            damping = max(damping_least, 10.0 * damping)
            continue
        change = complex((h_qq * g_d - h_dq * g_q) / determinant, (h_dd * g_q - h_dq * g_d) / determinant)
        trial = i + change
        psi_d, psi_q, t_dd, t_dq, t_qd, t_qq = _flux(trial.real, trial.imag, axes, coefficients, electrical[4:], work)
        f_d, f_q = psi.real - psi_d, psi.imag - psi_q
        if f_d * f_d + f_q * f_q <= e_d * e_d + e_q * e_q:
            i, e_d, e_q, dd, dq, qd, qq = trial, f_d, f_q, t_dd, t_dq, t_qd, t_qq
            damping = 0.1 * damping if damping > damping_least else 0.0
            if abs(change) < _SEARCH_TOLERANCE * electrical[3]:
                break
        else:
            damping = max(damping_least, 10.0 * damping)
    return i


@compiled
def _drop_vector(i_s: complex, scale: float) -> complex:
    """Return the stator-frame space vector of tanh(i_abc / scale)."""
    half_root3 = 0.8660254037844386
    a = np.tanh(i_s.real / scale)
    b = np.tanh((-0.5 * i_s.real + half_root3 * i_s.imag) / scale)
    c = np.tanh((-0.5 * i_s.real - half_root3 * i_s.imag) / scale)
    return complex((2.0 * a - b - c) / 3.0, (b - c) * (half_root3 * 2.0 / 3.0))


@compiled
def _flux(
    i_d: float, i_q: float, axes: FloatArray, coefficients: FloatArray, inductances: FloatArray, work: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return psi_d, psi_q and the Jacobian's dd, dq, qd, qq; ``inductances`` is damping, typical d, typical q."""
    count_d, count_q = coefficients.shape[0], coefficients.shape[1]
    low_d, width_d, low_q, width_q = axes[0, 0], axes[0, 1], axes[1, 0], axes[1, 1]
    cell_d, t_d = bspline.locate(i_d, low_d, width_d, count_d - 3)
    cell_q, t_q = bspline.locate(i_q, low_q, width_q, count_q - 3)
    bspline.weights(t_d, work[0])
    bspline.slopes(t_d, width_d, work[1])
    bspline.weights(t_q, work[2])
    bspline.slopes(t_q, width_q, work[3])
    psi_d = psi_q = dd = dq = qd = qq = 0.0
    for a in range(4):
        for b in range(4):
            c_d, c_q = coefficients[cell_d + a, cell_q + b, 0], coefficients[cell_d + a, cell_q + b, 1]
            value, by_d, by_q = work[0, a] * work[2, b], work[1, a] * work[2, b], work[0, a] * work[3, b]
            psi_d += value * c_d
            psi_q += value * c_q
            dd += by_d * c_d
            dq += by_q * c_d
            qd += by_d * c_q
            qq += by_q * c_q
    beyond_d = i_d - (low_d + (cell_d + t_d) * width_d)
    beyond_q = i_q - (low_q + (cell_q + t_q) * width_q)
    psi_d += inductances[1] * beyond_d
    psi_q += inductances[2] * beyond_q
    if beyond_d != 0.0:
        dd, qd = inductances[1], 0.0
    if beyond_q != 0.0:
        dq, qq = 0.0, inductances[2]
    return psi_d, psi_q, dd, dq, qd, qq
