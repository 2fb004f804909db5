"""Results with exact maps: what a fit of a machine would give without any error."""

from __future__ import annotations

import numpy as np

from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.methods.parameters import FitReport
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.files.results.identification import Provenance
from drive_id.fitting.result import Identification


def exact_map(i_d, i_q, psi, sigma=np.nan, harmonics=()):
    """Return the map of fluxes (D, Q, 2), Wb, with data everywhere."""
    return FluxMap.of(i_d, i_q, psi, np.full(psi.shape, sigma), np.ones(psi.shape[:2], np.bool_), harmonics)


def exact_result(machine, *, sigma=np.nan, drop=None, **changes):
    """Return the result of a MachineMap, with a standard error of the fluxes, Wb, and a drop of each phase.

    Further keywords replace fields of the identified drive, or the harmonics of its map.
    """
    psi = np.stack([machine.psi_d, machine.psi_q], axis=-1)
    flux_map = exact_map(machine.i_d, machine.i_q, psi, sigma, changes.pop("harmonics", ()))
    current = np.linspace(-machine.i_max, machine.i_max, 201)
    fields = {
        "method": "full",
        "i_max": machine.i_max,
        "resistance": machine.resistance,
        "sigma_resistance": np.nan,
        "voltage_error": 0.0,
        "sigma_voltage_error": np.nan,
        "inverter_current": current,
        "inverter_voltage": np.zeros(201) if drop is None else drop(current),
        "flux_map": flux_map,
        "report": FitReport(samples_read=0, samples_used=0, condition=1.0, residual_rms=0.0, coverage=1.0),
    }
    known = Provenance({}, FitSettings(), machine=machine.name, pole_pairs=machine.pole_pairs, u_dc=machine.u_dc)
    return Identification(IdentifiedDrive(**fields | changes), known)
