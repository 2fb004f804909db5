"""References are inside the disc to the last bit, and their steps are bounded, whatever is asked for."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drive_id.core.experiment.limits import approach, follow, inside_disc

anything = st.floats(allow_nan=True, allow_infinity=True)
wild = arrays(np.float64, (20, 2), elements=anything)
tame = arrays(np.float64, (20, 2), elements=st.floats(-1e6, 1e6))
point = arrays(np.float64, 2, elements=st.floats(-1e6, 1e6))
radii = st.floats(1e-3, 1e6)


@given(wild, radii)
def test_inside_the_disc_to_the_last_bit(i_dq, i_max):
    single = inside_disc(i_dq, i_max)
    d, q = single.astype(np.longdouble).T
    assert np.all(d * d + q * q <= np.longdouble(i_max) ** 2)
    assert np.all(np.hypot(*single.T) <= np.float32(i_max))


@given(tame, radii)
def test_what_is_inside_stays_where_it_is(i_dq, i_max):
    radius = np.hypot(*i_dq.T)
    i_dq = i_dq * (0.999 * i_max / np.maximum(radius, 0.999 * i_max))[:, None]
    np.testing.assert_allclose(inside_disc(i_dq, i_max), i_dq, rtol=2e-7, atol=1e-44)


@given(point, wild, st.floats(1e-4, 1e6))
def test_steps_are_bounded(start, targets, step):
    out = follow(start, targets, step)
    assert out.shape == targets.shape
    steps = np.hypot(*np.diff(out, axis=0, prepend=start[None, :]).T)
    assert steps.max() <= step * (1 + 1e-9) + 1e-9


def test_reachable_targets_are_met():
    targets = np.column_stack((np.linspace(0, 1, 50), np.linspace(0, -1, 50)))
    np.testing.assert_array_equal(follow(np.zeros(2), targets, 0.03), targets)
    np.testing.assert_allclose(follow(np.array([0.0, 0.5]), targets, 0.1)[-10:], targets[-10:])


@given(point, point, st.floats(1e-3, 1e3), st.integers(1, 50))
def test_a_way_is_straight_bounded_and_ends(start, end, step, count):
    way = approach(start, end, step, count)
    assert len(way) <= count
    steps = np.hypot(*np.diff(way, axis=0, prepend=start[None, :]).T)
    assert np.all(steps <= step * (1 + 1e-9) + 1e-9)
    if len(way) < count:
        assert np.array_equal(way[-1] if len(way) else start, end)
    distance = np.hypot(*(end - start))
    if len(way):
        np.testing.assert_allclose(
            np.hypot(*(end - way[-1])), max(0.0, distance - len(way) * step), atol=1e-6 * (1 + distance)
        )
