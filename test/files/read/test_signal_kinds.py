"""Bags whose fields are no plain phase quantities of equal rate: what they mean comes back."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from bag_samples import START, assert_equal_samples, make_samples
from foreign_rows import write_rows

from drive_id.core import frames
from drive_id.core.signals.join import joined
from drive_id.errors import ConfigurationError, MissingTopicError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read.reader import bag_pieces
from drive_id.files.read.several import read_recording

N = 400
STEP = 100_000
DEFAULTS = "topic: /log, sample_period: 1e-4"
STAMPS = START + STEP * np.arange(N)


@pytest.fixture(scope="module")
def truth():
    made = make_samples(N, reference=False)
    return replace(made, i_abc=made.i_abc - made.i_abc.mean(axis=1, keepdims=True),
                   u_abc=made.u_abc - made.u_abc.mean(axis=1, keepdims=True))  # fmt: skip


def signals(currents="fields: [data[0], data[1], data[2]]", voltages="fields: [data[3], data[4], data[5]]",
            resolver="angle: data[6], speed: data[7]", more="", defaults=DEFAULTS):  # fmt: skip
    text = f"defaults: {{{defaults}}}\ncurrents: {{{currents}}}\nvoltages: {{{voltages}}}\nresolver: {{{resolver}}}\n"
    return parse_signals(re.sub(r"(?<!')data\[\d+\]", r"'\g<0>'", text + more), "test")


def rows(truth, currents=None, voltages=None, angle=None, speed=None):
    parts = (truth.i_abc if currents is None else currents, truth.u_abc if voltages is None else voltages,
             truth.angle if angle is None else angle, truth.speed if speed is None else speed)  # fmt: skip
    return np.column_stack(parts)


def read(path, signal_map):
    """Read a bag as a whole, and check that it is the same piece by piece."""
    found = read_recording(path, signal_map).samples
    assert_equal_samples(joined(list(bag_pieces(path, signal_map))), found)
    return found


def assert_same(found, truth, atol=1e-9):
    np.testing.assert_array_equal(found.stamp, truth.stamp)
    np.testing.assert_allclose(found.i_abc, truth.i_abc, atol=atol)
    np.testing.assert_allclose(found.u_abc, truth.u_abc, atol=atol * 10)
    np.testing.assert_allclose(np.exp(1j * found.angle), np.exp(1j * truth.angle), atol=1e-9)


def test_dq_quantities_of_the_resolvers_angle(tmp_path, truth):
    """The voltages are transformed 1.5 periods ahead, as drives do that compensate their delay."""
    ahead = truth.angle + 1.5e-4 * truth.speed
    table = rows(truth, frames.to_dq(truth.i_abc, truth.angle), frames.to_dq(truth.u_abc, ahead))
    path = write_rows(tmp_path / "bag", {"/log": table}, {"/log": STAMPS})
    found = read(path, signals("fields: ['data[0]', 'data[1]'], frame: dq",
                               "fields: ['data[2]', 'data[3]'], frame: dq, angle_advance: 1.5",
                               "angle: data[4], speed: data[5]"))  # fmt: skip
    assert_same(found, truth)
    assert found.turned == {"currents", "voltages"}


def test_dq_quantities_of_their_own_angle_and_alpha_beta(tmp_path, truth):
    own = truth.angle + 0.3
    i_s = frames.space_vector(truth.i_abc)
    voltages = np.column_stack([frames.to_dq(truth.u_abc, own), np.rad2deg(own)])
    path = write_rows(
        tmp_path / "bag", {"/log": rows(truth, np.column_stack([i_s.real, i_s.imag]), voltages)}, {"/log": STAMPS}
    )
    found = read(path, signals("fields: ['data[0]', 'data[1]'], frame: alpha_beta",
                               "fields: ['data[2]', 'data[3]'], frame: dq, angle: data[4], angle_unit: deg",
                               "angle: data[5], speed: data[6]"))  # fmt: skip
    assert_same(found, truth)
    assert found.turned == {"voltages"}


@pytest.mark.parametrize("count", [2, 3])
def test_line_to_line_voltages_and_linear_combinations(tmp_path, truth, count):
    lines = truth.u_abc - truth.u_abc[:, [1, 2, 0]]
    mixed = np.column_stack([truth.i_abc[:, 0] + truth.i_abc[:, 1], truth.i_abc[:, 0] - 2 * truth.i_abc[:, 1]])
    path = write_rows(tmp_path / "bag", {"/log": rows(truth, mixed, lines)}, {"/log": STAMPS})
    fields = ", ".join(f"'data[{2 + k}]'" for k in range(count))
    found = read(path, signals(
        "fields: [{'data[0]': 0.6666666666666666, 'data[1]': 0.3333333333333333}, "
        "{'data[0]': 0.3333333333333333, 'data[1]': -0.3333333333333333}], scale: 1",
        f"fields: [{fields}], frame: line_to_line", "angle: data[5], speed: data[6]"))  # fmt: skip
    assert_same(found, truth)


def test_encoder_counts_that_wrap_anywhere_and_count_backwards(tmp_path, truth):
    shaft = np.unwrap(truth.angle) / 3
    counts = np.rint(-(shaft - 0.4) / (2 * np.pi) * 1_000_000) % 65_536
    speed = -truth.speed / 3 * 30 / np.pi
    path = write_rows(tmp_path / "bag", {"/log": rows(truth, angle=counts, speed=speed)}, {"/log": STAMPS})
    rotor = (
        "angle: data[6], angle_unit: counts, counts_per_turn: 1000000, angle_modulus: 65536, direction: -1, "
        "mechanical: true, pole_pairs: 3, angle_offset: {offset}, speed: data[7], speed_unit: rpm"
    )
    found = read(path, signals(resolver=rotor.format(offset=0)))
    away = np.angle(np.exp(1j * (found.angle - truth.angle)))
    assert np.ptp(away) < 2.1 * 3 * np.pi / 1e6
    np.testing.assert_allclose(found.speed, truth.speed, rtol=1e-9)
    moved = read(path, signals(resolver=rotor.format(offset=-away[0])))
    assert np.abs(np.angle(np.exp(1j * (moved.angle - truth.angle)))).max() < 2.1 * 3 * np.pi / 1e6


def test_a_scale_from_another_topic_is_interpolated(tmp_path, truth):
    slow = START + 7_000 + 1_000_000 * np.arange(42)
    u_dc = 500 + 50 * np.sin(1e-9 * (STAMPS - START) * 2 * np.pi * 5)
    at_slow = 500 + 50 * np.sin(1e-9 * (slow - START) * 2 * np.pi * 5)
    wanted = np.interp(STAMPS - START, slow - START, at_slow)
    path = write_rows(
        tmp_path / "bag",
        {"/log": rows(truth, voltages=truth.u_abc / wanted[:, None] * 2), "/dc": at_slow[:, None]},
        {"/log": STAMPS, "/dc": slow},
    )
    voltages = "fields: ['data[3]', 'data[4]', 'data[5]'], scale: {topic: /dc, field: 'data[0]', scale: 0.5}"
    found = read(path, signals(voltages=voltages))
    assert found.dc_link_voltage is None
    np.testing.assert_allclose(found.u_abc[1:], truth.u_abc[1:], rtol=1e-9)
    assert np.abs(wanted - u_dc).max() < 1  # the oracle is that of the interpolation, and it is right
    with pytest.raises(MissingTopicError, match="no topic /none for the voltage_scale"):
        read_recording(path, signals(voltages=voltages.replace("/dc", "/none")))


def test_timer_ticks_that_wrap_and_sample_indices(tmp_path, truth):
    late = STAMPS + (2**32 * 10 - int(STAMPS[150] % (2**32 * 10)))  # the timer starts again in the middle
    path = write_rows(tmp_path / "bag", {"/log": rows(truth)}, {"/log": late})
    ticks = "topic: /log, sample_period: 1e-4, stamp: ticks, stamp_scale: 1e-8, stamp_bits: 32"
    found = read(path, signals(defaults=ticks))
    np.testing.assert_array_equal(np.diff(found.stamp), np.diff(late) // 10 * 10)
    assert_same(replace(found, stamp=truth.stamp), truth)
    kept = np.delete(np.arange(N), slice(100, 130))
    path = write_rows(
        tmp_path / "counted", {"/log": rows(truth)[kept]}, {"/log": STAMPS[kept]}, counts={"/log": kept + 5}
    )
    found = read(path, signals(defaults="topic: /log, sample_period: 1e-4, stamp: index, first_sample: counter"))
    np.testing.assert_array_equal(found.stamp, (kept + 5) * STEP)
    assert found.run_starts.tolist() == [0, 100]
    found = read(path, signals(defaults="topic: /log, sample_period: 1e-4, stamp: index"))
    np.testing.assert_array_equal(found.stamp, np.arange(N - 30) * STEP)


@pytest.mark.parametrize("counter", [False, True])
def test_jitter_of_arrival_invents_no_gaps(tmp_path, truth, counter):
    """Currents and resolver are topics of their own, at 20 kHz, and arrive up to 20 us early or late."""
    rng = np.random.default_rng(8)
    stamps = START + 50_000 * np.arange(N)
    arrival = {topic: stamps + rng.integers(-20_000, 20_000, N) for topic in ("/log", "/rotor")}
    table = rows(truth)
    path = write_rows(
        tmp_path / "bag",
        {"/log": table[:, :6], "/rotor": table[:, 6:]},
        dict.fromkeys(arrival, stamps),
        arrival=arrival,
    )
    time = "topic: /log, stamp: log_time, equally_spaced: true" + (", first_sample: counter" if counter else "")
    recording = read_recording(path, signals(resolver="topic: /rotor, angle: data[0], speed: data[1]", defaults=time))
    found = recording.samples
    assert len(found) == N
    assert found.run_starts.tolist() == [0]
    assert found.sample_period == pytest.approx(50e-6, rel=1e-3)
    np.testing.assert_array_equal(found.i_abc, truth.i_abc)
    np.testing.assert_allclose(found.angle, truth.angle)
    assert sum("were taken as equally spaced" in text for text in recording.warnings) == 2


def test_an_angle_of_another_rate_and_a_speed_of_a_third(tmp_path, truth):
    slow, slower = START - 900_000 + 1_000_000 * np.arange(42), START - 10_000_000 + 10_000_000 * np.arange(6)
    turn = 2e-7 * (slow - START) + 0.5
    path = write_rows(
        tmp_path / "bag",
        {"/log": rows(truth), "/enc": np.angle(np.exp(1j * turn))[:, None], "/speed": np.full((6, 1), 2000.0)},
        {"/log": STAMPS, "/enc": slow, "/speed": slower},
    )
    more = "topic: /enc, angle: data[0], interpolate: true, sample_period: 1e-3"
    for speed, unit in (("", ""), (", speed: {topic: /speed, field: 'data[0]'}", ", speed_scale: 0.1")):
        recording = read_recording(path, signals(resolver=more + speed + unit))
        found = recording.samples
        np.testing.assert_allclose(
            np.exp(1j * found.angle), np.exp(1j * (2e-7 * (found.stamp - START) + 0.5)), atol=1e-6
        )
        np.testing.assert_allclose(found.speed, 200.0, rtol=1e-6)
        assert len(found) == N
        assert any("was interpolated; its error, about" in text for text in recording.warnings)
        assert 0 < found.angle_error < 1e-6


def test_a_decimated_log_is_read_as_means_over_its_samples(tmp_path):
    """The voltage of the control, constant in the rotor frame, turns between the logged samples."""
    n, every, turn = 60, 5, 0.06
    fast = np.arange(n * every)
    angle = turn * fast
    u_abc = frames.to_abc(np.column_stack([np.full(n * every, 30.0), 80 + 0.02 * fast]), angle)
    mean = frames.space_vector(u_abc).reshape(n, every).mean(axis=1)
    kept = fast[::every]
    table = np.column_stack([np.zeros((n, 3)), u_abc[kept], angle[kept], np.full(n, turn / 1e-4)])
    path = write_rows(tmp_path / "bag", {"/log": table}, {"/log": START + STEP * kept})
    voltages = "fields: ['data[3]', 'data[4]', 'data[5]'], decimation: 5"
    found = read(path, signals(voltages=voltages, defaults="topic: /log, sample_period: 5e-4"))
    np.testing.assert_allclose(frames.space_vector(found.u_abc)[:-1], mean[:-1], rtol=1e-9)
    assert abs(frames.space_vector(u_abc[kept])[3] - mean[3]) > 5


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ({"currents": "fields: [a, b], frame: dq, angle_advance: 9"}, "at most 5"),
        ({"currents": "fields: [a, b, c], frame: dq"}, "3 components of frame dq: give the paths of two"),
        ({"currents": "fields: [a, b], angle: x"}, "angle belongs to frame dq"),
        ({"currents": "fields: [a, b], frame: line_to_line"}, "only voltages are"),
        ({"currents": "fields: [a, b], decimation: 3"}, "belongs to the voltages"),
        ({"currents": "fields: [a, b], scale: {topic: /x, field: y}"}, "is another signal: give the factor"),
        ({"currents": "fields: [a, {b: 0}]"}, "a linear combination is"),
        ({"voltages": "fields: [a, b, c], offset: [1, 2]"}, "one per field"),
        ({"resolver": "angle: x, angle_unit: counts"}, "counts_per_turn belong together"),
        ({"resolver": "angle: x, direction: 0"}, "direction is 0"),
        ({"defaults": "stamp: index, topic: /t"}, "without a sample_period"),
        ({"defaults": "stamp_bits: 32, topic: /t"}, "without a field that counts"),
        ({"resolver": "topic: '', angle: x"}, "topic is missing"),
    ],
)  # fmt: skip
def test_contradictions_are_named(text, said):
    with pytest.raises(ConfigurationError, match=said):
        signals(**text)


def test_columns_are_not_those_of_a_bag(tmp_path, truth):
    path = write_rows(tmp_path / "bag", {"/log": rows(truth)}, {"/log": STAMPS})
    with pytest.raises(ConfigurationError, match="is a bag, and the signals file names columns"):
        read_recording(path, signals(defaults="sample_period: 1e-4"))
