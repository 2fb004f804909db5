"""Why R is less certain than it was from fewer samples: the largest cause among noise, lack of fit and curve."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drive_id.core.full.model import RESISTANCE
from drive_id.core.result.resistance_error import growth


def assessment(noise, misfit, curve, left_open=0.0):
    """Changes of R by four batches of time, a bias, a delay, two groups, a rival and the curve."""
    own = [*[noise / 2] * 4, 0.0, left_open * 0.6, *[misfit / np.sqrt(2)] * 2, left_open * 0.8, curve]
    changes = np.zeros((RESISTANCE + 1, len(own)))
    changes[RESISTANCE] = own
    return SimpleNamespace(
        changes=changes, sources=(*["noise"] * 4, "bias", "open", "misfit", "misfit", "open", "curve")
    )


@pytest.mark.parametrize(
    ("parts", "cause"),
    [((1e-5, 2e-5, 5e-5), "inverter's drop is still nonlinear"), ((1e-5, 5e-5, 2e-5), "a misfit that repeats"),
     ((5e-5, 1e-5, 2e-5), "residuals of later samples are larger"),
     ((1e-5, 0.0, 2e-5, 5e-5), "the voltage delay or the effects of the drive are ambiguous")],
)  # fmt: skip
def test_the_largest_cause_is_named(parts, cause):
    said = growth(assessment(*parts), 5.5e-5, (85_000, 2.5e-5))
    assert cause in said
    assert "from ±0.025 mΩ (at 85000 samples) to ±0.055 mΩ" in said
    assert "83 %" in said


def test_nothing_is_said_where_the_error_does_not_grow():
    assert growth(assessment(1e-5, 1e-5, 1e-5), 2.9e-5, (85_000, 2.5e-5)) is None
    assert growth(assessment(1e-5, 1e-5, 1e-5), 2.9e-5, (85_000, 0.0)) is None
