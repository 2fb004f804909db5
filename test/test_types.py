"""Samples cut and put together again."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.errors import DataError, NonFiniteError
from drive_id.types import SCALARS, Samples


def numbered(count, run_starts=(0,), *, references=False, scalars=()):
    n = np.arange(count)
    three = n[:, None] + np.array([0.1, 0.2, 0.3])
    return Samples(
        stamp=n * 100_000,
        i_abc=three,
        u_abc=-three,
        angle=0.01 * n,
        speed=np.full(count, 100.0),
        sample_period=1e-4,
        run_starts=np.array(run_starts),
        i_dq_reference=three[:, :2] + 5 if references else None,
        **{name: 100.0 * k + n for k, name in enumerate(scalars)},
    )


def assert_equal(ours, theirs):
    for field in fields(Samples):
        np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name), err_msg=field.name)


def test_what_was_checked_cannot_be_changed():
    given = numbered(10, [0, 4], scalars=SCALARS[:1])
    arrays = {name: getattr(given, name).copy() for name in ("stamp", "i_abc", "u_abc", "angle", "speed", SCALARS[0])}
    starts = np.array([0, 4])
    samples = Samples(**arrays, run_starts=starts, sample_period=1e-4)
    for values in (*arrays.values(), starts):
        values[:] = 99
    assert_equal(samples, given)
    for part in (samples, samples.part(2, 8), samples.part(2, 8, copy=True), Samples.joined([samples])):
        for name in (*arrays, "run_starts"):
            with pytest.raises(ValueError, match="read-only"):
                getattr(part, name)[0] = 0
    assert np.shares_memory(replace(samples, speed=given.speed).i_abc, samples.i_abc)  # without a copy


@given(
    starts=st.sets(st.integers(1, 29)),
    cuts=st.sets(st.integers(1, 29)),
    references=st.booleans(),
    scalars=st.sets(st.sampled_from(SCALARS)),
    data=st.data(),
)
def test_parts_that_overlap_by_a_sample_within_runs_join_to_the_whole(starts, cuts, references, scalars, data):
    whole = numbered(30, [0, *sorted(starts)], references=references, scalars=scalars)
    bounds = [0, *sorted(cuts), 30]
    continues = [k > 0 and first not in starts for k, first in enumerate(bounds[:-1])]
    copy = data.draw(st.booleans())
    parts = [
        whole.part(first - goes_on, last, copy=copy)
        for first, last, goes_on in zip(bounds[:-1], bounds[1:], continues, strict=True)
    ]
    assert_equal(Samples.joined(parts, continues), whole)
    assert parts[0].stamp.base is not whole.stamp or not copy


def test_joining_without_continuing_begins_a_run_each_time():
    whole = numbered(10, [0, 4])
    joined = Samples.joined([whole.part(0, 6), whole.part(6, 10)])
    assert joined.run_starts.tolist() == [0, 4, 6]


def test_references_are_unknown_in_parts_without():
    whole = numbered(6, references=True)
    joined = Samples.joined([whole.part(0, 2), replace(whole.part(2, 6), i_dq_reference=None)])
    assert np.isnan(joined.i_dq_reference[2:]).all()
    np.testing.assert_array_equal(joined.i_dq_reference[:2], whole.i_dq_reference[:2])


def test_optional_signals_are_unknown_in_parts_without():
    whole = numbered(6, scalars=("shaft_torque",))
    joined = Samples.joined([replace(whole.part(0, 2), shaft_torque=None), whole.part(2, 6)])
    assert np.isnan(joined.shaft_torque[:2]).all()
    np.testing.assert_array_equal(joined.shaft_torque[2:], whole.shaft_torque[2:])
    assert joined.dc_link_voltage is None
    assert "with shaft torque" in repr(whole)


def test_optional_signals_may_be_unknown_but_not_infinite_or_of_another_length():
    whole = numbered(6)
    replace(whole, dc_link_voltage=np.full(6, np.nan))
    with pytest.raises(NonFiniteError, match="dc_link_voltage holds infinite values"):
        replace(whole, dc_link_voltage=np.array([1.0, 2, np.inf, 4, 5, 6]))
    with pytest.raises(DataError, match=r"shaft_torque has shape \(5,\) where 6 stamps need \(6,\)"):
        replace(whole, shaft_torque=np.zeros(5))


def test_chosen_samples_keep_their_runs():
    whole = numbered(10, [0, 4], references=True, scalars=("winding_temperature",))
    kept, begins = np.ones(10, bool), np.zeros(10, bool)
    kept[[5, 6]] = False
    begins[[0, 4, 7]] = True
    chosen = whole.chosen(kept, begins)
    assert chosen.run_starts.tolist() == [0, 4, 5]
    assert_equal(chosen, Samples.joined([whole.part(0, 4), whole.part(4, 5), whole.part(7, 10)]))


def test_parts_out_of_order_are_refused():
    whole = numbered(6)
    with pytest.raises(DataError, match="do not increase strictly"):
        Samples.joined([whole.part(3, 6), whole.part(0, 3)])


@pytest.mark.parametrize("name", ["i_abc", "u_abc", "angle", "speed"])
@pytest.mark.parametrize(("value", "said"), [(1e160, "larger than 1e\\+39"), (-1e60, "larger"), (np.inf, "infinite")])
def test_values_whose_squares_overflow_are_refused(name, value, said):
    whole = numbered(6)
    array = getattr(whole, name).copy()
    array[3] = value
    with pytest.raises(NonFiniteError, match=rf"{name} holds 1 sample .*{said}"):
        replace(whole, **{name: array})
    array[3] = np.finfo(np.float32).max  # what a message can hold is judged by the checks of a fit
    replace(whole, **{name: array})
