"""Frames lost at random are no jitter: the stamps of the others count."""

from __future__ import annotations

import numpy as np

from drive_id.inspection.contents import Table

PERIOD = 100_000


def table(stamp):
    return Table("log", "csv", len(stamp), stamp=stamp.astype(np.int64))


def test_lost_frames_and_jitter():
    rng = np.random.default_rng(3)
    regular = np.arange(20_000) * PERIOD
    for share in (0.005, 0.02, 0.05):
        kept = rng.random(len(regular)) > share
        assert table(regular[kept]).jitter < 1e-12
        shaken = regular[kept] + np.rint(rng.normal(0, 300, kept.sum()))
        assert 3e-7 < table(shaken).jitter < 6e-7
    shaken = regular + np.rint(rng.normal(0, 15_000, len(regular)))
    assert 1.5e-5 < table(shaken).jitter < 3e-5
