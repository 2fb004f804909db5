"""An i_max far from the data is named with the numbers and the remedy."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import only, record

from drive_id.bench.drive import simulate
from drive_id.bench.machines import machine_map
from drive_id.bench.settings import SimulationSettings
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.prescan import Prescan
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import gather, identify
from drive_id.errors import CoverageError


@pytest.fixture(scope="module")
def samples():
    return record(duration=2.0)


@pytest.mark.parametrize("method", ["joint", "full"])
@pytest.mark.parametrize(
    ("i_max", "said"),
    [
        (140.0, r"^i_max is 140 A but the recording reaches 300 A: .* beyond 147 A .* set i_max to 300 A\.$"),
        (1500.0, r"^i_max is 1500 A but the currents reach only 300 A: .* cover only 4\.\d % .* set i_max to 300 A "),
    ],
)
def test_far_off(samples, method, i_max, said):
    with pytest.raises(CoverageError, match=said):
        identify([samples], FitSettings(method, i_max=i_max))


def test_off_by_some(samples):
    def warnings(i_max):
        return " ".join(identify([samples], FitSettings("joint", i_max=i_max)).report.warnings)

    assert "i_max is 200 A but the recording reaches 300 A: " in warnings(200.0)
    assert "set i_max to 300 A." in warnings(200.0)
    assert "i_max is 600 A but the currents reach only 300 A: the map would cover only 2" in warnings(600.0)
    for i_max in (290.0, 300.0, 400.0):
        assert "i_max" not in warnings(i_max)


def test_a_disc_that_is_not_filled_is_no_wrong_i_max():
    thin = Lissajous(300.0)(np.arange(20_000) * 1e-4) * [0.007, 1.0]
    samples = simulate(machine_map("ipm"), SimulationSettings(inverter="none", harmonics=0.0), thin).samples
    with pytest.raises(CoverageError, match=r"^The trajectory covers \d\.\d % of the disc of 300 A, too little"):
        identify([samples], FitSettings("joint", i_max=300.0))


@pytest.mark.parametrize(("axis", "sign", "name"), [(0, 1, "i_d < 0"), (0, -1, "i_d > 0"), (1, 1, "i_q < 0")])
def test_the_empty_half_of_the_disc_is_named(samples, axis, sign, name):
    i_dq = frames.to_dq(samples.i_abc, samples.angle)
    half = only(samples, (sign * i_dq[:, axis] > 20) & (np.abs(i_dq[:, 1 - axis]) < 250))
    said = identify([half], FitSettings("joint", i_max=300.0)).report.warnings
    assert f" % of its half with {name}. Elsewhere, use the map" in " ".join(said)


def test_what_was_reached_is_merged_and_stored():
    settings = FitSettings("joint", i_max=300.0)
    one, other = (gather([record(duration=1.0, i_max=i_max)], settings) for i_max in (100.0, 300.0))
    assert one.merged(other).reached == other.reached == pytest.approx(300.0, rel=1e-3)
    restored = Evidence.within(settings, 300.0)
    restored.restore(one.state())
    assert restored.reached == one.reached == pytest.approx(100.0, rel=1e-3)


def test_prepared_evidence_knows_what_was_reached(samples):
    prescan = Prescan()
    prescan.add(samples)
    assert prescan.prepare(FitSettings("joint")).reached == prescan.radius == pytest.approx(300.0, rel=1e-3)


@pytest.mark.slow  # 5 s at 10 kHz are checked
def test_too_large_an_i_max_does_not_hide_the_mirrored_currents(simulation):
    """It was once said that i_q had one sign only."""
    found = identify([simulation.samples], FitSettings("full", i_max=1200.0, harmonic_orders=(6,)))
    assert "i_max is 1200 A but the currents reach only 300 A: " in " ".join(found.report.warnings)
    assert "one sign" not in " ".join((*found.statements, *found.report.warnings))
