from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.core.maps.flux_models import Polynomial, TensorSpline
from drive_id.core.numerics.bspline import Axis
from drive_id.errors import ConfigurationError

SPLINE = TensorSpline(Axis(-300.0, 250.0, 8), Axis(-200.0, 310.0, 11))
MODELS = [SPLINE, Polynomial(1, 300.0), Polynomial(5, 300.0)]
currents = st.tuples(st.floats(-300, 250), st.floats(-200, 310)).map(lambda pair: np.array([pair]))


def naive_spline(x, knots, index, degree):
    """Cox and de Boor's recursion, as printed in the textbooks."""
    if degree == 0:
        return 1.0 if knots[index] <= x < knots[index + 1] else 0.0
    left = (x - knots[index]) / (knots[index + degree] - knots[index]) * naive_spline(x, knots, index, degree - 1)
    right = (knots[index + degree + 1] - x) / (knots[index + degree + 1] - knots[index + 1])
    return left + right * naive_spline(x, knots, index + 1, degree - 1)


@given(i_dq=currents)
def test_spline_values_against_the_naive_recursion(i_dq):
    dense = SPLINE.rows(np.minimum(i_dq, [249.99, 309.99])).dense(SPLINE.parameters)[0]
    i_d, i_q = np.minimum(i_dq, [249.99, 309.99])[0]
    knots_d = -300 + 550 / 5 * np.arange(-3, 9)
    knots_q = -200 + 510 / 8 * np.arange(-3, 12)
    by_d = [naive_spline(i_d, knots_d, k, 3) for k in range(8)]
    by_q = [naive_spline(i_q, knots_q, k, 3) for k in range(11)]
    np.testing.assert_allclose(dense[0, :88], np.outer(by_d, by_q).ravel(), atol=1e-12)
    np.testing.assert_array_equal(dense[0, :88], dense[1, 88:])
    assert not dense[0, 88:].any()
    assert not dense[1, :88].any()


@given(i_dq=currents)
def test_partition_of_unity(i_dq):
    np.testing.assert_allclose(SPLINE.rows(i_dq).value.sum(axis=-1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("model", MODELS)
@given(i_dq=currents)
def test_slopes_are_the_derivatives(model, i_dq):
    inner = np.clip(i_dq, [-299, -199], [249, 309])
    for axis, rows in enumerate(model.slope_rows(inner)):
        step = np.zeros(2)
        step[axis] = 1e-4
        difference = (
            model.rows(inner + step).dense(model.parameters) - model.rows(inner - step).dense(model.parameters)
        ) / 2e-4
        np.testing.assert_allclose(rows.dense(model.parameters), difference, atol=1e-8)


def test_beyond_the_range_is_told_and_taken_at_the_edge():
    beyond = np.array([[-301.0, 0.0], [0.0, 311.0], [0.0, 0.0]])
    np.testing.assert_array_equal(SPLINE.contains(beyond), [False, False, True])
    at_edge = SPLINE.rows(np.array([[-300.0, 0.0], [0.0, 310.0], [0.0, 0.0]]))
    np.testing.assert_allclose(
        SPLINE.rows(beyond).dense(SPLINE.parameters), at_edge.dense(SPLINE.parameters), atol=1e-14
    )
    assert MODELS[1].contains(beyond).all()


def test_a_polynomial_of_first_degree_is_the_linear_machine():
    model = Polynomial(1, 1.0)
    i_dq = np.array([[10.0, -4.0]])
    rows = model.rows(i_dq).dense(model.parameters)[0]
    np.testing.assert_array_equal(rows, [[1, -4, 10, 0, 0, 0], [0, 0, 0, 1, -4, 10]])


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda: Axis(1.0, 1.0, 8), "is empty"),
        (lambda: Axis(0.0, float("nan"), 8), "is empty"),
        (lambda: Axis(0.0, 1.0, 3), "too few"),
    ],
)
def test_nonsense_is_refused(make, fragment):
    with pytest.raises(ConfigurationError, match=fragment):
        make()
