"""What the reader of a fit by method ``full`` must be told: warnings, and what made the unknowns identifiable."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.full.calibration import Calibration
from drive_id.core.full.fit import FullFit
from drive_id.core.result.identification import FluxMap
from drive_id.core.result.warnings import on_data
from drive_id.types import FloatArray

_WEAK_FIT = 0.05
_OUTLYING_BATCH, _LEAST_OUTLYING = 20.0, 0.01
_LEAST_TURN = np.deg2rad(45.0)
_FEW_POINTS = 0.005
_LARGE_SIGMA = 0.01
_LARGE_OFFSET, _LARGE_MISMATCH = 0.005, 0.01
_LARGE_MAD = 0.03
_REVERSED = 0.1
_SPEEDS_APART = 0.1
_COMPENSATION = "The drive compensates its inverter by currents that are old by then: what that leaves was fitted, too."


def review_full(
    evidence: Evidence,
    coverage: float,
    fit: FullFit,
    flux_map: FluxMap,
    calibrations: Sequence[Calibration],
    mad: tuple[float, float],
) -> tuple[str, ...]:
    """Return whole sentences on what is weak, most basic first."""
    warnings = [*on_data(evidence, coverage), *_on_fit(fit), *_on_map(evidence, fit, flux_map)]
    asymmetric = [c for c in calibrations if c.name == "resolver_offset" and not c.applied]
    warnings += [c.sentence for c in asymmetric]
    if not fit.spec.reciprocal and evidence.settings.maps == "auto":
        better = 100 * fit.selection.advantage
        warnings.append(
            f"The maps are not reciprocal: free ones predict data left out {better:.0f} % better, so they were used; "
            "at one speed, this leaves resistance and delay of the voltages open."
        )
    warnings += dict.fromkeys(c.sentence for c in calibrations if c.doubtful)
    for c in calibrations:
        largest = _LARGE_OFFSET * evidence.i_max if c.unit == "A" else _LARGE_MISMATCH
        if c.name.startswith("current_") and c.applied and abs(c.value) > largest:
            warnings.append(f"{c.sentence} This is large: check the sensor.")
    if np.isfinite(mad).all() and max(mad) > _LARGE_MAD * evidence.i_max:
        warnings.append(
            f"The simulated current is {max(mad):.3g} A off on average, so the model does not describe this drive: "
            "check the order of the phases, of currents and voltages alike, the angle, and that all recordings are of "
            "one drive."
        )
    if not np.isfinite(mad).all():
        warnings.append(
            "The simulated current diverged, so there is no MAD, and the identified model is not stable: check the "
            "order of the phases and the angle, or set passive_maps."
        )
    return tuple(warnings)


def _on_fit(fit: FullFit) -> list[str]:
    warnings = []
    total = fit.total_voltage
    share = fit.solution.residual_rms / np.sqrt(max(total, np.finfo(np.float64).tiny))
    if share > _WEAK_FIT:
        warnings.append(
            f"The model leaves {100 * share:.1f} % of the voltage unexplained: check the order of the phases, the "
            "alignment of the signals in time, and their noise."
        )
    if fit.outlying > _OUTLYING_BATCH and fit.outlying_share > _LEAST_OUTLYING:
        warnings.append(
            f"The samples around {fit.outlying_time:.2f} s of data stand out from all others: look there for a faulty "
            "angle, voltage or current."
        )
    if fit.turn < _LEAST_TURN:
        warnings.append(
            f"The rotor turns by only {np.rad2deg(fit.turn):.0f} degrees electrical while a window lasts, so that "
            "errors of the voltages weigh more than the deviations say: record faster."
        )
    resistance, sigma = fit.solution.resistance, fit.sigma_resistance
    if resistance < -2 * sigma:
        warnings.append(
            f"The resistance is negative ({resistance:.4g} ohm): currents or voltages have the wrong sign, or are "
            "shifted in time."
        )
    elif not resistance > 2 * sigma:
        warnings.append(
            f"The resistance, {resistance:.4g} ohm, is not distinct from zero (deviation {sigma:.2g} ohm): record "
            "slower or at several speeds."
        )
    return warnings


def _on_map(evidence: Evidence, fit: FullFit, flux_map: FluxMap) -> list[str]:
    warnings: list[str] = []
    grid = flux_map.grid()
    chosen = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    i_dq = grid[chosen]
    if not len(i_dq):
        return warnings
    active = ~fit.passive(i_dq)
    if active.mean() > _FEW_POINTS:
        d, q = i_dq[active].mean(axis=0)
        warnings.append(
            f"The inductance matrix is not positive definite at {active.sum()} of {len(i_dq)} points of the map, on "
            f"average at i_d = {d:.3g} A, i_q = {q:.3g} A: do not simulate or control with the map there, or set "
            "passive_maps."
        )
    largest = max(np.abs(flux_map.psi_d[chosen]).max(), np.abs(flux_map.psi_q[chosen]).max())
    uncertain = np.maximum(flux_map.sigma_d, flux_map.sigma_q)[chosen] > _LARGE_SIGMA * largest
    if uncertain.mean() > _FEW_POINTS:
        d, q = i_dq[uncertain].mean(axis=0)
        warnings.append(
            f"The flux is uncertain by more than {100 * _LARGE_SIGMA:.0f} % at {uncertain.sum()} of {len(i_dq)} "
            f"points, on average at i_d = {d:.3g} A, i_q = {q:.3g} A: record longer, or more there."
        )
    origin = i_dq[np.hypot(*i_dq.T).argmin()]
    psi_d = fit.model.flux.rows(origin[None]).dot(fit.solution.estimate[fit.model.map])[0, 0]
    if psi_d < -_REVERSED * largest:
        warnings.append(
            f"The magnet's flux is negative ({psi_d:.4g} Wb): the angle is offset by half a turn, or currents and "
            "voltages have the wrong sign."
        )
    return warnings


def statements(
    evidence: Evidence, fit: FullFit, flux_map: FluxMap, calibrations: Sequence[Calibration]
) -> tuple[str, ...]:
    """Say what fixed the unknowns that single data leave open, where there are no data, and what would help most."""
    several = _several_speeds(fit.speeds)
    relative = fit.sigma_resistance / max(abs(fit.solution.resistance), np.finfo(np.float64).tiny)
    by = (
        "the different speeds"
        if several
        else "the reciprocity of the maps"
        if fit.spec.reciprocal
        else "the changes of the currents alone"
    )
    said = [
        (
            f"Resistance and the rotation of the flux map were told apart by {by}; the resistance is known to "
            f"{100 * relative:.2g} %."
        ),
        (
            "The resistance holds whatever part of the inverter's drop is linear over the whole current range; the "
            "curve is what is left, flat at large currents."
        ),
        "A common gain of all currents or all voltages scales the result and cannot be seen in these data.",
        *([_COMPENSATION] if fit.spec.lag else []),
        *dict.fromkeys(c.sentence for c in calibrations),
        _on_harmonics(fit),
        _on_region(evidence, flux_map),
    ]
    if not several:
        advice = "a second recording at another speed, best in the other direction"
    elif flux_map.inside.mean() < 0.5 * np.pi / 4:
        advice = "a trajectory that fills the current disc"
    else:
        advice = "a longer recording: all deviations fall with the root of its duration"
    said.append(f"What would help most: {advice}.")
    return tuple(said)


def _several_speeds(speeds: FloatArray) -> bool:
    """Tell whether 5 % of the data at either end are of clearly different speeds."""
    low, high = np.quantile(speeds, [0.05, 0.95])
    return bool(high - low > _SPEEDS_APART * max(abs(low), abs(high)))


def _on_harmonics(fit: FullFit) -> str:
    found = [str(order) for order in fit.spec.orders if order > 2]
    if not found:
        return "No harmonics of the rotor position stand out from the noise."
    return f"Harmonics of the rotor position of the orders {', '.join(found)} were identified and taken out of the map."


def _on_region(evidence: Evidence, flux_map: FluxMap) -> str:
    grid = flux_map.grid()
    disc = np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max
    missing = disc & ~flux_map.inside
    share = missing.sum() / max(disc.sum(), 1)
    if share < 0.02:
        return "The whole current disc has data."
    d, q = grid[missing][np.hypot(*grid[missing].T).argmin()]
    return (
        f"{100 * share:.0f} % of the current disc have no data, nearest to the origin at i_d = {d:.3g} A, "
        f"i_q = {q:.3g} A; there the map is a smooth continuation."
    )
