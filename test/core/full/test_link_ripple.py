"""The frequency of a ripple of the DC link, and what is said of one that was recorded."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic import reciprocal_flux, record

from drive_id.core.full.effects.effect import Reported
from drive_id.core.full.effects.link import DcLink
from drive_id.core.full.link_ripple import ripple_frequency
from drive_id.core.full.model import FullModel, ModelSpec
from drive_id.core.full.solver import Solver
from drive_id.core.full.window_sums import WindowSums


def fitted(share):
    """Sums and the estimate without a ripple, of voltages that act with a share ``share(t)`` too much."""
    samples = record(reciprocal_flux, duration=6.0, noise=0.1)
    time = (samples.stamp - samples.stamp[0]) * 1e-9
    acting = replace(samples, u_abc=samples.u_abc / (1 + share(time))[:, None])
    sums = WindowSums(FullModel(np.full(2, -310.0), np.full(2, 310.0), 300.0, (), reciprocal=True))
    sums.next_recording()
    sums.add(acting)
    sums = sums.finished()
    return sums, Solver.over(sums).solve(ModelSpec(True, (), penalty=1e-4)).estimate


@pytest.mark.parametrize("frequency", [0.61, 7.3, 299.2])
def test_the_frequency_of_a_ripple_is_found(frequency):
    sums, estimate = fitted(lambda t: 0.01 * np.cos(2 * np.pi * frequency * t + 0.7))
    found, share = ripple_frequency(sums.model, estimate, sums.kept())
    assert found == pytest.approx(frequency, abs=0.01)
    assert share > 0.5


def test_a_ripple_does_not_slow_down_to_a_gain_while_it_is_refined():
    """Where a machine was weaker behind a gap, it went to 0.0001 Hz and 100 %, and R to 0.04 % of itself."""
    sums, estimate = fitted(lambda t: np.where(t > 3.0, 0.005, -0.005))
    half_a_turn, frequency = 0.5 / 6.0, 0.2
    for _ in range(5):
        frequency, _ = ripple_frequency(sums.model, estimate, sums.kept(), frequency)
        assert frequency > half_a_turn


@pytest.mark.parametrize(
    ("share", "said", "doubtful"),
    [
        (1.0, "", False),
        (2.0, "only 0 to 100 % are possible", True),
        (-0.5, "only 0 to 100 % are possible", True),
        (0.5, "neither none nor all of it", True),
        (-1.0, "DC link is noise", False),
    ],
)
def test_a_share_of_the_recorded_link_that_cannot_be_right_is_doubted(share, said, doubtful):
    reported = SimpleNamespace(rivals=(), open=False, several_speeds=True)
    entry = partial(Reported.entry, reported)
    found = SimpleNamespace(value=[share], sigma=[0.01], links=(400.0, 400.0), link=400.0, entry=entry)
    (told,) = DcLink("dc_link_share").report(found)
    assert told.doubtful == doubtful
    assert said in told.message
