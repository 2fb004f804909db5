"""Analyses against quintic splines and general-purpose optimizers: the hardest two machines of the benchmark."""

from __future__ import annotations

import math

import pytest
import reference


@pytest.mark.slow  # an independent optimization finds every quantity
@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("IPM, half plane", (1e-4, 5e-3, 2e-2, 1e-6, 1e-6, 1e-5, 1e-4)),
        ("IPM, data to 0.75 i_max", (1e-4, 5e-3, 5e-3, 1e-6, 1e-6, 1e-5, 1e-4)),
    ],
)
def test_all_quantities(name, limits):
    found = reference.figures(*reference.machines()[name])
    assert sum(map(math.isfinite, found)) >= 5
    assert all(not value > limit for value, limit in zip(found, limits, strict=True)), found
