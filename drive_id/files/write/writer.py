"""Samples to a recording of our own messages, with the ground truth of a simulation as an attachment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from drive_id.core.signals.signal import finite_rows
from drive_id.errors import ConfigurationError
from drive_id.files.machines.ground_truth import encode_truth
from drive_id.files.messages.block_codec import encode_block
from drive_id.files.messages.messages import CURRENT_REFERENCE, PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER, SCALAR_SAMPLES
from drive_id.files.storage.container import TRUTH_ATTACHMENT, RawMessage
from drive_id.files.write.rosbag2_writer import CHUNK_SIZE, Rosbag2McapWriter, whole_or_nothing
from drive_id.types import NANOSECONDS, BoolArray, GroundTruth, IntArray, Samples

BLOCK_SIZE = 100
"""Samples per message: 100 messages a second at 10 kHz."""
_SESSION = 1
"""Of the references of a simulated recording, which is one run."""
_FRAME = "drive"
_JUST_BELOW_PI = np.nextafter(np.float32(np.pi), np.float32(0))


def write_recording(
    path: Path,
    samples: Samples,
    truth: GroundTruth | None = None,
    *,
    block_size: int = BLOCK_SIZE,
    scalar_periods: Mapping[str, float] | None = None,
    start_stamp: int | None = None,
    compression: str = "zstd",
    chunk_size: int = CHUNK_SIZE,
) -> None:
    """Write samples, as float32 like our messages, as a rosbag2 recording, all of it or nothing.

    Raises OutputError when the path exists or cannot be written, ConfigurationError when the block size or the stamps
    do not fit the messages.

    Parameters
    ----------
    path : Path
        Folder to create.
    truth : GroundTruth, optional
        Stored as the attachment ``ground_truth.npz``.
    block_size : int
        Samples per message.
    scalar_periods : mapping of str to float, optional
        Time between the stored values of optional signals, s, by name; default: that of the samples.
    start_stamp : int, optional
        Stamp of the first sample, ns; default: stamps are not shifted.
    compression, chunk_size
        See :class:`~drive_id.files.write.rosbag2_writer.Rosbag2McapWriter`.
    """
    if block_size < 1:
        raise ConfigurationError(f"block_size is {block_size}: it must be at least 1 sample.")
    shift = 0 if start_stamp is None else start_stamp - int(samples.stamp[0])
    messages = [*_messages(samples, shift, block_size), *_scalars(samples, shift, block_size, scalar_periods or {})]
    messages.sort(key=lambda message: message.log_time)
    with (
        whole_or_nothing(path) as folder,
        Rosbag2McapWriter(folder, compression=compression, chunk_size=chunk_size) as writer,
    ):
        writer.add_topic("/phase_currents", PHASE_CURRENTS)
        writer.add_topic("/phase_voltages", PHASE_VOLTAGES)
        writer.add_topic("/resolver", RESOLVER)
        if samples.i_dq_reference is not None:
            writer.add_topic("/current_reference", CURRENT_REFERENCE)
        for name in samples.scalars():
            writer.add_topic(f"/{name}", SCALAR_SAMPLES)
        for message in messages:
            writer.write(message.topic, bytes(message.data), message.log_time)
        if truth is not None:
            writer.attach(TRUTH_ATTACHMENT, encode_truth(truth), "application/zip")


def _messages(samples: Samples, shift: int, block_size: int) -> Iterator[RawMessage]:
    """Yield all messages by topic; set-points are logged when due, measurements at the end of their block."""
    angle = ((samples.angle + np.pi) % (2 * np.pi) - np.pi).astype(np.float32).clip(-_JUST_BELOW_PI, _JUST_BELOW_PI)
    signals = [
        ("/phase_currents", samples.i_abc.astype(np.float32), True),
        ("/phase_voltages", samples.u_abc.astype(np.float32), True),
        ("/resolver", np.column_stack((angle, samples.speed.astype(np.float32))), True),
    ]
    if samples.i_dq_reference is not None:
        signals.append(("/current_reference", samples.i_dq_reference.astype(np.float32), False))
    every = samples.stamp + shift
    if every[0] < 0 or every[-1] >= 2**31 * NANOSECONDS:
        raise ConfigurationError(
            f"Stamps from {every[0]} to {every[-1]} ns do not fit into a message: choose another start_stamp."
        )
    for topic, values, when_full in signals:
        known = finite_rows(values.astype(np.float64))
        begins = np.zeros(len(samples), np.bool_)
        begins[samples.run_starts] = True
        for start, end in zip(*_blocks(every, known, begins, samples.sample_period, block_size), strict=True):
            stamp = int(every[start])
            end_time = int(every[end - 1]) + round(samples.sample_period * NANOSECONDS)
            columns = list(values[start:end].T)
            session = None if when_full else (_SESSION, int(start), False, False)
            data = encode_block(stamp, int(start), samples.sample_period, columns, _FRAME, session)
            yield RawMessage(topic, end_time if when_full else stamp, data)


def _scalars(samples: Samples, shift: int, block_size: int, periods: Mapping[str, float]) -> Iterator[RawMessage]:
    """Yield the messages of the optional signals: blocks of known values, of which each run holds every n-th."""
    for name, values in samples.scalars().items():
        stride = max(1, round(periods.get(name, 0.0) / samples.sample_period))
        since = np.concatenate([np.arange(run.stop - run.start) for run in samples.runs()])
        chosen = np.flatnonzero(since % stride == 0)
        stamp, sparse, period = samples.stamp[chosen] + shift, values[chosen], stride * samples.sample_period
        known = np.isfinite(sparse)
        size = max(1, block_size // stride)
        for start, end in zip(*_blocks(stamp, known, since[chosen] == 0, period, size), strict=True):
            end_time = int(stamp[end - 1]) + round(samples.sample_period * NANOSECONDS)
            data = encode_block(int(stamp[start]), int(start), period, [sparse[start:end].astype(np.float32)], _FRAME)
            yield RawMessage(f"/{name}", end_time, data)


def _blocks(
    stamp: IntArray, known: BoolArray, begins: BoolArray, period: float, block_size: int
) -> tuple[IntArray, IntArray]:
    """Return begins and ends of blocks of known samples; no block spans a gap, an unknown sample or an uneven stamp."""
    index = np.arange(len(stamp))
    uneven = np.abs(np.diff(stamp) - period * NANOSECONDS) > 0.01 * period * NANOSECONDS
    breaks = begins.copy()
    breaks[0] = True
    breaks[1:] |= uneven | (known[1:] != known[:-1])
    since = index - np.maximum.accumulate(np.where(breaks, index, 0))
    starts = np.flatnonzero(since % block_size == 0)
    ends = np.append(starts[1:], len(stamp))
    return starts[known[starts]], ends[known[starts]]
