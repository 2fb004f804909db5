"""Which differences between two recordings errors and heat explain, and which show that the drive was exchanged."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.same_drive import compared


def drive(method, resistance=0.01, magnet=0.1, sigma=0.0):
    axis = np.array([-1.0, 0.0, 1.0])
    flat = np.ones((3, 3))
    sigmas = sigma * magnet * flat
    flux_map = FluxMap(axis, axis, magnet * flat, 0.0 * flat, sigmas, sigmas, np.ones((3, 3), np.bool_))
    return SimpleNamespace(method=method, resistance=resistance, sigma_resistance=sigma * resistance, flux_map=flux_map)


@pytest.mark.parametrize(
    ("method", "seconds", "most"),
    [("full", 0.0, 0.01 + 2 * 0.00393), ("full", 100.0, 0.01 + 25 * 0.00393), ("full", -10.0, 0.01 + 7 * 0.00393),
     ("joint", 0.0, 0.05 + 2 * 0.00393)],
)  # fmt: skip
def test_resistances_may_differ_by_the_error_of_the_method_and_by_heat(method, seconds, most):
    one = drive(method)
    assert compared(one, drive(method, 0.01 / (1 - 0.98 * most)), seconds).differ == ()
    (said,) = compared(one, drive(method, 0.01 / (1 - 1.02 * most)), seconds).differ
    assert said.startswith("R is 10")


@pytest.mark.parametrize(("method", "most"), [("full", 0.01 + 2 * 0.001), ("joint", 0.05 + 2 * 0.001)])
def test_magnets_may_differ_likewise(method, most):
    one = drive(method)
    assert compared(one, drive(method, magnet=0.1 / (1 - 0.98 * most)), 0.0).differ == ()
    (said,) = compared(one, drive(method, magnet=0.1 / (1 - 1.02 * most)), 0.0).differ
    assert said.startswith("psi_PM is")


def test_large_errors_show_nothing():
    assert not compared(drive("full", sigma=0.005), drive("full", sigma=0.005), 0.0).vague
    found = compared(drive("full", sigma=0.1), drive("full", resistance=0.012, sigma=0.1), 0.0)
    assert (found.differ, found.vague) == ((), True)
