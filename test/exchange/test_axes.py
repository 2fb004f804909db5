"""Axes of tables contain exactly zero and reach i_max."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.axes import default_axis, equal_steps, listed


def test_the_grid_that_was_asked_for():
    axis = equal_steps(41, -300.0, 300.0)
    assert axis.tolist() == [15.0 * k for k in range(-20, 21)]
    assert equal_steps(7, -0.3, 0.3).tolist() == [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert equal_steps(4, -300.0, 0.0).tolist() == [-300.0, -200.0, -100.0, 0.0]


@pytest.mark.parametrize(
    ("count", "low", "high", "said"),
    [
        (40, -300.0, 300.0, "choose --grid 41"),
        (41, -300.0, 310.0, "choose another range"),
        (41, 10.0, 300.0, "contain 0"),
        (41, 300.0, -300.0, "increase"),
        (3, -1.0, 1.0, "choose 4 to 2001"),
        (41, -np.inf, 1.0, "finite"),
    ],
)
def test_grids_without_zero(count, low, high, said):
    with pytest.raises(ConfigurationError, match=said):
        equal_steps(count, low, high)


def test_lists():
    assert listed("-300,-100,0,50", "axis-d").tolist() == [-300.0, -100.0, 0.0, 50.0]
    assert listed("-0.3:0.1:0.1", "axis-d").tolist() == [-0.3, -0.2, -0.1, 0.0, 0.1]
    for text in ("", "a,b", "1:2", "-3,-2,-1,1", "0,1,1,2", "-1:0.3:1", "nan,0,1,2", "-1:0:1"):
        with pytest.raises(ConfigurationError, match="--axis-q"):
            listed(text, "axis-q")


@pytest.mark.parametrize("i_max", [0.7, 10.0, 24.89, 309.7, 1234.0])
def test_the_default(i_max):
    axis = default_axis(i_max)
    assert (len(axis), axis[20]) == (41, 0.0)
    assert axis[0] == pytest.approx(-i_max, rel=1e-12)
    assert axis[-1] == pytest.approx(i_max, rel=1e-12)
    np.testing.assert_allclose(np.diff(axis), i_max / 20)
