"""What the live page is told: forecasts that hold, and values that JSON can hold."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from drive_id.live.live_view import LiveView, ResistanceSoFar, forecast


def course(sigmas, resistance=0.01, rate=10_000):
    """Estimates 1 s, 2 s, ... after the start."""
    return [ResistanceSoFar(float(k), rate * k, resistance, sigma) for k, sigma in enumerate(sigmas, 1)]


def test_white_noise_is_forecast_to_the_second():
    """1.96 σ = 1.96 % of R after 4 s: a quarter of the variance needs four times the time."""
    found = course(2e-4 / np.sqrt(np.arange(1, 5)))
    assert forecast(found, 4.0) == "11 s more, and R is within 1 % (95 %)."
    assert forecast(found, 9.0) == "6 s more, and R is within 1 % (95 %)."
    assert forecast(found, 16.0) == "", "overdue"
    needed = found[-1].time * (found[-1].error / 0.01) ** 2
    assert needed - 4.0 == pytest.approx(11.37, abs=0.01)


@pytest.mark.parametrize(
    "sigmas",
    [[], [1e-4], [1e-4, 1e-4, 1e-4], [1e-4, 2e-5, 1.9e-5 * 3], [4e-4, 4e-4 / 2**0.5], [np.inf, np.inf], [1e-4, 2e-4]],
    ids=["none", "one", "constant", "erratic", "far", "unknown", "growing"],
)
def test_what_cannot_be_known_is_not_forecast(sigmas):
    assert forecast(course(sigmas), len(sigmas)) == ""


def test_reached_is_said():
    assert forecast(course([5e-5, 4e-5]), 9.0) == "R is within 0.78 % (95 %)."


def test_health_of_the_identification_gives_estimates_once_for_each_fit():
    view = LiveView()

    def status(samples, time, sigma=1e-4):
        values = {"fit: samples": str(samples), "fit: resistance [ohm]": "0.01", "fit: age [s]": "0.5"}
        view.health("/identification", 0, "Busy.", values | {"fit: sigma of resistance [ohm]": str(sigma)}, time)
        return view.take()

    status(1000, 1.0)
    status(1000, 2.0)
    found = status(2000, 3.0)
    assert [samples for samples, _, _ in found["resistance"]["estimates"]] == [1000, 2000]
    assert found["nodes"] == {"/identification": {"level": 0, "message": "Busy."}}
    assert len(status(500, 4.0)["resistance"]["estimates"]) == 1, "another experiment"
    view.health("/recorder", 1, "Samples are missing.", {}, 5.0)
    assert "resistance" not in view.take()
    view.health("/trajectory_publisher", 0, "Waiting for a start.", {"i_max [A]": "300"}, 6.0)
    assert view.take()["i_max"] == 300.0


def test_the_map_of_a_requested_fit_holds_until_the_next_run(fitted):
    view, provisional = LiveView(), message(fitted)
    requested = SimpleNamespace(**{**vars(provisional), "provisional": False, "method": "full"})
    view.flux_map(provisional)
    view.flux_map(requested)
    view.flux_map(provisional)
    assert view.take()["map"]["method"] == "full"
    view.state("publisher", {"state": "idle"})
    view.flux_map(provisional)
    assert "map" not in view.take()
    view.state("publisher", {"state": "running"})
    view.flux_map(provisional)
    assert view.take()["map"]["method"] == "joint"


def message(fitted):
    found, drive = fitted.flux_map, fitted.drive
    arrays = {name: getattr(found, name).ravel() for name in ("psi_d", "psi_q", "sigma_d", "sigma_q", "inside")}
    return SimpleNamespace(
        i_d=found.i_d, i_q=found.i_q, i_max=fitted.i_max, resistance=drive.resistance, sigma_resistance=np.nan,
        voltage_error=1.0, sigma_voltage_error=0.1, coverage=0.9, provisional=True, machine="ipm", method="joint",
        warnings=["A warning."], **arrays,
    )  # fmt: skip


def test_a_map_is_its_cells_with_data_and_its_quantities(fitted):
    view = LiveView()
    view.flux_map(message(fitted))
    found = json.loads(json.dumps(view.take(), allow_nan=False))["map"]
    assert found["resistance"] == [pytest.approx(1e3 * fitted.resistance), None, "mΩ"]
    psi_pm = 1e3 * float(fitted.flux_map.psi_dq(0.0, 0.0)[0])
    assert found["psi_pm"][0] == pytest.approx(psi_pm, rel=1e-6)
    assert found["psi_pm"][2] == "mWb"
    cells = found["step"] * np.array(found["cells"])
    assert np.hypot(*cells.T).max() <= 1.1 * fitted.i_max
    sigma = np.maximum(*fitted.flux_map.sigma(*cells.T))
    np.testing.assert_allclose(found["sigma"], 1e3 * sigma, rtol=1e-9)
    assert len(cells) > 1000
    assert found["warnings"] == ["A warning."]


def test_points_are_bounded_and_told_once():
    view = LiveView()
    for k in range(5000):
        view.point(float(k), 0.0, 100.0)
    found = view.take()
    assert [found["points"][0][0], found["points"][-1][0], len(found["points"])] == [3000.0, 4999.0, 2000]
    assert view.take() == {}


def test_infinite_durations_are_null():
    view = LiveView()
    view.state("publisher", {"state": "running", "duration": np.inf})
    assert json.dumps(view.take(), allow_nan=False) == '{"publisher": {"state": "running", "duration": null}}'


def test_who_has_fallen_silent_is_told_once_and_until_it_is_back():
    view = LiveView()
    view.health("/identification", 0, "Waiting.", {}, 10.0)
    view.state("drive", {"enabled": True}, 12.0)
    assert "silent" not in view.take(14.0)
    assert view.take(16.0)["silent"] == ["Nothing is heard of /identification any more."]
    assert "silent" not in view.take(16.5)
    assert len(view.take(18.0)["silent"]) == 2
    view.state("drive", {"enabled": True}, 19.0)
    view.health("/identification", 0, "Waiting.", {}, 19.0)
    assert view.take(19.5)["silent"] == []
