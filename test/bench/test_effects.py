"""The effects of real drives: each against an independent calculation, and all inside the balance of energy."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from bench_runs import IPM, PHASES, T, lissajous, run
from machine_kinds import co_energy
from scipy.integrate import solve_ivp

from drive_id.bench import real_drive
from drive_id.bench.bench import SimulatedBench
from drive_id.bench.drive import Drive, Simulation, build_machine, simulate
from drive_id.bench.effect_settings import EFFECT_NAMES
from drive_id.bench.effects import effects_of
from drive_id.bench.machines import MACHINES, CoEnergyMachine, machine_map
from drive_id.bench.settings import BenchSettings, SimulationSettings
from drive_id.cli.options import merged_settings
from drive_id.core.frames import wrapped
from drive_id.errors import ConfigurationError, DataError
from drive_id.types import MachineMap

CLARKE = 2 / 3 * np.exp(1j * PHASES)
POLE_PAIRS = 4


def hold(i_d: float, i_q: float, count: int, source: MachineMap = IPM, **settings: object) -> Simulation:
    return simulate(source, SimulationSettings(**settings), np.tile((i_d, i_q), (count, 1)))  # type: ignore[arg-type]


def stator(simulation: Simulation) -> np.ndarray:
    """Return the true terminal currents as complex numbers in the stator frame."""
    return (simulation.i_dq_true @ (1, 1j)) * np.exp(1j * simulation.angle_true)


# --- the plant


def test_an_effect_without_strength_leaves_the_plain_drive():
    plain, same = run(inverter="two_stage"), run(inverter="two_stage", resolver_latency=1e-15)
    assert plain.course is None
    assert same.course is not None
    for name in ("i_abc", "u_abc", "speed"):
        np.testing.assert_allclose(getattr(same.samples, name), getattr(plain.samples, name), atol=1e-6)
    np.testing.assert_allclose(wrapped(same.samples.angle - plain.samples.angle), 0.0, atol=1e-9)


def test_block_by_block_equals_the_whole_bit_for_bit():
    settings = SimulationSettings(
        speeds=(500.0, -300.0), segment_durations=(0.1, 0.1), iron_conductance=0.3, flux_lag=0.03, current_filter=3e3,
        copper_heat_capacity=50.0, resolver_latency=3e-5, u_dc_drift=0.01, log_decimation=3, voltage_delay=-1.4,
        current_noise=1e-3, resolver_noise=1e-3, speed_noise=0.5,
    )  # fmt: skip
    machine = build_machine(IPM, settings)
    i_ref = lissajous(machine.i_max, 1500)
    whole = Drive(machine, settings).step_block(i_ref)
    drive = Drive(machine, settings)
    blocks = [drive.step_block(i_ref[a:b]) for a, b in ((0, 1), (1, 700), (700, 731), (731, 1500))]
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed", "i_dq_reference"):
        pieces = np.concatenate([getattr(block.samples, name) for block in blocks])
        np.testing.assert_array_equal(pieces, getattr(whole.samples, name))


def slopes(machine: CoEnergyMachine, i: np.ndarray, theta: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return f, df/di and df/dtheta of the analytic machine by central differences."""

    def flux(d: float, q: float, at: float) -> np.ndarray:
        return np.array(machine.flux(np.asarray(d), np.asarray(q), np.asarray(at)))

    d, q = i
    by_d = (flux(d + 0.05, q, theta) - flux(d - 0.05, q, theta)) / 0.1
    by_q = (flux(d, q + 0.05, theta) - flux(d, q - 0.05, theta)) / 0.1
    by_theta = (flux(d, q, theta + 1e-4) - flux(d, q, theta - 1e-4)) / 2e-4
    return flux(d, q, theta), np.stack((by_d, by_q), axis=-1), by_theta


