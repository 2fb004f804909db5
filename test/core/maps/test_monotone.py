"""Monotone maps: convexity and reciprocity at random points, truth regained, options, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import isotonic_regression
from steady_state import disc_points

from drive_id.core.maps.monotone import fit_monotone
from drive_id.core.maps.support import Support
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


@pytest.mark.cases
@pytest.mark.parametrize("seed", range(4))
def test_any_machine_gives_a_monotone_map_close_to_the_truth(seed):
    rng = np.random.default_rng(seed)
    rated = 10 ** rng.uniform(0, 2.7)
    machine = Machine.random(rng, rated)
    i = disc_points(rng, rated, (40, 150, 400, 2000)[seed])
    truth = machine.psi(i)
    noise = 0.01 * rms(truth - truth.mean(axis=0))
    found = fit_monotone(
        i, truth + noise * rng.standard_normal(truth.shape) / np.sqrt(2), cells=(None, None, 14, 12)[seed]
    )
    assert_monotone(found, rng)
    elsewhere = disc_points(rng, rated, 2000)
    elsewhere = elsewhere[found.inside(elsewhere)]
    assert rms(found.psi(elsewhere) - machine.psi(elsewhere)) < (3.0, 1.0, 0.5, 0.4)[seed] * noise


def test_data_of_a_convex_spline_come_back_exactly():
    rng = np.random.default_rng(5)
    machine = Machine.random(rng, 80.0)
    truth = fit_monotone(i := disc_points(rng, 80.0, 500), machine.psi(i), smoothness=1e-6, cells=10)
    found = fit_monotone(i, truth.psi(i), smoothness=1e-11, cells=10)
    assert not found.convexity.active
    np.testing.assert_allclose(found.psi(i), truth.psi(i), atol=1e-4 * np.abs(truth.psi(i)).max())


def test_the_slopes_of_the_flux_are_the_inductances():
    rng = np.random.default_rng(6)
    machine = Machine.random(rng, 5.0)
    found = fit_monotone(i := disc_points(rng, 5.0, 60), machine.psi(i), smoothness=1e-5)
    at, step = rng.uniform(found.low + 0.1, found.high - 0.1, (7, 3, 2)), 1e-4
    for axis, way in enumerate(step * np.eye(2)):
        slope = (found.psi(at + way) - found.psi(at - way)) / (2 * step)
        np.testing.assert_allclose(found.inductances(at)[..., axis], slope, rtol=1e-4, atol=1e-6)


def test_a_folded_map_becomes_the_nearest_monotone_one():
    """Along i_d the raw flux falls; the best monotone function along the axis is that of isotonic regression."""
    axis = np.linspace(-10.0, 10.0, 41)
    fold = 0.4 * np.tanh(axis / 4) + 0.02 * axis - 0.25 * np.tanh((axis - 5.0) / 2)
    i = np.stack(np.meshgrid(axis, axis[::4], indexing="ij"), axis=-1).reshape(-1, 2)
    psi = np.column_stack([np.repeat(fold, 11), 0.03 * i[:, 1]])
    assert np.diff(fold).min() < 0
    found = fit_monotone(i, psi, smoothness=1e-8, cells=16)
    assert found.convexity.active
    assert_monotone(found, np.random.default_rng(7))
    best = isotonic_regression(fold).x
    least = rms((best - fold)[:, None])
    assert least <= found.convexity.residual_rms < 1.15 * least
    np.testing.assert_allclose(found.psi(i)[5::11, 0], best, atol=0.03)


def test_noise_on_a_saturated_machine_is_kept_from_folding_the_map():
    rng = np.random.default_rng(8)
    machine = Machine(0.3, 1e-4, 0.2, 0.3, np.array([0.5, 0.0]), np.array([0.0, 0.4]))
    i = disc_points(rng, 20.0, 400)
    psi = machine.psi(i) + 0.02 * rng.standard_normal(i.shape)
    found = fit_monotone(i, psi, smoothness=1e-8, cells=12)
    assert found.convexity.active
    assert_monotone(found, rng)
    assert found.convexity.residual_rms < 0.04
    assert rms(found.psi(i) - machine.psi(i)) < 0.025


@pytest.mark.cases
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_beyond_the_data_slopes_do_not_rise_and_the_flux_stays_near(noise):
    rng = np.random.default_rng(9)
    machine, radius = Machine.random(rng, 45.0), 45.0
    i = disc_points(rng, radius, 500)
    scale = rms(machine.psi(i) - machine.psi(i).mean(axis=0))
    found = fit_monotone(i, machine.psi(i) + noise * scale * rng.standard_normal(i.shape), cells=14)
    angle = np.linspace(0, 2 * np.pi, 37)[:-1]
    way = np.column_stack([np.cos(angle), np.sin(angle)])
    slopes = [np.einsum("nk,nkl,nl->n", way, found.inductances(r * radius * way), way) for r in (1.0, 1.1, 1.25)]
    assert (slopes[1] < 1.15 * slopes[0]).all()
    assert (slopes[2] < 1.15 * slopes[0]).all()
    assert (slopes[2] > 0).all()
    far = 1.25 * radius * way
    assert not found.inside(far).any()
    assert found.inside(0.9 * radius * way).all()
    assert (found.low <= -1.2 * radius).all()
    assert (found.high >= 1.2 * radius).all()
    assert rms(found.psi(far) - machine.psi(far)) < (0.05 + 3 * noise) * scale


def test_uncertain_points_count_less():
    rng = np.random.default_rng(11)
    machine = Machine.random(rng, 10.0)
    i = disc_points(rng, 10.0, 300)
    psi, sigma = machine.psi(i), np.full(i.shape, 1e-3)
    wrong = rng.permutation(300)[:30]
    psi[wrong], sigma[wrong] = psi[wrong] + 0.3, 1.0
    right = np.setdiff1d(np.arange(300), wrong)
    weighted, equal = (fit_monotone(i, psi, errors, cells=10) for errors in (sigma, None))
    assert rms(weighted.psi(i[right]) - psi[right]) < 2e-3
    assert rms(equal.psi(i[right]) - psi[right]) > 2e-2


def test_units_do_not_matter():
    rng = np.random.default_rng(12)
    i = disc_points(rng, 1.0, 50)
    psi = Machine.random(rng, 1.0).psi(i)
    found, scaled = fit_monotone(i, psi), fit_monotone(1e3 * i, 1e-3 * psi)
    np.testing.assert_allclose(scaled.psi(1e3 * i), 1e-3 * found.psi(i), rtol=1e-6, atol=1e-12)
    assert scaled.smoothness == pytest.approx(found.smoothness)
    assert scaled.convexity.least_inductance == pytest.approx(1e-6 * found.convexity.least_inductance, rel=1e-4)


GOOD = disc_points(np.random.default_rng(13), 10.0, 30)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda i, psi: (i[:7], psi[:7]), "made of 7 points"),
        (lambda i, psi: (i, psi[:, ::-1] * [1, -1]), "does not rise"),
        (lambda i, psi: (i, -psi), "psi_d does not rise with i_d"),
        (lambda i, psi: (i, np.where(i > 9, np.nan, psi)), "not finite"),
        (lambda i, psi: (i[:, :1] * [1, 2], psi), "on a line"),
        (lambda i, psi: (i, np.ones_like(psi)), "flux is constant"),
        (lambda i, psi: (i.T, psi), "shape"),
        (lambda i, psi: (i, psi, 0 * psi), "sigma is not positive"),
    ],
)
def test_points_of_which_no_map_follows_are_refused(change, said):
    with pytest.raises(DataError, match=said):
        fit_monotone(*change(GOOD, 0.01 * GOOD + [0.1, 0]))


@pytest.mark.parametrize(
    "option", [{"reach": 0.9}, {"margin": 0.0}, {"margin": 1.0}, {"smoothness": -1.0}, {"cells": 0}]
)
def test_options_out_of_range_are_refused(option):
    with pytest.raises(ConfigurationError):
        fit_monotone(GOOD, 0.01 * GOOD, **option)


def test_holes_and_the_outside_of_the_hull_are_no_support():
    rng = np.random.default_rng(14)
    i = disc_points(rng, 10.0, 2000)
    support = Support.of(np.vstack([i[np.hypot(*(i - [3, 2]).T) > 2], i[:5]]))
    assert support.contains(np.array([[-3.0, -2.0], [0, 0], [7.0, 6.0]])).tolist() == [True, True, True]
    assert support.contains(np.array([[3.0, 2.0], [8.0, 8.0]])).tolist() == [False, False]
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(7.0)), axis=-1).reshape(-1, 2)
    assert Support.of(grid).contains(np.array([[0.0, 0.0], [4.0, 6.0], [2.5, 0.0], [1.5, 3.5]])).all()
    assert not Support.of(grid).contains(np.array([[-0.01, 0.0], [4.0, 6.1]])).any()
