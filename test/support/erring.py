"""A drive that errs: its result, changed by chosen amounts of each of its causes of error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np


def erring(result, amounts):
    """Return a result with each cause of error by an amount (M,), in standard errors."""
    modes, drive = result.drive.error_modes, result.drive
    flux_map = replace(
        drive.flux_map,
        psi_d=drive.flux_map.psi_d + np.tensordot(amounts, modes.psi_d, 1),
        psi_q=drive.flux_map.psi_q + np.tensordot(amounts, modes.psi_q, 1),
    )
    changed = replace(
        drive,
        flux_map=flux_map,
        resistance=drive.resistance + float(amounts @ modes.resistance),
        inverter_voltage=drive.inverter_voltage + amounts @ modes.inverter_voltage,
    )
    return replace(result, drive=changed)
