"""Kernels of the drive: plant, inverter and sensors with the effects of real drives, each of which may be absent.

The state of the plant is the stator flux linkage in the stator frame, so neither the speed nor the rotor harmonics
stand in what is integrated: they enter through the inverse of the flux map, found by Newton's method to rounding. The
balance of voltages and the map are thus exact, and the fourth-order Runge-Kutta step only has to integrate the smooth,
small R i + drop. With the induced voltage e, the current i_m that
magnetises the machine, the rotor position theta, the magnet temperature t and the mechanical angle theta_m,

    d/dt psi = e = u - R(t_copper) i - drop(i),                 i = i_m + G v + h v / sqrt(|v|^2 + s^2),
    d/dt v = (e - v) / tau_iron,
    e^(-J theta) psi = m(theta_m) ((1 - k) f(i_m, theta) + k l) + (offset(t_magnet), 0),
    d/dt l = (f(i_m, theta) - l) / tau_lag,                     m = 1 + sum_n a_n cos(n theta_m),

    J/p d/dt omega = 3/2 p psi x i_m - B omega/p - T_c sign(omega) - cogging(theta) - T_load     (free shaft only),

where i flows in the terminals and G v + h v/... is the iron current; v lags the induced voltage slightly, because the
field diffuses into the laminations. Temperatures and loss energies are updated after each step.

The cache of numba detects changes of a kernel's own file only: after a change in kernels.py, touch this file.
"""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np

from drive_id.bench.kernels import control, current_of_flux, phase_drop, with_ripple, wrap
from drive_id.bench.parameters import Controller, DriveState, Noise, PhaseDrop, Plant, Sensors, Signals
from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray

_FINEST = 1024  # parts of a step, where the drop bends
_STICTION = 0.1  # mechanical speed within which Coulomb friction changes its sign, rad/s
_SQRT3 = math.sqrt(3.0)
_REACH = (0.5, 0.5, 1.0)  # Runge-Kutta stages: fraction of the step from each rate to the next stage
_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # of the rates of the stages
_SIMPSON = (1 / 6, 0.0, 2 / 3, 0.0, 1 / 6)  # of the powers of stages and end
_BEND = (1.0, 0.0, -2.0, 1.0)  # of the drops of the stages: their curvature

Pair = tuple[float, float]
Six = tuple[float, float, float, float, float, float]


@compiled()
def _modulation(effects: np.record, theta: float) -> float:
    """Return the factor of the eccentric rotor on the flux."""
    factor = 1.0
    for n in range(effects.orders[0]):
        factor += effects.eccentricity[n] * math.cos((n + 1) * theta / effects.pole_pairs)
    return factor


@compiled()
def _map_flux(effects: np.record, offset: float, y: Six, theta: float) -> Pair:
    """Return the flux f of the map, rotor frame, that belongs to the state ``y``."""
    c, s = math.cos(theta), math.sin(theta)
    factor, k = _modulation(effects, theta), effects.flux_lag
    f_d = ((c * y[0] + s * y[1] - offset) / factor - k * y[4]) / (1.0 - k)
    f_q = ((c * y[1] - s * y[0]) / factor - k * y[5]) / (1.0 - k)
    return f_d, f_q


@compiled()
def terminal_current(effects: np.record, i_dq: Pair, v: Pair, theta: float) -> tuple[Pair, Pair]:
    """Return the current in the terminals and the iron current in it, stator frame."""
    c, s = math.cos(theta), math.sin(theta)
    g = effects.iron_conductance
    if effects.iron_hysteresis > 0.0:
        g += effects.iron_hysteresis / math.sqrt(v[0] ** 2 + v[1] ** 2 + effects.iron_hysteresis_voltage**2)
    iron = (g * v[0], g * v[1])
    return (c * i_dq[0] - s * i_dq[1] + iron[0], s * i_dq[0] + c * i_dq[1] + iron[1]), iron


@compiled()
def _drop(plant: Plant, effects: np.record, j: int, i: float) -> float:
    """Return the drop of phase ``j`` at its current, V."""
    drop = phase_drop(plant.drop, i)
    return float(effects.drop_factor[j] * (drop + effects.drop_asymmetry[j] * abs(drop)))


