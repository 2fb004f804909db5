"""The compiled heart of the simulated drive: flux splines, phase drop, controller and plant.

All kernels live in this one file because the cache of compiled code only notices changes of a kernel's own file.

The state of the plant is the stator flux linkage in the stator frame. There the voltage equation is

    d/dt psi_ab = u_ab - R i_ab - drop_ab(i_abc),        i_dq = f^-1(e^(-J theta) psi_ab, theta),

so neither the speed nor the rotor harmonics stand in what is integrated: they enter through the inverse of the flux
map, found by Newton's method to rounding. The balance of voltages and the map are thus exact, and the fourth-order
Runge-Kutta step only has to integrate the smooth, small R i + drop.
"""

from __future__ import annotations

import math

import numpy as np

from drive_id.bench.parameters import (
    HISTORY,
    Controller,
    DriveState,
    Noise,
    PhaseDrop,
    Plant,
    Sensors,
    Signals,
    SplineTable,
)
from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray

_FINEST = 1024
_SQRT3 = math.sqrt(3.0)


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
def drop_alpha_beta(drop: PhaseDrop, i_alpha: float, i_beta: float) -> tuple[float, float]:
    """Return the drop in the stator frame, V; its zero sequence drives no current."""
    a = phase_drop(drop, i_alpha)
    b = phase_drop(drop, -0.5 * i_alpha + 0.5 * _SQRT3 * i_beta)
    c = phase_drop(drop, -0.5 * i_alpha - 0.5 * _SQRT3 * i_beta)
    return (2 * a - b - c) / 3, (b - c) / _SQRT3


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
def _rate(
    plant: Plant, u: tuple[float, float], i_dq: tuple[float, float], c: float, s: float
) -> tuple[float, float, float, float]:
    """Return d/dt psi and the drop in the stator frame, V."""
    i_alpha, i_beta = c * i_dq[0] - s * i_dq[1], s * i_dq[0] + c * i_dq[1]
    d_alpha, d_beta = drop_alpha_beta(plant.drop, i_alpha, i_beta)
    return u[0] - plant.resistance * i_alpha - d_alpha, u[1] - plant.resistance * i_beta - d_beta, d_alpha, d_beta


@compiled()
def _current(
    plant: Plant, p: float, q: float, theta: float, guess: tuple[float, float], c: float, s: float
) -> tuple[tuple[float, float], bool]:
    """Return the current (d, q) that belongs to the stator-frame flux (p, q)."""
    i_d, i_q, good = current_of_flux(
        plant.table, c * p + s * q, c * q - s * p, theta, guess[0], guess[1], plant.current_tolerance
    )
    return (i_d, i_q), good


@compiled()
def step(
    plant: Plant,
    u: tuple[float, float],
    flux: tuple[float, float],
    i_dq: tuple[float, float],
    thetas: tuple[float, float, float],
    h: float,
) -> tuple[tuple[float, float], tuple[float, float], float, bool]:
    """Make one step of Runge-Kutta's rule of order 4 under the voltage ``u``; angles at its start, middle and end.

    Returns flux and current at the end, what the drop's curvature may have cost, Wb, and whether Newton converged.
    """
    p, q = flux
    c, s = math.cos(thetas[0]), math.sin(thetas[0])
    p1, q1, x1, y1 = _rate(plant, u, i_dq, c, s)
    c, s = math.cos(thetas[1]), math.sin(thetas[1])
    middle, good1 = _current(plant, p + 0.5 * h * p1, q + 0.5 * h * q1, thetas[1], i_dq, c, s)
    p2, q2, _, _ = _rate(plant, u, middle, c, s)
    middle, good2 = _current(plant, p + 0.5 * h * p2, q + 0.5 * h * q2, thetas[1], middle, c, s)
    p3, q3, x3, y3 = _rate(plant, u, middle, c, s)
    c, s = math.cos(thetas[2]), math.sin(thetas[2])
    guess = (2 * middle[0] - i_dq[0], 2 * middle[1] - i_dq[1])
    end, good3 = _current(plant, p + h * p3, q + h * q3, thetas[2], guess, c, s)
    p4, q4, x4, y4 = _rate(plant, u, end, c, s)
    p += h / 6 * (p1 + 2 * p2 + 2 * p3 + p4)
    q += h / 6 * (q1 + 2 * q2 + 2 * q3 + q4)
    end, good4 = _current(plant, p, q, thetas[2], end, c, s)
    estimate = h / 6 * (abs(x1 - 2 * x3 + x4) + abs(y1 - 2 * y3 + y4))
    return (p, q), end, estimate, good1 and good2 and good3 and good4


