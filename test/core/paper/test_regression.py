"""The production regression against the plain dense one, and the properties of its accumulation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from dense_oracle import DenseOracle
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from numpy_oracles import dense_rows
from synthetic import record, tanh_drop

from drive_id.core import frames
from drive_id.core.maps.flux_models import Polynomial, TensorSpline
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.bspline import Axis
from drive_id.core.paper.regression import CHUNK, RegressionSums
from drive_id.core.paper.rows import FLUX, sample_integrals
from drive_id.core.paper.solver import solve


@pytest.fixture(scope="module")
def coarse():
    """Two seconds at 1 kHz with noise and an inverter: enough to fill the disc, few enough for the dense oracle."""
    return record(drop=tanh_drop, noise=0.3, duration=2.0, period=1e-3)


@pytest.fixture(scope="module")
def model(coarse):
    i_dq = frames.to_dq(coarse.i_abc, coarse.angle)
    low, high = i_dq.min(axis=0), i_dq.max(axis=0)
    return TensorSpline(Axis(low[0], high[0], 8), Axis(low[1], high[1], 8))


@pytest.fixture(scope="module")
def oracle(coarse, model):
    return DenseOracle(coarse, (model.d.low, model.q.low), (model.d.high, model.q.high), 8)


def test_rows_agree_with_the_dense_oracle(coarse, model, oracle):
    integrals = sample_integrals(coarse, slice(0, len(coarse)), model, TanhShape())
    ours = dense_rows(integrals, model.parameters)
    theirs = np.concatenate([oracle.rows[..., :2], oracle.rhs[..., None], oracle.rows[..., 2:]], axis=-1)
    largest = np.abs(theirs).max(axis=(0, 1))
    seen = largest > 0
    assert np.all(np.abs(ours - theirs).max(axis=(0, 1))[seen] <= 1e-9 * largest[seen])
    assert not ours[..., ~seen].any()


@pytest.mark.parametrize("with_inverter", [False, True])
def test_solution_agrees_with_the_dense_oracle_inside_the_disc(coarse, model, oracle, with_inverter):
    information = RegressionSums(model, TanhShape())
    information.add(coarse)
    solution = solve(information.total, information.rows, with_inverter)
    resistance, voltage_error, gamma = oracle.solve(with_inverter)
    axis = np.linspace(-300, 300, 61)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    rows = model.rows(grid[np.hypot(*grid.T) <= 300])
    ours, theirs = rows.dot(solution.gamma), rows.dot(gamma)
    assert np.abs(ours - theirs).max() <= 1e-6 * np.abs(theirs).max()
    assert solution.resistance == pytest.approx(resistance, rel=1e-6)
    assert solution.voltage_error == pytest.approx(voltage_error, rel=1e-6, abs=1e-12)


def gram(model, samples):
    integrals = sample_integrals(samples, slice(0, len(samples)), model, TanhShape())
    z = dense_rows(integrals, model.parameters)[integrals.valid].reshape(-1, FLUX + model.parameters)
    return z.T @ z


@pytest.mark.parametrize("kind", ["spline", "polynomial"])
def test_accumulated_products_are_those_of_the_rows(coarse, model, kind):
    """Columns of a polynomial are the same for all samples."""
    model = model if kind == "spline" else Polynomial(3, 300.0)
    information = RegressionSums(model, TanhShape())
    information.add(coarse)
    expected = gram(model, coarse)
    assert np.abs(information.total - expected).max() <= 1e-13 * np.abs(expected).max()
    assert information.rows == 2 * (len(coarse) - 1)


@hypothesis_settings(max_examples=20, deadline=None)
@given(pieces=st.lists(st.integers(1, 1999), max_size=6, unique=True))
def test_pieces_that_share_their_end_samples_add_up_to_the_whole(coarse, model, pieces):
    whole, parts = RegressionSums(model, TanhShape()), RegressionSums(model, TanhShape())
    whole.add(coarse)
    edges = [0, *sorted(pieces), len(coarse) - 1]
    for start, stop in pairwise(edges):
        parts.add(coarse.part(start, stop + 1))
    assert np.abs(whole.total - parts.total).max() <= 1e-12 * np.abs(whole.total).max()
    assert whole.rows == parts.rows


def test_nothing_is_integrated_across_the_start_of_a_run(coarse, model):
    information, split = RegressionSums(model, TanhShape()), RegressionSums(model, TanhShape())
    information.add(replace(coarse, run_starts=np.array([0, 700])))
    split.add(coarse.part(0, 700))
    split.add(coarse.part(700, len(coarse)))
    assert information.rows == split.rows == 2 * (len(coarse) - 2)
    assert np.abs(information.total - split.total).max() <= 1e-13 * np.abs(split.total).max()


def test_samples_beyond_the_model_are_left_out_and_counted(coarse):
    small = TensorSpline(Axis(-100, 100, 8), Axis(-100, 100, 8))
    information = RegressionSums(small, TanhShape())
    information.add(coarse)
    i_dq = frames.to_dq(coarse.i_abc, coarse.angle)
    within = (np.abs(i_dq) <= 100).all(axis=1)
    pairs = within[1:] & within[:-1]
    assert (information.rows, information.outside) == (2 * pairs.sum(), (~pairs).sum())
    expected = gram(small, coarse)
    assert np.abs(information.total - expected).max() <= 1e-13 * np.abs(expected).max()


def test_the_number_of_blocks_stays_bounded_and_their_sum_exact(coarse, model):
    information = RegressionSums(model, TanhShape())
    information.block_duration, information.max_blocks = 0.01, 8
    information.add(coarse)
    expected = gram(model, coarse)
    assert 4 <= len(information.blocks) <= 8
    assert np.abs(information.blocks.sum(axis=0) - expected).max() <= 1e-12 * np.abs(expected).max()


def test_recordings_longer_than_a_chunk_lose_no_row():
    samples = record(duration=(2 * CHUNK + 5) * 1e-4, period=1e-4)
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    model = TensorSpline(Axis(*np.sort(i_dq[:, 0])[[0, -1]], 6), Axis(*np.sort(i_dq[:, 1])[[0, -1]], 6))
    information = RegressionSums(model, TanhShape())
    done = []
    information.add(samples, done.append)
    assert information.rows == 2 * (len(samples) - 1)
    assert done[-1] == len(samples)
    expected = gram(model, samples)
    assert np.abs(information.total - expected).max() <= 1e-12 * np.abs(expected).max()