@compiled()
def _rates(
    plant: Plant, effects: np.record, resistance: float, u: Pair, y: Six, i_dq: Pair, f: Pair, theta: float
) -> tuple[Six, Pair, Pair, Six]:
    """Return d/dt y, the terminal current, the drop (stator frame), powers into terminals and losses, W; torque, Nm."""
    (i_alpha, i_beta), iron = terminal_current(effects, i_dq, (y[2], y[3]), theta)
    i_b, i_c = -0.5 * i_alpha + 0.5 * _SQRT3 * i_beta, -0.5 * i_alpha - 0.5 * _SQRT3 * i_beta
    factors = effects.resistance_factor
    r_a, r_b, r_c = resistance * factors[0] * i_alpha, resistance * factors[1] * i_b, resistance * factors[2] * i_c
    d_a, d_b, d_c = _drop(plant, effects, 0, i_alpha), _drop(plant, effects, 1, i_b), _drop(plant, effects, 2, i_c)
    drop = ((2 * d_a - d_b - d_c) / 3, (d_b - d_c) / _SQRT3)
    e_alpha = u[0] - (2 * r_a - r_b - r_c) / 3 - drop[0]
    e_beta = u[1] - (r_b - r_c) / _SQRT3 - drop[1]
    lag_d, lag_q, magnet = effects.lag_rate * (f[0] - y[4]), effects.lag_rate * (f[1] - y[5]), 0.0
    if effects.flux_lag > 0.0:  # the lagging flux belongs to another current; the difference flows in the magnets
        l_d, l_q, _ = current_of_flux(plant.table, y[4], y[5], theta, i_dq[0], i_dq[1], plant.current_tolerance)
        magnet = (i_dq[0] - l_d) * lag_d + (i_dq[1] - l_q) * lag_q
        magnet *= 1.5 * effects.flux_lag * _modulation(effects, theta)
    powers = (
        1.5 * (u[0] * i_alpha + u[1] * i_beta),
        r_a * i_alpha + r_b * i_b + r_c * i_c,
        d_a * i_alpha + d_b * i_b + d_c * i_c,
        1.5 * (e_alpha * iron[0] + e_beta * iron[1]),
        magnet,
        effects.torque_factor * (y[0] * (i_beta - iron[1]) - y[1] * (i_alpha - iron[0])),
    )
    rate = effects.iron_rate
    y_rate = (e_alpha, e_beta, rate * (e_alpha - y[2]), rate * (e_beta - y[3]), lag_d, lag_q)
    return y_rate, (i_alpha, i_beta), drop, powers


@compiled()
def _moved(y: Six, rate: Six, h: float) -> Six:
    return (
        y[0] + h * rate[0],
        y[1] + h * rate[1],
        y[2] + h * rate[2],
        y[3] + h * rate[3],
        y[4] + h * rate[4],
        y[5] + h * rate[5],
    )


@compiled()
def _filtered(pole: complex, z: complex, i: tuple[float, float, float], h: float) -> complex:
    """Return z after dz/dt = pole z + i, exactly for a parabola through the currents at start, middle and end."""
    slope = (-3 * i[0] + 4 * i[1] - i[2]) / h
    bend = 2 * (i[0] - 2 * i[1] + i[2]) / h**2
    c = -bend / pole
    b = (2 * c - slope) / pole
    a = (b - i[0]) / pole
    return a + b * h + c * h**2 + (z - a) * cmath.exp(pole * h)


