"""Warnings that all methods share: weak data, and models that do not hold."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from drive_id.common.messages import Message
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.checks.radius import radius_warnings
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.maps.flux_models import positive_definite
from drive_id.core.methods.method import Estimate, Limits
from drive_id.types import BoolArray

_BY_NOISE = 3.0  # mean deviation of a simulation from noisy currents that it begins with: twice their noise was seen
_REVERSED = 4.0
"""Standard errors below zero at which the magnet's flux is negative: machines without magnets show up to 1.1."""
_FEW_POINTS = 0.005  # share of the map's points whose inductances may be indefinite
_IMPOSSIBLE = 3.0
"""Standard errors below zero at which a resistance is impossible: by chance one fit in 700 of a machine without any."""
_FAR_OFF = np.deg2rad(19.0)
"""Angle at the end of the range that is searched for the one that makes the map mirror-symmetric."""
_INDEFINITE = 0.1
"""Share of the map without positive definite inductances at which it is condemned, with a simulation that diverges. Of
288 random drives one is above 0.04: 0.48, with 57 % of flux error."""
_INDEFINITE_IN_ITSELF = 0.25  # the same without such a simulation
_MINOR = {"voltage_clipped", "phase_quantized", "single_vectors", "speed_drift", "outlier"}
"""Findings that move a map by percents: alone, they make no result impossible."""
_LEAST_SHIFT = 2.0  # samples: a shift in time that the checks report is of three at least
_MISFITS = {"misfit", "not_reciprocal"}
_DECIMATED = (-0.55, -0.22)  # delays of the voltages, samples, of a log with every n-th sample: -(n - 1)/(2 n)
_DECIMATED_TURN = np.deg2rad(4.0)  # per sample, at least


def review(
    evidence: Evidence,
    coverage: float,
    estimate: Estimate,
    mad: tuple[float, float],
    limits: Limits,
) -> tuple[Message, ...]:
    """Return one warning per weakness, most basic first."""
    return (
        *(
            finding
            for finding in evidence.findings
            if finding.code != "outlier" or estimate.outlying_time is None  # the fit knows the time more precisely
            if finding.code != "time_shift" or not _simultaneous(estimate)
        ),
        *radius_warnings(evidence, coverage),
        *_on_fit(estimate, limits),
        *_on_decimation(evidence, estimate),
        *_on_map(evidence, estimate, limits),
        *estimate.warnings,
        *_on_simulation(evidence, estimate, mad, limits),
    )


def _simultaneous(estimate: Estimate) -> bool:
    """Tell whether a fit that looks for a delay found none of samples, and explains the voltages without one.

    The rough model of the checks knows neither saturation nor the bends of the inverter's curve.
    """
    delay = next((c.value for c in estimate.calibrations if c.name == "voltage_delay"), np.nan)
    misfit = any(said.code.partition(".")[0] in _MISFITS for said in estimate.warnings)
    return bool(abs(delay) < _LEAST_SHIFT) and not misfit


def condemned(evidence: Evidence, estimate: Estimate, mad: tuple[float, float], limits: Limits) -> Message | None:
    """Return why no machine can have this result, or None."""
    if not limits.impossible:
        return None
    resistance, sigma = estimate.resistance, estimate.sigma_resistance
    if resistance < -_IMPOSSIBLE * sigma:
        return because(evidence, "impossible_resistance", resistance=resistance, sigma_resistance=sigma)
    told = any(finding.code == "angle_offset" for finding in evidence.findings)
    unfound = (c.message for c in estimate.calibrations if c.name == "resolver_offset" and c.message.kind == "warning")
    if told and any(abs(message.values["value"]) > _FAR_OFF for message in unfound):
        return because(evidence, "impossible_angle")
    inside = _with_data(evidence, estimate.flux_map)
    if not inside.any():
        return None
    share = float(_indefinite(estimate.flux_map, inside).mean())
    diverges = not np.isfinite(mad).all()
    if share < (_INDEFINITE if diverges else _INDEFINITE_IN_ITSELF):
        return None
    return because(evidence, "impossible_inductances", share=share, diverges=diverges)


