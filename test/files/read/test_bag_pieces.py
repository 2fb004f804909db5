"""Bags piece by piece against bags read as a whole."""

from __future__ import annotations

import struct
import threading
import time

import numpy as np
import pytest
from bag_samples import assert_equal_samples, make_samples, make_truth
from copied_bags import with_messages
from test_bag_reader import SPEED, STRANGER, stranger

from drive_id.core.signals.join import joined
from drive_id.errors import DriveIdError, NonFiniteError, StampOrderError
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.signals_file import SignalMap, parse_signals
from drive_id.files.read import extraction
from drive_id.files.read import reader as module
from drive_id.files.read.drive_parts import drive_parts
from drive_id.files.read.extraction import DividedError, UnusualError
from drive_id.files.read.reader import bag_pieces, prefetched
from drive_id.files.read.several import read_recording
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.writer import write_recording


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(extraction, "PART_SAMPLES", 70)
    monkeypatch.setattr(module, "_LOCKING_PAIRS", 100)


def read(path, signals=None, **options):
    """Put the pieces together again; also what else there is to know."""
    facts = []
    return list(bag_pieces(path, signals or SignalMap(), end=facts.append, **options)), facts[0]


def assert_same_as_whole(path, signals=None, least_pieces=3, **options):
    pieces, facts = read(path, signals, **options)
    expected = read_recording(path, signals)
    assert_equal_samples(joined(pieces), expected.samples)
    reference = [p.samples.i_dq_reference for p in pieces]
    if all(part is not None for part in reference):
        parts = [part[int(piece.continues) :] for part, piece in zip(reference, pieces, strict=True)]
        np.testing.assert_array_equal(np.concatenate(parts), expected.samples.i_dq_reference)
    assert facts.warnings == expected.warnings
    assert (facts.truth is None) == (expected.truth is None)
    assert len(pieces) >= least_pieces
    return pieces


@pytest.fixture
def ours(tmp_path):
    write_recording(tmp_path / "bag", make_samples(1500, gap_at=250), make_truth(), chunk_size=1500)
    return tmp_path / "bag"


def test_our_bags(tmp_path):
    """Of one compression and storage: test_bag_reader.py has the others, whose messages are the same."""
    write_recording(tmp_path / "bag", make_samples(1500, gap_at=777), chunk_size=1500)
    assert_same_as_whole(tmp_path / "bag")


@pytest.mark.parametrize("with_speed", [True, False])
def test_bags_of_strangers(tmp_path, with_speed):
    path, *_ = stranger(tmp_path)
    text = STRANGER + SPEED * with_speed
    assert_same_as_whole(path, parse_signals(text, "test"), least_pieces=1)
    text = text.replace("  topic:", "  sample_period: 0.0001\n  topic:")
    assert_same_as_whole(path, parse_signals(text, "test"), least_pieces=3 if with_speed else 1)


def test_scales_offsets_and_log_times(tmp_path):
    ours = tmp_path / "bag"
    write_recording(ours, make_samples(1500), chunk_size=1500)
    text = (
        "currents: {topic: phase_currents, fields: [b, a], scale: [2.0, -3.0], sample_period: sample_period, "
        "first_sample: first_sample, stamp_offset: 0.00002}\n"
        "voltages: {topic: phase_voltages, fields: [c, a, b], sample_period: sample_period, first_sample: first_sample}"
        "\nresolver: {topic: resolver, angle: angle, angle_offset: 0.1, speed: speed, sample_period: sample_period, "
        "first_sample: first_sample}\n"
    )
    assert_same_as_whole(ours, parse_signals(text, "test"))
    logged = text.replace("sample_period: sample_period", "sample_period: sample_period, stamp: log_time")
    assert_same_as_whole(ours, parse_signals(logged, "test"))