@compiled()
def _step(
    plant: Plant,
    effects: np.record,
    warm: Pair,
    u: Pair,
    y: Six,
    i_dq: Pair,
    thetas: tuple[float, float, float],
    h: float,
) -> tuple[Six, Pair, tuple[Pair, Pair, Pair], Six, float, bool]:
    """Make one step of the Runge-Kutta method of order 4; ``warm`` is resistance and flux offset at their temperatures.

    Returns y and the machine's current at the end; the terminal current at start, middle and end; the energies and
    the angular impulse of the step by Simpson's rule; the error estimated from the curvature of the drop, Wb; and
    whether Newton converged. The stages are a loop, of which the fifth is the end of the step: unrolled, the kernel
    takes longer to compile.
    """
    resistance, offset = warm
    at, new_y, i, first, theta = y, y, i_dq, i_dq, thetas[0]
    f = _map_flux(effects, offset, y, theta)
    i_start = i_middle = i_stop = (0.0, 0.0)
    energy = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bend_alpha = bend_beta = 0.0
    good = True
    for stage in range(5):
        rate, current, drop, power = _rates(plant, effects, resistance, u, at, i, f, theta)
        energy = _moved(energy, power, _SIMPSON[stage] * h)
        if stage % 2 == 0:
            i_start, i_middle, i_stop = i_middle, i_stop, current
        if stage == 4:
            break
        bend_alpha += _BEND[stage] * drop[0]
        bend_beta += _BEND[stage] * drop[1]
        new_y = _moved(new_y, rate, _WEIGHTS[stage] * h)
        at = new_y if stage == 3 else _moved(y, rate, _REACH[stage] * h)
        theta = thetas[1] if stage < 2 else thetas[2]
        f = _map_flux(effects, offset, at, theta)
        guess = (2 * i[0] - first[0], 2 * i[1] - first[1]) if stage == 2 else i
        i_d, i_q, found = current_of_flux(plant.table, f[0], f[1], theta, guess[0], guess[1], plant.current_tolerance)
        i, good = (i_d, i_q), good and found
    return new_y, i, (i_start, i_middle, i_stop), energy, h / 6 * (abs(bend_alpha) + abs(bend_beta)), good


@compiled()
def _warm(plant: Plant, effects: np.record, more: np.record) -> Pair:
    """Return the resistance, ohm, and the offset of psi_d, Wb, at the present temperatures."""
    copper, magnet = more.temperature[0] - REFERENCE_TEMPERATURE, more.temperature[1] - REFERENCE_TEMPERATURE
    resistance = plant.resistance * (1.0 + effects.thermal_coefficient[0] * copper)
    return resistance, effects.magnet_flux * effects.thermal_coefficient[1] * magnet


@compiled()
def _angle_at(plant: Plant, more: np.record, time: float) -> float:
    """Return the electrical angle at ``time``, s since the sample."""
    h = time - more.motion[0]
    return with_ripple(plant, more.motion[1] + h * (more.motion[2] + 0.5 * more.motion[3] * h))


@compiled()
def _resistance(effects: np.record, angle: float, speed: float) -> float:
    """Return the torque against the free shaft, Nm; Coulomb friction changes its sign within ``_STICTION`` of rest."""
    torque = effects.load_torque + effects.friction[0] * speed
    torque += effects.friction[1] * math.tanh(speed / (_STICTION * effects.pole_pairs))
    return float(torque + effects.cogging[0] * math.sin(effects.cogging[1] * angle))


@compiled()
def _accelerate(effects: np.record, more: np.record, impulse: float, torque: float, time: float) -> None:
    """Move the free shaft to ``time``, s since the sample, by the angular impulse, Nms, since the last step.

    Velocity Verlet, with the torque of the machine by Simpson's rule; ``torque`` is that at the end, Nm.
    """
    motion = more.motion
    h = time - motion[0]
    angle = motion[1] + h * (motion[2] + 0.5 * motion[3] * h)
    before = _resistance(effects, motion[1], motion[2])
    speed = motion[2] + effects.rotor_rate * (impulse - before * h)
    after = _resistance(effects, angle, speed)
    speed -= 0.5 * h * effects.rotor_rate * (after - before)
    motion[0], motion[1], motion[2] = time, angle, speed
    motion[3] = effects.rotor_rate * (torque - _resistance(effects, angle, speed))


