"""Warnings that all methods share: weak data, and models that do not hold."""

from __future__ import annotations

import numpy as np

from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.radius import radius_warnings
from drive_id.core.methods.method import Estimate, Limits
from drive_id.core.methods.registry import method_named
from drive_id.core.result.identification import FluxMap

_REVERSED = 0.1
_FEW_POINTS = 0.005
_IMPOSSIBLE = 3.0
"""Standard errors below zero at which a resistance is impossible: by chance one fit in 700 of a machine without any."""
_FAR_OFF = np.deg2rad(19.0)
"""Correction of the angle at the end of the range that is searched."""
_INDEFINITE = 0.1
"""Share of the map without positive definite inductances at which a diverging simulation condemns it."""
_DECIMATED, _DECIMATED_TURN = (-0.55, -0.22), np.deg2rad(4.0)
"""Delays of the voltages, samples, of a log with every n-th sample, -(n - 1)/(2 n), and the least turn per sample."""


def review(
    evidence: Evidence, coverage: float, estimate: Estimate, flux_map: FluxMap, mad: tuple[float, float]
) -> tuple[str, ...]:
    """Return one sentence per weakness, most basic first: what is wrong, where, and what to do."""
    limits = method_named(evidence.settings.method).limits
    return (
        *(
            finding.message
            for finding in evidence.findings
            if finding.code != "outlier" or estimate.outlying_time is None  # the fit knows the time more precisely
        ),
        *radius_warnings(evidence, coverage),
        *_on_fit(estimate, limits),
        *_on_decimation(evidence, estimate),
        *_on_map(evidence, estimate, flux_map, limits),
        *estimate.warnings,
        *_on_simulation(evidence, mad, limits),
    )


def unexplained_sentence(evidence: Evidence, estimate: Estimate) -> str:
    """Return why a fit that explains too little is refused: by the first finding of the checks, if there is one."""
    return _condemned(
        evidence,
        f"The model leaves {100 * estimate.unexplained:.0f} % of the voltage unexplained",
        "check the order of the phases, the angle, and that currents, voltages and angle are of one drive and of the "
        "same time",
    )


def _condemned(evidence: Evidence, symptom: str, advice: str) -> str:
    """Return a symptom with the first finding of the checks as its cause, or with advice if there is none."""
    if not evidence.findings:
        return f"{symptom}, so there is no valid map: {advice}."
    cause = evidence.findings[0].message
    return f"{symptom}, so there is no valid map; most likely, {cause[0].lower()}{cause[1:]}"


def impossible_sentence(
    evidence: Evidence, estimate: Estimate, flux_map: FluxMap, mad: tuple[float, float]
) -> str | None:
    """Return why no machine can have this result, or None."""
    resistance, sigma = estimate.resistance, estimate.sigma_resistance
    if resistance < -_IMPOSSIBLE * sigma:
        return _condemned(
            evidence,
            f"The resistance comes out negative ({resistance:.3g} +- {sigma:.2g} ohm)",
            "check the signs of currents and voltages and their alignment in time, and record at a second speed",
        )
    told = any(finding.code == "angle_offset" for finding in evidence.findings)
    at_limit = (
        c.name == "resolver_offset" and abs(c.value) > _FAR_OFF and not c.applied for c in estimate.calibrations
    )
    if told and any(at_limit):
        return _condemned(
            evidence, "No angle near the one given makes the map mirror-symmetric", "check the offset of the angle"
        )
    grid = flux_map.grid()
    i_dq = grid[flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)]
    if np.isfinite(mad).all() or not len(i_dq):
        return None
    active = float((~estimate.positive_definite(i_dq)).mean())
    if active < _INDEFINITE:
        return None
    return _condemned(
        evidence,
        f"The inductances of the fitted map are not positive definite at {100 * active:.0f} % of its points and the "
        "current simulated with it diverges",
        "check the order of the phases, the angle and the alignment in time, or record longer and at a second speed",
    )


def _on_fit(estimate: Estimate, limits: Limits) -> list[str]:
    warnings = []
    resistance, sigma = estimate.resistance, estimate.sigma_resistance
    if not np.isfinite(sigma):
        warnings.append("The recording is too short to estimate standard errors: record longer.")
    elif resistance < -2 * sigma:
        warnings.append(
            f"The resistance is negative ({resistance:.4g} ohm): check the signs of currents and voltages and their "
            "alignment in time."
        )
    elif not resistance > 2 * sigma:
        warnings.append(
            f"The resistance, {resistance:.4g} ohm, is not significantly different from zero (standard error "
            f"{sigma:.2g} ohm): record at a lower speed or at several speeds."
        )
    if estimate.unexplained > limits.unexplained:
        warnings.append(
            f"The model leaves {100 * estimate.unexplained:.1f} % of the voltage unexplained: check the order of the "
            "phases, the alignment of the signals in time, and their noise."
        )
    if estimate.outlying_time is not None:
        warnings.append(
            f"The samples around {estimate.outlying_time:.2f} s of data stand out from all others: check angle, "
            "voltages and currents there."
        )
    return warnings


def _on_decimation(evidence: Evidence, estimate: Estimate) -> list[str]:
    """Recognize a decimated log by the delay that method full finds, unless the checks did before."""
    delay = next((c.value for c in estimate.calibrations if c.name == "voltage_delay"), 0.0)
    told = any(finding.code == "decimated" for finding in evidence.findings)
    if told or evidence.turn < _DECIMATED_TURN or not _DECIMATED[0] <= delay <= _DECIMATED[1]:
        return []
    sentence = (
        f"The voltages act {-delay:.2f} samples early and the rotor turns by {np.rad2deg(evidence.turn):.1f} degrees "
        "electrical per sample, the marks of a log with every n-th sample only: log every PWM period, or set "
        "decimation: n for the voltages (signals file)."
    )
    return [sentence]


def _on_map(evidence: Evidence, estimate: Estimate, flux_map: FluxMap, limits: Limits) -> list[str]:
    grid = flux_map.grid()
    chosen = flux_map.inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    i_dq = grid[chosen]
    if not len(i_dq):
        return []
    warnings = []
    active = ~estimate.positive_definite(i_dq)
    if active.mean() > _FEW_POINTS:
        d, q = i_dq[active].mean(axis=0)
        warnings.append(
            f"The inductance matrix is not positive definite at {active.sum()} of {len(i_dq)} points of the map, on "
            f"average at i_d = {d:.3g} A, i_q = {q:.3g} A: do not simulate or control with the map there"
            f"{limits.remedy}."
        )
    magnet = estimate.psi[chosen][np.hypot(*i_dq.T).argmin(), 0]
    offset = any(finding.code == "angle_offset" for finding in evidence.findings)
    if not offset and magnet < -_REVERSED * np.abs(estimate.psi[chosen]).max():
        warnings.append(
            f"The magnet's flux is negative ({magnet:.4g} Wb): check the angle for an offset of half a turn, and the "
            "signs of currents and voltages."
        )
    return warnings


def _on_simulation(evidence: Evidence, mad: tuple[float, float], limits: Limits) -> list[str]:
    warnings = []
    if not np.isfinite(mad).all():
        warnings.append(
            "The simulated current diverged, so there is no MAD, and the identified model is not stable: check the "
            f"order of the phases and the angle{limits.remedy}."
        )
    elif max(mad) > limits.mad * evidence.i_max:
        warnings.append(
            f"The simulated current is {max(mad):.3g} A off on average, so the model does not describe this drive: "
            "check the order of the phases, of currents and voltages alike, the angle, and that all recordings are of "
            "one drive."
        )
    return warnings
