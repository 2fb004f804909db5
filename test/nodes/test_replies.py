"""What a FluxMap holds, for each origin of its result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.core.result.identification import Cogging, Mechanics
from drive_id.live.identification.identifier import Reply
from drive_id.nodes.support.replies import fit_report_message, flux_map_message


@pytest.mark.parametrize("provisional", [False, True])
@pytest.mark.parametrize("name", [name for name, origin in ORIGINS.items() if origin.live])
def test_a_flux_map_holds_a_curve_where_its_method_has_one_provisional_or_not(fitted, name, provisional):
    drive = replace(fitted.drive, method=name)
    weak = Message("little_coverage", coverage=0.1, i_max=drive.i_max)
    message = flux_map_message(Reply("ok", "", drive, warnings=(weak,), provisional=provisional), "drive")
    assert (list(message.warnings), list(message.warning_codes)) == ([weak], ["little_coverage"])
    assert message.coverage == drive.report.coverage
    assert message.method == name
    assert message.provisional == provisional
    points = len(drive.inverter_current) if name != "psm" else 0
    assert len(message.inverter_current) == len(message.inverter_voltage) == points
    assert len(message.psi_d) == drive.flux_map.psi_d.size


def test_a_report_holds_all_of_the_mechanics(fitted):
    shaft = Mechanics(0.03, 1e-5, 1.2, 0.1, None, None, 0.5, 0.1, (Cogging(6, 2.0, 0.05),), None, None, 0.99, 6.0, 0.3)
    message = fit_report_message(Reply("ok", "", replace(fitted.drive, mechanics=shaft)))
    assert (message.inertia, message.load, message.sigma_load, message.cogging_visible) == (0.03, 0.5, 0.1, 0.3)
    assert np.isnan([message.viscous_friction, message.torque_gain]).all()
    cogging = message.cogging_orders, message.cogging_amplitudes, message.cogging_sigmas
    assert [list(values) for values in cogging] == [[6], [2.0], [0.05]]
    without = fit_report_message(Reply("ok", "", replace(fitted.drive, mechanics=None)))
    assert np.isnan([without.inertia, without.load, without.cogging_visible]).all()
    assert len(without.cogging_orders) == 0