@compiled()
def integrate(plant: Plant, effects: np.record, state: DriveState, more: np.record, u: Pair, span: Pair) -> bool:
    """Integrate the plant over a span of a sample period, s, under a constant stator voltage, V.

    The steps are halved, down to 1/1024, where the drop bends sharply, that is where a phase current crosses zero. The
    rotor moves as ``more.motion`` says, which a free shaft updates after each step. Returns False where Newton fails.
    """
    steps = max(1, math.ceil((span[1] - span[0]) / effects.largest_step - 1e-9))
    tick = (span[1] - span[0]) / (steps * _FINEST)
    warm = _warm(plant, effects, more)
    y = (state.flux[0], state.flux[1], more.iron_voltage[0], more.iron_voltage[1], more.lagged[0], more.lagged[1])
    i_dq, energy = (state.current[0], state.current[1]), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    theta = _angle_at(plant, more, span[0])
    now, size = 0, _FINEST
    while now < steps * _FINEST:
        middle, stop = span[0] + (now + 0.5 * size) * tick, span[0] + (now + size) * tick
        thetas = (theta, _angle_at(plant, more, middle), _angle_at(plant, more, stop))
        h = size * tick
        new_y, new_i, i, spent, estimate, good = _step(plant, effects, warm, u, y, i_dq, thetas, h)
        if estimate > plant.flux_tolerance and size > 1:
            size //= 2
            continue
        if not good:
            return False
        y, i_dq, theta, energy = new_y, new_i, thetas[2], _moved(energy, spent, 1.0)
        if effects.free_shaft:
            c, s = math.cos(theta), math.sin(theta)
            psi_d, psi_q = c * y[0] + s * y[1], c * y[1] - s * y[0]
            _accelerate(effects, more, spent[5], effects.torque_factor * (psi_d * i_dq[1] - psi_q * i_dq[0]), stop)
        if effects.filter_pole != 0.0:
            for j in range(2):
                more.filter[j] = _filtered(effects.filter_pole, more.filter[j], (i[0][j], i[1][j], i[2][j]), h)
        now += size
        if estimate < plant.flux_tolerance / 16 and size < _FINEST and now % (2 * size) == 0:
            size *= 2
    state.flux[0], state.flux[1] = y[0], y[1]
    more.iron_voltage[0], more.iron_voltage[1] = y[2], y[3]
    more.lagged[0], more.lagged[1] = y[4], y[5]
    state.current[0], state.current[1] = i_dq
    _heat(effects, more, energy, span[1] - span[0])
    return True


@compiled()
def _heat(effects: np.record, more: np.record, energy: Six, time: float) -> None:
    """Add up the losses and update the temperatures of copper and magnets."""
    for k in range(5):
        more.energy[k] += energy[k]
    for k, heat in ((0, energy[1]), (1, energy[1] + energy[3] + energy[4])):
        if effects.heat_rate[k] > 0.0:
            cooled = effects.cooling_rate[k] * (more.temperature[k] - effects.ambient_temperature) * time
            more.temperature[k] += effects.heat_rate[k] * heat - cooled


@compiled()
def _angle_error(effects: np.record, theta: float) -> float:
    """Return the resolver's error at the electrical angle ``theta``, rad."""
    error = 0.0
    for n in range(effects.orders[1]):
        amplitude, phase = effects.resolver_electrical[n, 0], effects.resolver_electrical[n, 1]
        error += amplitude * math.cos((n + 1) * theta - phase)
    for n in range(effects.orders[2]):
        amplitude, phase = effects.resolver_mechanical[n, 0], effects.resolver_mechanical[n, 1]
        error += amplitude * math.cos((n + 1) * theta / effects.pole_pairs - phase)
    return float(error)


@compiled()
def _observe(effects: np.record, more: np.record, angle: float, period: float) -> float:
    """Return the speed of a critically damped tracking observer of the angle, rad/s."""
    rate, observer = effects.observer_rate, more.observer
    error = wrap(angle - observer[0])
    observer[1] += period * rate**2 * error
    observer[0] = wrap(observer[0] + period * (observer[1] + 2 * rate * error))
    return float(observer[1])


