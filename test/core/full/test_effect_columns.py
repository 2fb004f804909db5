"""Columns of the effects of real drives, against drives in closed form that have a little of each effect.

A current that is a sum of exponentials, a flux map in closed form and a constant speed give every effect exactly. The
balance over the windows of such a recording, with the true map, leaves a residual: its derivative by the size of the
effect must be minus the effect's column.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from full_design import design
from synthetic import saturating_flux

from drive_id.core import frames
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.columns import EffectColumns
from drive_id.core.full.effects.link import RippleShape
from drive_id.core.full.integrals import LAGS
from drive_id.core.full.model import EFFECTS, RESISTANCE, VOLTAGE, FullModel
from drive_id.core.full.winding_heat import WindingHeat
from drive_id.core.full.windows import WindowCutter, Windows
from drive_id.types import Samples

I_MAX, RADIUS, R, PERIOD, SECONDS, SPEED, PAIRS = 330.0, 300.0, 0.02, 1e-4, 0.5, 209.0, 3
NEAR = 0.02
OF_SAMPLING = {
    "flux_lag_1ms": 0.06, "current_latency": 0.03, "current_offset": 0.1, "current_offset, imaginary": 0.1,
    "late_magnet_heating": 0.03, "drop_by_link": 0.04, "link_rise": 0.06, "current_filters": 0.07,
    "current_filters, of b": 0.07, "device_sag": 0.03, "sampling_instant": 0.05,
    "angle_clock": 0.04, "current_clock": 0.04,
}  # fmt: skip
"""Relative error of a column; larger where half a sample of 0.1 ms counts: of a lag of 1 ms, and as the current of this
drive is smooth between the samples, where that of a real drive has the ripple of the held voltage; and where coarse
shapes stand for the slope of the drop, which is a large part of an offset's column; where the zero sequence of currents
that are filtered is taken for that of a circle; where heat and link have one
value in a window, in which the power may change its sign; and where a clock does, in windows of 1 % of a recording."""
OF_SECOND_ORDER = 0.1
LARGE_LOSS = 1.2
"""Conductance of the iron, S."""
U_DC, LINK_TURN = 400.0, 2 * np.pi * 9.0
SPANS = SECONDS * np.array([[0.0, 1.0], [1.0, 2.0]])
"""When recordings begin and end, s."""
SETTLED = 0.08
"""Time after which the lagging currents have forgotten their unknown start, s."""
TURNS = 2 * np.pi * np.array([2.6, -2.6, 4.8, -4.8, 1.1, -1.1])
SHARES = RADIUS * np.array([0.25j, -0.25j, -0.25j, 0.25j, 0.5, -0.5])
"""cos(1.1) sin(3.7) along d and sin(1.1) along q, as exponentials (1.1, 3.7: frequencies in Hz)."""
MODEL = FullModel(np.full(2, -I_MAX), np.full(2, I_MAX), RADIUS, (6,))
HEIGHT = 4.0
"""Of one of the inverter's shapes, V."""


def current(t, lag=0.0):
    """Return i_d + j i_q, after a first-order lag, A."""
    return np.sum(SHARES / (1 + 1j * TURNS * lag) * np.exp(1j * TURNS * np.asarray(t)[..., None]), axis=-1)


def flux(i):
    psi = saturating_flux(np.stack([i.real, i.imag], axis=-1))
    return psi[..., 0] + 1j * psi[..., 1]


def by_time(f, t, step=1e-6):
    return (f(t + step) - f(t - step)) / (2 * step)


def turning(t):
    return np.exp(1j * SPEED * t)


def drop_of(i_s):
    """Return the space vector of the drop at a terminal current, V."""
    shape = MODEL.shapes(frames.phases(i_s.ravel()))[:, :, 3]
    return HEIGHT * frames.space_vector(shape).reshape(i_s.shape)


def dq_flux(t):
    return flux(current(t))


def plain_flux(t):
    """Return psi_s of the drive without effects, Vs."""
    return turning(t) * dq_flux(t)


