"""Parts of a recording: all of a short one, evenly spaced ones of a long one, never glued across what is missing."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import cut

from drive_id.core.accumulation.excerpts import SPAN, SPANS, Spans, shortened
from drive_id.core.signals.join import Piece
from drive_id.types import Samples

PERIOD = 1e-4


def counted(n, gaps):
    index = np.arange(n)
    gap = np.isin(index, gaps).cumsum()
    return Samples(
        stamp=100_000 * (index + 50 * gap),
        i_abc=np.repeat(index[:, None], 3, axis=1).astype(float),
        u_abc=np.repeat(-index[:, None], 3, axis=1).astype(float),
        angle=index.astype(float),
        speed=index + 0.5,
        sample_period=PERIOD,
        run_starts=np.union1d([0], gaps).astype(np.int64),
    )


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 900),
    gaps=st.lists(st.integers(1, 899), max_size=4, unique=True),
    part=st.sampled_from([3, 40, 1000]),
)
def test_what_is_kept(n, gaps, part):
    samples = counted(n, [gap for gap in gaps if gap < n])
    spans = Spans(50, 4)
    for start in range(0, n, part):
        spans.add(Piece(*cut(samples, start, min(start + part, n))))
    (found,) = spans.samples()
    index = found.angle.astype(int)
    for name in ("stamp", "i_abc", "u_abc", "speed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(samples, name)[index])
    inner = np.setdiff1d(np.arange(len(found)), found.run_starts)
    assert (np.diff(found.stamp)[inner - 1] == 100_000).all()
    assert spans.whole == (n <= 200)
    if spans.whole:
        np.testing.assert_array_equal(index, np.arange(n))
        assert found.run_starts.tolist() == samples.run_starts.tolist()
        return
    assert 100 <= len(found) <= 208  # a part that goes on has the sample before it, too
    numbers = np.unique(index[inner] // 50)
    assert len(numbers) <= 4
    assert numbers[-1] >= 0.4 * n // 50


def test_nothing_is_nothing():
    assert Spans().samples() == ()


def test_the_kept_parts_are_copies():
    samples = counted(10, [])
    spans = Spans(50, 4)
    spans.add(Piece(samples, False))
    assert not np.shares_memory(spans.samples()[0].i_abc, samples.i_abc)


def test_of_a_long_recording_in_memory_those_parts_are_simulated_that_are_kept_of_a_bag():
    long, spans = counted(SPAN * SPANS + 1, []), Spans()
    for start in range(0, len(long), 50_000):
        spans.add(Piece(*cut(long, start, min(start + 50_000, len(long)))))
    np.testing.assert_array_equal(shortened(long).angle, spans.samples()[0].angle)
    assert len(shortened(long)) < len(long)
    assert shortened(short := long.part(0, SPAN * SPANS)) is short