@compiled()
def hold(
    plant: Plant, state: DriveState, u: tuple[float, float], speeds: tuple[float, float], span: tuple[float, float]
) -> bool:
    """Integrate the plant over part of a sample period under a constant voltage.

    ``speeds`` are the mean electrical speeds at the period's ends, rad/s; ``span`` is the part of the period, s.
    The steps are halved, down to 1/1024, where the drop bends sharply, that is where a phase current crosses zero.
    """
    steps = max(1, math.ceil(plant.substeps * (span[1] - span[0]) / plant.period - 1e-9))
    tick = (span[1] - span[0]) / (steps * _FINEST)
    slope = (speeds[1] - speeds[0]) / plant.period
    mean = state.mean_angle[0]
    flux, i_dq = (state.flux[0], state.flux[1]), (state.current[0], state.current[1])
    now, size = 0, _FINEST
    while now < steps * _FINEST:
        start, middle, stop = span[0] + now * tick, span[0] + (now + 0.5 * size) * tick, span[0] + (now + size) * tick
        thetas = (
            with_ripple(plant, mean + start * (speeds[0] + 0.5 * slope * start)),
            with_ripple(plant, mean + middle * (speeds[0] + 0.5 * slope * middle)),
            with_ripple(plant, mean + stop * (speeds[0] + 0.5 * slope * stop)),
        )
        new_flux, new_current, estimate, good = step(plant, u, flux, i_dq, thetas, size * tick)
        if estimate > plant.flux_tolerance and size > 1:
            size //= 2
            continue
        if not good:
            return False
        flux, i_dq = new_flux, new_current
        now += size
        if estimate < plant.flux_tolerance / 16 and size < _FINEST and now % (2 * size) == 0:
            size *= 2
    state.flux[0], state.flux[1] = flux
    state.current[0], state.current[1] = i_dq
    return True


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
def _measure(
    plant: Plant, sensors: Sensors, state: DriveState, speed: float, noise: Noise, out: Signals, k: int
) -> None:
    theta = with_ripple(plant, state.mean_angle[0])
    for j in range(3):
        c, s = math.cos(theta - j * 2 * math.pi / 3), math.sin(theta - j * 2 * math.pi / 3)
        i = c * state.current[0] - s * state.current[1]
        i = sensors.current_gain[j] * i + sensors.current_offset[j] + noise.current[k, j]
        if sensors.current_quantum > 0.0:
            i = sensors.current_quantum * np.rint(i / sensors.current_quantum)
        out.i_abc[k, j] = i
    out.angle[k] = wrap(theta + sensors.angle_offset + noise.angle[k])
    out.speed[k] = speed * (1.0 + plant.ripple * math.cos(plant.ripple_order * state.mean_angle[0])) + noise.speed[k]
    out.i_dq_true[k, 0], out.i_dq_true[k, 1] = state.current[0], state.current[1]
    out.angle_true[k] = theta


@compiled()
def wrap(angle: float) -> float:
    """Return the angle in [-pi, pi)."""
    angle -= 2 * math.pi * math.floor((angle + math.pi) / (2 * math.pi))
    return angle - 2 * math.pi if angle >= math.pi else angle


@compiled()
def run(
    plant: Plant,
    controller: Controller,
    sensors: Sensors,
    state: DriveState,
    revolution: float,
    i_dq_reference: FloatArray,
    mean_speed: FloatArray,
    noise: Noise,
    out: Signals,
) -> int:
    """Run the drive over a block of N samples and carry ``state`` on.

    ``i_dq_reference`` is (N, 2), A; ``mean_speed`` (N + 1,) at the samples and at the end, rad/s; ``revolution`` the
    electrical angle of one mechanical revolution, rad. Returns the sample at which the map could not be inverted, or
    -1.
    """
    for k in range(len(i_dq_reference)):
        _measure(plant, sensors, state, mean_speed[k], noise, out, k)
        i_a, i_b, i_c = out.i_abc[k, 0], out.i_abc[k, 1], out.i_abc[k, 2]
        i_alpha, i_beta = (2 * i_a - i_b - i_c) / 3, (i_b - i_c) / _SQRT3
        c, s = math.cos(out.angle[k]), math.sin(out.angle[k])
        i_dq = (c * i_alpha + s * i_beta, c * i_beta - s * i_alpha)
        reference = (i_dq_reference[k, 0], i_dq_reference[k, 1])
        control(controller, plant.drop, state, i_dq, out.angle[k], out.speed[k], reference, plant.period)
        for j in range(3):
            out.u_abc[k, j] = state.commands[1 - sensors.log_lead, j]
        change = sensors.held_fraction * plant.period
        for row, start, stop in ((2, 0.0, change), (1, change, plant.period)):
            if stop > start:
                u_a = state.commands[row, 0] + state.compensations[row, 0]
                u_b = state.commands[row, 1] + state.compensations[row, 1]
                u_c = state.commands[row, 2] + state.compensations[row, 2]
                u = (2 * u_a - u_b - u_c) / 3, (u_b - u_c) / _SQRT3
                if not hold(plant, state, u, (mean_speed[k], mean_speed[k + 1]), (start, stop)):
                    return k
        angle = state.mean_angle[0] + 0.5 * plant.period * (mean_speed[k] + mean_speed[k + 1])
        state.mean_angle[0] = angle - revolution * math.floor(angle / revolution)
    return -1
