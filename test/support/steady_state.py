"""A drive in steady state, written differently from the fit: waveforms over a turn, then means, then noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drive_id.bench.machines import MACHINES
from drive_id.core.steady.operating_data import OperatingData

TURN = np.arange(720) * (2 * np.pi / 720) + 1e-3
SHIFTS = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])


@dataclass(frozen=True)
class LinearDrive:
    """A machine without saturation."""

    resistance: float = 0.05
    psi_pm: float = 0.08
    l_d: float = 0.4e-3
    l_q: float = 1.1e-3
    i_max: float = 100.0

    def flux(self, i_d, i_q, theta):
        return self.psi_pm + self.l_d * i_d + 0 * theta, self.l_q * i_q + 0 * theta


def machine(name):
    return MACHINES[name]


def mean_flux(drive, i_dq):
    """Average the fluxes over the rotor position."""
    psi = drive.flux(i_dq[:, :1], i_dq[:, 1:], TURN[::6])
    return np.column_stack([part.mean(axis=1) for part in psi])


def mean_drop(i_dq, curve):
    """Average the drop in d and q over a turn of sinusoidal currents."""
    out = []
    for i_d, i_q in i_dq:
        angles = TURN[:, None] - SHIFTS
        drop = curve(i_d * np.cos(angles) - i_q * np.sin(angles))
        d = 2 / 3 * np.sum(drop * np.cos(angles), axis=1)
        q = -2 / 3 * np.sum(drop * np.sin(angles), axis=1)
        out.append([d.mean(), q.mean()])
    return np.array(out)


def steady_voltage(drive, i_dq, speed, curve):
    psi = mean_flux(drive, i_dq)
    u_d = drive.resistance * i_dq[:, 0] - speed * psi[:, 1]
    u_q = drive.resistance * i_dq[:, 1] + speed * psi[:, 0]
    return np.column_stack([u_d, u_q]) + mean_drop(i_dq, curve)


def disc_points(rng, radius, count, first=0.0, last=2 * np.pi, least=0.0):
    r = radius * np.sqrt(rng.uniform(least**2, 1, count))
    angle = rng.uniform(first, last, count)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def telemetry(
    drive,
    i_dq,
    speed,
    curve: Callable[[np.ndarray], np.ndarray] = np.zeros_like,
    *,
    rng: np.random.Generator,
    samples: int = 10,
    rate: float = 10.0,
    noise: float = 0.002,
) -> OperatingData:
    """Dwell at each point for some samples, of which the first is disturbed by the change; white noise on all."""
    u_dq = steady_voltage(drive, i_dq, speed, curve)
    i, u, w = (np.repeat(values, samples, axis=0) for values in (i_dq, u_dq, speed))
    first = np.arange(len(w)) % samples == 0
    u = u + 0.2 * np.abs(u_dq).max() * first[:, None] * rng.standard_normal(u.shape)
    i = i + noise * np.abs(i_dq).max() * rng.standard_normal(i.shape)
    u = u + noise * np.abs(u_dq).max() * rng.standard_normal(u.shape)
    w = w + noise / 2 * np.abs(speed).max() * rng.standard_normal(w.shape)
    return OperatingData(i, u, w, np.arange(len(w)) / rate)
