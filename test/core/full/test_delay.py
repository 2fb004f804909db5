"""When a delay of the voltages is believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from synthetic import reciprocal_flux, record

from drive_id.core.full.delay import Delay, estimate_delay
from drive_id.core.full.model import FullModel, ModelSpec
from drive_id.core.full.solver import CurrentNoise, Solver
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import MOST_DELAY


def test_a_delay_of_several_samples_is_not_believed_where_noise_explains_what_is_left():
    """What a controller answers to noise of its currents feigned four samples, and took psi_q to 170 % of itself."""
    samples = record(reciprocal_flux, duration=3.0, noise=0.3)
    late = replace(samples, u_abc=np.roll(samples.u_abc, -3, axis=0))
    sums = WindowSums(FullModel(np.full(2, -310.0), np.full(2, 310.0), 300.0, (), reciprocal=True))
    sums.next_recording()
    sums.add(late)
    sums = sums.finished()
    solver = Solver.over(sums)
    solution = solver.solve(ModelSpec(True, (), penalty=1e-4))
    noise = CurrentNoise.met(2 / 3 * 0.3**2, sums.kept())
    turn = 209.0 * 1e-4
    found = estimate_delay(solver, solution, noise)
    assert abs(found.value - 3.0) < 0.5
    assert found.significant(turn)
    left = solution.residual_rms**2 / noise.explained(solver.model, solution)
    louder = replace(noise, variance=left * noise.variance)
    doubted = estimate_delay(solver, solution, louder)
    assert doubted.sigma >= MOST_DELAY
    assert not doubted.significant(turn)


def test_a_delay_that_was_rounded_is_certain_by_its_distance_from_the_next_half_sample():
    """One of 0.84 samples +- 0.12 was rounded to 1, though one half is 2.9 errors off: silently 0.37 % at 5 sigma."""
    assert not Delay(1.0, 0.116, off=-0.163).certain
    assert Delay(1.0, 0.116).certain
    assert Delay(1.0, 0.08, off=-0.163).certain