def plain_current(t):
    return turning(t) * current(t)


def wanted_current(t):
    """Return the references, A: the currents lag behind them by 2 ms."""
    return current(t + 2e-3)


@dataclass(frozen=True)
class Drive:
    """What an effect changes: functions of time, in the stator frame."""

    psi: Callable = plain_flux
    terminal: Callable = plain_current
    resistive: Callable = lambda _, i_s: R * i_s
    measured: Callable | None = None
    angle_error: Callable = np.zeros_like
    logged: Callable = lambda _, u_s: u_s

    def record(self, link=False):
        """Return the samples; held voltages are exact, integrals by Gauss-Legendre quadrature."""
        t = PERIOD * np.arange(round(SECONDS / PERIOD) + 1)
        u_s = np.diff(self.psi(t)) / PERIOD
        for node, weight in zip(*np.polynomial.legendre.leggauss(4), strict=True):
            at = t[:-1] + (node + 1) / 2 * PERIOD
            i_s = self.terminal(at)
            u_s = u_s + weight / 2 * (self.resistive(at, i_s) + drop_of(i_s))
        t = t[:-1]
        return Samples(
            stamp=np.rint(t * 1e9).astype(np.int64),
            i_abc=frames.phases((self.measured or self.terminal)(t)),
            u_abc=frames.phases(self.logged(t, u_s)),
            angle=np.angle(np.exp(1j * (SPEED * t + self.angle_error(t)))),
            speed=np.full(len(t), SPEED),
            sample_period=PERIOD,
            i_dq_reference=frames.as_pairs(wanted_current(t)),
            dc_link_voltage=U_DC * (1 + 0.01 * np.cos(LINK_TURN * t)) if link else None,
        )


def voltage(t):
    """Return the induced voltage e, V."""
    return by_time(plain_flux, t)


def iron(x, factor=1.0):
    return Drive(terminal=lambda t: plain_current(t) + x * factor * voltage(t))


def lagging(x, lag, by_axis=lambda behind: behind):
    """Let a share x of the flux lag, or of what ``by_axis`` makes of what it is behind by."""
    return Drive(psi=lambda t: turning(t) * (dq_flux(t) - x * by_axis(dq_flux(t) - flux(current(t, lag)))))


def heat(t):
    """Return int abs(i)^2 dt, relative to that over the recording."""
    fine = np.linspace(0.0, SECONDS, 20001)
    integral = np.append(0.0, np.cumsum(np.abs(current(fine[1:] - fine[1] / 2)) ** 2))
    return np.interp(t, fine, integral / integral[-1])


def turned_resolver(x, order, shift=0.0):
    """Measure an angle too small by x cos(order theta - shift)."""
    return Drive(angle_error=lambda t: -x * np.cos(order * SPEED * t - shift))


def read_at(t, x):
    """Return when a signal was read whose stamps grow too fast by x, and are right in the middle."""
    return t - x * (t - SECONDS / 2)


def above_and_below_mean(i_s):
    """Return what is taken by a property of phase a above the mean, and of phase c below it."""
    return frames.space_vector(frames.phases(i_s) * [1.0, 0.0, -1.0])


def unequal(x):
    """Add x to the resistance of phase a and take it from that of phase c."""
    return Drive(resistive=lambda _, i_s: R * i_s + x * above_and_below_mean(i_s))


def sampled_early(x):
    """Let R and the drop be those of currents that move by -L^-1 e in x seconds."""
    step = 1e-2

    def at_edges(t, i_s):
        i, e = current(t), voltage(t) / turning(t)
        by_d, by_q = ((flux(i + unit * step) - flux(i - unit * step)) / (2 * step) for unit in (1, 1j))
        jacobian = np.moveaxis(np.array([[by_d.real, by_q.real], [by_d.imag, by_q.imag]]), (0, 1), (-2, -1))
        d, q = np.linalg.solve(jacobian, np.stack([e.real, e.imag], axis=-1)[..., None])[..., 0].T
        later = i_s - x * turning(t) * (d + 1j * q)
        return R * later + drop_of(later) - drop_of(i_s)

    return Drive(resistive=at_edges)


