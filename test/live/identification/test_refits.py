"""Fits of live samples in the background: when they run, what they cost, and what a reply takes over from them."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from synthetic import reciprocal_flux, record
from test_live_evidence import feed

from drive_id.core.fit_settings import FitSettings
from drive_id.live.identification import refits as refits_module
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.live_evidence import LiveEvidence, Snapshot
from drive_id.live.identification.refits import MOST_GROWTH, Refits, of_snapshot
from drive_id.live.worker import Cancelled, Worker
from drive_id.types import silent

JOINT = FitSettings("joint", i_max=300.0)
FULL = FitSettings(i_max=300.0)
SHARE = 0.25


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture(scope="module")
def samples():
    return record(reciprocal_flux, duration=5.0, noise=0.3)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def refits(clock):
    return Refits(IdentificationSettings(refit_share=SHARE), clock)


def fed(samples, count, settings=JOINT):
    live = LiveEvidence(settings)
    feed(live, samples, 0, count)
    return live


@pytest.fixture(scope="module")
def full(samples):
    """Method full over the first 90 % of the samples, over all, and over all with the selection of the first."""
    share = 9 * len(samples) // 10
    live = fed(samples, share, FULL)
    first = of_snapshot(live.snapshot(), None)
    feed(live, samples, share)
    return first, of_snapshot(live.snapshot(), None), of_snapshot(live.snapshot(), first.conclusion)


@pytest.mark.accuracy
def test_a_fit_that_takes_a_selection_over_is_the_whole_fit_of_all_samples(full):
    first, anew, again = full
    sigma = np.stack([anew.drive.flux_map.sigma_d, anew.drive.flux_map.sigma_q])
    maps = [np.stack([fit.drive.flux_map.psi_d, fit.drive.flux_map.psi_q]) for fit in full]
    by_less, by_selection = (np.sqrt(np.nanmean(((psi - maps[1]) / sigma) ** 2)) for psi in (maps[0], maps[2]))
    assert by_selection < 0.4, "in standard errors"
    assert by_selection < 0.6 * by_less
    assert again.drive.resistance == pytest.approx(anew.drive.resistance, abs=0.3 * anew.drive.sigma_resistance)
    read = [fit.drive.report.samples_read for fit in full]
    assert read[0] < read[1] == read[2]
    assert (first.selected, anew.selected, again.selected) == (True, True, False)


@pytest.mark.accuracy
def test_taken_over_on_the_same_samples_it_is_the_same_fit(samples):
    live = fed(samples, len(samples), FULL)
    first = of_snapshot(live.snapshot(), None)
    again = of_snapshot(live.snapshot(), first.conclusion)
    for name in ("psi_d", "psi_q", "sigma_d", "sigma_q"):
        np.testing.assert_allclose(
            getattr(again.drive.flux_map, name), getattr(first.drive.flux_map, name), rtol=1e-9, atol=1e-12
        )
    assert again.drive.resistance == pytest.approx(first.drive.resistance, rel=1e-9)
    assert again.drive.sigma_resistance == pytest.approx(first.drive.sigma_resistance, rel=1e-9)
    assert again.drive.report == first.drive.report
    assert repr(again.drive.calibrations) == repr(first.drive.calibrations)  # NaN is not NaN
    assert again.drive.statements == first.drive.statements


def test_standard_errors_taken_over_are_those_of_fewer_samples(full):
    first, anew, again = full
    assert again.drive.sigma_resistance == pytest.approx(first.drive.sigma_resistance, rel=1e-9)
    assert anew.drive.sigma_resistance < 1.1 * again.drive.sigma_resistance


def test_no_fit_without_new_samples_and_never_two_of_the_same(samples, refits, clock):
    live = LiveEvidence(JOINT)
    assert refits.job(live) is None
    feed(live, samples, 0, 20_000)
    job = refits.job(live)
    found = job(silent)
    refits.take(found)
    assert found.drive.report.samples_read == 20_000
    clock.now += 1000.0
    assert refits.job(live) is None
    feed(live, samples, 20_000, 40_000)
    assert refits.job(live) is not None
    assert refits.job(live) is None


def test_the_fit_is_that_of_a_request(samples, refits):
    live = fed(samples, 30_000)
    found = refits.job(live)(silent)
    requested = live.snapshot().conclude().drive
    np.testing.assert_array_equal(found.drive.flux_map.psi_d, requested.flux_map.psi_d)
    np.testing.assert_array_equal(found.drive.flux_map.sigma_q, requested.flux_map.sigma_q)
    assert found.drive.report == requested.report


def test_fits_keep_to_their_share_of_a_core(samples, refits, clock, monkeypatch):
    spent = [3.0, 5.0]
    monkeypatch.setattr(refits_module.time, "thread_time", lambda: spent.pop(0) if spent else 0.0)
    live = fed(samples, 20_000)
    started = clock.now
    refits.job(live)(silent)
    feed(live, samples, 20_000, 50_000)
    clock.now = started + 2.0 / SHARE - 0.1
    assert refits.job(live) is None
    clock.now = started + 2.0 / SHARE
    assert refits.job(live) is not None


def test_a_cheap_fit_is_made_once_a_second_at_most(samples, refits, clock):
    live = fed(samples, 10_000)
    refits.job(live)(silent)
    feed(live, samples, 10_000, 20_000)
    assert refits.job(live) is None
    clock.now += 1.0
    assert refits.job(live) is not None


def test_without_a_share_there_are_none(samples):
    assert Refits(IdentificationSettings(refit_share=0.0)).job(fed(samples, 20_000)) is None
    assert Refits(IdentificationSettings()).job(LiveEvidence(FitSettings())) is None


def test_a_selection_serves_a_little_growth_and_the_same_settings_only(samples, refits):
    live = fed(samples, 20_000)
    refits.take(refits.job(live)(silent))
    known = refits.earlier(JOINT, 20_000)
    assert known is not None
    assert refits.earlier(JOINT, int(MOST_GROWTH * 20_000)) is known
    assert refits.earlier(JOINT, int(MOST_GROWTH * 20_000) + 1) is None
    assert refits.earlier(JOINT, 19_999) is None
    assert refits.earlier(replace(JOINT, method="psm"), 20_000) is None
    refits.forget()
    assert refits.earlier(JOINT, 20_000) is None
    assert refits.values() == {}


def test_a_selection_is_renewed_before_it_is_too_old_for_a_request(samples, refits, clock):
    live = fed(samples, 20_000)
    refits.take(refits.job(live)(silent))
    clock.now += 1000.0
    feed(live, samples, 20_000, 21_000)
    assert refits.job(live) is None, "little is new, and nobody wants provisional maps"
    feed(live, samples, 21_000, 24_000)
    renewed = refits.job(live)(silent)
    assert renewed.selected
    assert renewed.samples < MOST_GROWTH * 20_000


def test_rests_do_not_make_a_selection_old(samples, refits, clock):
    still = replace(samples, i_abc=np.zeros_like(samples.i_abc), stamp=samples.stamp + 5 * 10**9)
    live = fed(samples, len(samples))
    refits.take(refits.job(live)(silent))
    feed(live, still)
    clock.now += 1000.0
    assert live.evidence.samples > 1.9 * len(samples)
    assert refits.job(live) is None
    assert refits.earlier(JOINT, refits_module.moving(live.evidence)) is not None


def test_provisional_maps_come_with_their_period_and_take_the_selection_over(samples, clock):
    refits = Refits(IdentificationSettings(refit_share=SHARE, provisional_map_period=300.0), clock)
    assert refits.publishes
    live = fed(samples, 20_000)
    refits.take(refits.job(live)(silent))
    feed(live, samples, 20_000, 21_500)
    clock.now += 299.0
    assert refits.job(live) is None
    clock.now += 1.0
    light = refits.job(live)(silent)
    assert not light.selected
    assert light.drive.report.samples_read == 21_500


def test_a_fit_that_is_refused_is_told_in_the_diagnostics(samples, tmp_path):
    still = replace(samples, angle=np.zeros(len(samples)), speed=np.zeros(len(samples)))
    identifier = Identifier(IdentificationSettings(output_directory=str(tmp_path)), JOINT)
    feed(identifier.live, still)
    assert identifier.refit()(silent) is None
    assert "without speed" in identifier.health("", [()] * 3).values["fit: error"]
    identifier.reset()
    assert "fit: error" not in identifier.health("", [()] * 3).values


@pytest.mark.accuracy
def test_a_reply_takes_over_and_covers_all_samples(samples, tmp_path):
    """And a request for another method changes nothing of what the background has found."""
    identifier = Identifier(IdentificationSettings(output_directory=str(tmp_path)), FULL)
    feed(identifier.live, samples, 0, 45_000)
    identifier.take(identifier.refit()(silent))
    feed(identifier.live, samples, 45_000)
    other = identifier.job([], "joint")(silent)
    assert other.success
    identifier.take(other.refit)
    reply = identifier.job([], "")(silent)
    assert reply.identification.report.samples_read == len(samples)
    assert reply.identification.method == "full"
    assert not reply.refit.selected
    identifier.take(reply.refit)
    values = identifier.health("", [()] * 3).values
    assert values["fit: samples"] == str(len(samples))
    assert float(values["fit: resistance [ohm]"]) == pytest.approx(reply.identification.resistance, rel=1e-5)
    assert float(values["fit: sigma of resistance [ohm]"]) > 0
    assert float(values["fit: median sigma of flux [%]"]) > 0
    assert float(values["fit: coverage"]) > 0.5


def test_a_provisional_map_says_so(samples, tmp_path):
    identifier = Identifier(IdentificationSettings(output_directory=str(tmp_path)), JOINT)
    feed(identifier.live, samples)
    reply = identifier.provisional(identifier.refit()(silent))
    assert reply.provisional
    assert reply.identification.method == "joint"
    assert reply.stamp == samples.stamp[-1]
    assert not list(tmp_path.iterdir()), "nothing is written"


def test_a_background_fit_ends_soon_when_it_is_cancelled(samples, refits):
    """It stays in its thread, and asks between pieces of work whether to go on."""
    live = fed(samples, len(samples), FULL)
    asked, threads = [], set()

    def tell(_what, _share):
        asked.append(1)
        threads.add(threading.get_ident())
        if len(asked) == 3:
            raise Cancelled

    with pytest.raises(Cancelled):
        refits.job(live)(tell)
    assert len(asked) == 3
    assert threads == {threading.get_ident()}
    assert refits.due > 100.0, "what it has cost until then counts"


def test_cancelling_a_worker_ends_the_job_and_the_next_one_runs():
    worker = Worker()
    going, results = threading.Event(), []

    def endless(tell):
        while True:
            tell("Turning", None)
            going.set()

    worker.start(endless, results.append)
    assert going.wait(10)
    worker.cancel()
    worker.start(lambda _: "next", results.append)  # at once: the cancelled one may still be about to end
    worker.stop(10)
    assert not worker.busy or results
    assert results in ([], ["next"])


def test_nothing_holds_the_samples_of_a_job_that_is_done(samples):
    import gc
    import weakref

    worker: Worker[None] = Worker()
    snapshot = fed(samples, 5000).snapshot()
    kept = weakref.ref(snapshot)
    job = Holding(snapshot)
    del snapshot
    done = threading.Event()
    worker.start(job, lambda _: done.set())
    del job
    assert done.wait(10)
    gc.collect()
    assert kept() is None


class Holding:
    """A job that holds a snapshot."""

    def __init__(self, snapshot: Snapshot):
        self.snapshot = snapshot

    def __call__(self, tell):
        tell("Holding", None)
