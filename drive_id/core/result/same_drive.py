"""Whether two recordings can be of one drive: what differs between their results beyond errors and heat."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drive_id.common.origins import ORIGINS
from drive_id.common.quantity import measured
from drive_id.common.temperature import COPPER
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.identification import IdentifiedDrive

MAGNET = 0.001
"""Relative loss of a magnet's flux, 1/K: that of NdFeB."""
_HEATING = 0.5
"""Largest rate at which a winding heats, K/s: adiabatically, at 10 A/mm2."""
_LEAST_HEAT, _MOST_HEAT = 2.0, 25.0
"""Change of the temperature between two parts that is assumed however short or long the time between them, K: a motor
takes minutes for more, in which nobody leaves a recording running at full current."""
_SIGNIFICANT = 3.0
"""Standard errors beyond which a difference is no chance."""
_MODEL = {True: 0.01, False: 0.05}
"""Relative error of R and flux that a method makes besides its standard errors: those over windows, and the paper's."""
_VAGUE = {"R": 0.25, "flux": 0.05}
"""Share of R and of the largest flux that the significant difference may reach: if both do, nothing shows that two
results are of one drive."""
_FLUX_FLOOR = 0.02
"""Of the largest flux, below which that of a magnet tells nothing."""


@dataclass(frozen=True)
class Compared:
    """Figures of two results: resistances, ohm, and magnet fluxes, Wb, with standard errors."""

    text: str  # both, for people
    differ: tuple[str, ...]  # what cannot be of one drive
    vague: bool  # the errors are so large that nothing shows whether it is one drive


def compared(one: IdentifiedDrive, other: IdentifiedDrive, seconds: float) -> Compared:
    """Compare the results of two recordings, whose middles are so many seconds apart.

    A quantity differs if it does by more than three standard errors, the error of the method's model, and what heat can
    explain: R of copper rises by 0.39 %/K, the flux of a magnet falls by 0.1 %/K, and a winding heats by at most 0.5
    K/s.
    """
    heat = min(_MOST_HEAT, _LEAST_HEAT + _HEATING * abs(seconds))
    model = _MODEL[ORIGINS[one.method].windows]
    texts, differ = [], []
    resistance = [(drive.resistance, drive.sigma_resistance) for drive in (one, other)]
    magnets = [magnet_flux(drive.flux_map) for drive in (one, other)]
    for name, unit, pair, slope in (("R", "Ω", resistance, COPPER), ("psi_PM", "Wb", magnets, MAGNET)):
        (first, error_1), (second, error_2) = pair
        if not math.isfinite(first + second):
            continue
        size = max(abs(first), abs(second))
        before, after = measured(first, error_1, unit, size), measured(second, error_2, unit, size)
        said = f"{name} is {before} before and {after} after"
        texts.append(said)
        least = _least(one, other) if name == "psi_PM" else 0.0
        tolerated = (heat * slope + model) * max(abs(first), abs(second), least)
        if abs(second - first) > tolerated + _SIGNIFICANT * math.hypot(error_1, error_2):
            differ.append(f"{said}, and heat explains {heat:.0f} K")
    away, told = _map_distance(one.flux_map, other.flux_map)
    if not differ and away > heat * MAGNET + 2 * model:
        differ.append(f"their flux maps differ by {100 * away:.1f} % of the largest flux")
    (first, error_1), (second, error_2) = resistance
    vague_resistance = _SIGNIFICANT * math.hypot(error_1, error_2) > _VAGUE["R"] * min(abs(first), abs(second))
    return Compared("; ".join(texts), tuple(differ), vague_resistance and told > _VAGUE["flux"])


def magnet_flux(flux_map: FluxMap) -> tuple[float, float]:
    """Return psi_d at zero current and its standard error, Wb; NaN where there are no data."""
    d, q = (int(np.argmin(np.abs(axis))) for axis in (flux_map.i_d, flux_map.i_q))
    if not flux_map.inside[d, q]:
        return math.nan, math.nan
    return float(flux_map.psi_d[d, q]), float(flux_map.sigma_d[d, q])


def _least(one: IdentifiedDrive, other: IdentifiedDrive) -> float:
    """Return the flux of a magnet, Wb, from which on it counts as one."""
    return _FLUX_FLOOR * max(one.flux_map.largest, other.flux_map.largest)


def _map_distance(one: FluxMap, other: FluxMap) -> tuple[float, float]:
    """Return the median distance of two maps where both have data, and that which is significant, by the largest flux.

    Both are on the same grid. The distance is that beyond the standard errors.
    """
    both = one.inside & other.inside
    if not both.any():
        return 0.0, math.inf
    square = (one.psi_d - other.psi_d) ** 2 + (one.psi_q - other.psi_q) ** 2
    told = _SIGNIFICANT**2 * (one.sigma_d**2 + one.sigma_q**2 + other.sigma_d**2 + other.sigma_q**2)
    largest = max(one.largest, other.largest)
    distance, error = float(np.median(np.maximum(square - told, 0.0)[both])), float(np.median(told[both]))
    return math.sqrt(distance) / largest, math.sqrt(error) / largest