def compensated_by_references(x):
    """Compensate x V of a shape of the drop by the references."""

    def left(t, i_s):
        shape, wanted = (MODEL.shapes(frames.phases(each))[..., 6] for each in (i_s, turning(t) * wanted_current(t)))
        return R * i_s + x * frames.space_vector(shape - wanted)

    return Drive(resistive=left)


def late_compensation(x, shares=(0, 0, 0, 0, 0, 0, 1, 0, 0, 0)):
    """Compensate shapes of the drop by phase currents that are late, as much as gives x V times lateness."""
    late = 1.5 * PERIOD

    def of_shapes(i_s):
        return frames.space_vector(MODEL.shapes(frames.phases(i_s)) @ np.array(shares, np.float64))

    def left(t, i_s):
        shape, before = of_shapes(i_s), of_shapes(plain_current(t - late))
        return R * i_s + x / late * (shape - before)

    return Drive(resistive=left)


def lopsided(x):
    """Let the drop of phase b exceed the usual one by the share x for positive current, and fall below it otherwise."""

    def more(i_s):
        shape = np.abs(MODEL.shapes(frames.phases(i_s.ravel()))[:, :, 3]) * [0.0, 1.0, 0.0]
        return HEIGHT * frames.space_vector(shape).reshape(i_s.shape)

    return Drive(resistive=lambda _, i_s: R * i_s + x * more(i_s))


def unequal_drops(x):
    """Add the share x of the usual drop to that of phase a, and take it from that of phase c."""

    def more(i_s):
        shape = MODEL.shapes(frames.phases(i_s.ravel()))[:, :, 3] * [1.0, 0.0, -1.0]
        return HEIGHT * frames.space_vector(shape).reshape(i_s.shape)

    return Drive(resistive=lambda _, i_s: R * i_s + x * more(i_s))


def unequally_filtered(t, a, b):
    """Return currents that are late by a, b and -a - b s in the phases, which stands for filters."""
    late = np.array([a, b, -a - b])
    own = np.stack([frames.phases(plain_current(t - each).ravel())[:, k] for k, each in enumerate(late)], axis=1)
    return frames.space_vector(own).reshape(t.shape)


def power(t, u_s):
    """Return the power that the machine takes at the middle of the samples that begin at t, W."""
    return 1.5 * (u_s * plain_current(t + 0.5 * PERIOD).conj()).real


def fallen(t, u_s):
    """Return the drop times the power that a machine behind a dead time takes from the link, V W."""
    drop = drop_of(plain_current(t + 0.5 * PERIOD))
    return drop * power(t, u_s - drop)


def fallen_link(x):
    """Let the link fall by x per power that is taken from it, and the drop, which takes no power, with it."""

    def commanded(t, u_s):
        left = u_s - drop_of(plain_current(t + 0.5 * PERIOD))
        return u_s + x * left * power(t, left)

    return Drive(logged=commanded)


def sparing_devices(x):
    """Let the drop stay and take its power: by how much a link that falls so changes the voltages more."""

    def commanded(t, u_s):
        left = u_s - drop_of(plain_current(t + 0.5 * PERIOD))
        return u_s + x * (u_s * power(t, u_s) - left * power(t, left))

    return Drive(logged=commanded)


