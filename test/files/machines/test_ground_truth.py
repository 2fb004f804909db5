from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bag_samples import make_truth

from drive_id.errors import BagError, ConfigurationError
from drive_id.files.machines import ground_truth
from drive_id.types import GroundTruth


def test_every_field_comes_back():
    truth = make_truth()
    found = ground_truth.decode_truth(ground_truth.encode_truth(truth), "here")
    for name in GroundTruth.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(found, name), getattr(truth, name), err_msg=name)


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"psi_d": np.zeros((5, 4))}, "does not match its axes"),
        ({"i_d": np.zeros(5)}, "do not increase"),
        ({"inverter_voltage": np.zeros(3)}, "does not fit its 5 currents"),
        ({"psi_q": np.full((5, 5), np.nan)}, "not finite"),
        ({"i_max": 0.0}, "disc empty"),
    ],
)
def test_a_truth_that_does_not_fit_is_refused(change, fragment):
    with pytest.raises(ConfigurationError, match=fragment):
        replace(make_truth(), **change)


def test_a_damaged_attachment_is_an_error_of_the_bag(monkeypatch):
    monkeypatch.setattr(ground_truth, "_ARRAYS", ("i_d", "i_q", "psi_d", "inverter_current", "inverter_voltage"))
    data = ground_truth.encode_truth(make_truth())
    monkeypatch.undo()
    with pytest.raises(BagError, match="attached to here cannot be read"):
        ground_truth.decode_truth(data, "here")
