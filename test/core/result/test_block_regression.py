"""Standard errors under correlated residuals, by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.block_regression import BlockRegression


def series(rng, memory, count=1600):
    """Response, a column that swings, and a constant; the residuals are an autoregression."""
    noise = rng.standard_normal(count)
    for k in range(1, count):
        noise[k] += memory * noise[k - 1]
    column = np.cos(2 * np.pi * np.arange(count) / 16) * (1 + 0.3 * rng.standard_normal(count))
    return np.column_stack([3.0 * column + noise + 1.0, column, np.ones(count)])


@pytest.mark.accuracy
@pytest.mark.parametrize("memory", [0.0, 0.9, -0.5])
def test_intervals_cover_the_truth(memory):
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(400):
        found = BlockRegression.of_series(series(rng, memory), 0, [1, 2], 20)
        for column, true in ((1, 3.0), (2, 1.0)):
            value, sigma = found.estimate(column)
            inside.append(abs(value - true) < 1.96 * sigma)
    assert 0.90 < np.mean(inside) < 0.98


def test_rows_of_large_leverage_do_not_hide_their_errors():
    """Ten columns of heavy tails, told by thirty blocks: the solution follows the errors of the largest ones."""
    rng, blocks, block, columns = np.random.default_rng(6), 30, 8, 10
    inside = []
    for _ in range(300):
        chosen = np.repeat(rng.standard_t(3, (blocks, columns)), block, axis=0)
        response = chosen.sum(axis=1) + np.repeat(rng.standard_normal(blocks), block)
        data = np.column_stack([response, chosen])
        found = BlockRegression.of_series(data, 0, list(range(1, columns + 1)), 16, block=block)
        value, sigma = found.estimate(1)
        inside.append(abs(value - 1) < 1.96 * sigma)
    assert 0.90 < np.mean(inside) < 0.985  # 0.82 without


def test_what_repeats_fast_is_no_scatter():
    """An error of the model that swings with the experiment leaves the coefficients alone."""
    data = series(np.random.default_rng(1), 0.0)
    data[:, 0] += 5.0 * np.sin(2 * np.pi * np.arange(len(data)) / 40)
    found = BlockRegression.of_series(data, 0, [1, 2], 20)
    as_if_white = found.rms(found.coefficients, len(data)) / np.sqrt(len(data))
    assert found.estimate(2)[1] < 0.6 * as_if_white


def test_independent_errors_of_the_response_add_up():
    data = series(np.random.default_rng(2), 0.0)
    plain = BlockRegression.of_series(data, 0, [1], 20).estimate(1)[1]
    mode = 0.01 * data[:, 1]  # an error of 1 % of the column's own unit
    with_mode = BlockRegression.of_series(data, 0, [1], 20, (mode @ data[:, [1]])[None]).estimate(1)[1]
    assert with_mode == pytest.approx(np.hypot(plain, 0.01))


def test_collecting_is_the_transpose_of_interpolating():
    rng = np.random.default_rng(3)
    d, q, zero = np.linspace(-5, 5, 6), np.linspace(-4, 6, 9), np.zeros((6, 9))
    grid = FluxMap(d, q, zero, zero, zero, zero, np.ones((6, 9), bool))
    i_dq, weights, values = rng.uniform(-6, 7, (50, 2)), rng.standard_normal((50, 2)), rng.standard_normal((6, 9))
    by_samples = weights.T @ grid.sampled(values, *i_dq.T)
    np.testing.assert_allclose((grid.collected(weights, i_dq) * values[..., None]).sum(axis=(0, 1)), by_samples)
