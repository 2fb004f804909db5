"""What tests of the report share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from browser import driven

from drive_id.common.messages import Message
from drive_id.core.full.effects.effect import Calibration
from drive_id.core.maps.flux_map import HarmonicMap


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium."""
    with driven() as browser:
        yield browser


@pytest.fixture(scope="session")
def full_like(fitted):
    """A result with all that only method full gives, its numbers being those of joint."""
    drive = fitted.drive
    shape = drive.flux_map.psi_d.shape
    parts = [np.full(shape, value) for value in (1e-3, 2e-3, 3e-3, 4e-3)]
    voltage = drive.inverter_voltage
    more = replace(
        drive,
        method="full",
        flux_map=replace(drive.flux_map, harmonics=(HarmonicMap(6, *parts),)),
        calibrations=(
            Calibration(
                "resolver_offset",
                0.01,
                0.001,
                "rad",
                applied=True,
                message=Message("resolver_offset", value=0.01, sigma=0.001),
            ),
        ),
        sigma_inverter_voltage=np.full(len(voltage), 0.05),
        phase_voltages=np.stack([voltage, 1.1 * voltage, 0.9 * voltage], axis=1),
        statements=(Message("region.whole"), Message("record_longer")),
        magnet_coefficient=(-1e-4, 1e-5),
    )
    return replace(fitted, drive=more)