@compiled()
def _measure(
    plant: Plant,
    effects: np.record,
    sensors: Sensors,
    state: DriveState,
    more: np.record,
    speed: float,
    noise: Noise,
    out: Signals,
    k: int,
) -> None:
    for j in range(3):
        i = more.sampled[j]
        i += effects.cubic * i**3
        i = math.copysign(max(abs(i) - effects.current_dead_band, 0.0), i)
        i = sensors.current_gain[j] * i + sensors.current_offset[j] + noise.current[k, j]
        if sensors.current_quantum > 0.0:
            i = sensors.current_quantum * np.rint(i / sensors.current_quantum)
        out.i_abc[k, j] = i
    if sensors.two:
        out.i_abc[k, 2] = -out.i_abc[k, 0] - out.i_abc[k, 1]
    mean, late = state.mean_angle[0], effects.resolver_latency
    theta = with_ripple(plant, mean)
    seen = with_ripple(plant, mean - late * (speed - 0.5 * more.motion[3] * late))
    angle = effects.angle_scale * (seen + _angle_error(effects, seen)) + sensors.angle_offset + noise.angle[k]
    if effects.resolver_quantization > 0.0:
        angle = effects.resolver_quantization * np.rint(angle / effects.resolver_quantization)
    out.angle[k] = wrap(angle)
    out.speed[k] = effects.angle_scale * speed * (1.0 + plant.ripple * math.cos(plant.ripple_order * mean))
    if effects.observer_rate > 0.0:
        out.speed[k] = _observe(effects, more, out.angle[k], plant.period)
    out.speed[k] += noise.speed[k]
    (i_alpha, i_beta), _ = terminal_current(
        effects, (state.current[0], state.current[1]), (more.iron_voltage[0], more.iron_voltage[1]), theta
    )
    c, s = math.cos(theta), math.sin(theta)
    out.i_dq_true[k, 0], out.i_dq_true[k, 1] = c * i_alpha + s * i_beta, c * i_beta - s * i_alpha
    out.angle_true[k] = theta


@compiled()
def _note(state: DriveState, more: np.record, theta: float, u_dc: float, row: np.record) -> None:
    """Fill the row of the course."""
    c, s = math.cos(theta), math.sin(theta)
    row.psi_dq[0], row.psi_dq[1] = c * state.flux[0] + s * state.flux[1], c * state.flux[1] - s * state.flux[0]
    for j in range(2):
        row.i_dq_machine[j] = state.current[j]
        row.lagged[j] = more.lagged[j]
        row.temperature[j] = more.temperature[j]
    for j in range(5):
        row.energy[j] = more.energy[j]
    row.u_dc = u_dc


@compiled()
def _on_phase(pair: Pair, j: int) -> float:
    """Return the part of a vector in the stator frame on phase ``j``."""
    turn = j * 2 * math.pi / 3
    return math.cos(turn) * pair[0] + math.sin(turn) * pair[1]


@compiled()
def _sensed(effects: np.record, more: np.record, i: Pair) -> Pair:
    """Return the output of the current sensors' filter, stator frame."""
    if effects.filter_pole == 0.0:
        return i
    return (effects.filter_gain * more.filter[0]).real, (effects.filter_gain * more.filter[1]).real


@compiled()
def _predicted(
    plant: Plant, effects: np.record, state: DriveState, more: np.record, u: Pair, theta: float, turn: float
) -> Pair:
    """Return the terminal current one dead time later, by one explicit step, stator frame, A."""
    resistance, offset = _warm(plant, effects, more)
    y = (state.flux[0], state.flux[1], more.iron_voltage[0], more.iron_voltage[1], more.lagged[0], more.lagged[1])
    i = (state.current[0], state.current[1])
    rate, _, _, _ = _rates(plant, effects, resistance, u, y, i, _map_flux(effects, offset, y, theta), theta)
    y = _moved(y, rate, effects.dead_time)
    f = _map_flux(effects, offset, y, theta + turn)
    i_d, i_q, _ = current_of_flux(plant.table, f[0], f[1], theta + turn, i[0], i[1], plant.current_tolerance)
    terminals, _ = terminal_current(effects, (i_d, i_q), (y[2], y[3]), theta + turn)
    return terminals