def because(evidence: Evidence, code: str, **values: float) -> Message:
    """Return an error with the first finding of the checks that moves a map by that much as its cause, or none."""
    cause = next((finding for finding in evidence.findings if finding.code not in _MINOR), None)
    return Message(code, "error", cause=cause and f"{cause[0].lower()}{cause[1:]}", **values)


def _with_data(evidence: Evidence, flux_map: FluxMap) -> BoolArray:
    """Tell (D, Q) which points of the map have data and lie on the disc."""
    return flux_map.inside & (np.hypot(flux_map.i_d[:, None], flux_map.i_q) <= evidence.i_max)


def _indefinite(flux_map: FluxMap, points: BoolArray) -> BoolArray:
    """Tell (N,) at which of the points (D, Q) the inductances are not positive definite."""
    return ~positive_definite(flux_map.inductances(*flux_map.grid()[points].T))


def _on_fit(estimate: Estimate, limits: Limits) -> Iterator[Message]:
    resistance, sigma = estimate.resistance, estimate.sigma_resistance
    if not np.isfinite(sigma):
        yield Message("too_short")
    elif resistance < -2 * sigma:
        yield Message("resistance_negative", resistance=resistance, sigma_resistance=sigma)
    elif not resistance > 2 * sigma:
        yield Message("resistance_vague", resistance=resistance, sigma_resistance=sigma)
    if estimate.unexplained > limits.unexplained:
        yield Message("unexplained.share", unexplained=estimate.unexplained)
    if estimate.outlying_time is not None:
        yield Message("outlier.fit", time=estimate.outlying_time)


def _on_decimation(evidence: Evidence, estimate: Estimate) -> Iterator[Message]:
    """Recognize a decimated log by the delay that method full finds, unless the checks did before."""
    delay = next((c.value for c in estimate.calibrations if c.name == "voltage_delay"), 0.0)
    told = any(finding.code == "decimated" for finding in evidence.findings)
    if not told and evidence.turn >= _DECIMATED_TURN and _DECIMATED[0] <= delay <= _DECIMATED[1]:
        yield Message("decimated.fit", delay=delay, early=-delay, turn=evidence.turn)


def _on_map(evidence: Evidence, estimate: Estimate, limits: Limits) -> Iterator[Message]:
    flux_map = estimate.flux_map
    inside = _with_data(evidence, flux_map)
    if not inside.any():
        return
    i_dq = flux_map.grid()[inside]
    active = _indefinite(flux_map, inside)
    if active.mean() > _FEW_POINTS:
        d, q = i_dq[active].mean(axis=0)
        points = int(active.sum())
        yield Message("indefinite_inductances", points=points, of=len(i_dq), i_d=d, i_q=q, remedy=limits.remedy)
    centre = np.hypot(*i_dq.T).argmin()
    nearest, magnet, sigma = (x[centre] for x in (i_dq, flux_map.psi_d[inside], flux_map.sigma_d[inside]))
    least = max(_REVERSED * sigma, limits.reversed * np.abs(flux_map.psi[inside]).max())
    offset = any(finding.code == "angle_offset" for finding in evidence.findings)
    if not offset and magnet < -least:
        magnet -= float(nearest[0] * np.nan_to_num(flux_map.inductances(*nearest))[0, 0])  # flux of that current
        if magnet < -least:
            yield Message("magnet_negative", flux=magnet, sigma=sigma)


def _on_simulation(
    evidence: Evidence, estimate: Estimate, mad: tuple[float, float], limits: Limits
) -> Iterator[Message]:
    crossed = any(said.code == "zero_crossings" for said in estimate.statements)  # its curve is a mean there
    if not np.isfinite(mad).all():
        yield Message("diverged", remedy=limits.remedy)
    elif not crossed and max(mad) > np.hypot(limits.mad * evidence.i_max, _BY_NOISE * np.sqrt(evidence.noise_variance)):
        yield Message("simulation_off", mad=max(mad))
