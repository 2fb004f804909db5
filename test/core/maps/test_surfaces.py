"""Bicubic surfaces against scipy's interpolating splines, which a fit does not load."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from drive_id.core.maps.surfaces import Bicubic


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize("counts", [(4, 4), (9, 17)])
def test_splines_on_uneven_axes_are_those_of_scipy(counts, dx, dy):
    rng = np.random.default_rng(0)
    x, y = (np.cumsum(rng.uniform(0.5, 2.0, count)) for count in counts)
    value = rng.normal(size=counts)
    at = [rng.uniform(axis[0], axis[-1], (5, 20)) for axis in (x, y)]
    expected = RectBivariateSpline(x, y, value).ev(*at, dx=dx, dy=dy)
    np.testing.assert_allclose(Bicubic.over(x, y, value).ev(*at, dx, dy), expected, rtol=1e-9, atol=1e-10)
    ends = [axis[[0, -1]] for axis in (x, y)]
    expected = RectBivariateSpline(x, y, value).ev(*ends, dx=dx, dy=dy)
    np.testing.assert_allclose(Bicubic.over(x, y, value).ev(*ends, dx, dy), expected, rtol=1e-9, atol=1e-10)
