"""References that arrive block by block against the join that has all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from whole_join import whole_join

from drive_id.core.signals.held_references import HeldReferences
from drive_id.core.signals.signal import Signal

STEP = 100_000


def signals(n):
    stamp = STEP * np.arange(n)
    values = np.zeros((n, 3))
    return [Signal(name, stamp, values[:, :width], 1e-4) for name, width in (("/i", 3), ("/u", 3), ("/r", 2))]


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_references_ahead_of_time_some_of_them_taken_back(data):
    n, ahead = 400, 60
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    ratio = data.draw(st.sampled_from([1, 3]))
    late = data.draw(st.sampled_from([0, 7_000, 20_000]))
    stamp = ratio * STEP * np.arange(n // ratio) + late
    values = rng.normal(size=(len(stamp), 2))
    blocks = [slice(k, k + 20) for k in range(0, len(stamp), 20)]
    if data.draw(st.booleans()):  # a stop: what was published ahead is taken back
        del blocks[len(blocks) // 2]
        values[len(stamp) // 3] = np.nan
    messages = [(int(stamp[b][0]), stamp[b], values[b]) for b in blocks]
    if data.draw(st.booleans()):
        at = len(messages) // 3
        due = messages[at][0] - 30 * STEP
        messages.insert(at, (due, due + ratio * STEP * np.arange(20), rng.normal(size=(20, 2))))
    whole = Signal(
        "/ref", np.concatenate([m[1] for m in messages]), np.concatenate([m[2] for m in messages]), ratio * 1e-4
    )
    expected = whole_join(*signals(n), whole).samples.i_dq_reference
    held, found, number = HeldReferences(ratio * 1e-4), [], 0
    part = data.draw(st.sampled_from([30, 100]))
    for start in range(0, n, part):
        clock = STEP * np.arange(start, min(start + part, n))
        while number < len(messages) and messages[number][0] <= clock[-1] + ahead * STEP:
            held.add(Signal("/ref", *messages[number][1:], ratio * 1e-4))
            number += 1
        at = held.at(clock, 1e-4)
        found.append(np.full((len(clock), 2), np.nan) if at is None else at)
    np.testing.assert_array_equal(np.concatenate(found), expected)


def test_nothing_is_known_before_the_first():
    held = HeldReferences(1e-4)
    clock = STEP * np.arange(5)
    assert held.at(clock, 1e-4) is None
    held.add(Signal("/ref", clock[:0], np.zeros((0, 2)), 1e-4))
    held.add(Signal("/ref", clock, np.full((5, 2), np.nan), 1e-4))
    assert held.at(clock, 1e-4) is None
    held.add(Signal("/ref", clock, np.ones((5, 2)), 1e-4))
    assert held.at(clock, 1e-4) == pytest.approx(np.ones((5, 2)))
    np.testing.assert_array_equal(held.at(clock + 6 * STEP, 1e-4), np.full((5, 2), np.nan))
