"""Whether two accumulations are the same to the bit."""

from __future__ import annotations

import numpy as np


def assert_same_bits(one, other):
    states = [accumulated.evidence.state() for accumulated in (one, other)]
    assert set(states[0]) == set(states[1])
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name], err_msg=name)
    for name in ("warnings", "digests", "samples", "last_stamp"):
        assert getattr(one, name) == getattr(other, name), name
    for first, second in zip(one.validation, other.validation, strict=True):
        np.testing.assert_array_equal(first.i_abc, second.i_abc)