CASES = {
    "iron_loss": (0, iron, 0.05),
    "hysteresis": (0, lambda x: iron(x, 1 / SPEED), 10.0),
    "coercivity": (0, lambda x: Drive(terminal=lambda t: plain_current(t) + x * voltage(t) / np.abs(voltage(t))), 1.0),
    "current_latency": (0, lambda x: Drive(measured=lambda t: plain_current(t - x)), 2e-5),
    "angle_latency": (0, lambda x: Drive(angle_error=lambda t: np.full_like(t, -x * SPEED)), 2e-5),
    "voltage_frame": (0, lambda x: Drive(logged=lambda _, u_s: u_s * np.exp(-1j * SPEED * x)), 2e-5),
    "current_frame": (0, lambda x: Drive(measured=lambda t: plain_current(t) * np.exp(-1j * SPEED * x)), 2e-5),
    "voltage_clock": (0, lambda x: Drive(logged=lambda t, u_s: np.interp(read_at(t, x), t, u_s)), 5e-5),
    "angle_clock": (0, lambda x: Drive(angle_error=lambda t: SPEED * (read_at(t, x) - t)), 1e-4),
    "current_clock": (0, lambda x: Drive(measured=lambda t: plain_current(read_at(t, x))), 1e-4),
    "late_compensation": (0, late_compensation, 1e-5),
    "late_shape": (3, lambda x: late_compensation(x, (0, 0, 0, 0, 0, 0, -1, 1, 0, 0)), 1e-5),
    "reference_compensation": (0, compensated_by_references, 0.1),
    "sampling_instant": (0, sampled_early, 1e-6),
    "flux_lag": (0, lambda x: Drive(psi=lambda t: plain_flux(t) - x * turning(t) * by_time(dq_flux, t)), 2e-5),
    **{f"flux_lag_{1e3 * lag:g}ms": (0, lambda x, lag=lag: lagging(x, lag), 0.01) for lag in LAGS},
    "flux_lag_4ms, of psi_d more than of psi_q": (1, lambda x: lagging(x, 4e-3, np.conj), 0.01),
    "copper_heating": (0, lambda x: Drive(resistive=lambda t, i_s: (R + x * heat(t)) * i_s), 1e-3),
    "magnet_heating": (0, lambda x: Drive(psi=lambda t: plain_flux(t) + x * heat(t) * turning(t)), 1e-3),
    "magnet_heating, by current": (1, lambda x: Drive(psi=lambda t: turning(t) * flux(current(t) + x * heat(t))), 1.0),
    "late_magnet_heating": (0, lambda x: Drive(psi=lambda t: plain_flux(t) + x * heat(t) ** 2 * turning(t)), 1e-3),
    "eccentricity": (0, lambda x: turned_resolver(x, 1 / PAIRS), 5e-3),
    "eccentricity, sine": (1, lambda x: turned_resolver(x, 1 / PAIRS, np.pi / 2), 5e-3),
    "eccentric_rotor": (0, lambda x: Drive(psi=lambda t: plain_flux(t) * (1 + x * np.cos(SPEED / PAIRS * t))), 5e-3),
    "resolver_first": (0, lambda x: turned_resolver(x, 1), 5e-3),
    "resolver_second, sine": (1, lambda x: turned_resolver(x, 2, np.pi / 2), 5e-3),
    "dc_link": (0, lambda x: Drive(logged=lambda t, u_s: u_s / (1 + x * 0.01 * np.cos(LINK_TURN * t))), 0.5),
    "drop_by_link": (
        0, lambda x: Drive(resistive=lambda t, i_s: R * i_s + x * 0.01 * np.cos(LINK_TURN * t) * drop_of(i_s)), 0.5
    ),
    "link_drift": (0, lambda x: Drive(logged=lambda t, u_s: u_s / (1 + x * (t / SECONDS - 0.5))), 5e-3),
    "link_sag": (0, fallen_link, 1e-6),
    "device_sag": (0, sparing_devices, 1e-6),
    "drop_by_sag": (0, lambda x: Drive(logged=lambda t, u_s: u_s - x * fallen(t, u_s)), 1e-5),
    "link_rise": (0, lambda x: Drive(logged=lambda t, u_s: u_s / (1 + x * (power(t, u_s) < 0))), 1e-3),
    "phase_resistance": (0, unequal, 1e-3),
    "phase_inductance": (
        0, lambda x: Drive(psi=lambda t: plain_flux(t) + x * above_and_below_mean(plain_current(t))), 1e-5
    ),
    "phase_drop": (0, unequal_drops, 0.05),
    "skin_effect": (0, lambda x: Drive(resistive=lambda _, i_s: (R + x * (1e-3 * SPEED) ** 2) * i_s), 1e-3),
    "drop_asymmetry": (1, lopsided, 0.05),
    "voltage_gains": (0, lambda x: Drive(logged=lambda _, u_s: u_s - x * u_s.conj()), 1e-3),
    "voltage_gains, imaginary": (1, lambda x: Drive(logged=lambda _, u_s: u_s - 1j * x * u_s.conj()), 1e-3),
    "current_rotation": (0, lambda x: Drive(measured=lambda t: plain_current(t) * (1 + 1j * x)), 1e-3),
    "current_gains": (0, lambda x: Drive(measured=lambda t: plain_current(t) + x * plain_current(t).conj()), 1e-3),
    "current_gains, imaginary": (
        1, lambda x: Drive(measured=lambda t: plain_current(t) + 1j * x * plain_current(t).conj()), 1e-3
    ),
    "current_filters": (0, lambda x: Drive(measured=lambda t: unequally_filtered(t, x, 0.0)), 1e-6),
    "current_filters, of b": (1, lambda x: Drive(measured=lambda t: unequally_filtered(t, 0.0, x)), 1e-6),
    "current_offset": (0, lambda x: Drive(measured=lambda t: plain_current(t) + x), 0.1),
    "current_offset, imaginary": (1, lambda x: Drive(measured=lambda t: plain_current(t) + 1j * x), 0.1),
}  # fmt: skip
"""Of each effect: number of the column, a drive with so much of it, and how much to try."""


