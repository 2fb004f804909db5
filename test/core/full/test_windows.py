"""Windows against direct sums, whatever the pieces, gaps and periods of the samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import signal
from synthetic import record

from drive_id.core import frames
from drive_id.core.full.integrals import LAGS, Reached, integrated
from drive_id.core.full.windows import (
    LONGEST_WINDOW,
    MEASURED,
    SHIFTS,
    STRIDE,
    WINDOW_ANGLE,
    WINDOW_CURRENT,
    Terms,
    WindowCutter,
    Windows,
    interval,
    kept_of,
)
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.types import Samples

SHAPES = CapacitiveShapes.up_to(300.0)
NAMES = MEASURED


def cut(*pieces, continues=()):
    cutter, parts = WindowCutter(SHAPES), []
    for number, piece in enumerate(pieces):
        parts += list(cutter.cut(piece, continues=number in continues))
    return Windows.joined(parts + list(cutter.finish()))


@pytest.fixture(scope="module")
def samples():
    return record(duration=2.0, noise=0.5)


def test_a_window_holds_the_sums_between_its_ends(samples):
    windows = cut(samples)
    begin = np.rint(windows.time / samples.sample_period).astype(int)
    end = begin + np.rint(windows.duration / samples.sample_period).astype(int)
    i_s, u_s = frames.space_vector(samples.i_abc), frames.space_vector(samples.u_abc)
    period, balanced = samples.sample_period, frames.phases(i_s)
    for n in (0, 17, len(windows) - 1):
        a, b = begin[n], end[n]
        np.testing.assert_allclose(windows.voltage[n], period * u_s[a:b].sum(), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(windows.current[n], np.trapezoid(i_s[a : b + 1], dx=period), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(windows.angle[n], samples.angle[[a, b]])
        np.testing.assert_allclose(
            windows.i_dq[n], frames.to_dq(samples.i_abc[[a, b]], samples.angle[[a, b]]), atol=1e-10
        )
        for column, shift in enumerate(SHIFTS):
            np.testing.assert_allclose(windows.shifted[n, column], period * (u_s[b + shift] - u_s[a + shift]))
        fine = np.linspace(0.0, 1.0, 401)[:, None, None]
        lines = balanced[a:b] + fine * np.diff(balanced[a : b + 1], axis=0)
        expected = period * np.trapezoid(SHAPES(lines), dx=1 / 400, axis=0).sum(axis=0).T
        np.testing.assert_allclose(windows.shape[n], expected, rtol=1e-3, atol=1e-7)
        one, turn = np.ones_like(i_s), np.exp(1j * samples.angle)
        for effect, x in enumerate((1j * i_s, i_s.conj(), 1j * i_s.conj(), one, 1j * one, turn, 1j * turn)):
            step = 1e-4
            moved = [
                SHAPES.coarse.integrals(frames.phases(i_s + sign * step * x)[a : b + 1], period) for sign in (1, -1)
            ]
            slope = [frames.space_vector(y[None])[0] for y in (moved[0][-1] - moved[1][-1]) / (2 * step)]
            np.testing.assert_allclose(windows.sensed[n, :, effect], slope, atol=0.03 * np.abs(slope).max())
        if a:
            angle = samples.angle[a : b + 1]
            i_dq = frames.to_dq(samples.i_abc, samples.angle)
            i_abc = np.stack([frames.to_abc(i_dq[a - 1 : b], angle), frames.to_abc(i_dq[a : b + 1], angle)])
            lines = i_abc[:, :-1] + fine[..., None] * np.diff(i_abc, axis=1)
            then, now = period * np.trapezoid(SHAPES(lines)[..., :8:2], dx=1 / 400, axis=0).sum(axis=1)
            expected = [frames.space_vector(x[None])[0] for x in (now - then).T]
            np.testing.assert_allclose(windows.lag[n], expected, atol=1e-4 * period)


@pytest.mark.parametrize("continues", [False, True])
def test_one_pass_follows_the_samples(continues):
    """Against scipy's filter and numpy's unwrap, from the beginning of a run and from the middle of it."""
    part = record(duration=0.1, noise=0.5)
    part = dataclasses.replace(part, angle=np.angle(np.exp(1j * part.angle)))
    first, idle, before = 300 if continues else 0, np.zeros(len(part), np.bool_), Reached.nothing()
    if continues:
        before = integrated(part, idle, slice(0, first + 1), before, continues=False)[1]
    stretch = integrated(part, idle, slice(first, len(part)), before, continues=continues)[0]
    i_s, new, period = frames.space_vector(part.i_abc), slice(first + continues, None), part.sample_period
    i_dq = i_s * np.exp(-1j * part.angle)
    np.testing.assert_allclose(stretch.i_s, i_s[new], atol=1e-11)
    np.testing.assert_allclose(stretch.u_s, frames.space_vector(part.u_abc)[new], atol=1e-11)
    np.testing.assert_allclose(stretch.i_dq, i_dq[new], atol=1e-11)
    turned = np.unwrap(part.angle)
    np.testing.assert_allclose(stretch.turned, (turned - turned[0])[new], atol=1e-11)
    heat = 2 / 3 * period * np.cumsum(np.sum(part.i_abc**2, axis=1) * (np.arange(len(part)) > 0))
    np.testing.assert_allclose(stretch.path[:, 1], heat[new], rtol=1e-12)
    balanced, u_s = part.i_abc - part.i_abc.mean(axis=1, keepdims=True), frames.space_vector(part.u_abc)[:-1]
    before = np.append(i_s[0], i_dq[:-1] * np.exp(1j * part.angle[1:]))
    np.testing.assert_allclose(stretch.i_abc, balanced[new], atol=1e-11)
    np.testing.assert_allclose(stretch.before, frames.phases(before)[new], atol=1e-11)
    mean, crossed = 0.5 * (i_s[:-1] + i_s[1:]), np.diff(np.sign(balanced), axis=0) / 2
    steps = np.stack([u_s, mean, frames.space_vector(crossed), 1.5 * (u_s * mean.conj()).real * u_s], axis=1)
    sums = period * np.cumsum(np.append(np.zeros((1, 4)), steps, axis=0), axis=0)
    np.testing.assert_allclose(stretch.sums, sums[new], rtol=1e-9, atol=1e-12)
    least = np.abs(balanced).min(axis=1)
    since = np.append(least[0], np.where(crossed.any(axis=1), 0.0, least[1:]))
    np.testing.assert_allclose(stretch.least, np.stack([least, since], axis=1)[new], atol=1e-12)
    for k, lag in enumerate(LAGS):  # a first-order lag of a current that is linear between the samples
        decay = np.exp(-period / lag)
        now = 1 - (1 - decay) * lag / period
        state = signal.lfiltic([now, 1 - decay - now], [1, -decay], [i_dq[0]], [i_dq[0]])
        expected = np.append(i_dq[0], signal.lfilter([now, 1 - decay - now], [1, -decay], i_dq[1:], zi=state)[0])
        np.testing.assert_allclose(stretch.lagged[:, k], expected[new], rtol=1e-10)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 0.3, 40.0])
def test_integrals_of_the_shapes_are_those_of_linear_currents(noise):
    """By quadrature between the samples; steps from far below to far above the scales, corners and zero crossings."""
    t, random = np.linspace(0.0, 0.1, 120)[:, None], np.random.default_rng(3)
    i_abc = 250 * np.sin(80 * t + [0.0, 2.1, 4.2]) * np.sin(20 * t) + noise * random.standard_normal((120, 3))
    i_abc[:4] = [[0.0, 5.0, -5.0], [0.0, 5.0, 5.0], [SHAPES.scales[3], 5.0, -5.0], [SHAPES.scales[3], -1e-9, 300.0]]
    found = SHAPES.integrals(i_abc, 1e-4)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    share = (np.arange(400)[:, None] + (nodes + 1) / 2).ravel()[:, None, None] / 400
    lines = i_abc[:-1] + share * np.diff(i_abc, axis=0)
    expected = 1e-4 / 400 * np.tensordot(np.tile(weights / 2, 400), SHAPES(lines), axes=1).transpose(0, 2, 1)
    np.testing.assert_allclose(np.diff(found, axis=0), expected, rtol=0, atol=1e-10)
    assert not found[0].any()


@pytest.mark.parametrize("size", [37, 700, 9000])
def test_pieces_make_no_difference(samples, size):
    starts = range(0, len(samples) - 1, size)
    pieces = [samples.part(max(start - 1, 0), min(start + size, len(samples))) for start in starts]
    whole, parts = cut(samples), cut(*pieces, continues=set(range(1, len(pieces))))
    for name in NAMES:
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("period", [1e-4, 1e-5])
def test_of_segments_that_are_not_kept_only_terms_are_cut(period):
    recording = record(duration=1.6, noise=0.5, period=period)
    cutter, whole = WindowCutter(SHAPES, segment=0.25), cut(recording)
    cutter.every = 2
    parts = [*cutter.cut(recording), *cutter.finish()]
    terms, windows = Terms.joined(parts), Windows.joined([part for part in parts if isinstance(part, Windows)])
    kept = kept_of(interval(whole.time, 0.25), 2)
    assert 0.2 < kept.mean() < 0.8
    names = [field.name for field in dataclasses.fields(Terms) if field.name in NAMES]
    for found, own, expected in ((terms, names, whole), (windows, NAMES, whole.part(kept))):
        for name in own:
            x = getattr(found, name)[~found.short]
            np.testing.assert_allclose(x, getattr(expected, name), rtol=1e-9, atol=1e-11, err_msg=name)
    assert windows.short.sum() == terms.short.sum() > 0


@pytest.mark.parametrize("period", [1e-4, 1e-5])
def test_adjacent_windows_do_not_depend_on_the_pieces(period, monkeypatch):
    recording = record(duration=0.5, noise=0.5, period=period)
    (start, whole), *none = WindowCutter(SHAPES).adjacent(recording, 20)
    monkeypatch.setattr("drive_id.core.full.windows._ADJACENT", 50)
    starts, parts = zip(*WindowCutter(SHAPES).adjacent(recording, 20), strict=True)
    assert not none
    assert np.array_equal(starts, start + 20 * 50 * np.arange(len(starts)))
    for name in NAMES:
        found = getattr(Windows.joined(list(parts)), name)
        np.testing.assert_allclose(found, getattr(whole, name), rtol=1e-9, atol=1e-11, err_msg=name)


def test_no_window_spans_a_gap(samples):
    gaps = dataclasses.replace(samples, run_starts=np.array([0, 3000, 3004, 12001]))
    windows = cut(gaps)
    begin = np.rint(windows.time / samples.sample_period).astype(int)
    end = begin + np.rint(windows.duration / samples.sample_period).astype(int)
    for gap in (3000, 3004, 12001):
        assert not np.any((begin < gap) & (end >= gap))
    assert len(windows) > 0.9 * len(cut(samples))


@pytest.mark.parametrize("speed", [-800.0, -40.0, 5.0, 209.0, 1300.0])
def test_a_window_turns_the_rotor_by_a_sixth(speed):
    windows = cut(record(speed=speed, duration=1.0))
    turn = np.abs(speed) * windows.duration
    assert np.all(windows.duration <= LONGEST_WINDOW * (1 + 1e-9))
    if abs(speed) * LONGEST_WINDOW > WINDOW_ANGLE:
        np.testing.assert_allclose(turn, WINDOW_ANGLE, atol=0.51 * abs(speed) * 1e-4)
    assert np.mean(np.diff(windows.time)) == pytest.approx(STRIDE, rel=0.05)


def test_a_window_ends_where_the_current_has_gone_its_way():
    """The speed that is recorded plays no part: that of the angle counts."""
    period = 1e-4
    t = period * np.arange(20_000)
    i_q = 250.0 * np.sin(2 * np.pi * 30 * t)
    angle = 20.0 * t
    i_abc = frames.to_abc(np.stack([np.zeros_like(i_q), i_q], axis=-1), angle)
    stamp = np.arange(len(t)) * 100_000
    swung = Samples(
        stamp=stamp, i_abc=i_abc, u_abc=0 * i_abc, angle=angle, speed=np.full(len(t), 1e3), sample_period=period
    )
    windows = cut(swung)
    rate = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(i_q)))])
    begin = np.rint(windows.time / period).astype(int)
    end = begin + np.rint(windows.duration / period).astype(int)
    np.testing.assert_allclose(rate[end] - rate[begin], WINDOW_CURRENT * 300.0, rtol=0.03)


def test_starts_meet_every_rotor_position():
    """Strides of a sixth of a turn would show the sixth harmonic at one phase only."""
    speed = 2 * np.pi / 6 / STRIDE
    windows = cut(record(speed=speed, duration=2.0))
    for order in (6, 12):
        assert np.abs(np.exp(1j * order * windows.angle[:, 0]).mean()) < 0.1


def test_fine_sampling_costs_no_more_windows():
    coarse, fine = (cut(record(duration=0.5, period=period)) for period in (1e-4, 1e-5))
    assert len(fine) == pytest.approx(len(coarse), rel=0.02)
    assert abs(np.abs(fine.voltage).mean() / np.abs(coarse.voltage).mean() - 1) < 0.01


@pytest.mark.parametrize("count", [1, 2, 5, 60])
def test_too_few_samples_give_no_window_or_few(samples, count):
    cutter = WindowCutter(SHAPES)
    parts = list(cutter.cut(samples.part(0, count))) + list(cutter.finish())
    assert sum(len(part) for part in parts) <= count / 8


def test_windows_at_rest_are_left_out_whatever_the_pieces(samples):
    idle = np.zeros(len(samples), np.bool_)
    idle[3000:9000] = idle[15_000:] = True
    cutter = WindowCutter(SHAPES)
    moving = Windows.joined([*cutter.cut(samples, idle), *cutter.finish()])
    every = cut(samples)
    begin = np.rint(every.time / samples.sample_period).astype(int)
    end = begin + np.rint(every.duration / samples.sample_period).astype(int)
    used = ~(idle[begin] & idle[end])
    assert 0.4 < used.mean() < 0.8
    for name in NAMES:
        np.testing.assert_allclose(getattr(moving, name), getattr(every, name)[used], rtol=1e-9, atol=1e-12)
    cutter = WindowCutter(SHAPES)
    pieces = [*cutter.cut(samples.part(0, 5001), idle[:5001])]
    pieces += [*cutter.cut(samples.part(5000, len(samples)), idle[5000:], continues=True), *cutter.finish()]
    np.testing.assert_allclose(Windows.joined(pieces).time, moving.time)


def test_acceleration_and_jerk_are_those_of_the_speeds_within_a_run(samples):
    """Up to the ends of a run, from one side."""
    windows, turn = cut(samples), 2 * np.pi * 5.0
    time, late = windows.time[:, None] + windows.duration[:, None] * [0.0, 1.0], windows.time > 1.0
    speed = np.where(late[:, None], -900.0, 600.0) + 60.0 * np.sin(turn * time)
    swinging = dataclasses.replace(windows, speed=speed, run=late.astype(int)).accelerated()
    inside = (np.abs(time - np.rint(time)) > 0.02) & (time < windows.time[-1] - 0.02)
    for found, of_speed, near in (
        (swinging.acceleration, turn * np.cos(turn * time), 0.2),
        (swinging.jerk, -(turn**2) * np.sin(turn * time), 0.6),
    ):
        error = np.abs(found / 60.0 - of_speed) / np.abs(of_speed).max()
        assert error.max() < near
        assert error[inside].max() < 0.05
    few = dataclasses.replace(swinging, run=np.arange(len(windows)), duration=0.0 * windows.duration).accelerated()
    assert not few.acceleration.any()
