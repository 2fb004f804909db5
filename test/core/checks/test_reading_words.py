"""What the checks say of a likely reading can be obeyed."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.common.messages import _percent
from drive_id.core import frames
from drive_id.core.checks.balance import Reading


@pytest.mark.parametrize("turned", range(6))
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_order_and_sign_of_the_voltages_are_those_of_the_reading(turned, mirrored):
    """A reading turns the voltages by sixths of a turn, after it has mirrored them."""
    reading = Reading(turned=turned, mirrored=mirrored)
    u_abc = np.random.default_rng(3).normal(size=(5, 3))
    u_s = frames.space_vector(u_abc)
    read = frames.space_vector(reading.voltage_sign * u_abc[:, list(reading.voltage_order)])
    np.testing.assert_allclose(read, np.exp(1j * np.pi / 3 * turned) * (u_s.conj() if mirrored else u_s), atol=1e-12)


@pytest.mark.parametrize(
    ("share", "said"), [(0.0012345, "0.12"), (0.0123, "1.2"), (0.0949, "9.5"), (0.0951, "10"), (0.5, "50"), (1, "100")]
)
def test_shares_in_percent_have_two_digits(share, said):
    assert _percent(share, "") == f"{said} %"