@compiled()
def edge_delay(effects: np.record, u_dc: float, i: float, i_stays: float, i_moves: float) -> float:
    """Return the delay of a falling edge of a leg after its command, s, as an ideal edge of equal volt-seconds.

    A positive current discharges the output within the dead time t_d by u = i t / C, at once without capacitance; a
    negative one keeps it high through the diode until the other switch turns on. With clamping, a current that reaches
    zero stays there until the end of the dead time, which fixes the mean voltage. ``i_stays`` and ``i_moves`` are the
    currents at that end if the leg stayed high, or fell at once. A rising edge is a falling edge with negated currents.
    """
    if not effects.current_clamping:
        i, i_stays, i_moves = max(i, 0.0), 1.0, 0.0
    elif i <= 0.0:  # the mean over the part that becomes positive
        i = 0.5 * i_stays**2 / (i_stays - i) if i_stays > 0.0 else 0.0
    x = i * effects.dead_time / max(effects.output_capacitance * u_dc, 1e-30)
    charged = 1.0 - 0.5 * x if x < 1.0 else 0.5 / x
    clamped = min(max(-i_moves / max(i_stays - i_moves, 1e-30), 0.0), 1.0)
    return float(effects.dead_time * max(charged, clamped))


@compiled()
def _set_marks(effects: np.record, sensors: Sensors, legs: FloatArray, period: float, marks: FloatArray) -> None:
    """Set the times in the period at which something changes, s.

    ``marks`` (16,): sampling of the three phases; change of the command; commanded rising edges and falling edges of
    the legs; their actual rising and falling edges, known once the commanded edges occur.
    """
    marks[:] = math.inf
    for j in range(3):
        marks[j] = period - effects.current_skew[j]
    marks[3] = sensors.held_fraction * period
    if effects.switching:
        for j in range(3):
            duty = 0.5 + legs[j] / effects.u_dc
            if duty >= 1.0:
                marks[10 + j] = -1.0
            elif duty > 0.0:
                marks[4 + j], marks[7 + j] = 0.5 * period * (1.0 - duty), 0.5 * period * (1.0 + duty)


@compiled()
def _command(effects: np.record, state: DriveState, row: int, legs: FloatArray) -> None:
    """Fill ``legs`` with the voltages commanded to the legs, V: with min-max injection if legs are limited."""
    for j in range(3):
        legs[j] = state.commands[row, j] + state.compensations[row, j]
    if effects.switching or effects.hexagon_limit:
        middle = 0.5 * (max(legs[0], legs[1], legs[2]) + min(legs[0], legs[1], legs[2]))
        for j in range(3):
            legs[j] = min(max(legs[j] - middle, -0.5 * effects.u_dc), 0.5 * effects.u_dc)


@compiled()
def _switch(
    plant: Plant,
    effects: np.record,
    state: DriveState,
    more: np.record,
    marks: FloatArray,
    legs: FloatArray,
    now: float,
    theta: float,
    turn: float,
    j: int,
    u_dc: float,
) -> None:
    """Set the actual edge of leg ``j`` at its commanded edge; ``turn`` is the angle turned in a dead time, rad."""
    for e in range(2):
        if marks[4 + 3 * e + j] != now:
            continue
        v = (more.iron_voltage[0], more.iron_voltage[1])
        i, _ = terminal_current(effects, (state.current[0], state.current[1]), v, theta)
        kept, high, low = legs[j], 0.0, 0.0
        for level in (0.5, -0.5):
            legs[j] = level * effects.u_dc
            later = _predicted(plant, effects, state, more, _vector(legs, u_dc / effects.u_dc), theta, turn)
            high, low = low, _on_phase(later, j)
        legs[j] = kept
        if e == 0:
            delay = edge_delay(effects, u_dc, -_on_phase(i, j), -low, -high)
        else:
            delay = edge_delay(effects, u_dc, _on_phase(i, j), high, low)
        marks[10 + 3 * e + j] = now + delay


@compiled()
def _vector(legs: FloatArray, scale: float) -> Pair:
    """Return the voltage of the legs in the stator frame, V."""
    return scale * (2 * legs[0] - legs[1] - legs[2]) / 3, scale * (legs[1] - legs[2]) / _SQRT3