@pytest.mark.cases
@pytest.mark.parametrize("rpm", [1000.0, -400.0])
def test_the_machine_matches_a_high_order_integrator_in_rotor_coordinates(rpm):
    """Iron loss with hysteresis, lagging flux, eccentricity, unequal phases, warm copper and magnets at once."""
    settings = SimulationSettings(
        speeds=(rpm,), inverter="tanh", inverter_voltage=4.0, inverter_current=30.0, iron_conductance=0.4,
        iron_hysteresis=3.0, iron_hysteresis_voltage=2.0, iron_time_constant=8e-5, flux_lag=0.05, flux_lag_time=6e-4,
        eccentricity=(0.02, -0.01), resistance_factor=(1.1, 1.0, 0.8), copper_temperature=70.0,
        magnet_temperature=60.0, magnet_coefficient=2e-3,
    )  # fmt: skip
    analytic, machine = MACHINES["ipm"], build_machine(IPM, settings)
    i_ref = lissajous(machine.i_max, 60) + np.array((-40.0, 60.0))
    drive = Drive(machine, settings, i_dq_start=tuple(i_ref[0]))
    first_v = drive._more.iron_voltage.copy()
    block = drive.step_block(i_ref)
    omega = rpm * np.pi / 30 * POLE_PAIRS
    resistances = machine.resistance * (1 + 3.93e-3 * 50) * np.array(settings.resistance_factor)
    offset = -2e-3 * 40 * machine.mean_flux(0, 0)[0]

    def rate(t, y, u, start):
        theta = start + omega * t
        turn = np.exp(-1j * theta)
        f, by_i, by_theta = slopes(analytic, y[:2], theta)
        a, b = settings.eccentricity
        m = 1 + a * np.cos(theta / POLE_PAIRS) + b * np.cos(2 * theta / POLE_PAIRS)
        by_angle = -(a * np.sin(theta / POLE_PAIRS) + 2 * b * np.sin(2 * theta / POLE_PAIRS)) / POLE_PAIRS
        l_rate = (f - y[4:]) / 6e-4
        v = y[2] + 1j * y[3]
        i_iron = 0.4 * v + 3.0 * v / np.hypot(abs(v), 2.0)
        phase = np.real(((y[0] + 1j * y[1]) / turn + i_iron) * np.exp(-1j * PHASES))
        e = CLARKE @ (u - resistances * phase - 4.0 * np.tanh(phase / 30.0))
        mixed = 0.95 * f + 0.05 * y[4:]
        psi = m * mixed + (offset, 0)
        known = m * (0.95 * by_theta * omega + 0.05 * l_rate) + by_angle * omega * mixed
        known += omega * np.array((-psi[1], psi[0]))
        e_dq = np.array(((e * turn).real, (e * turn).imag))
        v_rate = (e - v) / 8e-5
        i_rate = np.linalg.solve(0.95 * m * by_i, e_dq - known)
        return np.concatenate((i_rate, (v_rate.real, v_rate.imag), l_rate))

    y = np.concatenate((block.course.i_dq_machine[0], first_v, block.course.lagged[0]))
    for k in range(len(i_ref) - 1):
        theta = block.angle_true[k]
        arguments = (block.samples.u_abc[k], theta)
        y = solve_ivp(rate, (0, T), y, "DOP853", args=arguments, rtol=1e-10, atol=1e-10).y[:, -1]
        np.testing.assert_allclose(block.course.i_dq_machine[k + 1], y[:2], rtol=0, atol=1e-4 * machine.i_max)
        np.testing.assert_allclose(block.course.lagged[k + 1], y[4:], rtol=0, atol=3e-6)
    v = y[2] + 1j * y[3]
    total = y[0] + 1j * y[1] + (0.4 * v + 3.0 * v / np.hypot(abs(v), 2.0)) * np.exp(-1j * block.angle_true[-1])
    assert block.i_dq_true[-1] @ (1, 1j) == pytest.approx(total, abs=0.03)


