from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from drive_id.core import frames

angles = st.floats(-50.0, 50.0)
amperes = st.floats(-1e3, 1e3)
ALONG_A = np.array([[1.0, -0.5, -0.5]])


def clarke_park(angle):
    """Return the paper's matrix K(phi), (..., 2, 3)."""
    axes = np.asarray(angle)[..., None] - np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])
    return 2 / 3 * np.stack([np.cos(axes), -np.sin(axes)], axis=-2)


@given(angle=angles, d=amperes, q=amperes)
def test_park_round_trip(angle, d, q):
    i_dq = np.array([[d, q]])
    i_abc = frames.to_abc(i_dq, np.array([angle]))
    np.testing.assert_allclose(frames.to_dq(i_abc, np.array([angle])), i_dq, atol=1e-10)
    assert i_abc.sum() == pytest.approx(0.0, abs=1e-9)


@given(angle=angles, a=amperes, b=amperes, c=amperes)
def test_matrix_and_space_vector_are_the_same_transformation(angle, a, b, c):
    i_abc = np.array([[a, b, c]])
    np.testing.assert_allclose(clarke_park(angle) @ i_abc[0], frames.to_dq(i_abc, np.array([angle]))[0], atol=1e-9)


@given(angle=angles, common=amperes)
def test_a_zero_sequence_does_not_show(angle, common):
    assert np.abs(frames.to_dq(np.full((1, 3), common), np.array([angle]))).max() < 1e-9


def test_conventions_of_the_paper():
    matrix = frames.to_dq(np.eye(3), np.full(3, 0.3)).T
    shift = 2 * np.pi / 3
    expected = [
        [np.cos(0.3), np.cos(0.3 - shift), np.cos(0.3 + shift)],
        [-np.sin(0.3), -np.sin(0.3 - shift), -np.sin(0.3 + shift)],
    ]
    np.testing.assert_allclose(matrix, 2 / 3 * np.array(expected), rtol=1e-14)


@pytest.mark.parametrize("turn", [0.0, 1e-12, -1e-6, 1e-3, 0.05, 0.19, 0.2, 0.21, -0.7, 2.0, -9.0, 40.0])
def test_moments_of_the_rotation_against_quadrature(turn):
    held = frames.integrate_held(ALONG_A, np.zeros(1), np.array([turn]), 1.0)
    rising = frames.integrate_linear(np.array([[0.0], [1.0]]) * ALONG_A, np.zeros(1), np.array([turn]), 1.0)
    for value, power in ((held @ [1, 1j], 0), (rising @ [1, 1j], 1)):
        real = quad(lambda s, p=power: s**p * np.cos(turn * s), 0, 1, epsabs=1e-14)[0]
        imag = quad(lambda s, p=power: -(s**p) * np.sin(turn * s), 0, 1, epsabs=1e-14)[0]
        assert value[0] == pytest.approx(real + 1j * imag, abs=1e-13)


@pytest.mark.parametrize("turn", [1e-9, -3e-6, 1e-4, 0.02, 0.19, 0.21, 0.3])
def test_the_odd_moment_keeps_its_digits_at_low_speed(turn):
    """Against its Taylor series about the middle of the sample, summed in exact rational numbers."""
    ends = np.array([[-0.5], [0.5]]) * ALONG_A
    found = frames.integrate_linear(ends, np.zeros(1), np.array([turn]), 1.0) @ [1, 1j]
    half = Fraction(turn) / 2
    exact = sum((-1) ** k * half ** (2 * k + 1) / (factorial(2 * k + 1) * 2 * (2 * k + 3)) for k in range(8))
    odd = (found[0] * np.exp(0.5j * turn)).imag
    assert odd == pytest.approx(-float(exact), rel=1e-7, abs=1e-16)


def test_sample_integrals_against_quadrature_of_the_matrix():
    rng = np.random.default_rng(1)
    u_abc, i_abc = rng.normal(size=(1, 3)), rng.normal(size=(2, 3))
    angle, speed, period = np.array([0.7]), np.array([900.0]), 2e-4
    nodes, gauss = np.polynomial.legendre.leggauss(20)
    tau = (nodes + 1) / 2 * period
    matrices = clarke_park(angle + speed * tau)
    held = sum(w * period / 2 * m @ u_abc[0] for w, m in zip(gauss, matrices, strict=True))
    linear = sum(
        w * period / 2 * m @ (i_abc[0] + (i_abc[1] - i_abc[0]) * t / period)
        for w, m, t in zip(gauss, matrices, tau, strict=True)
    )
    np.testing.assert_allclose(frames.integrate_held(u_abc, angle, speed, period)[0], held, rtol=1e-13)
    np.testing.assert_allclose(frames.integrate_linear(i_abc, angle, speed, period)[0], linear, rtol=1e-13)
