"""Live samples as evidence: the offline fit and its verdicts, from snapshots that leave the stream alone."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from loaded_kernels import loaded
from synthetic import reciprocal_flux, record, spline_free_current

from drive_id.core import frames
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.coverage import Visits, disc_coverage
from drive_id.core.result.identify import identify
from drive_id.core.signals.join import Piece, joined
from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError, DataError, EmptyTopicError
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.write.writer import write_recording
from drive_id.fitting import streaming
from drive_id.fitting.fit import fit_bags
from drive_id.fitting.sources import Sources
from drive_id.live.identification import live_evidence
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import Identifier
from drive_id.live.identification.live_evidence import LiveEvidence
from drive_id.live.identification.warm_up import warm_up
from drive_id.result.pictures import plots
from drive_id.types import Samples, silent

SETTINGS = FitSettings("joint", i_max=300.0)


@pytest.fixture(scope="module")
def samples():
    return record(duration=2.0, noise=0.3)


def feed(live, samples, start=0, stop=None, block=100):
    stop = len(samples) if stop is None else stop
    resolver = np.column_stack((samples.angle, samples.speed))
    for at in range(start, stop, block):
        part = slice(at, min(at + block, stop))
        for section, values in enumerate((samples.i_abc, samples.u_abc, resolver)):
            live.add(section, Signal(f"/{section}", samples.stamp[part], values[part], samples.sample_period))


def assert_same(one, other):
    psi = [found.flux_map.psi[found.flux_map.inside] for found in (one, other)]
    np.testing.assert_allclose(*psi, rtol=0, atol=1e-9 * np.abs(psi[1]).max())
    assert one.resistance == pytest.approx(other.resistance, rel=1e-9)
    assert one.voltage_error == pytest.approx(other.voltage_error, rel=1e-9, abs=1e-9)
    assert one.sigma_resistance == pytest.approx(other.sigma_resistance, rel=1e-6)
    for name in ("samples_read", "samples_used", "gaps", "rows", "rank", "unseen", "coverage"):
        assert getattr(one.report, name) == getattr(other.report, name), name
    np.testing.assert_array_equal(one.flux_map.inside, other.flux_map.inside)


@pytest.mark.cases
@pytest.mark.parametrize("method", ["psm", "joint"])
def test_snapshots_are_the_offline_fit_of_what_was_there(samples, method):
    live = LiveEvidence(SETTINGS)
    feed(live, samples, 0, 12_345)
    first = live.snapshot(method)
    feed(live, samples, 12_345)
    second = live.snapshot(method)
    settings = replace(SETTINGS, method=method)
    older = (first, samples.part(0, 12_345))  # the last one: later samples are not in it
    for snapshot, recording in ((second, samples), older):
        found, expected = snapshot.conclude().drive, identify([recording], settings)
        assert_same(found, expected)
        # such a map folds at some points, and a simulation that passes there amplifies rounding
        assert found.report.mad_d == pytest.approx(expected.report.mad_d, rel=5e-3)
        assert snapshot.join.last_stamp == recording.stamp[-1]


def test_optional_signals_arrive_beside_the_others(samples, tmp_path):
    """At a rate of their own, from the middle on; the excerpt holds them, the fit is the same."""
    identifier = Identifier(IdentificationSettings(output_directory=str(tmp_path)), SETTINGS)
    for at in range(0, len(samples), 1000):
        feed(identifier.live, samples, at, at + 1000)
        if at >= 10_000:
            values = np.arange(at, at + 1000, 100, dtype=np.float32)
            message = encode_block(int(samples.stamp[at]), at // 100, 1e-2, [values], "drive")
            identifier.receive_scalar("shaft_torque", message)
    identifier.receive_scalar("shaft_torque", b"\0")
    values = identifier.health("", [()] * 3).values
    assert (values["shaft_torque: samples"], values["unreadable messages"]) == ("100", "1")
    snapshot = identifier.live.snapshot("")
    assert_same(snapshot.conclude().drive, identify([samples], SETTINGS))
    (kept,) = snapshot.validation()
    assert len(kept) == len(samples)
    np.testing.assert_allclose(kept.shaft_torque[11_000:19_901], np.arange(11_000, 19_901))


def resting(on, duration, period=2e-4):
    """Record a drive that turns throughout and carries current in the intervals ``on``, s, only."""

    def current(t, i_max):
        share = sum(np.clip(20 * np.minimum(t - start, end - t), 0, 1) for start, end in on)
        return spline_free_current(t, i_max) * np.sin(np.pi / 2 * share[..., None]) ** 2

    return record(duration=duration, noise=0.3, period=period, current=current)


@pytest.mark.accuracy
@pytest.mark.parametrize("seconds", [4.0, 12.0])
def test_the_mad_is_taken_over_the_trajectory_not_over_the_rest_behind_it(tmp_path, monkeypatch, seconds):
    """A stream that goes on for 20 s at rest, where every map looks good, against the bag of the trajectory.

    The model is too simple for the machine, so that the MAD is not that of the noise.
    """
    settings = replace(SETTINGS, flux_model="linear")
    for module in (live_evidence, streaming):
        monkeypatch.setattr(module, "Spans", partial(Spans, 1 << 12, 8))
    stream = resting([(-1.0, seconds)], seconds + 20.0)
    trajectory = stream.part(0, round(seconds / stream.sample_period))
    write_recording(tmp_path / "bag", trajectory)
    expected = fit_bags(Sources([tmp_path / "bag"]), None, settings)
    live = LiveEvidence(settings)
    feed(live, stream, block=500)
    snapshot = live.snapshot()
    report, truth = snapshot.conclude().drive.report, expected.drive.report
    assert (report.mad_d, report.mad_q) == pytest.approx((truth.mad_d, truth.mad_q), rel=0.03)
    (kept,) = snapshot.validation()
    assert len(kept) == pytest.approx(sum(len(part) for part in expected.excerpts), rel=0.05)
    assert len(kept) <= 8 << 12
    assert kept.stamp[-1] <= trajectory.stamp[-1] + 0.3e9
    visits = Visits(np.linspace(-315, 315, 65), np.linspace(-315, 315, 65))
    visits.add(frames.to_dq(kept.i_abc, kept.angle))
    assert disc_coverage(visits.i_d, visits.i_q, visits.inside(60.0, 60.0), 300.0) > 0.9


def test_the_live_picture_shows_the_trajectory(tmp_path, monkeypatch):
    """And not the dot at which the drive rests by then."""
    drawn = []
    monkeypatch.setattr(plots, "result_pictures", lambda _found, samples, _title, **_: drawn.extend(samples) or {})
    stream = resting([(-1.0, 3.0)], 8.0)
    settings = IdentificationSettings(output_directory=str(tmp_path), picture=True)
    identifier = Identifier(settings, SETTINGS)
    feed(identifier.live, stream, block=500)
    reply = identifier.job([], "")(silent)
    assert reply.success, reply.message
    (kept,) = drawn
    assert kept.duration == pytest.approx(3.0, abs=0.3)
    assert np.hypot(*frames.to_dq(kept.i_abc, kept.angle).T).max() > 295.0


def test_a_rest_between_two_trajectories_divides_the_excerpt_only():
    stream = resting([(-1.0, 2.0), (4.0, 6.0)], 6.0)
    live = LiveEvidence(SETTINGS)
    feed(live, stream)
    snapshot = live.snapshot()
    assert snapshot.conclude().drive.report.gaps == 0
    (kept,) = snapshot.validation()
    assert len(kept.run_starts) == 2
    assert kept.duration == pytest.approx(4.0, abs=0.5)
    np.testing.assert_array_equal(kept.stamp, stream.stamp[np.isin(stream.stamp, kept.stamp)])


def test_pieces_with_gaps_are_put_together():
    part = record(duration=0.05)
    later = replace(part, stamp=part.stamp + 10**9, run_starts=np.array([0, 100]))
    more = replace(part, stamp=part.stamp + 2 * 10**9, run_starts=np.array([0, 200]))
    going_on = replace(Samples.joined([later.part(499, 500), more]), run_starts=np.array([0, 201]))
    together = joined([Piece(part, True), Piece(later, False), Piece(going_on, True)])
    assert together.run_starts.tolist() == [0, 500, 600, 1200]
    assert len(together) == 1500


def test_memory_does_not_grow(samples, monkeypatch):
    monkeypatch.setattr(live_evidence, "Spans", partial(Spans, 1000, 4))
    live = LiveEvidence(SETTINGS)
    sizes = []
    for again in range(3):
        feed(live, replace(samples, stamp=samples.stamp + again * 3 * 10**9))
        kept = sum(len(part) for part in live.snapshot().validation())
        sizes.append(kept + sum(len(track.stamp) for track in live.join.tracks))
    assert max(sizes) < 6000
    assert live.snapshot().conclude().drive.report.gaps == 2


@pytest.mark.parametrize("method", ["joint", "full"])
def test_a_jump_of_the_resolver_is_refused_on_every_way_in(samples, tmp_path, method):
    """Live it was once accepted."""
    settings = replace(SETTINGS, method=method, harmonic_orders=())
    angle = samples.angle.copy()
    angle[7000:] += 2.0
    jumping = replace(samples, angle=np.angle(np.exp(1j * angle)))
    live = LiveEvidence(settings)
    feed(live, jumping)
    write_recording(tmp_path / "bag", jumping)
    ways = (
        lambda: identify([jumping], settings),
        lambda: fit_bags(Sources([tmp_path / "bag"]), None, settings),
        lambda: fit_bags(Sources([tmp_path / "bag"]), None, replace(settings, i_max=None)),
        live.snapshot().conclude,
    )
    for way in ways:
        with pytest.raises(DataError, match=r"jumps in 1 place, the first at 0\.700000 s by 2\.00 rad") as found:
            way()
        assert type(found.value) is DataError


def test_a_new_i_max_that_the_sums_resolve_keeps_the_samples(samples):
    live = LiveEvidence(replace(SETTINGS, i_max=320.0))
    feed(live, samples)
    assert not live.configure(replace(SETTINGS, i_max=300.0))
    assert live.evidence.coverage() == pytest.approx(live.snapshot().conclude().drive.report.coverage, abs=0.05)
    for i_max in (250.0, 0.0):
        assert live.snapshot(i_max=i_max).conclude().drive.i_max == (i_max or 300.0)
    with pytest.raises(ConfigurationError, match=r"i_max is 330 A, and the live samples are summed for 320 A"):
        live.snapshot(i_max=330.0)
    assert live.configure(replace(SETTINGS, i_max=150.0)), "cells too wide for so small a disc"


def test_settings_that_shape_the_sums_forget_the_samples(samples):
    live = LiveEvidence(FitSettings(method="joint"))
    feed(live, samples, 0, 3000)
    with pytest.raises(ConfigurationError, match="i_max is not set"):
        live.snapshot()
    assert live.configure(SETTINGS)
    feed(live, samples, 0, 5000)
    assert not live.configure(replace(SETTINGS, method="psm"))
    assert live.snapshot().conclude().drive.method == "psm"
    assert live.configure(replace(SETTINGS, splines_d=9))
    with pytest.raises(EmptyTopicError):
        live.snapshot().conclude()
    with pytest.raises(ConfigurationError, match="method is 'best'"):
        live.snapshot("best")


def test_settings_of_the_solution_keep_the_samples(samples):
    """What full has gathered serves all methods, there and back, and any calibration."""
    full = replace(SETTINGS, method="full", harmonic_orders=(6,))
    live = LiveEvidence(full)
    feed(live, samples, 0, len(samples))
    for change in ({"method": "joint"}, {"method": "full"}, {"maps": "free"}, {"calibrate_delay": False}):
        assert not live.configure(replace(live.settings, **change)), change
    assert live.snapshot().conclude().drive.method == "full"
    assert live.configure(replace(full, harmonic_orders=(6, 12)))
    assert live.configure(replace(full, temperatures=(20.0,)))


@pytest.mark.accuracy
def test_live_samples_are_the_first_recording_of_the_conditions():
    warm = LiveEvidence(replace(SETTINGS, method="full", harmonic_orders=(), temperatures=(100.0,)))
    feed(warm, record(reciprocal_flux, resistance=0.02, duration=2.0, noise=0.3))
    assert warm.snapshot().conclude().drive.resistance * (1 + 3.93e-3 * 80.0) == pytest.approx(0.02, rel=5e-3)
    warm.configure(replace(warm.settings, temperatures=(20.0, 30.0)))
    with pytest.raises(ConfigurationError, match="temperatures has 2 entries for 1 recording:"):
        warm.snapshot()


@pytest.mark.parametrize("model", ["spline", "polynomial", "linear"])
def test_warming_up_leaves_nothing_to_compile(model):
    warm_up(FitSettings("joint", flux_model=model))
    before = loaded()
    assert "rows.add_rows" in {name for name, _ in before}
    live = LiveEvidence(replace(SETTINGS, flux_model=model))
    feed(live, record(duration=1.0))
    assert live.evidence.samples > 1000
    assert loaded() == before
