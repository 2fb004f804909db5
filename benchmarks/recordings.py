"""Recordings of any length: a simulated minute, repeated with later stamps."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

from population_machines import CoEnergy, Harmonic, Machine

from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.files.storage.bag import open_bag
from drive_id.files.write.rosbag2_writer import Rosbag2McapWriter, whole_or_nothing
from drive_id.files.write.writer import write_recording
from drive_id.fitting.simulated import run_experiment
from drive_id.types import Samples

RATE = 10_000
BLOCK = 100
PART = 60.0
"""Seconds that are simulated; longer recordings repeat them, with a break of one message in between."""

_STAMP, _COUNT = struct.Struct("<iI"), struct.Struct("<Q")
_STAMP_AT, _COUNT_AT = 4, 28  # in the CDR of a message whose frame is "drive"


@cache
def experiment(seconds: float, rate: float = RATE, trajectory: Lissajous | None = None) -> Samples:
    """Simulate the ipm drive, by default on the paper's trajectory, 300 A, 500 rpm, 0.1 % noise, dead time."""
    settings = SimulationSettings(inverter="dead_time", current_noise=1e-3, sample_period=1.0 / rate)
    return run_experiment(machine_map("ipm"), settings, trajectory, seconds).samples


def recording(folder: Path, seconds: float) -> Path:
    """Write a bag of so many seconds, in blocks of 100 samples, if it is not there yet."""
    path = folder / f"bag_{seconds:.0f}s"
    if path.exists():
        return path
    if seconds <= PART:
        write_recording(path, experiment(seconds), block_size=BLOCK)
    else:
        _repeat(recording(folder, PART), path, round(seconds / PART))
    return path


def real_shaped(folder: Path) -> dict[str, Path]:
    """Write bags of 10 s of machines that bend as real ones do, and return them by what they are."""
    waves = tuple(Harmonic(order, 0.0, (0.04 / order, 0.06 / order), (0.02, 0.02)) for order in (6, 12, 18, 24))
    shapes = {
        "a PM-SyRM of fine saturation, harmonics of orders 6 to 24": CoEnergy(
            (0.25, 0.1), (0.15, 0.15), (0.1, 1.5), 0.4, 4.0, harmonics=waves
        ),
        "an IPM with a sharp bridge, harmonics of orders 6 and 12": CoEnergy(
            (0.5, 0.5), (0.13, 0.13), (0.2, 0.7), 0.6, 3.0, bridge=(0.1, 0.02, 0.1), harmonics=waves[:2]
        ),
    }
    out = {}
    for number, (name, shape) in enumerate(shapes.items()):
        out[name] = path = folder / f"real_shaped_{number}"
        if not path.exists():
            drive = Machine(shape, 20.0, 0.7, 0.3, 2, 560.0).to_map(name)
            settings = SimulationSettings(inverter="dead_time", current_noise=1e-3)
            write_recording(path, run_experiment(drive, settings, None, 10.0).samples, block_size=BLOCK)
    return out


def copies(folder: Path, seconds: float, count: int) -> list[Path]:
    """Write several bags of so many seconds, taken one after the other, so that no two are the same recording."""
    source, step = recording(folder, min(seconds, PART)), min(seconds, PART)
    targets = [folder / f"copy_{number}_{seconds:.0f}s" for number in range(count)]
    for number, target in enumerate(targets):
        if not target.exists():
            times = round(seconds / step)
            _repeat(source, target, times, number * times)
    return targets


def _repeat(source: Path, target: Path, times: int, before: int = 0) -> None:
    """Write the messages of a bag again and again, with stamps and counts that go on, as if after so many others."""
    with open_bag(source) as bag:
        types = {name: topic.type_name for name, topic in bag.topics.items()}
        messages = [(entry.topic, entry.log_time, bytes(entry.data)) for entry in bag.messages(frozenset(types))]
    samples = round(PART * RATE) + BLOCK
    with whole_or_nothing(target) as partial, Rosbag2McapWriter(partial) as writer:
        for topic, type_name in types.items():
            writer.add_topic(topic, type_name)
        for number in range(before, before + times):
            shift = number * samples * (1_000_000_000 // RATE)
            for topic, log_time, data in messages:
                writer.write(topic, moved(data, shift, number * samples), log_time + shift)


def moved(data: bytes, shift: int, count: int) -> bytes:
    """Return a message whose samples were taken ``shift`` ns later and count on from ``count``."""
    seconds, nanoseconds = _STAMP.unpack_from(data, _STAMP_AT)
    (first,) = _COUNT.unpack_from(data, _COUNT_AT)
    stamp = _STAMP.pack(*divmod(seconds * 1_000_000_000 + nanoseconds + shift, 1_000_000_000))
    middle = data[_STAMP_AT + _STAMP.size : _COUNT_AT]
    return data[:_STAMP_AT] + stamp + middle + _COUNT.pack(first + count) + data[_COUNT_AT + _COUNT.size :]
