"""Samples cut and put together again."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_id.errors import DataError
from drive_id.types import Samples


def numbered(count, run_starts=(0,), *, references=False):
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
    )


def assert_equal(ours, theirs):
    for field in fields(Samples):
        np.testing.assert_array_equal(getattr(ours, field.name), getattr(theirs, field.name), err_msg=field.name)


@given(starts=st.sets(st.integers(1, 29)), cuts=st.sets(st.integers(1, 29)), references=st.booleans(), data=st.data())
def test_parts_that_overlap_by_a_sample_within_runs_join_to_the_whole(starts, cuts, references, data):
    whole = numbered(30, [0, *sorted(starts)], references=references)
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


def test_parts_out_of_order_are_refused():
    whole = numbered(6)
    with pytest.raises(DataError, match="do not increase strictly"):
        Samples.joined([whole.part(3, 6), whole.part(0, 3)])
