"""Method ``full`` on drives recorded live: zero current before and after the figure, and what is said about them."""

from __future__ import annotations

import numpy as np
import pytest
from store import stored

from drive_id.bench.drive import build_machine, simulate
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full.calibration import mirrored_points
from drive_id.core.result.conclusion import conclude
from drive_id.core.result.identify import gather, identify, score

pytestmark = pytest.mark.accuracy

COMPENSATES, STANDS_OUT = "compensates the inverter's drop", "are outliers"


def live(machine="ipm", before=2.0, after=2.0, figure=3.0, **settings):
    """Simulate a drive that rests, follows a Lissajous figure whose end has a kink, and rests again."""
    wanted = SimulationSettings(**{"current_noise": 1e-3, **settings})
    source = machine_map(machine)
    trajectory = Lissajous(i_max=build_machine(source, wanted).i_max)
    moving = trajectory(1e-4 * np.arange(round(1e4 * figure)))
    rests = [np.zeros((round(1e4 * seconds), 2)) for seconds in (before, after)]
    return simulate(source, wanted, np.concatenate([rests[0], moving, rests[1]]))


def concluded(simulation, samples=None, **settings):
    """Fit as the live node does, by a radius that is known in advance."""
    samples = samples or simulation.samples
    return conclude(gather([samples], FitSettings("full", i_max=simulation.truth.i_max, **settings)), [])


def of_live(machine, **options):
    """Return what is found of such a drive, and the larger error of its fluxes."""
    simulation = live(machine, **options)
    found = concluded(simulation)
    return found, max(score(found, simulation.truth))


def said(found):
    return " ".join((*found.statements, *found.report.warnings))


@pytest.mark.parametrize(
    ("machine", "options"),
    [
        ("ipm", {"seed": 0, "before": 5.0}),
        ("ipm", {"seed": 1, "speeds": (300.0,), "current_noise": 5e-3}),
        ("spm", {"seed": 2, "after": 0.1}),
        ("pmsyrm", {"seed": 4, "speeds": (1200.0,), "current_noise": 2e-3}),
    ],
)
def test_a_healthy_drive_that_rests_is_told_nothing_false(machine, options):
    found, _ = stored(of_live, machine, **options)
    assert COMPENSATES not in said(found)
    assert STANDS_OUT not in said(found)
    assert "No angle" not in said(found)


def test_rests_change_next_to_nothing():
    (rested, error), (plain, of_plain) = (
        stored(of_live, "ipm", seed=0, before=5.0),
        of_live("ipm", before=0.0, after=0.0),
    )
    assert error < 1.5 * of_plain < 5e-4
    assert rested.report.samples_used == pytest.approx(plain.report.samples_used, abs=1000)


def test_a_compensating_drive_is_still_told_apart():
    assert COMPENSATES in said(concluded(live("pmsyrm", figure=6.0, inverter_compensation=True)))


def test_a_map_of_motoring_currents_alone_has_no_mirror():
    """Without a given radius the axis of i_q ends where the data do, just below zero."""
    source, settings = machine_map("ipm"), SimulationSettings(current_noise=1e-3)
    t = 1e-4 * np.arange(40_000)
    i_dq = np.stack([-150 + 140 * np.sin(2 * np.pi * 3.7 * t), 142 - 142 * np.cos(2 * np.pi * 1.1 * t)], axis=-1)
    found = identify([simulate(source, settings, i_dq).samples], FitSettings("full"))
    assert -20 < found.flux_map.i_q[0] < 0
    assert found.flux_map.i_q[-1] > 280
    (angle,) = (entry for entry in found.calibrations if entry.name == "resolver_offset")
    assert not angle.applied
    assert "only one sign of i_q" in angle.message
    assert "No angle" not in said(found)


@pytest.mark.parametrize(("low", "high"), [(-300.0, 300.0), (-120.0, 290.0), (-4.5, 289.0), (-289.0, 130.0)])
def test_only_points_whose_images_have_data_are_mirrored(low, high):
    i_d, i_q = np.linspace(-300.0, 10.0, 21), np.linspace(low, high, 33)
    inside = np.random.default_rng(0).random((21, 33)) < 0.7
    half = (i_q[1] - i_q[0]) / 2
    expected = [
        (i_d[m], i_q[n])
        for m, n in np.argwhere(inside)
        if any(inside[m, k] and abs(i_q[k] + i_q[n]) <= half for k in range(33))
    ]
    if max((abs(q) for _, q in expected), default=0.0) < 90.0:
        expected = []
    found = mirrored_points(i_d, i_q, inside, 300.0)
    np.testing.assert_allclose(found, np.reshape(expected, (-1, 2)))
