"""At many degrees per sample the current bows between its samples, on a drive that the bench integrates in time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate

from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import between_samples
from drive_id.core.full.model import RESISTANCE, FullModel
from drive_id.core.result.identify import identify, score
from drive_id.fitting.simulated import machine_map, run_experiment

SETTINGS = SimulationSettings(
    speeds=(3000.0,), sample_period=2e-4, inverter="none", harmonics=0.0, i_max=10.0, current_noise=1e-4, substeps=8
)


@pytest.fixture(scope="module")
def fast():
    """Return a servo machine that turns by 10.8 degrees electrical per sample."""
    return run_experiment(machine_map("spm"), SETTINGS, None, 5.0)


def fitted(fast):
    found = identify([fast.samples], FitSettings("full", i_max=10.0, harmonic_orders=(6,), search_orders=False))
    return found, max(score(found, fast.truth))


@pytest.mark.accuracy
def test_the_current_between_samples_is_counted(fast, monkeypatch):
    found, error = fitted(fast)
    assert error < 2e-4
    assert found.resistance == pytest.approx(fast.truth.resistance, rel=5e-3)
    assert not {c.name for c in found.calibrations if c.applied} & {"angle_latency", "current_latency", "flux_lag"}
    monkeypatch.setattr(between_samples, "_NEGLIGIBLE", np.inf)
    without, larger = fitted(fast)
    assert larger > 2 * error or abs(without.resistance / fast.truth.resistance - 1) > 2e-2


class OneWindow(SimpleNamespace):
    """What the integrals need of a window."""

    def __len__(self):
        return 1

    @property
    def measured(self):
        return self.i_dq[..., 0] + 1j * self.i_dq[..., 1]


def linear_machine(magnet, inductance, resistance, drop):
    """Return a model and an estimate of it, with a drop, V, on a curve that bends at 25 mA."""
    model = FullModel(np.array([-10.0, -10.0]), np.array([10.0, 10.0]), 10.0, ())
    estimate = np.zeros(model.size)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-10.0, 10.0, 41)]), axis=-1).reshape(-1, 2)
    rows = model.flux.rows(grid).sparse(model.flux.parameters).toarray()
    estimate[model.map] = np.linalg.lstsq(rows, (magnet + grid @ inductance).ravel())[0]
    estimate[RESISTANCE] = resistance
    estimate[model.phase_columns()[1]] = drop
    return model, estimate


@pytest.mark.slow  # the oracle integrates in time
def test_resistive_voltage_and_drop_over_a_sample_agree_with_integration_in_time():
    """A linear machine, integrated by scipy over one sample of 15 degrees, with a drop that the current crosses."""
    inductance, magnet, resistance, period, speed = np.diag([2e-3, 3e-3]), np.array([0.1, 0.0]), 0.4, 2e-4, 1300.0
    model, estimate = linear_machine(magnet, inductance, resistance, 3.0)

    def current(angle, psi_s):
        psi = np.exp(-1j * angle) * psi_s - magnet[0]
        return np.exp(1j * angle) * (psi.real / inductance[0, 0] + 1j * psi.imag / inductance[1, 1])

    def taken(i_s):
        drop = model.shapes(frames.phases(np.array([i_s]))) @ estimate[model.phase_columns()][:, 0]
        return resistance * i_s + frames.space_vector(drop)[0]

    for start in np.linspace(0.0, 2 * np.pi, 12, endpoint=False):
        i_dq = 0.7 * np.exp(1j * start)
        psi_s = np.exp(1j * start) * (magnet[0] + i_dq.real * 2e-3 + 1j * i_dq.imag * 3e-3)
        held = 1j * speed * np.exp(1j * (start + 0.5 * speed * period)) * magnet[0]

        def derivative(t, y, start=start, held=held):
            took = taken(current(start + speed * t, y[0] + 1j * y[1]))
            return [(held - took).real, (held - took).imag, took.real, took.imag]

        y = integrate.solve_ivp(derivative, (0, period), [psi_s.real, psi_s.imag, 0, 0], max_step=period / 400).y[:, -1]
        last = current(start + speed * period, y[0] + 1j * y[1])
        ends = np.array([i_dq, np.exp(-1j * (start + speed * period)) * last])
        line = np.linspace(0.0, 1.0, 4001)
        straight = np.mean(
            [taken((1 - s) * i_dq * np.exp(1j * start) + s * last) for s in 0.5 * (line[1:] + line[:-1])]
        )
        windows = OneWindow(
            angle=np.array([[start, start + speed * period]]),
            period=np.array([period]),
            duration=np.array([period]),
            drop_scale=np.ones(1),
            i_dq=np.stack([ends.real, ends.imag], axis=-1)[None],
        )
        psi = (magnet[0] + 2e-3 * ends.real + 3e-3j * ends.imag)[None]
        found = between_samples.between_samples(model, estimate, windows, psi)[0]
        expected = y[2] + 1j * y[3] - period * straight
        assert abs(found - expected) < 0.1 * abs(expected)  # the drop's step falls within one of the parts


def test_a_window_of_several_samples_is_the_sum_of_its_parts(monkeypatch):
    """Up to the drop of a straight current, whose ends lie at each sample, or at every fourth one."""
    model, estimate = linear_machine([0.1, 0.0], np.diag([2e-3, 2e-3]), 0.4, 3.0)

    def course(share):
        return 0.2 + share, 3.0 - 2.0j + share * (1.0 + 4.0j)

    def integral(first, samples):
        """Of so many of the four samples in which the machine turns by 1 rad, from one of them on."""
        angle, i_dq = course(np.array([first, first + samples]) / 4)
        windows = OneWindow(
            angle=angle[None], period=np.array([2e-4]), duration=np.array([samples * 2e-4]), drop_scale=np.ones(1),
            i_dq=np.stack([i_dq.real, i_dq.imag], axis=-1)[None],
        )  # fmt: skip
        return between_samples.between_samples(model, estimate, windows, (0.1 + 2e-3 * i_dq)[None])[0]

    def straight(first, samples):
        angle, i_dq = course(np.array([first, first + samples]) / 4)
        line = np.interp(np.linspace(0.0, 1.0, 20_001), [0.0, 1.0], np.exp(1j * angle) * i_dq)
        drop = model.shapes(frames.phases(line)) @ estimate[model.phase_columns()][:, 0]
        return 2e-4 * samples * frames.space_vector(drop).mean()

    whole = integral(0, 4)
    assert sum(integral(k, 1) for k in range(4)) == pytest.approx(whole, rel=1e-3)
    monkeypatch.setattr(between_samples, "spacing", lambda _: 4)
    expected = sum(straight(k, 1) for k in range(4)) - straight(0, 4)
    assert abs(expected) > 0.1 * abs(whole)
    assert integral(0, 4) - whole == pytest.approx(expected, rel=1e-2)


_SETTLING = 30
"""Steps before the first sample."""


def held(steps, late, every):
    """Integrate a slow machine with R T / L = 0.3 in time; return its currents at every n-th step and what R takes.

    The voltages are held from one step to the next, the currents are sampled a share ``late`` of a step before.
    """
    resistance, inductance, speed, step, fine = 8.0, np.array([2e-3, 3e-3]), 100.0, 1e-4, 200

    def turned(x_dq, angle):
        return np.exp(1j * angle) * (x_dq[0] + 1j * x_dq[1])

    def current(psi_s, angle):
        psi = np.exp(-1j * angle) * psi_s - 0.1
        return np.array([psi.real, psi.imag]) / inductance

    first = np.array([2.0, -1.0])
    psi_s, taken, samples = complex(0.1 + inductance @ (first * [1, 1j])), 0j, []
    for k in range(-_SETTLING * fine, steps * fine + 1):
        angle = speed * step * (k / fine + _SETTLING)
        now = current(psi_s, angle)
        if k >= 0 and k % (every * fine) == 0:
            samples.append((angle, now, taken))
        if (k - round(late * fine)) % fine == 0 or k == -_SETTLING * fine:
            wanted = first + np.array([3.0, 4.0]) * (k / fine + _SETTLING) / steps
            u_s = turned(
                resistance * now + speed * np.array([0.0, 0.1]) + inductance * (wanted - now) / (3 * step), angle
            )
        middle = psi_s + 0.5 * step / fine * (u_s - resistance * turned(now, angle))
        half = angle + 0.5 * speed * step / fine
        by_middle = resistance * turned(current(middle, half), half)
        taken += step / fine * by_middle
        psi_s += step / fine * (u_s - by_middle)
    angles, currents, sums = (np.array(each) for each in zip(*samples, strict=True))
    return angles, currents, sums, (inductance, resistance, step * every)


@pytest.mark.parametrize(
    ("late", "every", "delay", "off"), [(0.0, 1, 0.0, 0.1), (0.5, 1, 0.5, 0.1), (0.0, 3, -1 / 3, 0.3)]
)
def test_the_decay_of_a_slow_machine_within_its_samples_is_counted(late, every, delay, off):
    """Before, the current was straight at few degrees per sample, which cost 1 % of the flux at this resistance."""
    angles, currents, sums, (inductance, resistance, period) = held(90, late, every)
    i_s = np.exp(1j * angles) * (currents @ [1, 1j])
    expected = sums[-1] - sums[0] - resistance * period * (i_s[1:] + i_s[:-1]).sum() / 2
    model, estimate = linear_machine(np.array([0.1, 0.0]), np.diag(inductance), resistance, 0.0)
    ends = currents[[0, -1]]
    windows = OneWindow(
        angle=angles[None, [0, -1]], period=np.array([period]), duration=np.array([period * (len(angles) - 1)]),
        drop_scale=np.ones(1), i_dq=ends[None],
    )  # fmt: skip
    psi = (0.1 + (ends * inductance) @ [1, 1j])[None]
    found = between_samples.between_samples(model, estimate, windows, psi, delay)[0]
    assert abs(expected) > 1e-3 * np.abs(np.diff(psi)).max()
    assert abs(found - expected) < off * abs(expected)


@pytest.mark.cases
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("inductance", [3e-5, 1e-6, 0.0])
def test_what_cannot_be_found_by_iteration_is_left_out(inductance):
    """Resistance and drop divided by such inductances let the iteration diverge, as after a fit that is far off."""
    model, estimate = linear_machine(0.0, inductance * np.eye(2), 2.0, 20.0)
    angle = np.array([[0.0, 0.3]])
    windows = OneWindow(
        angle=angle, period=np.array([2e-4]), duration=np.array([2e-4]), drop_scale=np.ones(1),
        i_dq=np.array([[[5.0, 5.0], [5.0, 5.0]]]),
    )  # fmt: skip
    psi = np.array([[5.0 + 5.0j, 5.0 + 5.0j]]) * inductance + 1e-3
    found = between_samples.between_samples(model, estimate, windows, psi)[0]
    assert abs(found) < 2e-4 * (2 * 20.0 + 2.0 * 2 * 10.0)
