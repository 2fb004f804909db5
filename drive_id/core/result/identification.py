"""The results of a fit: maps, resistance, inverter and what is to be said about them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drive_id.types import BoolArray, FloatArray

if TYPE_CHECKING:  # whoever draws a map needs neither numba nor scipy
    from drive_id.core.full.calibration import Calibration
    from drive_id.core.maps.flux_models import FluxModel


@dataclass(frozen=True, eq=False)
class FluxMap:
    """Flux linkages on a grid.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Axes, A.
    psi_d, psi_q : (D, Q) float
        Wb.
    sigma_d, sigma_q : (D, Q) float
        Standard deviations of psi_d and psi_q, Wb, NaN where not inside: scatter of the data, not the error of a
        model that is too simple. Infinite when the recording is too short to know them.
    inside : (D, Q) bool
        Data support the map there; elsewhere it is a continuation of typical slope.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    sigma_d: FloatArray
    sigma_q: FloatArray
    inside: BoolArray

    def grid(self) -> FloatArray:
        """Return the currents of all points, (D, Q, 2), A."""
        return np.stack(np.meshgrid(self.i_d, self.i_q, indexing="ij"), axis=-1)


@dataclass(frozen=True, eq=False)
class HarmonicMap:
    """Amplitudes of one rotor-position harmonic, ``cos(h theta)`` and ``sin(h theta)``, on the flux map's grid.

    Parameters
    ----------
    order : int
        h, electrical.
    psi_d_cos, psi_d_sin, psi_q_cos, psi_q_sin : (D, Q) float
        Wb.
    """

    order: int
    psi_d_cos: FloatArray
    psi_d_sin: FloatArray
    psi_q_cos: FloatArray
    psi_q_sin: FloatArray


@dataclass(frozen=True)
class FitReport:
    """How well the data determined the model.

    Parameters
    ----------
    samples_read, samples_used : int
        Given, and integrated over (a sample before a gap, beyond the map's range or at rest is not).
    gaps : int
        Breaks within recordings, across which nothing was integrated.
    rows : int
        Of the regression, two per pair of samples.
    parameters, rank : int
        Unknowns, and how many of them the data determine.
    unseen : int
        Flux parameters without any data (corner functions outside of the disc).
    condition : float
        Of the column-scaled regression within its rank.
    residual_rms : float
        Of the mean voltage over a sample, V.
    mad_d, mad_q : float
        Mean absolute deviation of the open-loop simulated from the measured currents, A; NaN when it diverged.
    coverage : float
        Share of the disc of radius ``i_max`` with data, 0 to 1.
    warnings : tuple of str
        Whole sentences.
    """

    samples_read: int
    samples_used: int
    gaps: int
    rows: int
    parameters: int
    rank: int
    unseen: int
    condition: float
    residual_rms: float
    mad_d: float
    mad_q: float
    coverage: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified drive.

    Parameters
    ----------
    method : str
        ``psm``, ``joint`` or ``full``.
    i_max : float
        Radius of the current disc of the experiment, A.
    resistance, sigma_resistance : float
        The paper's R with the inverter's linear part in it, and its standard deviation, ohm.
    voltage_error, sigma_voltage_error : float
        u_e in the drop convention (positive for a physical inverter) and its standard deviation, V; 0 for ``psm``.
    inverter_current, inverter_voltage : (C,) float
        The identified drop of one phase, V, over its current, A.
    model : FluxModel
        With ``gamma`` (P,), Wb, the flux map as a function.
    gamma : (P,) float
    flux_map : FluxMap
    report : FitReport
    inverter_deviation : (C,) float or None
        Standard deviation of ``inverter_voltage``, V; method ``full``.
    phase_voltages : (C, 3) float or None
        The identified drop of each phase, V, when each has a curve of its own.
    harmonics : tuple of HarmonicMap
        Of the rotor position; method ``full``.
    calibrations : tuple of Calibration
        Faults of the sensors; method ``full``.
    magnet_coefficient : (float, float) or None
        Change of the magnet's flux per kelvin and its deviation, Wb/K, when temperatures were given and differ.
    statements : tuple of str
        What fixed the unknowns that single data leave open, where data are missing, and what would help most.
    """

    method: str
    i_max: float
    resistance: float
    sigma_resistance: float
    voltage_error: float
    sigma_voltage_error: float
    inverter_current: FloatArray
    inverter_voltage: FloatArray
    model: FluxModel
    gamma: FloatArray
    flux_map: FluxMap
    report: FitReport
    inverter_deviation: FloatArray | None = None
    phase_voltages: FloatArray | None = None
    harmonics: tuple[HarmonicMap, ...] = ()
    calibrations: tuple[Calibration, ...] = ()
    magnet_coefficient: tuple[float, float] | None = None
    statements: tuple[str, ...] = ()

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_d, psi_q (N, 2), Wb, at currents (N, 2), A."""
        return self.model.rows(i_dq).dot(self.gamma)
