"""From the fit of method ``full`` to an identified drive: calibrated maps on a grid, curves, deviations, statements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.full import calibration
from drive_id.core.full.calibration import Calibration, rotated
from drive_id.core.full.fit import FullFit, fit_full, sigma
from drive_id.core.full.model import MAGNET, SENSOR_ORDERS
from drive_id.core.maps.coverage import smoothed
from drive_id.core.maps.flux_models import TensorSpline, fitted, sites
from drive_id.core.numerics.bspline import Axis
from drive_id.core.result.full_warnings import review_full, statements
from drive_id.core.result.identification import FitReport, FluxMap, HarmonicMap, Identification
from drive_id.core.validation.harmonic_simulation import simulate_harmonic_current
from drive_id.core.validation.metrics import mean_absolute_deviation
from drive_id.errors import DataError
from drive_id.types import BoolArray, FloatArray, Samples

_FINE, _DENSITY = 72, 2
_CURVE_POINTS = 201


@dataclass(frozen=True, eq=False)
class TrueFrame:
    """The fitted maps as functions of the true current, the resolver's offset taken out.

    Parameters
    ----------
    fit : FullFit
    angle : float
        Measured minus true electrical angle, rad.
    """

    fit: FullFit
    angle: float

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_dq (N, 2), Wb, averaged over the rotor position, at currents (N, 2), A."""
        rows = self.fit.model.flux.rows(rotated(i_dq, -self.angle))
        return rotated(rows.dot(self.fit.solution.estimate[self.fit.model.map]), self.angle)

    def harmonic(self, order: int, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the amplitudes of cos(h theta) and sin(h theta), (N, 2) each, Wb, theta being the true angle."""
        model = self.fit.model
        rows = model.space(order).rows(rotated(i_dq, -self.angle))
        halves = np.split(self.fit.solution.estimate[model.harmonics[order]], 2)
        a, b = (rotated(rows.dot(half), self.angle) for half in halves)
        cosine, sine = np.cos(order * self.angle), np.sin(order * self.angle)
        return a * cosine + b * sine, b * cosine - a * sine

    def deviations(self, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the deviations of psi_dq (N, 2), Wb: consistent with the residuals' behaviour, and for white ones."""
        model = self.fit.model
        rows = model.flux.rows(rotated(i_dq, -self.angle))
        return sigma(rows.dot(self.fit.changes[model.map])), self.fit.white_sigma(rows)


def conclude_full(
    evidence: Evidence,
    validation: Sequence[Samples],
    inside: BoolArray,
    coverage: float,
    on_map: Callable[[FluxMap], None],
) -> Identification:
    """Fit, calibrate, draw up the maps and judge them.

    Parameters
    ----------
    evidence : Evidence
        With windows.
    validation : sequence of Samples
    inside : (D, Q) bool
        Where on the grid there are data.
    coverage : float
        Share of the disc with data.
    on_map : callable
        Told of the flux map before currents are simulated.

    Raises
    ------
    DataError
        When there are too few windows.
    """
    assert evidence.windows is not None
    information = evidence.windows.finished()
    if information.windows < information.model.flux.parameters:
        raise DataError(
            f"The recordings give {information.windows} windows, fewer than the unknowns of method full: record "
            "longer, or choose method joint."
        )
    fit = fit_full(information, evidence.settings, evidence.turn)
    grid = evidence.visits.grid()
    found = _calibrations(evidence, fit, grid, inside)
    frame = TrueFrame(fit, next((c.value for c in found if c.name == "resolver_offset" and c.applied), 0.0))
    flux_map = _flux_map(evidence, frame, grid, inside)
    on_map(flux_map)
    spline, gamma, harmonics = _splines(evidence, frame)
    current = np.linspace(-evidence.i_max, evidence.i_max, _CURVE_POINTS)
    drops, deviation = _inverter(fit, current)
    mad = _mad(validation, found, spline, gamma, harmonics, fit.solution.resistance, (current, drops.mean(axis=1)))
    warnings = review_full(evidence, coverage, fit, flux_map, found, mad if validation else (0.0, 0.0))
    report = FitReport(
        samples_read=evidence.samples,
        samples_used=round(
            (evidence.samples - evidence.idle) * information.windows / (information.windows + information.outside)
        ),
        gaps=evidence.gaps,
        rows=2 * information.windows,
        parameters=fit.solution.basis.shape[1],
        rank=fit.solution.basis.shape[1],
        unseen=0,
        condition=float(1.0 / np.min(np.diag(fit.solution.factor))),
        residual_rms=fit.solution.residual_rms / evidence.sample_period,
        mad_d=mad[0],
        mad_q=mad[1],
        coverage=coverage,
        warnings=warnings,
    )
    points = grid.reshape(-1, 2)
    return Identification(
        method="full",
        i_max=evidence.i_max,
        resistance=fit.solution.resistance,
        sigma_resistance=fit.sigma_resistance,
        voltage_error=float(drops[-1].mean()),
        sigma_voltage_error=float(deviation[-1]),
        inverter_current=current,
        inverter_voltage=drops.mean(axis=1),
        model=spline,
        gamma=gamma,
        flux_map=flux_map,
        report=report,
        inverter_deviation=deviation,
        phase_voltages=drops if fit.spec.per_phase else None,
        harmonics=tuple(_harmonic_map(frame, order, points, grid.shape[:2]) for order in _orders(fit)),
        calibrations=tuple(found),
        magnet_coefficient=_magnet_coefficient(fit),
        statements=statements(evidence, fit, flux_map, found),
    )


def _magnet_coefficient(fit: FullFit) -> tuple[float, float] | None:
    if not fit.spec.magnet:
        return None
    form = np.zeros(fit.model.size)
    form[MAGNET] = 1.0
    return float(fit.solution.estimate[MAGNET]), fit.sigma(form)


def _orders(fit: FullFit) -> list[int]:
    return [order for order in fit.spec.orders if order not in SENSOR_ORDERS]


def _calibrations(evidence: Evidence, fit: FullFit, grid: FloatArray, inside: BoolArray) -> list[Calibration]:
    settings = evidence.settings
    found = [calibration.calibrate_delay(fit, settings.calibrate_delay)]
    disc = inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    i_dq = grid[disc]
    if settings.calibrate_angle:
        mirrored = calibration.mirrored_points(
            evidence.visits.i_d, evidence.visits.i_q, disc, min(evidence.i_max, evidence.reached or evidence.i_max)
        )
        found.append(calibration.calibrate_angle(fit, mirrored))
    if settings.calibrate_currents:
        found += calibration.calibrate_currents(fit, i_dq, evidence.i_max)
    return found


def _flux_map(evidence: Evidence, frame: TrueFrame, grid: FloatArray, inside: BoolArray) -> FluxMap:
    psi = frame.flux(grid.reshape(-1, 2)).reshape(grid.shape)
    sigma = np.full(grid.shape, np.nan)
    consistent, white = frame.deviations(grid[inside])
    ratio = np.zeros(grid.shape)
    ratio[inside] = (consistent / white) ** 2
    local = np.stack([smoothed(ratio[..., flux], inside) for flux in range(2)], axis=-1)
    sigma[inside] = white * np.sqrt(local[inside])
    return FluxMap(
        i_d=evidence.visits.i_d,
        i_q=evidence.visits.i_q,
        psi_d=psi[..., 0],
        psi_q=psi[..., 1],
        sigma_d=sigma[..., 0],
        sigma_q=sigma[..., 1],
        inside=inside,
    )


def _harmonic_map(frame: TrueFrame, order: int, points: FloatArray, shape: tuple[int, ...]) -> HarmonicMap:
    cosine, sine = (part.reshape(*shape, 2) for part in frame.harmonic(order, points))
    return HarmonicMap(order, cosine[..., 0], sine[..., 0], cosine[..., 1], sine[..., 1])


def _splines(
    evidence: Evidence, frame: TrueFrame
) -> tuple[TensorSpline, FloatArray, dict[int, tuple[FloatArray, FloatArray]]]:
    """Return the maps as fine cubic splines: one form for simulation and queries, whatever they were fitted with."""
    d, q = (Axis(axis.low, axis.high, _FINE) for axis in (evidence.d, evidence.q))
    places = sites(d, q, _DENSITY)
    points = places.reshape(-1, 2)
    gamma = fitted(frame.flux(points).reshape(places.shape), d, q)
    harmonics = {}
    for order in _orders(frame.fit):
        cosine, sine = (fitted(x.reshape(places.shape), d, q) for x in frame.harmonic(order, points))
        harmonics[order] = (cosine, sine)
    return TensorSpline(d, q), gamma, harmonics


def _inverter(fit: FullFit, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the drop of each phase (C, 3), V, and the deviation of their mean (C,), V."""
    columns, shapes = fit.model.phase_columns(), fit.model.shapes(current)
    drops = shapes @ fit.solution.estimate[columns]
    if not fit.spec.inverter:
        return drops, np.zeros(len(current))
    forms = np.zeros((fit.model.size, len(current)))
    for phase in range(3):
        forms[columns[:, phase]] = shapes.T / 3
    return drops, sigma(forms.T @ fit.changes)


def _mad(
    validation: Sequence[Samples],
    found: Sequence[Calibration],
    spline: TensorSpline,
    gamma: FloatArray,
    harmonics: dict[int, tuple[FloatArray, FloatArray]],
    resistance: float,
    drop: tuple[FloatArray, FloatArray],
) -> tuple[float, float]:
    if not validation:
        return float("nan"), float("nan")
    pieces = [calibration.corrected(samples, found) for samples in validation]
    simulated = [simulate_harmonic_current(piece, spline, gamma, harmonics, resistance, drop) for piece in pieces]
    measured = [frames.to_dq(piece.i_abc, piece.angle) for piece in pieces]
    return mean_absolute_deviation(np.concatenate(simulated), np.concatenate(measured))
