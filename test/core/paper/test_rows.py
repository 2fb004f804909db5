"""The kernel of cross products against the dense rows, where trajectories are smooth and where they are not."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_oracles import dense_rows

from drive_id.core import frames
from drive_id.core.maps.flux_models import TensorSpline
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.bspline import Axis
from drive_id.core.paper.regression import RegressionSums
from drive_id.core.paper.rows import FLUX, sample_integrals
from drive_id.types import Samples

MODEL = TensorSpline(Axis(-100, 100, 7), Axis(-80, 120, 9))


def wild(n, seed, step, speed):
    """Currents that wander by so many amperes from sample to sample, also beyond the model."""
    rng = np.random.default_rng(seed)
    i_dq = np.clip(np.cumsum(rng.normal(0, step, (n, 2)), axis=0), -130, 130)
    angle = rng.uniform(-np.pi, np.pi, n)
    return Samples(
        stamp=100_000 * np.arange(n),
        i_abc=frames.to_abc(i_dq, angle) + rng.normal(0, 1, (n, 1)),
        u_abc=rng.normal(0, 100, (n, 3)),
        angle=angle,
        speed=rng.normal(0, speed, n),
        sample_period=1e-4,
    )


def expected(samples, left_out):
    integrals = sample_integrals(samples, slice(0, len(samples)), MODEL, TanhShape(), left_out)
    z = dense_rows(integrals, MODEL.parameters)[integrals.valid].reshape(-1, FLUX + MODEL.parameters)
    return z.T @ z, 2 * int(integrals.valid.sum()), int((~integrals.inside).sum())


@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([2, 3, 5, 6, 50, 301]),
    seed=st.integers(0, 10_000),
    step=st.sampled_from([0.0, 0.5, 10.0, 100.0]),
    speed=st.sampled_from([0.0, 100.0, 3000.0]),
    leaving=st.booleans(),
)
def test_the_kernel_sums_what_the_rows_give(n, seed, step, speed, leaving):
    samples = wild(n, seed, step, speed)
    left_out = np.random.default_rng(seed).random(n) < 0.2 * leaving
    information = RegressionSums(MODEL, TanhShape())
    information.add(samples, left_out=left_out)
    gram, rows, outside = expected(samples, left_out)
    scale = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    largest = max(scale.max(), 1e-300)
    rounding = 1e-13 * np.sqrt(largest)  # rows are differences of basis values of the order of one
    assert np.abs(information.total - gram).max(initial=0) <= 1e-12 * largest + rounding
    assert (information.rows, information.outside) == (rows, outside)
    np.testing.assert_array_equal(information.total, information.total.T)
