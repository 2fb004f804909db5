"""Work in threads: the results are those of a loop, in their order, and so are errors."""

from __future__ import annotations

import threading

import pytest

from drive_id.core.numerics import threads


@pytest.mark.parametrize("processors", [None, 1, 2, 64])
def test_results_come_in_the_order_of_the_items(monkeypatch, processors):
    monkeypatch.setattr(threads.os, "cpu_count", lambda: processors)
    assert threads.in_threads(lambda item: item**2, range(50)) == [item**2 for item in range(50)]
    assert threads.in_threads(str, []) == []


def test_two_really_work_at_once(monkeypatch):
    monkeypatch.setattr(threads.os, "cpu_count", lambda: 2)
    both = threading.Barrier(2, timeout=60.0)
    assert sorted(threads.in_threads(lambda _: both.wait(), range(2))) == [0, 1]


def test_an_error_is_not_lost():
    def refuse(item):
        raise ValueError(item)

    with pytest.raises(ValueError, match="0"):
        threads.in_threads(refuse, range(9))
