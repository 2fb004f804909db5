"""Samples and bags for the tests of ``drive_id.files``: small, and with every value different."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from drive_id.types import GroundTruth, Samples

START = 1_700_000_000_123_456_789
PERIOD = 1e-4
STEP = 100_000


def make_samples(n: int = 600, *, gap_at: int = 0, reference: bool = True, seed: int = 0) -> Samples:
    """Make ``n`` samples whose values are float32 numbers, with a gap of 1 ms before sample ``gap_at``."""
    rng = np.random.default_rng(seed)
    index = np.arange(n)
    stamp = START + index * STEP
    stamp[gap_at:] += 1_000_000 if gap_at else 0
    angle = np.asarray((0.02 * index + np.pi) % (2 * np.pi) - np.pi, np.float32)
    return Samples(
        stamp=stamp,
        i_abc=rng.normal(0, 10, (n, 3)).astype(np.float32).astype(float),
        u_abc=rng.normal(0, 100, (n, 3)).astype(np.float32).astype(float),
        angle=angle.astype(float),
        speed=np.full(n, 200.0),
        sample_period=PERIOD,
        run_starts=np.array([0, gap_at] if gap_at else [0]),
        i_dq_reference=rng.normal(0, 10, (n, 2)).astype(np.float32).astype(float) if reference else None,
    )


def make_truth() -> GroundTruth:
    """Make a ground truth with a value in every field."""
    axis = np.linspace(-10, 10, 5)
    return GroundTruth(
        machine="test machine",
        i_d=axis,
        i_q=axis + 1,
        psi_d=np.outer(axis, axis),
        psi_q=np.outer(axis, axis) + 1,
        resistance=0.5,
        inverter_current=axis,
        inverter_voltage=np.tanh(axis),
        i_max=10.0,
        pole_pairs=3,
        details={"seed": 1, "speed": 500.0, "noise": "white"},
    )


def assert_equal_samples(found: Samples, expected: Samples) -> None:
    """Compare everything that a recording stores."""
    assert found.sample_period == expected.sample_period
    for name in ("stamp", "run_starts", "i_abc", "u_abc", "angle", "speed"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def write_foreign(
    path: Path,
    store: Typestore,
    topics: dict[str, tuple[str, Iterable[tuple[int, Any]]]],
    *,
    storage: StoragePlugin = StoragePlugin.MCAP,
) -> Path:
    """Write a bag with the writer of rosbags: topic to type and (log time, message) pairs."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        queue = []
        for name, (kind, messages) in topics.items():
            connection = writer.add_connection(name, kind, typestore=store)
            queue += [(time, number, connection, kind, message) for number, (time, message) in enumerate(messages)]
        for time, _, connection, kind, message in sorted(queue, key=lambda entry: entry[:2]):
            writer.write(connection, time, bytes(store.serialize_cdr(message, kind)))
    return path
