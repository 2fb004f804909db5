"""The excerpt of the simulated current: around the largest deviation, also of what diverged."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from drive_id.core.validation.simulated_current import simulated_current


@pytest.fixture(scope="module")
def pieces():
    return [synthetic.record(resistance=0.02, duration=seconds) for seconds in (1.5, 1.0)]


def currents(pieces):
    return [np.column_stack([np.arange(len(piece)), -np.arange(len(piece))]).astype(float) for piece in pieces]


def test_the_excerpt_surrounds_the_largest_deviation(pieces):
    measured, simulated = currents(pieces), currents(pieces)
    at = len(pieces[1]) // 2
    simulated[1][at, 1] += 7.0
    found = simulated_current(pieces, simulated, measured)
    assert found is not None
    length = pieces[0].duration + pieces[1].duration
    when = pieces[0].duration + at * pieces[1].sample_period
    assert found.time[0] < when < found.time[-1] <= length
    assert found.time[-1] - found.time[0] == pytest.approx(1.0, rel=0.01)
    assert len(found.time) <= 2001
    place = int(when / length * len(found.bin_time))
    assert found.deviation[:, 1].argmax() == place
    assert found.deviation[:, 0].max() == 0.0


def test_a_simulation_that_diverged_is_shown_as_far_as_it_goes(pieces):
    measured, simulated = currents(pieces), currents(pieces)
    simulated[0][100:] = np.nan
    simulated[1][:] = np.nan
    found = simulated_current(pieces, simulated, measured)
    assert found is not None
    assert found.time[0] == 0.0
    assert np.isfinite(found.simulated[0]).all()
    assert np.isnan(found.simulated[-1]).all()
    assert np.isfinite(found.measured).all()
    assert np.isnan(found.deviation[-1]).all()


def test_nothing_simulated_gives_no_excerpt(pieces):
    assert simulated_current([], [], []) is None
    never = [np.full((len(piece), 2), np.nan) for piece in pieces]
    assert simulated_current(pieces, never, currents(pieces)) is None
