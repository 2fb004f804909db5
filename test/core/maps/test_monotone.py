"""Monotone maps: convexity and reciprocity at random points, truth regained, options, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from drive_id.core.maps.monotone import fit_monotone
from drive_id.errors import ConfigurationError, DataError


@dataclass(frozen=True)
class Machine:
    """Gradient of ``psi_m i_d + leakage |i|^2 / 2 + a (sqrt(1 + u^2) - 1) + b log cosh v``, in closed form.

    u and v are combinations of the currents, so the axes cross-saturate.
    """

    magnet: float
    leakage: float
    a: float
    b: float
    u: np.ndarray
    v: np.ndarray

    @classmethod
    def random(cls, rng, rated):
        inductance = rng.uniform(0.5, 2.0) / rated
        turn = rng.uniform(-0.3, 0.3)
        u = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(1.0, 3.0) / rated
        v = np.array([-np.sin(turn), np.cos(turn)]) * rng.uniform(0.8, 2.0) / rated
        a, b = inductance / (u @ u), rng.uniform(0.3, 1.0) * inductance / (v @ v)
        return cls(rng.uniform(0, 0.5), 0.08 * inductance, a, b, u, v)

    def psi(self, i):
        x, y = i @ self.u, i @ self.v
        saturated = self.a * (x / np.sqrt(1 + x**2))[..., None] * self.u + self.b * np.tanh(y)[..., None] * self.v
        return saturated + self.leakage * i + np.array([self.magnet, 0.0])


def disc(rng, radius, count):
    angle, r = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def rms(x):
    return float(np.sqrt(np.mean(np.sum(x**2, axis=-1))))


def assert_monotone(found, rng, count=10_000):
    """Check symmetric, positive definite inductances by eigenvalues, and that fluxes rise between pairs of points."""
    points = rng.uniform(found.low, found.high, (count, 2))
    inductances = found.inductances(points)
    np.testing.assert_allclose(
        inductances[:, 0, 1], inductances[:, 1, 0], rtol=0, atol=1e-12 * np.abs(inductances).max()
    )
    eigenvalues = np.linalg.eigvalsh(inductances)
    assert eigenvalues.min() >= found.convexity.least_inductance * (1 - 1e-9) > 0
    psi = found.psi(points)
    rise = np.sum((psi[1:] - psi[:-1]) * np.diff(points, axis=0), axis=1)
    assert (rise >= 0.999 * found.convexity.least_inductance * np.sum(np.diff(points, axis=0) ** 2, axis=1)).all()


@pytest.mark.parametrize("seed", range(4))
def test_any_machine_gives_a_monotone_map_close_to_the_truth(seed):
    rng = np.random.default_rng(seed)
    rated = 10 ** rng.uniform(0, 2.7)
    machine = Machine.random(rng, rated)
    i = disc(rng, rated, (40, 150, 600, 2000)[seed])
    truth = machine.psi(i)
    noise = 0.01 * rms(truth - truth.mean(axis=0))
    found = fit_monotone(i, truth + noise * rng.standard_normal(truth.shape) / np.sqrt(2))
    assert_monotone(found, rng)
    elsewhere = disc(rng, rated, 2000)
    elsewhere = elsewhere[found.inside(elsewhere)]
    assert rms(found.psi(elsewhere) - machine.psi(elsewhere)) < 0.8 * noise
