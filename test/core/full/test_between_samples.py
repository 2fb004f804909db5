"""At many degrees per sample the current bows between its samples, on a drive that the bench integrates in time."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.bench.settings import SimulationSettings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import effects
from drive_id.core.result.identify import identify, score
from drive_id.fitting.simulated import machine_map, run_experiment

SETTINGS = SimulationSettings(
    speeds=(3000.0,), sample_period=2e-4, inverter="none", harmonics=0.0, i_max=10.0, current_noise=1e-4, substeps=8
)


@pytest.fixture(scope="module")
def fast():
    """Return a servo machine that turns by 10.8 degrees electrical per sample."""
    return run_experiment(machine_map("spm"), SETTINGS, None, 5.0)


def fitted(fast):
    found = identify([fast.samples], FitSettings("full", i_max=10.0, harmonic_orders=(6,), search_orders=False))
    return found, max(score(found, fast.truth))


def test_the_current_between_samples_is_counted(fast, monkeypatch):
    found, error = fitted(fast)
    assert error < 2e-4
    assert found.resistance == pytest.approx(fast.truth.resistance, rel=5e-3)
    assert not {c.name for c in found.calibrations if c.applied} & {"angle_latency", "current_latency", "flux_lag"}
    monkeypatch.setattr(effects, "_LEAST_TURN", np.inf)
    without, larger = fitted(fast)
    assert larger > 2 * error or abs(without.resistance / fast.truth.resistance - 1) > 2e-2