def found_in(path):
    """Return the samples, the sizes of the pieces and the warnings of a bag, or the error that refuses it."""
    try:
        pieces, facts = read(path)
    except (DriveIdError, DividedError) as error:
        return repr(error)
    return [
        (p.samples.i_abc.tobytes(), p.samples.angle.tobytes(), p.samples.stamp.tolist()) for p in pieces
    ], facts.warnings


CHANGES = {
    "none": lambda data: data,
    "an empty block": lambda _: encode_block(0, 0, 1e-4, [np.zeros(0, np.float32)] * 3, "drive"),
    "another drive": lambda data: data.replace(b"drive", b"other"),
    "another period": lambda data: data.replace(struct.pack("<d", 1e-4), struct.pack("<d", 2e-4)),
    "no period": lambda data: data.replace(struct.pack("<d", 1e-4), struct.pack("<d", 0.0)),
    "cut": lambda data: data[:60],
    "of several nanoseconds": lambda data: data[:8] + b"\xff" * 4 + data[12:],
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("topics", [("/phase_currents",), ("/phase_currents", "/resolver")])
def test_messages_read_at_once_are_those_read_one_by_one(tmp_path, ours, monkeypatch, change, topics):
    """Of two that cannot be read, the first is told."""

    def changed(messages):
        return [(k, t, CHANGES[change](data) if k in (33, 34, 35, 36) and t in topics else data, time)
                for k, t, data, time in messages]  # fmt: skip

    path = with_messages(ours, tmp_path / "changed", changed)
    at_once = found_in(path)
    monkeypatch.setattr(extraction.SignalStream, "_at_once", lambda *_: None)
    assert at_once == found_in(path)
    assert isinstance(at_once, str) == (change not in ("none", "an empty block"))


def test_lost_and_repeated_blocks(tmp_path, ours):
    def change(messages):
        kept = [m for m in messages if m[0] not in (9, 14, 15, 23)]
        return [*kept[:30], kept[28], *kept[30:]] if kept[28][1] == kept[30][1] else kept

    pieces = assert_same_as_whole(with_messages(ours, tmp_path / "lossy", change))
    assert sum(len(piece.samples.run_starts) - piece.continues for piece in pieces) == 3


@pytest.mark.parametrize("seed", range(3))
def test_blocks_out_of_order_are_read_in_order(tmp_path, ours, seed):
    rng = np.random.default_rng(seed)

    def disordered(messages):
        first, rest = messages[:4], [m for m in messages[4:] if m[1] != "/current_reference"]
        return [*first, *sorted(rest, key=lambda m: m[0] + 30 * rng.uniform() * (rng.uniform() < 0.2))]

    path = with_messages(ours, tmp_path / "disordered", disordered)
    assert [m.log_time for m in _messages(path)] != sorted(m.log_time for m in _messages(path))
    pieces = assert_same_as_whole(path, least_pieces=1)
    expected = read_recording(ours)
    for name in ("stamp", "i_abc", "u_abc", "angle", "run_starts"):
        np.testing.assert_array_equal(getattr(joined(pieces), name), getattr(expected.samples, name))
    assert read_recording(path).warnings == expected.warnings


def _messages(path):
    with open_bag(path) as bag:
        return list(bag.messages(frozenset({"/phase_currents", "/phase_voltages", "/resolver"})))


@pytest.mark.parametrize("topic", ["/phase_currents", "/phase_voltages", "/resolver"])
def test_a_topic_that_lags_behind_or_ends_early(tmp_path, ours, topic):
    def late(messages):
        own = [m for m in messages if m[1] == topic]
        others = [m for m in messages if m[1] != topic]
        return sorted([*others, *((k + 18, *rest) for k, *rest in own)], key=lambda m: m[0])

    def ends(messages):
        return [m for m in messages if m[1] != topic or m[0] < 30]

    assert_same_as_whole(with_messages(ours, tmp_path / "late", late))
    assert_same_as_whole(with_messages(ours, tmp_path / "ends", ends), least_pieces=1)


def test_topics_one_behind_the_other_are_read_at_once(tmp_path, ours, monkeypatch):
    monkeypatch.setattr(module, "CAPACITY", 300)
    path = with_messages(ours, tmp_path / "sorted", lambda messages: sorted(messages, key=lambda m: (m[1], m[0])))
    with pytest.raises(UnusualError):
        read(path)
    assert_same_as_whole(path, whole=True, least_pieces=1)


def test_a_topic_that_is_missing_for_long_needs_no_memory(tmp_path, ours, monkeypatch):
    monkeypatch.setattr(module, "CAPACITY", 300)
    path = with_messages(
        ours, tmp_path / "gone", lambda messages: [m for m in messages if m[1] != "/resolver" or not 8 < m[0] < 40]
    )
    assert_same_as_whole(path)


def test_a_recording_split_into_files(tmp_path):
    samples = make_samples(1500, gap_at=800)
    folder = tmp_path / "split"
    folder.mkdir()
    for number, part in enumerate(((0, 800), (800, 1500))):
        write_recording(tmp_path / f"part{number}", samples.part(*part), chunk_size=1500)
        (tmp_path / f"part{number}" / f"part{number}_0.mcap").rename(folder / f"split_{number}.mcap")
    with pytest.raises(DividedError):  # the count begins anew: either part may be of another drive
        read(folder)
    parts = drive_parts(folder, SignalMap())
    pieces = [piece for part in parts for piece in read(folder, part=range(part.begin, part.end))[0]]
    assert len(parts) == 2
    recording = read_recording(folder)
    assert_equal_samples(recording.samples, samples)
    assert len(recording.digests) == 2
    np.testing.assert_array_equal(joined(pieces).i_abc, samples.i_abc)


def test_errors_say_the_same(tmp_path):
    def spoil(messages):
        nan = np.full(2, np.nan, np.float32).tobytes()
        return [(k, topic, data[:-8] + nan if k in (21, 37) else data, time) for k, topic, data, time in messages]

    write_recording(tmp_path / "good", make_samples(1500))
    spoiled = with_messages(tmp_path / "good", tmp_path / "nan", spoil)
    with pytest.raises(NonFiniteError) as expected:
        read_recording(spoiled)
    with pytest.raises(NonFiniteError) as found:
        read(spoiled)
    assert str(found.value) == str(expected.value)
    backward = with_messages(
        tmp_path / "good", tmp_path / "backward", lambda messages: [*messages[:40], *messages[20:]]
    )  # fmt: skip
    with pytest.raises(StampOrderError):
        read_recording(backward)
    with pytest.raises(DividedError):  # as its count runs back; read_recording tries the parts, and tells why they fail
        read(backward)


# -- ahead, in another thread --------------------------------------------------------------------------------------


def test_items_come_in_order_and_errors_where_they_are_used():
    def items():
        yield from range(100)
        raise KeyError("end")

    found = []
    with pytest.raises(KeyError, match="end"):
        found.extend(prefetched(items(), 3))
    assert found == [] or found == list(range(100))
    assert list(prefetched((k for k in range(50)), 2)) == list(range(50))


def test_the_progress_is_told_while_an_item_is_awaited():
    """By the thread of the caller: a bag of single samples stood at 0 % for 15 s."""
    told = []

    def slow():
        while len(told) < 2:
            time.sleep(0.01)
        yield 1

    assert list(prefetched(slow(), 1, tell=lambda: told.append(threading.current_thread()))) == [1]
    assert set(told) == {threading.current_thread()}


def test_a_recording_read_at_once_tells_its_progress(bag):
    told = []
    list(bag_pieces(bag, SignalMap(), whole=True, threads=False, tell=told.append))
    assert len(told) > 2
    assert told == sorted(told)
    assert told[-1] > 0.9


def test_closing_ends_the_thread_and_what_it_reads():
    closed = threading.Event()

    def endless():
        try:
            while True:
                yield 1
        finally:
            closed.set()

    stream = prefetched(endless(), 2)
    assert next(stream) == 1
    stream.close()
    assert closed.is_set()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("reader")]
