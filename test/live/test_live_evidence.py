"""Live samples as evidence: the offline fit and its verdicts, from snapshots that leave the stream alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import record

from drive_id.core import frames
from drive_id.core.checks.plausibility import Plausibility
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import identify
from drive_id.core.signals.join import Piece, joined
from drive_id.core.signals.signal import Signal
from drive_id.errors import ConfigurationError, DriveIdError, EmptyTopicError
from drive_id.live.live_evidence import LiveEvidence
from drive_id.live.warm_up import warm_up

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
    np.testing.assert_allclose(one.gamma, other.gamma, rtol=0, atol=1e-9 * np.abs(other.gamma).max())
    assert one.resistance == pytest.approx(other.resistance, rel=1e-9)
    assert one.voltage_error == pytest.approx(other.voltage_error, rel=1e-9, abs=1e-9)
    assert one.sigma_resistance == pytest.approx(other.sigma_resistance, rel=1e-6)
    for name in ("samples_read", "samples_used", "gaps", "rows", "rank", "unseen", "coverage"):
        assert getattr(one.report, name) == getattr(other.report, name), name
    np.testing.assert_array_equal(one.flux_map.inside, other.flux_map.inside)


@pytest.mark.parametrize("method", ["psm", "joint"])
def test_snapshots_are_the_offline_fit_of_what_was_there(samples, method):
    live = LiveEvidence(SETTINGS, 10.0)
    feed(live, samples, 0, 12_345)
    first = live.snapshot(method)
    feed(live, samples, 12_345)
    second = live.snapshot(method)
    settings = replace(SETTINGS, method=method)
    part = replace(samples, **{n: getattr(samples, n)[:12_345] for n in ("stamp", "i_abc", "u_abc", "angle", "speed")})
    for snapshot, recording in ((second, samples), (first, part)):  # the older one last: later samples are not in it
        found, expected = snapshot.identify(), identify([recording], settings)
        assert_same(found, expected)
        assert found.report.mad_d == pytest.approx(expected.report.mad_d, rel=1e-6)
        assert snapshot.join.last_stamp == recording.stamp[-1]


def test_the_validation_is_the_last_seconds_as_one_recording(samples):
    live = LiveEvidence(SETTINGS, 0.5)
    feed(live, samples)
    kept = live.snapshot().validation()
    assert 0.5 <= kept.duration <= 0.8
    assert kept.run_starts.tolist() == [0]
    assert kept.stamp[-1] == samples.stamp[-1]
    tail = slice(len(samples) - len(kept), None)
    np.testing.assert_array_equal(kept.stamp, samples.stamp[tail])
    np.testing.assert_array_equal(kept.u_abc, samples.u_abc[tail])


def test_pieces_with_gaps_are_put_together():
    part = record(duration=0.05)
    later = replace(part, stamp=part.stamp + 10**9, run_starts=np.array([0, 100]))
    last = {name: getattr(later, name)[-1:] for name in ("stamp", "i_abc", "u_abc", "angle", "speed")}
    more = replace(part, stamp=part.stamp + 2 * 10**9, run_starts=np.array([0, 200]))
    begun = {n: np.concatenate([last[n], getattr(more, n)]) for n in last}
    going_on = replace(more, **begun, run_starts=np.array([0, 201]))
    together = joined([Piece(part, True), Piece(later, False), Piece(going_on, True)])
    assert together.run_starts.tolist() == [0, 500, 600, 1200]
    assert len(together) == 1500


def test_memory_does_not_grow(samples):
    live = LiveEvidence(SETTINGS, 0.2)
    sizes = []
    for again in range(3):
        feed(live, replace(samples, stamp=samples.stamp + again * 3 * 10**9))
        kept = sum(len(piece.samples) for piece in live._recent) + sum(len(t.stamp) for t in live.join.tracks)
        sizes.append(kept)
    assert max(sizes) < 6000
    assert live.snapshot().identify().report.gaps == 2


def spoiled(samples):
    rng = np.random.default_rng(0)
    zero = np.zeros(len(samples))
    spike = samples.i_abc.copy()
    spike[7000] = 1e6, -5e5, -5e5
    yield replace(samples, speed=zero, angle=zero)
    yield replace(samples, speed=samples.speed / 4)
    yield replace(samples, angle=-samples.angle)
    yield replace(samples, i_abc=rng.normal(size=samples.i_abc.shape))
    yield replace(samples, i_abc=spike)
    yield replace(samples, u_abc=np.zeros_like(samples.u_abc))
    yield replace(samples, i_abc=samples.i_abc * 0.01)


def test_live_samples_get_the_errors_of_recorded_ones(samples):
    for wrong in spoiled(samples):
        with pytest.raises(DriveIdError) as expected:
            identify([wrong], SETTINGS)
        live = LiveEvidence(SETTINGS, 1.0)
        feed(live, wrong)
        snapshot = live.snapshot()
        with pytest.raises(type(expected.value)) as found:
            snapshot.identify()
        if "stay below" not in str(expected.value):  # that amplitude is known to 2 %
            assert str(found.value) == str(expected.value)


def test_the_usual_amplitude_is_known_within_two_percent(samples):
    plausibility = Plausibility()
    plausibility.add(samples)
    amplitude = np.hypot(*frames.to_dq(samples.i_abc, samples.angle).T)
    assert plausibility._usual() == pytest.approx(np.quantile(amplitude, 0.999), rel=0.023)


def test_settings_that_shape_the_sums_forget_the_samples(samples):
    live = LiveEvidence(FitSettings(method="joint"), 1.0)
    feed(live, samples, 0, 3000)
    with pytest.raises(ConfigurationError, match="i_max is not set"):
        live.snapshot()
    assert live.configure(SETTINGS)
    feed(live, samples, 0, 3000)
    assert not live.configure(replace(SETTINGS, method="psm"))
    assert live.snapshot().identify().method == "psm"
    assert live.configure(replace(SETTINGS, splines_d=9))
    with pytest.raises(EmptyTopicError):
        live.snapshot().identify()
    with pytest.raises(ConfigurationError, match="method is 'best'"):
        live.snapshot("best")


def test_settings_of_the_solution_keep_the_samples(samples):
    """What full has gathered serves all methods, there and back, and any calibration."""
    full = replace(SETTINGS, method="full", harmonic_orders=(6,))
    live = LiveEvidence(full, 1.0)
    feed(live, samples, 0, len(samples))
    for change in ({"method": "joint"}, {"method": "full"}, {"maps": "free"}, {"calibrate_delay": False}):
        assert not live.configure(replace(live.settings, **change)), change
    assert live.snapshot().identify().method == "full"
    assert live.configure(replace(full, harmonic_orders=(6, 12)))
    assert live.configure(replace(full, temperatures=(20.0,)))


def test_live_samples_are_the_first_recording_of_the_conditions(samples):
    warm = LiveEvidence(replace(SETTINGS, method="full", harmonic_orders=(), temperatures=(100.0,)), 1.0)
    cold = LiveEvidence(replace(SETTINGS, method="full", harmonic_orders=()), 1.0)
    for live in (warm, cold):
        feed(live, samples, 0, len(samples))
    hot, as_is = (live.snapshot().identify().resistance for live in (warm, cold))
    assert hot * (1 + 3.93e-3 * 80.0) == pytest.approx(as_is, rel=1e-3)
    warm.configure(replace(warm.settings, temperatures=(20.0, 30.0)))
    with pytest.raises(ConfigurationError, match="temperatures has 2 entries for 1 recordings"):
        warm.snapshot()


@pytest.mark.parametrize("model", ["spline", "polynomial", "linear"])
def test_warming_up_leaves_nothing_to_compile(model):
    from drive_id.core.paper import row_products, spline_rows
    from drive_id.core.validation import current_simulation

    add_rows = spline_rows.add_spline_rows if model == "spline" else row_products.add_rows
    warm_up(FitSettings("joint", flux_model=model))
    before = len(add_rows.signatures), len(current_simulation._simulate.signatures)
    assert min(before) >= 1
    live = LiveEvidence(replace(SETTINGS, flux_model=model), 1.0)
    feed(live, record(duration=1.0))
    live.snapshot().identify()
    assert (len(add_rows.signatures), len(current_simulation._simulate.signatures)) == before
