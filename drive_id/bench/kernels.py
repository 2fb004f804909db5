"""Kernels of the simulated drive's parts: flux splines, phase drop, controller.

They live in one file because the cache of compiled code only notices changes of a kernel's own file.
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.bench.parameters import HISTORY, Controller, DriveState, PhaseDrop, Plant, SplineTable
from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray


@compiled()
def evaluate(
    table: SplineTable, i_d: float, i_q: float, theta: float
) -> tuple[float, float, float, float, float, float]:
    """Return psi_d, psi_q (Wb) and dpsi_d/di_d, dpsi_d/di_q, dpsi_q/di_d, dpsi_q/di_q (H)."""
    c = table.coefficients
    x = (i_d - table.d_start) * table.d_rate
    m = min(max(math.floor(x), 0), c.shape[0] - 4)
    x -= m
    y = (i_q - table.q_start) * table.q_rate
    n = min(max(math.floor(y), 0), c.shape[1] - 4)
    y -= n
    wd, vd = _weights(x), _slopes(x)
    wq, vq = _weights(y), _slopes(y)
    nodes = c.shape[3] - 3
    h = 0
    wt = (1.0, 0.0, 0.0, 0.0)
    if nodes > 0:
        z = (theta - table.theta_start) * table.theta_rate
        z -= nodes * math.floor(z / nodes)
        h = min(int(z), nodes - 1)
        wt = _weights(z - h)
    psi_d = psi_q = l_dd = l_dq = l_qd = l_qq = 0.0
    for a in range(4):
        d_value = d_slope = q_value = q_slope = 0.0
        for b in range(4):
            if nodes > 0:
                p = c[m + a, n + b, 0, h : h + 4]
                q = c[m + a, n + b, 1, h : h + 4]
                fd = wt[0] * p[0] + wt[1] * p[1] + wt[2] * p[2] + wt[3] * p[3]
                fq = wt[0] * q[0] + wt[1] * q[1] + wt[2] * q[2] + wt[3] * q[3]
            else:
                fd = c[m + a, n + b, 0, 0]
                fq = c[m + a, n + b, 1, 0]
            d_value += wq[b] * fd
            d_slope += vq[b] * fd
            q_value += wq[b] * fq
            q_slope += vq[b] * fq
        psi_d += wd[a] * d_value
        psi_q += wd[a] * q_value
        l_dd += vd[a] * d_value
        l_qd += vd[a] * q_value
        l_dq += wd[a] * d_slope
        l_qq += wd[a] * q_slope
    return psi_d, psi_q, l_dd * table.d_rate, l_dq * table.q_rate, l_qd * table.d_rate, l_qq * table.q_rate


@compiled()
def evaluate_many(table: SplineTable, i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> FloatArray:
    """Evaluate at (N,) currents and angles: (N, 6) of psi_d, psi_q (Wb) and the four incremental inductances (H)."""
    out = np.empty((len(i_d), 6))
    for k in range(len(i_d)):
        f_d, f_q, l_dd, l_dq, l_qd, l_qq = evaluate(table, i_d[k], i_q[k], theta[k])
        out[k, 0], out[k, 1] = f_d, f_q
        out[k, 2], out[k, 3], out[k, 4], out[k, 5] = l_dd, l_dq, l_qd, l_qq
    return out


@compiled()
def _weights(x: float) -> tuple[float, float, float, float]:
    y = 1.0 - x
    return y * y * y / 6, (x * x * (3 * x - 6) + 4) / 6, (y * y * (3 * y - 6) + 4) / 6, x * x * x / 6


@compiled()
def _slopes(x: float) -> tuple[float, float, float, float]:
    y = 1.0 - x
    return -y * y / 2, x * (3 * x - 4) / 2, -y * (3 * y - 4) / 2, x * x / 2


@compiled()
def phase_drop(drop: PhaseDrop, i: float) -> float:
    """Return the voltage that one leg takes away, V, odd in and rising with the phase current ``i``, A.

    With x = i / charge_current, the dead-time part is u_td x/2 for |x| < 1 and u_td sign(x) (1 - 1/(2|x|)) beyond:
    within the dead time the current charges the legs' capacitance linearly, and fully only above the charge current.
    The devices add threshold_voltage tanh(i / threshold_current) + resistance i.
    """
    u = drop.resistance * i
    if drop.dead_time_voltage != 0.0:
        x = i / drop.charge_current
        if abs(x) < 1.0:
            u += drop.dead_time_voltage * 0.5 * x
        else:
            u += drop.dead_time_voltage * (math.copysign(1.0, x) - 0.5 / x)
    if drop.threshold_voltage != 0.0:
        u += drop.threshold_voltage * math.tanh(i / drop.threshold_current)
    return u


@compiled()
def phase_drops(drop: PhaseDrop, current: FloatArray) -> FloatArray:
    """Return the drop, V, at (N,) phase currents, A."""
    out = np.empty(len(current))
    for k in range(len(current)):
        out[k] = phase_drop(drop, current[k])
    return out


@compiled()
def current_of_flux(
    table: SplineTable, psi_d: float, psi_q: float, theta: float, i_d: float, i_q: float, tolerance: float
) -> tuple[float, float, bool]:
    """Invert the flux map by Newton's method from the guess (i_d, i_q); the flag tells whether it converged.

    Convergence is quadratic: the error left is of the order of the square of the last step.
    """
    for _ in range(30):
        f_d, f_q, l_dd, l_dq, l_qd, l_qq = evaluate(table, i_d, i_q, theta)
        r_d = psi_d - f_d
        r_q = psi_q - f_q
        determinant = l_dd * l_qq - l_dq * l_qd
        step_d = (l_qq * r_d - l_dq * r_q) / determinant
        step_q = (l_dd * r_q - l_qd * r_d) / determinant
        i_d += step_d
        i_q += step_q
        if abs(step_d) + abs(step_q) < tolerance:
            return i_d, i_q, True
    return i_d, i_q, False


@compiled()
def with_ripple(plant: Plant, mean_angle: float) -> float:
    """Return the angle whose speed is d/dt mean_angle (1 + ripple cos(order mean_angle)), rad."""
    if plant.ripple == 0.0:
        return mean_angle
    return mean_angle + plant.ripple / plant.ripple_order * math.sin(plant.ripple_order * mean_angle)


@compiled()
def control(
    controller: Controller,
    drop: PhaseDrop,
    state: DriveState,
    i_dq: tuple[float, float],
    angle: float,
    speed: float,
    i_dq_reference: tuple[float, float],
    period: float,
) -> None:
    """Compute the command of the next period from measured values into ``state.commands[0]``.

    A PI controller whose error is the flux error seen through a rough map, which schedules the gains with saturation:

        u = a (psi_ref - psi) + d/dt psi_ref + omega J psi + R i + z,     dz/dt = a_i a (psi_ref - psi),

    all in the rotor frame. The reference is shrunk to the flux that the voltage can hold at this speed; the error uses
    the reference of two samples ago, when the voltage now acting was decided; the integral sees the voltage realised.
    """
    psi_d, psi_q, _, _, _, _ = evaluate(controller.table, i_dq[0], i_dq[1], 0.0)
    ref_d, ref_q, _, _, _, _ = evaluate(controller.table, i_dq_reference[0], i_dq_reference[1], 0.0)
    reachable = 0.95 * controller.u_max - controller.resistance * math.hypot(i_dq_reference[0], i_dq_reference[1])
    shrink = min(1.0, max(reachable, 0.0) / (abs(speed) * math.hypot(ref_d, ref_q) + 1e-9))
    reference = state.flux_reference
    for k in range(2, 0, -1):
        reference[k, 0], reference[k, 1] = reference[k - 1, 0], reference[k - 1, 1]
    reference[0, 0], reference[0, 1] = shrink * ref_d, shrink * ref_q
    e_d, e_q = reference[2, 0] - psi_d, reference[2, 1] - psi_q
    a = controller.bandwidth
    u_d = a * e_d + (reference[0, 0] - reference[1, 0]) / period - speed * psi_q + controller.resistance * i_dq[0]
    u_q = a * e_q + (reference[0, 1] - reference[1, 1]) / period + speed * psi_d + controller.resistance * i_dq[1]
    u_d += state.integral[0]
    u_q += state.integral[1]
    limit = min(1.0, controller.u_max / (math.hypot(u_d, u_q) + 1e-9))
    gain = period * controller.integral_rate
    state.integral[0] += gain * (a * e_d + (limit - 1.0) * u_d)
    state.integral[1] += gain * (a * e_q + (limit - 1.0) * u_q)
    for k in range(HISTORY - 1, 0, -1):
        for j in range(3):
            state.commands[k, j] = state.commands[k - 1, j]
            state.compensations[k, j] = state.compensations[k - 1, j]
    middle = angle + 1.5 * period * speed
    for j in range(3):
        c, s = math.cos(middle - j * 2 * math.pi / 3), math.sin(middle - j * 2 * math.pi / 3)
        state.commands[0, j] = limit * (c * u_d - s * u_q)
        if controller.compensate:
            state.compensations[0, j] = phase_drop(drop, c * i_dq[0] - s * i_dq[1])


@compiled()
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    angle -= 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))
    return angle - 2 * math.pi if angle >= math.pi else angle