def current_of(machine: CoEnergyMachine, psi: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Invert the analytic map by Newton's method with differences."""
    i = np.zeros_like(psi)
    for _ in range(40):
        f = np.stack(machine.flux(i[:, 0], i[:, 1], theta), axis=-1)
        columns = [np.stack(machine.flux(i[:, 0] + d, i[:, 1] + q, theta), -1) - f for d, q in ((1e-4, 0), (0, 1e-4))]
        i = i + np.linalg.solve(np.stack(columns, -1) / 1e-4, (psi - f)[..., None])[..., 0]
    return i


COMBINATIONS = {
    "plain": {"resolver_latency": 1e-15},
    "iron": {"iron_conductance": 0.5, "iron_hysteresis": 4.0},
    "lag": {"flux_lag": 0.1, "flux_lag_time": 5e-4},
    "eccentric": {"eccentricity": (0.03, 0.02)},
    "heating": {"copper_heat_capacity": 10.0, "magnet_heat_capacity": 50.0, "magnet_coefficient": 5e-3},
    "sensors": {"current_filter": 2000.0, "resolver_latency": 5e-5, "resolver_mechanical_errors": (0.01,)},
    "all": {
        "iron_conductance": 0.3, "iron_hysteresis": 2.0, "flux_lag": 0.05, "eccentricity": (0.02,),
        "copper_heat_capacity": 20.0, "magnet_heat_capacity": 100.0, "magnet_coefficient": 5e-3,
        "resistance_factor": (1.2, 1.0, 0.9), "u_dc_ripple": 0.02, "u_dc_drift": 0.01, "current_filter": 3000.0,
        "current_skew": (0.0, 1e-5, 2e-5), "drop_asymmetry": (0.2, -0.1, 0.0), "drop_factor": (1.0, 0.9, 1.3),
    },
    "all, switching": {
        "inverter": "switching", "dead_time": 2e-6, "output_capacitance": 2e-9, "device_voltage": 2.0,
        "iron_conductance": 0.2, "flux_lag": 0.05, "copper_heat_capacity": 20.0, "u_dc_ripple": 0.02,
        "eccentricity": (0.02,),
    },
}  # fmt: skip


@pytest.fixture
def instants(monkeypatch):
    """Return a list to which every simulation adds time, angle, state and effects' state, several in each period."""
    rows: list[np.ndarray] = []
    integrate, parts, begin = real_drive.integrate, 3, [-1.0]

    def observed(plant, effects, state, more, u, span):
        if span[0] == 0.0:
            begin[0] += 1
        edges = np.linspace(*span, parts + 1)
        for start, stop in pairwise(edges):
            if not integrate(plant, effects, state, more, u, (start, stop)):
                return False
            angle = state.mean_angle[0] + stop * more.motion[2]  # at constant speed
            time = begin[0] * plant.period + stop
            rows.append(
                np.concatenate(([time, angle], state.flux, state.current, more.lagged, more.temperature, more.energy))
            )
        return True

    monkeypatch.setattr(real_drive, "integrate", observed)
    monkeypatch.setattr(real_drive, "_period", real_drive._period.function)
    monkeypatch.setattr("drive_id.bench.drive.run", real_drive.run.function)
    return rows


@pytest.mark.slow  # the switching level is integrated
@pytest.mark.parametrize("name", COMBINATIONS)
def test_energy_is_conserved(name, instants):
    """Input = copper + iron + inverter + magnets + torque x speed + change of the stored energy.

    Torque and stored energy come from the analytic co-energy W: T = 3/2 p (psi x i + dW/dtheta), E = i psi - W.
    """
    chosen = SimulationSettings(**{"speeds": (1000.0,), "inverter": "two_stage", **COMBINATIONS[name]})
    machine = MACHINES["ipm"]
    drive = Drive(build_machine(IPM, chosen), chosen, i_dq_start=(0.0, 50.0))
    instants.clear()
    drive.step_block(lissajous(300.0, 700)[200:])
    time, theta, flux_a, flux_b, i_d, i_q, lag_d, lag_q, _, magnet, *energy = np.array(instants).T
    psi = (flux_a + 1j * flux_b) * np.exp(-1j * theta)
    omega, k = 1000 * np.pi / 30 * POLE_PAIRS, chosen.flux_lag
    orders = np.arange(1, len(chosen.eccentricity) + 1) / POLE_PAIRS
    m = 1 + np.cos(theta[:, None] * orders) @ np.array(chosen.eccentricity)
    by_angle = -np.sin(theta[:, None] * orders) @ (orders * chosen.eccentricity)

    def energies(d, q):
        """Return W, dW/dtheta and E."""
        by_theta = (co_energy(machine, d, q, theta + 1e-5) - co_energy(machine, d, q, theta - 1e-5)) / 2e-5
        psi_d, psi_q = machine.flux(d, q, theta)
        w = co_energy(machine, d, q, theta)
        return w, by_theta, d * psi_d + q * psi_q - w

    w, by_theta, stored = energies(i_d, i_q)
    torque = psi.real * i_q - psi.imag * i_d + (1 - k) * (m * by_theta + by_angle * w)
    total = m * (1 - k) * stored
    if k > 0:
        _, by_theta, stored = energies(*current_of(machine, np.stack((lag_d, lag_q), -1), theta).T)
        torque += k * (m * by_theta + by_angle * (i_d * lag_d + i_q * lag_q - stored))
        total += m * k * stored
    mechanical = 1.5 * omega * np.trapezoid(torque, time)
    offset = -chosen.magnet_coefficient * (magnet - 20) * drive.truth().details["magnet_flux"]
    magnet_work = 1.5 * np.sum(0.5 * (i_d[1:] + i_d[:-1]) * np.diff(offset))
    into, *lost = (course[-1] - course[0] for course in energy)
    assert into > 100
    assert sum(lost) + mechanical + 1.5 * (total[-1] - total[0]) + magnet_work == pytest.approx(into, rel=3e-4)
    for power, strength in zip(lost[2:], (chosen.iron_conductance, chosen.flux_lag), strict=True):
        assert (power > 0.02) == (strength > 0)


def test_the_terminals_take_what_the_log_says():
    """The energy into the terminals is the integral of u i, by the trapezoidal rule on the samples."""
    simulation = run(4001, speeds=(200.0,), iron_conductance=0.5, harmonics=0.0, inverter="none")
    i = stator(simulation)
    u = simulation.samples.u_abc[:-1] @ CLARKE
    expected = 1.5 * T * np.sum(np.real(u * np.conj(i[1:] + i[:-1]) / 2))
    assert simulation.course.energy[-1, 0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("rpm", [300.0, -1500.0])
def test_iron_current_in_the_steady_state(rpm):
    """i_machine = i - G v - h v/|v|, where the induced voltage v is omega J psi, late by its time constant."""
    options = {"speeds": (rpm,), "harmonics": 0.0, "inverter": "none", "iron_time_constant": 5e-5}
    simulation = hold(
        -60.0, 80.0, 3000, iron_conductance=0.2, iron_hysteresis=2.0, iron_hysteresis_voltage=1e-3, **options
    )
    late = slice(2500, None)
    psi = (simulation.course.psi_dq @ (1, 1j))[late].mean()
    iron = (simulation.i_dq_true @ (1, 1j) - simulation.course.i_dq_machine @ (1, 1j))[late].mean()
    omega = rpm * np.pi / 30 * POLE_PAIRS
    v = 1j * omega * psi / (1 + 1j * omega * 5e-5)
    assert iron == pytest.approx(0.2 * v + 2.0 * v / abs(v), rel=abs(omega) * 5e-5)
    power = np.diff(simulation.course.energy[late, 3]).mean() / T
    induced = abs(omega * psi)
    assert power == pytest.approx(1.5 * (0.2 * induced**2 + 2.0 * induced), rel=0.02)


def test_lagging_flux_follows_a_step_with_its_time_constant():
    simulation = hold(0.0, 100.0, 200, speeds=(0.0,), harmonics=0.0, inverter="none", flux_lag=0.2, flux_lag_time=2e-3)
    step = simulate(
        IPM,
        SimulationSettings(speeds=(0.0,), harmonics=0.0, inverter="none", flux_lag=0.2, flux_lag_time=2e-3),
        np.concatenate((np.zeros((1, 2)), np.tile((0.0, 100.0), (999, 1)))),
    )
    f = step.machine.flux(*step.course.i_dq_machine.T, 0.0)
    mixed = 0.8 * f + 0.2 * step.course.lagged
    np.testing.assert_allclose(mixed, step.course.psi_dq, rtol=0, atol=1e-9)
    time = np.arange(1000) * T
    expected = solve_ivp(
        lambda t, y: (np.interp(t, time, f[:, 1]) - y) / 2e-3, (0, 0.0999), [0.0], t_eval=time, max_step=T
    ).y[0]
    np.testing.assert_allclose(step.course.lagged[:, 1], expected, rtol=0, atol=2e-3 * f[-1, 1])
    np.testing.assert_allclose(simulation.course.lagged, f[-1] * np.ones((200, 1)), rtol=0, atol=1e-4)


def test_copper_and_magnet_warm_by_their_losses_and_cool():
    """At a held current: C dT/dt = 3/2 R(T) I^2 - C (T - T_ambient) / tau, for the magnets likewise."""
    options = {
        "copper_heat_capacity": 20.0, "copper_time_constant": 0.8, "copper_temperature": 40.0,
        "magnet_heat_capacity": 90.0, "magnet_time_constant": 1.5, "magnet_temperature": 30.0,
        "ambient_temperature": 25.0, "inverter": "none", "speeds": (300.0,), "harmonics": 0.0,
    }  # fmt: skip
    simulation = hold(-120.0, 200.0, 10000, **options)
    amplitude = np.mean(np.sum(simulation.i_dq_true**2, axis=1))

    def rate(_t, y):
        loss = 1.5 * 10e-3 * (1 + 3.93e-3 * (y[0] - 20)) * amplitude
        return loss / 20 - (y[0] - 25) / 0.8, loss / 90 - (y[1] - 25) / 1.5

    time = np.arange(0, 10000, 500) * T
    expected = solve_ivp(rate, (0, 1.0), [40.0, 30.0], t_eval=time, rtol=1e-8).y.T
    np.testing.assert_allclose(simulation.course.temperature[::500], expected, rtol=0, atol=0.02)
    details = simulation.truth.details
    assert details["copper_temperature_end"] == pytest.approx(simulation.course.temperature[-1, 0], abs=0.02)
    assert details["resistance_end"] == pytest.approx(10e-3 * (1 + 3.93e-3 * (details["copper_temperature_end"] - 20)))
    assert details["resistance_start"] == pytest.approx(10e-3 * (1 + 3.93e-3 * 20))


def test_a_warm_drive_needs_the_voltage_of_its_resistance_and_weaker_magnets():
    options = {"harmonics": 0.0, "inverter": "none", "copper_temperature": 70.0, "magnet_temperature": 120.0}
    still = hold(0.0, 100.0, 2000, speeds=(0.0,), **options)
    u = still.samples.u_abc[-1] @ CLARKE
    assert u == pytest.approx(1j * 100.0 * 10e-3 * (1 + 3.93e-3 * 50), abs=1e-3)
    turning = hold(0.0, 0.0, 2000, speeds=(1000.0,), **options)
    magnet = turning.machine.mean_flux(0.0, 0.0)[0]
    psi = turning.course.psi_dq[-1]
    expected = turning.machine.mean_flux(*turning.course.i_dq_machine[-1]) - (0.1 * magnet, 0)
    np.testing.assert_allclose(psi, expected, rtol=0, atol=1e-9)


def test_an_eccentric_rotor_modulates_the_flux_at_mechanical_orders():
    simulation = run(3000, eccentricity=(0.03, -0.01))
    theta = simulation.angle_true / POLE_PAIRS
    factor = 1 + 0.03 * np.cos(theta) - 0.01 * np.cos(2 * theta)
    flux = simulation.machine.flux(*simulation.course.i_dq_machine.T, simulation.angle_true)
    np.testing.assert_allclose(simulation.course.psi_dq, factor[:, None] * flux, rtol=0, atol=1e-9)


def test_the_dc_link_scales_what_the_log_says():
    """Without resistance and drop, each flux step is the voltage truly held."""
    source = dataclasses.replace(machine_map("spm"), resistance=0.0)
    waves = {"u_dc_ripple": 0.03, "u_dc_ripple_frequency": 300.0, "u_dc_drift": 0.02, "u_dc_drift_frequency": 2.3}
    simulation = run(2000, source, inverter="none", **waves)
    time = (np.arange(2000) + 0.5) * T
    scale = 1 + 0.03 * np.sin(2 * np.pi * 300 * time) + 0.02 * np.sin(2 * np.pi * 2.3 * time)
    np.testing.assert_allclose(simulation.course.u_dc, 325.0 * scale, rtol=1e-12)
    psi = (simulation.course.psi_dq @ (1, 1j)) * np.exp(1j * simulation.angle_true)
    logged = simulation.samples.u_abc @ CLARKE
    np.testing.assert_allclose(np.diff(psi), T * (scale * logged)[:-1], rtol=0, atol=1e-12)


# --- the inverter


def linear_machine(resistance: float, inductance: float, i_max: float, u_dc: float) -> MachineMap:
    """Return a machine without magnets, saturation and saliency: three resistances and inductances in star."""
    axis = np.linspace(-1.5 * i_max, 1.5 * i_max, 31)
    d, q = np.meshgrid(axis, axis, indexing="ij")
    return MachineMap("linear", axis, axis, inductance * d, inductance * q, resistance, 1, i_max, u_dc)


def fine_legs(u_abc, i, dead_time, capacitance, machine):
    """Simulate three legs with capacitive outputs on three inductances in steps of 40 ns, from period to period."""
    step, out, u_dc = 4e-8, [], machine.u_dc
    inductance = machine.psi_d[-1, 0] / machine.i_d[-1]
    count = round(T / step)
    carrier = np.abs(np.arange(count) + 0.5 - 0.5 * count) / (0.5 * count)  # 1, down to 0, up to 1
    upper_on, lower_on = np.full(3, np.inf), np.full(3, -1.0)  # since when commanded on
    v, now = np.zeros(3), 0.0
    for u in u_abc:
        out.append(i)
        duty = 0.5 + (u - 0.5 * (u.max() + u.min())) / u_dc
        for k in range(count):
            upper = carrier[k] < duty
            upper_on = np.where(upper, np.minimum(upper_on, now), np.inf)
            lower_on = np.where(upper, np.inf, np.minimum(lower_on, now))
            v = np.minimum(np.maximum(v - i * step / capacitance, 0.0), u_dc)
            v = np.where(now - upper_on >= dead_time - 1e-12, u_dc, v)
            v = np.where(now - lower_on >= dead_time - 1e-12, 0.0, v)
            i = i + step / inductance * (v - v.sum() / 3 - machine.resistance * i)
            now += step
    return np.array(out)


@pytest.mark.slow  # scipy integrates the legs
@pytest.mark.parametrize(("capacitance", "error"), [(3e-8, 0.12), (1e-13, 0.8)])
def test_a_switching_inverter_matches_legs_with_capacitances(capacitance, error):
    """Within ``error``, V, per period, where the dead time costs 12 V; phase currents cross zero."""
    machine = linear_machine(0.5, 2e-3, 20.0, 300.0)
    settings = SimulationSettings(
        inverter="switching", dead_time=4e-6, output_capacitance=capacitance, device_voltage=0.0, device_resistance=0.0,
        speeds=(6000.0,), i_max=20.0,
    )  # fmt: skip
    drive = Drive(build_machine(machine, settings), settings, i_dq_start=(0.0, 4.0))
    block = drive.step_block(np.tile((0.0, 4.0), (24, 1)))
    i_abc = np.real(((block.i_dq_true @ (1, 1j)) * np.exp(1j * block.angle_true))[:, None] * np.exp(-1j * PHASES))
    assert np.ptp(np.sign(i_abc), axis=0).max() == 2

    def voltage(i):
        return np.sqrt(np.mean(np.diff(i - i_abc, axis=0) ** 2)) * 2e-3 / T

    assert voltage(fine_legs(block.samples.u_abc, i_abc[0], 4e-6, capacitance, machine)) < error
    assert voltage(fine_legs(block.samples.u_abc, i_abc[0], 0.0, capacitance, machine)) > 5.0


def test_a_leg_falls_late_by_its_charge_or_by_a_current_that_stays_at_zero():
    """Hard dead time of 4 us on 300 V, and the limits of the two laws."""
    settings = SimulationSettings(inverter="switching", dead_time=4e-6)
    machine = build_machine(linear_machine(0.5, 2e-3, 20.0, 300.0), settings)
    hard = effects_of(machine, settings)
    soft = effects_of(machine, dataclasses.replace(settings, output_capacitance=4e-8))  # 3 A charge it in the dead time

    def delay(constants, i, i_stays, i_moves):
        return real_drive.edge_delay(constants, 300.0, i, i_stays, i_moves)

    assert delay(hard, 5.0, 5.2, 4.8) == pytest.approx(0.0, abs=1e-18)
    assert delay(hard, -5.0, -4.8, -5.2) == pytest.approx(4e-6)
    assert delay(hard, 0.1, 0.4, -0.2) == pytest.approx(4e-6 / 3)  # ends at zero: 1/3 of 0.4 and 2/3 of -0.2
    assert delay(hard, -0.1, 0.2, -0.4) == pytest.approx(8e-6 / 3)
    bare = effects_of(machine, dataclasses.replace(settings, current_clamping=False))  # by the sign alone
    assert delay(bare, 0.1, 0.4, -0.2) == pytest.approx(0.0, abs=1e-18)
    assert delay(bare, -0.1, 0.2, -0.4) == pytest.approx(4e-6)
    assert delay(soft, 1.5, 1.6, 1.4) == pytest.approx(4e-6 * 0.75)
    assert delay(soft, 3.0, 3.1, 2.9) == pytest.approx(2e-6)
    assert delay(soft, 12.0, 12.1, 11.9) == pytest.approx(4e-6 / 8)
    assert delay(soft, -1.0, -0.9, -1.1) == pytest.approx(4e-6)


def test_with_capacitance_the_mean_voltage_error_of_switching_is_the_average_law():
    """Dead time u_td = u_dc t_d / T, and all charge moved within it at i_c = C u_dc / t_d."""
    options = {"speeds": (0.0,), "harmonics": 0.0, "device_voltage": 0.0, "device_resistance": 0.0}
    for i_d in (-200.0, -40.0, 15.0, 60.0):
        switching = {"inverter": "switching", "dead_time": 2e-6, "output_capacitance": 2e-7}
        average = {"inverter": "dead_time", "inverter_voltage": 8.0, "inverter_current": 40.0}
        u = [hold(i_d, 0.0, 600, **options, **law).samples.u_abc[400:].mean(axis=0) for law in (switching, average)]
        np.testing.assert_allclose(u[0], u[1], rtol=0, atol=0.05)


def test_hard_dead_time_costs_its_volt_seconds_at_any_current():
    options = {"speeds": (0.0,), "device_voltage": 0.0, "device_resistance": 0.0, "dead_time": 4e-6}
    for i_d in (-50.0, 100.0):
        simulation = hold(i_d, 0.0, 600, inverter="switching", **options)
        u = (simulation.samples.u_abc[400:] @ CLARKE).mean()
        assert u == pytest.approx(i_d * 10e-3 + 4 / 3 * 16.0 * np.sign(i_d), abs=0.02)
        curve = np.interp(i_d, simulation.truth.inverter_current, simulation.truth.inverter_voltage)
        assert curve == pytest.approx(16.0 * np.sign(i_d), rel=1e-3)


def test_devices_differ_between_phases_and_directions():
    """At standstill the log holds R i and each phase's own drop; its zero sequence is free."""
    options = {
        "speeds": (0.0,), "inverter": "tanh", "inverter_voltage": 5.0, "inverter_current": 1.0,
        "drop_factor": (1.0, 1.2, 0.7), "drop_asymmetry": (0.1, -0.2, 0.3), "resistance_factor": (1.1, 0.8, 1.0),
    }  # fmt: skip
    simulation = hold(90.0, 40.0, 3000, **options)
    i = np.real(stator(simulation)[-1] * np.exp(-1j * PHASES))
    drop = 5.0 * np.tanh(i)
    expected = np.array((1.1, 0.8, 1.0)) * 10e-3 * i
    expected += np.array((1.0, 1.2, 0.7)) * (drop + np.array((0.1, -0.2, 0.3)) * np.abs(drop))
    assert simulation.samples.u_abc[-1] @ CLARKE == pytest.approx(expected @ CLARKE, abs=2e-3)


def test_the_hexagon_limits_what_is_applied_and_not_what_is_logged():
    """Without resistance and drop, each flux step is the voltage truly held."""
    source = dataclasses.replace(machine_map("spm"), resistance=0.0)
    simulation = run(4000, source, inverter="none", speeds=(4500.0,), hexagon_limit=True, voltage_limit=1.3)
    psi = (simulation.course.psi_dq @ (1, 1j)) * np.exp(1j * simulation.angle_true)
    applied = np.diff(psi) / T
    u = simulation.samples.u_abc[:-1]
    beyond = np.ptp(u, axis=1) > 325.0
    assert 0.02 < beyond.mean() < 0.9
    np.testing.assert_allclose(applied[~beyond], u[~beyond] @ CLARKE, rtol=0, atol=1e-7)
    phases = np.real(applied[:, None] * np.exp(-1j * PHASES))
    assert np.ptp(phases, axis=1).max() <= 325.0 * (1 + 1e-9)  # line to line
    np.testing.assert_allclose(np.ptp(phases, axis=1)[beyond], 325.0)


def test_a_logged_zero_sequence_centres_the_phases_and_changes_nothing_else():
    plain, injected = run(log_zero_sequence=False), run(log_zero_sequence=True)
    u = injected.samples.u_abc
    np.testing.assert_allclose(u.max(axis=1) + u.min(axis=1), 0.0, atol=1e-9)
    np.testing.assert_allclose(u @ CLARKE, plain.samples.u_abc @ CLARKE, rtol=0, atol=1e-9)
    assert np.abs(u.sum(axis=1)).max() > 1.0
    np.testing.assert_array_equal(injected.samples.i_abc, plain.samples.i_abc)


# --- sensors


def test_phases_sampled_at_different_times():
    simulation = run(2000, current_skew=(0.0, 4e-5, 9e-5))
    i_abc = np.real(stator(simulation)[:, None] * np.exp(-1j * PHASES))
    time = np.arange(2000) * T
    seen = np.stack([np.interp(time - age, time, i) for age, i in zip((0.0, 4e-5, 9e-5), i_abc.T, strict=True)], -1)
    np.testing.assert_allclose(simulation.samples.i_abc[1:, 0], i_abc[1:, 0], rtol=0, atol=1e-9)
    assert np.abs(simulation.samples.i_abc - seen)[1:].max() < 0.3  # A, the currents' bend between samples
    assert np.abs(simulation.samples.i_abc - i_abc)[1:, 2].max() > 3.0


def test_dead_band_and_cubic_gain_of_the_sensors():
    simulation = run(current_dead_band=1.5, current_cubic=-0.01, current_gain=(1.0, 1.02, 1.0))
    i = np.real(stator(simulation)[:, None] * np.exp(-1j * PHASES))
    bent = i * (1 - 0.01 * (i / 300.0) ** 2)
    expected = np.where(np.abs(bent) > 1.5, bent - 1.5 * np.sign(bent), 0.0) * (1.0, 1.02, 1.0)
    np.testing.assert_allclose(simulation.samples.i_abc, expected, rtol=0, atol=1e-9)
    assert (simulation.samples.i_abc == 0.0).any()


def test_angle_quantization():
    step = 2 * np.pi / 1024
    simulation = run(resolver_quantization=step)
    turns = simulation.samples.angle / step
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-9)
    error = wrapped(simulation.samples.angle - simulation.angle_true)
    assert 0.4 * step < np.abs(error).max() <= 0.5 * step * (1 + 1e-9)


def test_jittered_stamps_are_late_by_a_random_time():
    plain, late = run(2000), run(2000, stamp_jitter=5e-5)
    delay = late.samples.stamp - plain.samples.stamp
    assert delay.min() >= 0
    assert delay.max() <= 50_000
    assert delay.std() == pytest.approx(50_000 / np.sqrt(12), rel=0.05)
    assert abs(np.corrcoef(delay[1:], delay[:-1])[0, 1]) < 0.08
    np.testing.assert_array_equal(late.samples.i_abc, plain.samples.i_abc)


@pytest.mark.parametrize(("order", "cut_off"), [(1, 400.0), (2, 500.0), (1, 50e3)])
def test_the_current_filter_has_its_transfer_function(order, cut_off):
    simulation = hold(
        -50.0, 90.0, 3000, speeds=(600.0,), harmonics=0.0, inverter="none", current_filter=cut_off,
        current_filter_order=order, current_bandwidth=40.0,
    )  # fmt: skip
    s = 1j * 600 * np.pi / 30 * POLE_PAIRS / (2 * np.pi * cut_off)
    expected = 1 / (1 + s) if order == 1 else 1 / (1 + np.sqrt(2) * s + s**2)
    measured = simulation.samples.i_abc @ CLARKE / stator(simulation)
    assert measured[2000:].mean() == pytest.approx(expected, abs=2e-3)  # the currents ripple within each period


@pytest.mark.parametrize("pole", [-3e4 + 0j, 2e4 * (-1 + 1j)])
def test_the_filter_is_exact_for_a_parabola(pole):
    h, (a, b, c) = 5e-5, (3.0, 2e4, -4e8)

    def i(t):
        return a + b * t + c * t**2

    expected = solve_ivp(lambda t, z: pole * z + i(t), (0, h), [1e-4 + 2e-5j], rtol=1e-11, atol=1e-16).y[0, -1]
    got = real_drive._filtered(pole, 1e-4 + 2e-5j, (i(0), i(h / 2), i(h)), h)
    assert got == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("latency", [3e-5, 2.5e-4])
def test_a_late_angle_is_the_angle_of_earlier(latency):
    simulation = run(
        3000, speeds=(500.0, -900.0), ramp_time=0.1, segment_durations=(0.1, 0.2), speed_ripple=0.02,
        resolver_latency=latency,
    )  # fmt: skip
    theta = np.unwrap(simulation.angle_true)
    time = np.arange(3000) * T
    expected = np.interp(time - latency, time, theta)
    np.testing.assert_allclose(
        wrapped(simulation.samples.angle - expected)[10:], 0.0, atol=1e-4
    )  # rad, at the ramps' ends
    lag = wrapped(simulation.angle_true - simulation.samples.angle)
    assert lag[500] == pytest.approx(simulation.samples.speed[500] * latency, rel=1e-2)


def test_resolver_errors_of_electrical_and_mechanical_orders():
    simulation = run(
        3000, resolver_electrical_errors=(0.01, 0.004), resolver_electrical_phases=(0.3,),
        resolver_mechanical_errors=(0.02, 0.0, 0.005), resolver_mechanical_phases=(0.1, 0.0, -2.0),
        resolver_offset=0.05,
    )  # fmt: skip
    theta = simulation.angle_true
    turn = theta / POLE_PAIRS
    expected = 0.05 + 0.01 * np.cos(theta - 0.3) + 0.004 * np.cos(2 * theta)
    expected += 0.02 * np.cos(turn - 0.1) + 0.005 * np.cos(3 * turn + 2.0)
    np.testing.assert_allclose(wrapped(simulation.samples.angle - theta), expected, rtol=0, atol=1e-9)


def test_a_decimated_log_is_every_nth_sample_of_the_full_one():
    full, thin = run(1001, current_noise=1e-3), run(1001, current_noise=1e-3, log_decimation=5)
    assert thin.samples.sample_period == pytest.approx(5e-4)
    for name in ("stamp", "i_abc", "u_abc", "angle", "speed", "i_dq_reference"):
        np.testing.assert_array_equal(getattr(thin.samples, name), getattr(full.samples, name)[::5])
    np.testing.assert_array_equal(thin.i_dq_true, full.i_dq_true[::5])


def test_a_block_without_a_logged_sample_is_refused_and_changes_nothing():
    settings = SimulationSettings(log_decimation=5)
    drive = Drive(build_machine(IPM, settings), settings)
    drive.step_block(np.zeros((6, 2)))
    with pytest.raises(DataError, match="None of the 4 samples is logged with log_decimation 5"):
        drive.step_block(np.zeros((4, 2)))
    assert drive.step_block(np.zeros((5, 2))).samples.stamp.tolist() == [1_000_000]


def test_the_bench_in_real_time_decimates_too():
    settings = SimulationSettings(log_decimation=4, flux_lag=0.02)
    bench = SimulatedBench(IPM, settings, BenchSettings(block_size=50))
    bench.advance(0)
    blocks = bench.advance(70_000_000)
    assert [block.first_sample for block in blocks] == [0, 50, 100]
    assert [block.stamp for block in blocks] == [0, 20_000_000, 40_000_000]
    assert {block.sample_period for block in blocks} == {4e-4}
    settings = dataclasses.replace(settings, log_decimation=1)
    expected = Drive(build_machine(IPM, settings), settings).step_block(np.zeros((600, 2))).samples
    measured = np.concatenate([np.stack(block.voltages, axis=-1) for block in blocks])
    np.testing.assert_array_equal(measured, expected.u_abc[::4].astype(np.float32))


def test_the_bench_in_real_time_stamps_late():
    bench = SimulatedBench(IPM, SimulationSettings(stamp_jitter=5e-5), BenchSettings(block_size=10))
    bench.advance(0)
    late = np.array([block.stamp - block.first_sample * 100_000 for block in bench.advance(100_000_000)])
    assert len(late) == 100
    assert late.min() >= 0
    assert 40_000 < late.max() <= 50_000


# --- settings and truth

IRON, HEATED, SWITCHED = "iron_conductance=0.3", "copper_heat_capacity=5.0", "inverter=switching"
ASSIGNMENTS = {
    "iron_conductance=0.3": [],
    "iron_hysteresis=3.0": [],
    "iron_hysteresis_voltage=10.0": ["iron_hysteresis=3.0"],
    "iron_time_constant=3e-4": [IRON],
    "flux_lag=0.03": [],
    "flux_lag_time=1e-2": ["flux_lag=0.03"],
    "eccentricity=[0.01, 0.005]": [],
    "resistance_factor=[1.1, 1.0, 1.0]": [],
    "copper_temperature=60": [],
    "copper_heat_capacity=5.0": [],
    "copper_time_constant=0.1": [HEATED],
    "copper_coefficient=1e-2": [HEATED],
    "magnet_temperature=60": [],
    "magnet_heat_capacity=5.0": [],
    "magnet_time_constant=0.1": ["magnet_heat_capacity=5.0"],
    "magnet_coefficient=2e-3": ["magnet_heat_capacity=5.0"],
    "ambient_temperature=90": [HEATED],
    "dead_time=3e-6": [SWITCHED],
    "output_capacitance=1e-7": [SWITCHED],
    "current_clamping=false": [SWITCHED, "dead_time=5e-6"],
    "drop_factor=[1.1, 1.0, 1.0]": [],
    "drop_asymmetry=[0.1, 0.0, 0.0]": [],
    "hexagon_limit=true": ["speeds=[12000]", "voltage_limit=2.0"],
    "voltage_limit=0.3": ["speeds=[3000]"],
    "u_dc_ripple=0.02": [],
    "u_dc_ripple_frequency=600": ["u_dc_ripple=0.02"],
    "u_dc_drift=0.01": [],
    "u_dc_drift_frequency=4.0": ["u_dc_drift=0.01"],
    "current_filter=5e3": [],
    "current_filter_order=2": ["current_filter=5e3"],
    "current_skew=[0.0, 1e-5, 2e-5]": [],
    "current_dead_band=0.5": [],
    "current_cubic=0.003": [],
    "resolver_latency=3e-5": [],
    "resolver_electrical_errors=[0.01]": [],
    "resolver_electrical_phases=[1.0]": ["resolver_electrical_errors=[0.01]"],
    "resolver_mechanical_errors=[0.01]": [],
    "resolver_mechanical_phases=[1.0]": ["resolver_mechanical_errors=[0.01]"],
    "resolver_quantization=1e-3": [],
    "log_zero_sequence=true": [],
    "stamp_jitter=1e-5": [],
    "log_decimation=2": [],
    "free_shaft=true": [],
    "inertia=0.01": ["free_shaft=true"],
    "viscous_friction=0.1": ["free_shaft=true"],
    "coulomb_friction=5.0": ["free_shaft=true"],
    "cogging_torque=2.0": ["free_shaft=true"],
    "cogging_order=12": ["free_shaft=true", "cogging_torque=2.0"],
    "load_torque=3.0": ["free_shaft=true"],
    "start_angle=1.0": ["free_shaft=true"],
    "angle_reversed=true": [],
    "angle_factor=2.0": [],
    "speed_observer=100.0": [],
}
"""What ``--set`` says for each effect, with what it needs besides to show."""


@cache
def signals(*assignments: str) -> tuple[Simulation, SimulationSettings]:
    settings = merged_settings(SimulationSettings, None, [*assignments], {})
    return simulate(IPM, settings, np.tile((-100.0, 120.0), (900, 1))), settings


@pytest.mark.parametrize("assignment", ASSIGNMENTS)
def test_every_effect_is_set_by_name_changes_the_log_and_is_in_the_truth(assignment):
    without, _ = signals(*ASSIGNMENTS[assignment])
    simulation, settings = signals(*ASSIGNMENTS[assignment], assignment)
    name = assignment.partition("=")[0]
    pairs = [
        (getattr(without.samples, x), getattr(simulation.samples, x))
        for x in ("stamp", "i_abc", "u_abc", "angle", "speed")
    ]
    assert any(a.shape != b.shape or np.abs(a - b).max() > 1e-5 for a, b in pairs)
    value = getattr(settings, name)
    assert simulation.truth.details[name] == (str(value) if isinstance(value, tuple) else value)


def test_no_effect_is_forgotten_here():
    assert [assignment.partition("=")[0] for assignment in ASSIGNMENTS] == [*EFFECT_NAMES]


def test_the_truth_records_active_effects_and_what_a_fit_is_scored_against():
    assert "iron_conductance" not in run(10).truth.details
    details = run(100, iron_conductance=0.3, eccentricity=(0.01,)).truth.details
    assert details["iron_conductance"] == 0.3
    assert details["eccentricity"] == "(0.01,)"
    assert details["iron_time_constant"] == 5e-5
    assert details["iron_power_mean"] > 0
    assert details["copper_temperature_end"] == 20.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"iron_conductance": -0.1}, r"iron_conductance is -0\.1 S: it must be at least 0"),
        ({"flux_lag": 0.6}, r"flux_lag is 0\.6: it must be at least 0\.0 and at most 0\.5"),
        ({"current_filter_order": 3}, "current_filter_order is 3: it must be at least 1 and at most 2"),
        ({"eccentricity": (0.2, 0.2, -0.2)}, "amplitudes of eccentricity sum up to more than 0.5"),
        ({"resolver_electrical_errors": (0.01,) * 9}, "resolver_electrical_errors has 9 entries: give at most 8"),
        (
            {"resolver_mechanical_phases": (0.1,)},
            "resolver_mechanical_phases has 1 entry and",
        ),
        ({"log_decimation": 0}, "log_decimation is 0"),
        ({"current_skew": (0.0, 1e-4, 0.0)}, r"current_skew reaches 0\.0001 s, a sample period or more"),
        ({"stamp_jitter": 2e-4}, r"stamp_jitter is 0\.0002 s, at least the period of the log"),
        ({"inverter": "switching", "dead_time": 5e-5}, "more than a quarter of the switching period"),
        ({"inverter": "switching", "voltage_delay": 0.5}, "with inverter switching it must be a whole number"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        SimulationSettings(**settings)