def cut(*recordings):
    cutter, parts = WindowCutter(MODEL.shapes), []
    for number, samples in enumerate(recordings):
        if number:
            parts += cutter.finish()
            cutter.restart(number * SECONDS, number)
        parts += cutter.cut(samples)
    return Windows.joined([*parts, *cutter.finish()])


@pytest.fixture(scope="module")
def estimate():
    """The true parameters: the spline map that meets the flux on a grid, R, and one shape of the inverter."""
    axis = np.linspace(-I_MAX, I_MAX, 45)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    rows = MODEL.flux.rows(grid)
    matrix = np.zeros((len(grid), 2, MODEL.flux.parameters))
    np.put_along_axis(matrix, rows.column, rows.value, axis=2)
    matrix = matrix.reshape(-1, MODEL.flux.parameters)
    ridge = 1e-9 * np.eye(MODEL.flux.parameters)
    out = np.zeros(MODEL.size)
    out[MODEL.map] = np.linalg.solve(matrix.T @ matrix + ridge, matrix.T @ saturating_flux(grid).ravel())
    out[VOLTAGE], out[RESISTANCE] = -1.0, R
    out[MODEL.phase_columns()[3]] = HEIGHT
    return out


@pytest.fixture(scope="module")
def columns(estimate):
    """The columns of the drive without effects (N, EFFECT_COLUMNS), from one recording and from two."""
    one, two = cut(Drive().record(link=True)), cut(Drive().record(), Drive().record())
    return [
        EffectColumns(MODEL, estimate, float(windows.heat.max()), U_DC, SPANS, PAIRS)(windows) for windows in (one, two)
    ]


def ends(windows):
    """Return the times (N, 2) of the ends of windows, s."""
    return windows.time[:, None] + windows.duration[:, None] * [0.0, 1.0]


def residual(windows, estimate):
    left = design(MODEL, windows) @ estimate
    return left[:, 0] + 1j * left[:, 1]


def close(windows, column, derivative, tolerance):
    settled = windows.time > SETTLED
    error = np.linalg.norm((column + derivative)[settled]) / np.linalg.norm(column[settled])
    assert error < tolerance, f"{100 * error:.2g} % off"


def test_the_drive_without_effects_leaves_next_to_nothing(estimate):
    windows = cut(Drive().record())
    assert np.abs(residual(windows, estimate)).max() < 1e-4 * np.abs(windows.voltage).max()


