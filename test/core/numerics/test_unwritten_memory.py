"""Nothing is computed with memory that was never written: what it holds depends on what ran before."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.core.fit_settings import FitSettings
from drive_id.core.result.identify import identify
from drive_id.fitting.simulated import simulate

_ANYTHING = np.uint64(0x7FF0000000000001).view(np.float64)
"""A signalling NaN: whatever is computed with it is invalid, which the tests make an error. A copy is not."""


@pytest.mark.parametrize("method", [pytest.param("full", marks=pytest.mark.slow), "joint"])
def test_fits_do_not_depend_on_it(method, monkeypatch):
    recording = [simulate("ipm", 3.0, speed=500.0, noise=1e-3, seed=1)]
    expected = identify(recording, FitSettings(method))
    empty, empty_like = np.empty, np.empty_like

    def poisoned(array):
        if array.dtype.kind in "fc":
            array.fill(_ANYTHING)
        return array

    monkeypatch.setattr(np, "empty", lambda *args, **kwargs: poisoned(empty(*args, **kwargs)))
    monkeypatch.setattr(np, "empty_like", lambda *args, **kwargs: poisoned(empty_like(*args, **kwargs)))
    found = identify(recording, FitSettings(method))
    np.testing.assert_array_equal(found.flux_map.psi_d, expected.flux_map.psi_d)
    np.testing.assert_array_equal(found.flux_map.sigma_d, expected.flux_map.sigma_d)
