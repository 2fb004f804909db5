"""The figures of a recording are the same however it is cut, and those of its samples taken together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from synthetic import cut, record

from drive_id.core import frames
from drive_id.core.checks.overview import Overviewing
from drive_id.core.signals.join import Piece


@pytest.fixture(scope="module")
def gappy():
    """Three runs, 3 ms and 20.1 ms apart."""
    whole = record(duration=0.3)
    starts = np.array([0, 700, 2100])
    lost = np.repeat([0, 30, 231], np.diff([*starts, len(whole)])) * 100_000
    return replace(whole, stamp=whole.stamp + lost, run_starts=starts)


@pytest.mark.parametrize("ends", [[], [700], [1400], [700, 1400, 2100], [350, 2100, 2600]])
def test_the_figures_are_those_of_the_samples(gappy, ends):
    overviewing = Overviewing()
    for start, stop in zip([0, *ends], [*ends, len(gappy)], strict=True):
        overviewing.add(Piece(*cut(gappy, start, stop)))
    figures = overviewing.overview(200.0).figures
    i_dq = frames.to_dq(gappy.i_abc, gappy.angle)
    assert (figures["samples"], figures["runs"]) == (len(gappy), 3)
    assert figures["time_lost"] == pytest.approx(0.003 + 0.0201, abs=1e-12)
    assert figures["duration"] == pytest.approx(len(gappy) * 1e-4)
    assert figures["speed_mean"] == pytest.approx(gappy.speed.mean())
    assert figures["turn_per_sample"] == pytest.approx(np.sqrt(np.mean(gappy.speed**2)) * 1e-4)
    assert (figures["speed_min"], figures["speed_max"]) == (gappy.speed.min(), gappy.speed.max())
    np.testing.assert_allclose([figures["i_d_min"], figures["i_q_min"]], i_dq.min(axis=0))
    np.testing.assert_allclose([figures["i_d_max"], figures["i_q_max"]], i_dq.max(axis=0))


def test_without_samples_or_current_there_is_none(gappy):
    assert Overviewing().overview(100.0) is None
    overviewing = Overviewing()
    overviewing.add(Piece(gappy, continues=False))
    assert overviewing.overview(0.0) is None