@pytest.mark.parametrize("case", CASES)
def test_a_column_is_what_a_little_of_the_effect_changes(case, estimate, columns):
    number, drive, size = CASES[case]
    windows = [cut(drive(sign * size).record()) for sign in (1, -1)]
    plus, minus = (residual(each, estimate) for each in windows)
    column = columns[0][:, EFFECTS[case.split(",")[0]].start + number]
    close(windows[0], column, (plus - minus) / (2 * size), OF_SAMPLING.get(case, NEAR))


def test_a_tracked_angle_lags_by_acceleration_and_jerk(estimate):
    """The jerk counts as far as the time constant of the loop is known."""
    windows, size, known, turn = cut(Drive().record()), 1e-5, estimate.copy(), 2 * np.pi * 5.0
    known[MODEL.effect("angle_tracking")] = size
    jerk = turn**2 * 60.0 * np.cos(turn * ends(windows))
    accelerated = replace(windows, acceleration=turn * 60.0 * np.sin(turn * ends(windows)), jerk=jerk)

    def lag(t):
        return turn * 60.0 * np.sin(turn * t) - 1.7 * np.sqrt(size) * turn**2 * 60.0 * np.cos(turn * t)

    plus, minus = (
        residual(cut(Drive(angle_error=lambda t, x=x: -x * lag(t)).record()), estimate) for x in (1e-6, -1e-6)
    )
    columns = EffectColumns(MODEL, known, 1.0, np.nan, SPANS, None)(accelerated)
    close(windows, columns[:, EFFECTS["angle_tracking"].start], (plus - minus) / 2e-6, NEAR)


@pytest.mark.parametrize(("hertz", "plausible"), [(60.0, True), (5.0, True), (0.003, False)])
def test_a_tracking_loop_that_is_slower_than_any_is_none(hertz, plausible):
    """At two constant speeds, one of 3 mHz stood for hysteresis, and 44 % of the voltage was unexplained: refused."""
    known = np.array([(2 * np.pi * hertz) ** -2])
    assert CATALOGUE["angle_tracking"].plausible(known, 0.1, 1e-4) == plausible


@pytest.mark.parametrize(("number", "constant"), [(0, 0.1), (2, 0.4)])
def test_heat_that_is_given_off_has_its_time_constant(number, constant, estimate):
    fine = np.linspace(0.0, SECONDS, 20001)
    risen = np.convolve(np.abs(current(fine)) ** 2, np.exp(-fine / constant))[: len(fine)]
    windows, size = cut(Drive().record()), 1e-3

    def warm(x):
        return Drive(resistive=lambda t, i_s: (R + x * np.interp(t, fine, risen / risen.max())) * i_s)

    winding = replace(WindingHeat.of(windows), constant=0.1, slow=0.4)
    columns = EffectColumns(MODEL, estimate, float(windows.heat.max()), U_DC, SPANS, PAIRS, winding=winding)(windows)
    plus, minus = (residual(cut(warm(x).record()), estimate) for x in (size, -size))
    own = columns[:, EFFECTS["copper_heating"]]
    close(windows, own[:, 0] + (own[:, number] if number else 0.0), (plus - minus) / (2 * size), NEAR)


