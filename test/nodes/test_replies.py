"""What a FluxMap holds, for each origin of its result."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drive_id.live.identification.identifier import Reply
from drive_id.nodes.support.replies import flux_map_message
from drive_id.origins import ORIGINS


@pytest.mark.parametrize("provisional", [False, True])
@pytest.mark.parametrize("name", [name for name, origin in ORIGINS.items() if origin.live])
def test_a_flux_map_holds_a_curve_where_its_method_has_one_provisional_or_not(fitted, name, provisional):
    drive = replace(fitted.drive, method=name)
    message = flux_map_message(Reply("ok", "", drive, provisional=provisional), "drive")
    assert message.method == name
    assert message.provisional == provisional
    points = len(drive.inverter_current) if name != "psm" else 0
    assert len(message.inverter_current) == len(message.inverter_voltage) == points
    assert len(message.psi_d) == drive.flux_map.psi_d.size
