"""Work in threads: the results are those of a loop, in their order, and so are errors."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # so that its BLAS is loaded
from threadpoolctl import threadpool_info

from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics import threads
from drive_id.core.numerics.threads import one_blas_thread


def may_use(monkeypatch, cores, told=None):
    monkeypatch.setattr(threads.os, "sched_getaffinity", lambda _: range(cores), raising=False)
    if told is None:
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OMP_NUM_THREADS", told)


@pytest.mark.parametrize("cores", [1, 2, 64])
def test_results_come_in_the_order_of_the_items(monkeypatch, cores):
    may_use(monkeypatch, cores)
    assert threads.in_threads(lambda item: item**2, range(50)) == [item**2 for item in range(50)]
    assert threads.in_threads(str, []) == []


def test_two_really_work_at_once(monkeypatch):
    may_use(monkeypatch, 2)
    both = threading.Barrier(2, timeout=60.0)
    assert sorted(threads.in_threads(lambda _: both.wait(), range(2))) == [0, 1]


@pytest.mark.parametrize(
    ("told", "cores"), [(None, 8), ("3", 3), ("3,2", 3), ("99", 8), ("0", 1), ("", 8), ("many", 8), ("-1", 8)]
)
def test_a_fit_keeps_to_the_cores_that_it_was_given(monkeypatch, told, cores):
    may_use(monkeypatch, 8, told)
    assert threads.usable_cores() == cores


def test_where_no_affinity_is_known_all_cores_count(monkeypatch):
    may_use(monkeypatch, 8)
    monkeypatch.delattr(threads.os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(threads.os, "cpu_count", lambda: None)
    assert threads.usable_cores() == 1


def test_an_error_is_not_lost():
    def refuse(item):
        raise ValueError(item)

    with pytest.raises(ValueError, match="0"):
        threads.in_threads(refuse, range(9))


def blas_threads():
    return {
        library["filepath"]: library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_blas_has_one_thread_inside_and_as_many_as_before_outside():
    before = blas_threads()
    with one_blas_thread():
        assert set(blas_threads().values()) == {1}
        with one_blas_thread():
            pass
        assert set(blas_threads().values()) == {1}
    assert blas_threads() == before
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert blas_threads() == before


def test_a_body_that_outlives_another_leaves_no_limit_behind():
    before = blas_threads()
    inside, done = threading.Event(), threading.Event()

    def body():
        with one_blas_thread():
            inside.set()
            assert done.wait(60.0)

    other = threading.Thread(target=body)
    with one_blas_thread():
        other.start()
        assert inside.wait(60.0)
    done.set()
    other.join()
    assert blas_threads() == before


def test_a_limit_costs_less_than_five_milliseconds():
    with one_blas_thread():
        pass
    start = time.perf_counter()
    for _ in range(20):
        with one_blas_thread():
            pass
    assert (time.perf_counter() - start) / 20 < 5e-3


@pytest.mark.cases
@pytest.mark.parametrize("method", ["psm", "joint", "full"])
def test_a_fit_by_evidence_and_conclusion_has_one_thread(method, monkeypatch):
    """As the live node does it, without :func:`identify`."""
    from synthetic import reciprocal_flux, record

    from drive_id.core.accumulation.evidence import Evidence
    from drive_id.core.result.conclusion import conclude

    seen = []
    for name in ("linalg.eigh", "linalg.lstsq", "linalg.pinv", "linalg.solve"):
        original = getattr(np.linalg, name.split(".")[1])

        def watched(*arguments, original=original, name=name, **options):
            seen.append((name, set(blas_threads().values())))
            return original(*arguments, **options)

        monkeypatch.setattr(f"numpy.{name}", watched)
    settings = FitSettings(method, i_max=300.0, maps="reciprocal", harmonic_orders=(), search_orders=False)
    evidence = Evidence.within(settings, 300.0)
    evidence.add(record(reciprocal_flux, duration=2.0, noise=0.3))
    conclude(evidence, [])
    assert seen
    assert all(count == {1} for _, count in seen), seen