@pytest.mark.parametrize(
    ("name", "number", "warm", "size"),
    [
        ("copper_recordings", 0, lambda x: Drive(resistive=lambda _, i_s: (R + x) * i_s), 1e-3),
        ("magnet_recordings", 0, lambda x: Drive(psi=lambda t: plain_flux(t) + x * turning(t)), 1e-3),
        ("magnet_recordings", 1, lambda x: Drive(psi=lambda t: turning(t) * flux(current(t) + x)), 1.0),
        ("angle_of_parts", 0, lambda x: Drive(angle_error=lambda t: np.full_like(t, -x)), 1e-3),
        ("drop_of_parts", 0, lambda x: Drive(resistive=lambda _, i_s: R * i_s + x * drop_of(i_s)), 0.05),
        ("unlike_parts", 0, lambda x: Drive(psi=lambda t: plain_flux(t) + x * turning(t) * dq_flux(t).real), 1e-3),
        ("unlike_parts", 1, lambda x: Drive(psi=lambda t: plain_flux(t) + x * turning(t) * 1j * dq_flux(t).imag), 1e-3),
    ],
)
def test_what_differs_in_a_recording_changes_its_own_windows(name, number, warm, size, estimate, columns):
    windows = [cut(Drive().record(), warm(sign * size).record()) for sign in (1, -1)]
    plus, minus = (residual(each, estimate) for each in windows)
    column = columns[1][:, EFFECTS[name].start + number]
    close(windows[0], column, (plus - minus) / (2 * size), NEAR)
    assert not column[: len(column) // 2 - 1].any()


def test_the_effects_add_up(estimate, columns):
    """Two effects at once: to first order the columns times their sizes explain the whole residual."""
    x, g = 3e-5, 0.02
    drive = replace(iron(g), angle_error=lambda t: np.full_like(t, -x * SPEED))
    left = residual(cut(drive.record()), estimate)
    late, loss = (columns[0][:, EFFECTS[name].start] for name in ("angle_latency", "iron_loss"))
    assert np.linalg.norm(left + x * late + g * loss) < 0.02 * np.linalg.norm(left)


def test_the_remainder_is_what_a_late_angle_changes_in_second_order(estimate):
    name, (_, drive, _), size = "angle_latency", CASES["angle_latency"], 1e-4
    number, remainder = EFFECTS[name].stop - 1, EFFECTS["remainder"].start

    def left_and_remainder(x):
        """Return what the column leaves of the residual, and the remainder."""
        known = estimate.copy()
        known[MODEL.effect(name).stop - 1] = x
        windows = cut(drive(x).record())
        columns = EffectColumns(MODEL, known, 1.0, np.nan, SPANS, None)(windows)
        return np.stack([residual(windows, estimate) + x * columns[:, number], columns[:, remainder]])

    plus, minus, none = (left_and_remainder(x) for x in (size, -size, 0.0))
    left, column = (plus + minus) / 2 - none
    close(cut(Drive().record()), column, left, OF_SECOND_ORDER)


def test_a_filter_is_known_beyond_the_first_order(estimate):
    """Of 150 us: taken for a latency, it left 4 % of what it changes."""
    time = 1.5e-4
    passed = SHARES / (1 + 1j * (TURNS + SPEED) * time)
    filtered = Drive(measured=lambda t: turning(t) * np.sum(passed * np.exp(1j * TURNS * t[..., None]), axis=-1))
    known, number = estimate.copy(), MODEL.effect("current_latency").start
    known[number], known[MODEL.effect("remainder")] = time, 1.0
    windows = cut(filtered.record())
    plain = residual(cut(Drive().record()), estimate)
    found = replace(windows, effects=EffectColumns(MODEL, known, 1.0, np.nan, SPANS, None)(windows))
    assert np.linalg.norm(residual(found, known) - plain) < 0.01 * np.linalg.norm(residual(windows, estimate))


@pytest.mark.parametrize("name", ["voltage_clock", "angle_clock", "current_clock"])
def test_a_clock_is_known_beyond_the_first_order(estimate, name):
    """Of two samples at either end of the recording."""
    size, known = 8e-4, estimate.copy()
    known[MODEL.effect(name).start], known[MODEL.effect("remainder")] = size, 1.0
    windows = cut(CASES[name][1](size).record())
    plain = residual(cut(Drive().record()), estimate)
    found = replace(windows, effects=EffectColumns(MODEL, known, 1.0, np.nan, SPANS, None)(windows))
    assert np.linalg.norm(residual(found, known) - plain) < OF_SAMPLING["angle_clock"] * np.linalg.norm(
        residual(windows, estimate)
    )


def test_a_clock_is_refused_from_the_lateness_on_that_windows_hold():
    clock = CATALOGUE["angle_clock"]
    assert clock.refused(np.array([-7e-5]), 5.0, 4e-4) is None
    said = clock.refused(np.array([-9e-5]), 5.0, 4e-4)
    assert str(said).startswith("The clock of the angle is some 90 ppm slow against that of the other signals")
    assert clock.refused(np.array([1e-6]), 5.0, 0.0) is not None, "where a drift is left, whatever was found"
    assert CATALOGUE["iron_loss"].refused(np.array([1.0]), 5.0, 0.0) is None


@pytest.mark.parametrize(("name", "size"), [("iron_loss", LARGE_LOSS), ("angle_latency", 8e-4)])
def test_at_moved_currents_the_columns_are_the_slopes_of_the_nonlinear_balance(estimate, name, size):
    """An effect that moves the current by a tenth of its range: its balance, differentiated numerically."""
    windows = cut(CASES[name][1](size).record())
    known, effect = estimate.copy(), MODEL.effect(name).start
    known[effect], known[MODEL.effect("remainder")] = size, 1.0

    def with_columns(some, x):
        return replace(some, effects=EffectColumns(MODEL, x, 1.0, np.nan, SPANS, None)(some))

    def balance(x):
        return residual(with_columns(windows, x), x)

    moved = EffectColumns(MODEL, known, 1.0, np.nan, SPANS, None).moved(windows)
    assert np.hypot(*np.moveaxis(moved.i_dq - windows.i_dq, -1, 0)).max() > 0.1 * RADIUS
    there = with_columns(moved, known)
    np.testing.assert_allclose(residual(there, known), balance(known), atol=1e-12)
    designs = design(MODEL, there), design(MODEL, with_columns(windows, known))
    middle = MODEL.map.start + MODEL.flux.parameters // 4
    for k in (*range(middle, middle + 5), effect):
        step = np.zeros(MODEL.size)
        step[k] = 1e-4
        slope = (balance(known + step) - balance(known - step)) / 2e-4
        there, here = (np.linalg.norm(design[:, 0, k] + 1j * design[:, 1, k] - slope) for design in designs)
        assert there < 1e-3 * np.linalg.norm(slope) < 0.1 * here


def test_what_the_recording_lacks_leaves_no_column(estimate):
    windows = cut(Drive().record())
    columns = EffectColumns(MODEL, estimate, 1.0, np.nan, SPANS, None)(windows)
    for name in ("dc_link", "eccentricity", "eccentric_rotor", "copper_recordings", "magnet_recordings"):
        assert not columns[:, EFFECTS[name]].any()


@pytest.mark.parametrize(("speed", "frequency"), [(209.0, 3.0), (209.0, 300.0), (-2550.0, 300.0), (2550.0, 720.0)])
def test_a_ripple_of_the_link_is_exact_over_the_held_voltages(speed, frequency):
    """At 4 samples per window, a voltage held in the rotor frame turned the column by 7 degrees."""
    t = PERIOD * np.arange(4000)
    u_dq = 100.0 + 60j + 40.0 * np.sin(2 * np.pi * 8.0 * t) + 30j * np.cos(2 * np.pi * 11.0 * t)
    u_s = u_dq * np.exp(1j * speed * (t + 0.5 * PERIOD))
    samples = Samples(
        stamp=np.rint(t * 1e9).astype(np.int64),
        i_abc=frames.phases(current(t) * np.exp(1j * speed * t)),
        u_abc=frames.phases(u_s),
        angle=np.angle(np.exp(1j * speed * t)),
        speed=np.full(len(t), speed),
        sample_period=PERIOD,
    )
    windows = cut(samples)
    found = RippleShape.of(windows).columns(frequency)
    middle = 2 * np.pi * frequency * (t + 0.5 * PERIOD)
    for column, wave in zip(found.T, (np.cos(middle), np.sin(middle)), strict=True):
        integral = PERIOD * np.append(0.0, np.cumsum(u_s * wave))
        begin, end = (np.rint(x / PERIOD).astype(int) for x in (windows.time, windows.time + windows.duration))
        expected = integral[begin] - integral[end]
        assert np.linalg.norm(column - expected) < 0.02 * np.linalg.norm(expected)