@compiled()
def _period(
    plant: Plant, effects: np.record, sensors: Sensors, state: DriveState, more: np.record, u_dc: float
) -> bool:
    """Integrate the plant over one sample period from mark to mark, and sample the phase currents of the next one."""
    period = plant.period
    legs, marks = np.empty(3), np.empty(16)
    _command(effects, state, 1 if sensors.held_fraction == 0.0 else 2, legs)
    _set_marks(effects, sensors, legs, period, marks)
    now = 0.0
    while now < period:
        stop = period
        for mark in marks:
            if now < mark < stop:
                stop = mark
        if effects.switching:
            for j in range(3):
                legs[j] = 0.5 * effects.u_dc if marks[10 + j] <= now < marks[13 + j] else -0.5 * effects.u_dc
        if not integrate(plant, effects, state, more, _vector(legs, u_dc / effects.u_dc), (now, stop)):
            return False
        theta = _angle_at(plant, more, stop)
        turn = effects.dead_time * more.motion[2]
        for j in range(3):
            if marks[j] == stop:
                v = (more.iron_voltage[0], more.iron_voltage[1])
                i, _ = terminal_current(effects, (state.current[0], state.current[1]), v, theta)
                more.sampled[j] = _on_phase(_sensed(effects, more, i), j)
            if effects.switching:
                _switch(plant, effects, state, more, marks, legs, stop, theta, turn, j, u_dc)
        if marks[3] == stop:
            _command(effects, state, 1, legs)
        now = stop
    return True


@compiled()
def run(
    plant: Plant,
    effects: np.record,
    controller: Controller,
    mean_drop: PhaseDrop,
    sensors: Sensors,
    state: DriveState,
    more: np.record,
    revolution: float,
    first: int,
    i_dq_reference: FloatArray,
    mean_speed: FloatArray,
    noise: Noise,
    out: Signals,
    course: np.recarray[Any, np.dtype[np.record]],
) -> int:
    """Run the drive over a block of N samples, of which the first is sample ``first``, and update its state.

    ``i_dq_reference`` is (N, 2), A; ``mean_speed`` (N + 1,) at the samples and at the end, rad/s; ``revolution`` the
    electrical angle of one mechanical revolution, rad; ``course`` (N,) of dtype COURSE. Returns the sample at which the
    map could not be inverted, or -1.
    """
    period = plant.period
    for k in range(len(i_dq_reference)):
        speed = more.motion[2] if effects.free_shaft else mean_speed[k]
        _measure(plant, effects, sensors, state, more, speed, noise, out, k)
        i_a, i_b, i_c = out.i_abc[k, 0], out.i_abc[k, 1], out.i_abc[k, 2]
        i_alpha, i_beta = (2 * i_a - i_b - i_c) / 3, (i_b - i_c) / _SQRT3
        c, s = math.cos(out.angle[k]), math.sin(out.angle[k])
        i_dq = (c * i_alpha + s * i_beta, c * i_beta - s * i_alpha)
        reference = (i_dq_reference[k, 0], i_dq_reference[k, 1])
        if effects.stator_frame:
            control(controller, mean_drop, state, (i_alpha, i_beta), 0.0, 0.0, reference, period)
        else:
            control(controller, mean_drop, state, i_dq, out.angle[k], out.speed[k], reference, period)
        for j in range(3):
            out.u_abc[k, j] = state.commands[1 - sensors.log_lead, j]
        u_dc = effects.u_dc
        for n in range(2):
            amplitude, frequency = effects.u_dc_waves[n, 0], effects.u_dc_waves[n, 1]
            u_dc += amplitude * effects.u_dc * math.sin(2 * math.pi * frequency * (first + k + 0.5) * period)
        _note(state, more, out.angle_true[k], u_dc, course[k])
        more.motion[0], more.motion[1], more.motion[2] = 0.0, state.mean_angle[0], speed
        if not effects.free_shaft:
            more.motion[3] = (mean_speed[k + 1] - mean_speed[k]) / period
        if not _period(plant, effects, sensors, state, more, u_dc):
            return k
        if effects.free_shaft:
            angle = more.motion[1]
        else:
            angle = state.mean_angle[0] + 0.5 * period * (mean_speed[k] + mean_speed[k + 1])
        state.mean_angle[0] = angle - revolution * math.floor(angle / revolution)
    return -1
