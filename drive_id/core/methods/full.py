"""Method ``full``: the fit over windows, calibrated, and drawn up as maps on a grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.fit_settings import FitSettings
from drive_id.core.full import calibration
from drive_id.core.full.calibration import Calibration, rotated
from drive_id.core.full.effect_report import effect_entries, misfit_warning, not_reciprocal_warning
from drive_id.core.full.effect_search import several_speeds
from drive_id.core.full.effects import OF_RECORDINGS
from drive_id.core.full.fit import EarlierFit, FullFit, fit_full
from drive_id.core.full.fit import sigma as fitted_sigma
from drive_id.core.full.model import (
    MAGNET,
    RESISTANCE,
    SENSOR_ORDERS,
    FullModel,
)
from drive_id.core.full.resolution import FLUX_CELLS
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import LONGEST_WINDOW, SHORT_ANGLE, WINDOW_ANGLE
from drive_id.core.maps.coverage import smoothed
from drive_id.core.maps.error_modes import ErrorModes, error_modes
from drive_id.core.maps.flux_models import BasisRows, TensorSpline, fitted, sites
from drive_id.core.methods.method import CURVE_POINTS, EffectVoltages, Estimate, Gathered, Limits, SimulationModel, Sums
from drive_id.core.methods.paper import regression_sums
from drive_id.core.numerics.bspline import Axis
from drive_id.errors import DataError
from drive_id.types import BoolArray, FloatArray, Samples

_FINE, _FINEST, _DENSITY = 72, 200, 2
"""Splines per axis of the map for simulation and queries, at least and at most, and points per spline that they fit."""
_POINTS = 256
"""Points of the map per batch of standard errors."""
_AVERAGED = 4
"""Samples over which the simulation averages the voltage that effects take."""
_OUTLYING_BATCH, _LEAST_OUTLYING = 20.0, 0.01
_LEAST_TURN = 0.75
"""Share of a window's angle."""
_FEW_POINTS = 0.005
_LARGE_SIGMA = 0.01
_LARGE_SHARE = 0.01
"""Of R, by which the shape of a wide inverter curve changes R."""
_LARGE_OFFSET, _LARGE_MISMATCH = 0.005, 0.01
_LIMITS = Limits(unexplained=0.05, refused=0.2, mad=0.03, remedy=", or set passive_maps", impossible=True)
_COMPENSATION = "The drive compensates its inverter with currents measured earlier: the remaining drop was fitted, too."


@dataclass(frozen=True)
class FullMethod:
    """Linear least squares over windows, with rotor harmonics, an inverter curve and calibration."""

    inverter: bool = True
    windows: bool = True
    limits: Limits = _LIMITS

    def accumulator(self, settings: FitSettings, d: Axis, q: Axis, i_max: float) -> Sums:
        """Return empty sums: those of the paper's regression as well, so that they serve all methods."""
        low, high = np.array([d.low, q.low]), np.array([d.high, q.high])
        reciprocal = settings.maps != "free"
        windows = WindowSums(FullModel(low, high, i_max, settings.harmonic_orders, reciprocal=reciprocal))
        return Sums(regression_sums(settings, d, q, i_max), windows)

    def resolution(self, d: Axis, q: Axis) -> tuple[float, float]:
        """Return the widths of a cell of the flux map, A."""
        return (d.high - d.low) / FLUX_CELLS, (q.high - q.low) / FLUX_CELLS

    def conclude(self, evidence: Gathered, inside: BoolArray, earlier: EarlierFit | None = None) -> Estimate:
        """Fit, calibrate, and evaluate maps and curve.

        Raises
        ------
        DataError
            When there are fewer windows than unknowns, or the delay of the voltages jumps within a recording.
        """
        assert evidence.windows is not None
        information = evidence.windows.finished()
        if information.windows < information.model.flux.parameters:
            raise DataError(
                f"The recordings give {information.windows} windows, fewer than the unknowns of method full: record "
                "longer, or choose method joint."
            )
        fit = fit_full(
            information,
            evidence.settings,
            evidence.turn,
            evidence.noise_variance,
            earlier,
            angle_variance=evidence.angle_variance,
        )
        if fit.jump is not None:
            direction = "later" if fit.jump.later else "earlier"
            raise DataError(
                f"The voltages act {direction} from {fit.jump.time:.2f} s of recording {fit.jump.recording + 1} on "
                "(gaps not counted): the log lost or doubled samples of one signal there; fit what comes before and "
                "after as separate recordings."
            )
        grid = evidence.visits.grid()
        points = grid.reshape(-1, 2)
        found = _calibrations(evidence, fit, grid, inside)
        frame = TrueFrame(fit, next((c.value for c in found if c.name == "resolver_offset" and c.applied), 0.0))
        psi = frame.flux(points).reshape(grid.shape)
        sigma = _sigma(frame, grid, inside)
        warnings = (*_on_map(evidence, fit, psi, sigma, inside), *_on_calibration(evidence, fit, found))
        earlier, scaled = EarlierFit.of(fit), calibration.by_common_gain(fit, found, grid[inside], _LARGE_MISMATCH)
        if scaled.any():
            fit = replace(fit, changes=np.column_stack([scaled, fit.changes]))
            frame = replace(frame, fit=fit)
            sigma = _sigma(frame, grid, inside)
        current = np.linspace(-evidence.i_max, evidence.i_max, CURVE_POINTS)
        drops, deviation = _inverter(fit, current)
        simulation = _simulation_model(evidence, frame, (current, drops.mean(axis=1)))
        outlying = fit.outlying > _OUTLYING_BATCH and fit.outlying_share > _LEAST_OUTLYING
        unknowns = fit.solution.basis.shape[1]
        return Estimate(
            resistance=fit.solution.resistance,
            sigma_resistance=fit.sigma_resistance,
            voltage_error=float(drops[-1].mean()),
            sigma_voltage_error=float(deviation[-1]),
            inverter_current=current,
            inverter_voltage=drops.mean(axis=1),
            model=simulation.model,
            gamma=simulation.gamma,
            psi=psi,
            sigma=sigma,
            simulation=simulation,
            positive_definite=fit.passive,
            samples_used=round(
                (evidence.samples - evidence.idle) * information.windows / (information.windows + information.outside)
            ),
            rows=2 * information.windows,
            parameters=unknowns,
            rank=unknowns,
            unseen=0,
            condition=float(1.0 / np.min(np.diag(fit.solution.factor))),
            residual_rms=fit.solution.residual_rms,
            unexplained=float(fit.solution.residual_rms / np.sqrt(max(fit.total_voltage, np.finfo(np.float64).tiny))),
            outlying_time=fit.outlying_time if outlying else None,
            warnings=warnings,
            sigma_inverter_voltage=deviation,
            phase_voltages=drops if fit.spec.per_phase else None,
            harmonics=tuple(_harmonic(frame, order, grid) for order in _orders(fit)),
            calibrations=tuple(found),
            magnet_coefficient=_magnet_coefficient(fit),
            statements=(
                *_statements(evidence, fit, inside, found),
                *_on_free_maps(fit, information),
                *_on_fine_cells(fit, information),
            ),
            fit=earlier,
            error_modes=_error_modes(frame, grid, inside, sigma, current, deviation),
        )


@dataclass(frozen=True, eq=False)
class TrueFrame:
    """The fitted maps as functions of the true current, corrected for the resolver's offset.

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

    def sigma(self, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the standard errors of psi_dq (N, 2), Wb: consistent with the residuals, and for white residuals."""
        model, changes = self.fit.model, self.fit.changes[self.fit.model.map]
        rows, consistent = model.flux.rows(rotated(i_dq, -self.angle)), np.empty((len(i_dq), 2))
        for start in range(0, len(i_dq), _POINTS):  # in batches: memory grows with points times time batches
            part = slice(start, start + _POINTS)
            consistent[part] = fitted_sigma(BasisRows(rows.column[part], rows.value[part]).dot(changes))
        return consistent, self.fit.white_sigma(rows)


def _orders(fit: FullFit) -> list[int]:
    return [order for order in fit.spec.orders if order not in SENSOR_ORDERS]


def _magnet_coefficient(fit: FullFit) -> tuple[float, float] | None:
    if not fit.spec.magnet:
        return None
    form = np.zeros(fit.model.size)
    form[MAGNET] = 1.0
    return float(fit.solution.estimate[MAGNET]), fit.sigma(form)


def _calibrations(evidence: Gathered, fit: FullFit, grid: FloatArray, inside: BoolArray) -> list[Calibration]:
    settings = evidence.settings
    found = [calibration.calibrate_delay(fit, settings.calibrate_delay)]
    found += effect_entries(fit, several_speeds=several_speeds(fit.speeds))
    disc = inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    if settings.calibrate_angle:
        reached = min(evidence.i_max, evidence.reached or evidence.i_max)
        mirrored = calibration.mirrored_points(evidence.visits.i_d, evidence.visits.i_q, disc, reached)
        found.append(calibration.calibrate_angle(fit, mirrored))
    if settings.calibrate_currents:
        found += calibration.calibrate_currents(fit, grid[disc], evidence.i_max)
    return found


def _sigma(frame: TrueFrame, grid: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the standard errors (D, Q, 2), Wb: white ones, scaled by the local mean ratio to the consistent ones.

    They include the flux that the model cannot follow, see :func:`~drive_id.core.full.lack_of_fit.missed_flux`, unless
    the residuals are those of the inverter near zero crossings, which short windows turn into much larger fluxes.
    """
    consistent, white = frame.sigma(grid[inside])
    ratio = np.zeros(grid.shape)
    ratio[inside] = (consistent / white) ** 2
    local = np.stack([smoothed(ratio[..., flux], inside) for flux in range(2)], axis=-1)
    sigma = np.full(grid.shape, np.nan)
    sigma[inside] = white * np.sqrt(local[inside])
    missed = frame.fit.misfit.missed_at(rotated(grid[inside], -frame.angle), frame.fit.model.i_max)
    if missed.any() and np.isnan(frame.fit.crossings):
        sigma[inside] = np.sqrt(sigma[inside] ** 2 + missed)
    return sigma


def _harmonic(frame: TrueFrame, order: int, grid: FloatArray) -> tuple[int, FloatArray, FloatArray]:
    cosine, sine = frame.harmonic(order, grid.reshape(-1, 2))
    return order, cosine.reshape(grid.shape), sine.reshape(grid.shape)


def _simulation_model(evidence: Gathered, frame: TrueFrame, drop: tuple[FloatArray, FloatArray]) -> SimulationModel:
    """Return the maps as fine cubic splines: one form for simulation and queries, whatever they were fitted with."""
    cells = frame.fit.model.resolution
    counts = (
        int(np.clip(2 * (edges[-1] - edges[0]) / np.diff(edges).min(), _FINE, _FINEST)) for edges in (cells.d, cells.q)
    )
    d, q = (Axis(axis.low, axis.high, count) for axis, count in zip((evidence.d, evidence.q), counts, strict=True))
    places = sites(d, q, _DENSITY)
    points = places.reshape(-1, 2)
    gamma = fitted(frame.flux(points).reshape(places.shape), d, q)
    harmonics = {}
    for order in _orders(frame.fit):
        cosine, sine = (fitted(x.reshape(places.shape), d, q) for x in frame.harmonic(order, points))
        harmonics[order] = (cosine, sine)
    return SimulationModel(TensorSpline(d, q), gamma, harmonics, drop, _effect_voltages(evidence, frame.fit))


def _effect_voltages(evidence: Gathered, fit: FullFit) -> EffectVoltages | None:
    if not fit.spec.effects:
        return None
    search = fit.selection.search
    columns = replace(search.columns, estimate=fit.solution.estimate)
    recordings = 1 + max(int(windows.recording.max()) for windows in search.sums.kept())
    of_recordings = set(fit.spec.effects) & set(OF_RECORDINGS)

    def voltages(pieces: Sequence[Samples]) -> tuple[list[FloatArray], bool]:
        whole = len(pieces) == recordings and sum(len(piece) for piece in pieces) >= evidence.samples
        if whole or not of_recordings:
            return columns.voltages(pieces, _AVERAGED), True
        estimate = columns.estimate.copy()
        for name in of_recordings:
            estimate[fit.model.effect(name)] = 0.0
        return replace(columns, estimate=estimate).voltages(pieces, _AVERAGED), False

    return voltages


def _inverter(fit: FullFit, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the drop of each phase (C, 3), V, and the standard error of their mean (C,), V."""
    columns, shapes = fit.model.phase_columns(), fit.model.shapes(current)
    drops = shapes @ fit.solution.estimate[columns]
    if not fit.spec.inverter:
        return drops, np.zeros(len(current))
    forms = np.zeros((fit.model.size, len(current)))
    for phase in range(3):
        forms[columns[:, phase]] = shapes.T / 3
    return drops, fitted_sigma(forms.T @ fit.changes)


def _error_modes(
    frame: TrueFrame, grid: FloatArray, inside: BoolArray, sigma: FloatArray, current: FloatArray, drops: FloatArray
) -> ErrorModes | None:
    """Return the joint errors; ``drops`` (C,) are the standard errors of the inverter's curve at currents (C,), A."""
    fit = frame.fit
    columns, shapes = fit.model.phase_columns(), fit.model.shapes(current)
    curve = np.zeros((len(current), fit.changes.shape[1]))
    if fit.spec.inverter:
        curve += shapes @ fit.changes[columns].mean(axis=1)
    others = np.concatenate([fit.changes[[RESISTANCE]], curve[-1:], curve])
    errors = np.concatenate([[fit.sigma_resistance], drops[-1:], drops])
    rows = fit.model.flux.rows(rotated(grid[inside], -frame.angle))
    return error_modes(
        fit.changes[fit.model.map], rows, sigma, inside, (others, errors), lambda psi: rotated(psi, frame.angle)
    )


def _on_map(evidence: Gathered, fit: FullFit, psi: FloatArray, sigma: FloatArray, inside: BoolArray) -> tuple[str, ...]:
    """Return warnings of the windows and of the standard errors of the flux map."""
    misfit = misfit_warning(fit)
    warnings = [misfit] if misfit else []
    share = SHORT_ANGLE / WINDOW_ANGLE if fit.crossings > 1 else 1.0
    # Windows that end sooner do so because the current changes fast, which tells flux and voltage errors apart, too.
    if fit.turn < _LEAST_TURN * share * WINDOW_ANGLE and fit.duration > _LEAST_TURN * share * LONGEST_WINDOW:
        warnings.append(
            f"The rotor turns by only {np.rad2deg(fit.turn):.0f} degrees electrical while a window lasts, so the "
            "effect of voltage errors exceeds the stated standard errors: record at a higher speed."
        )
    grid = evidence.visits.grid()
    chosen = inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    if chosen.any():
        uncertain = sigma[chosen].max(axis=1) > _LARGE_SIGMA * np.abs(psi[chosen]).max()
        if uncertain.mean() > _FEW_POINTS:
            d, q = grid[chosen][uncertain].mean(axis=0)
            warnings.append(
                f"The flux has a standard error above {100 * _LARGE_SIGMA:.0f} % at {uncertain.sum()} of "
                f"{chosen.sum()} points, on average at i_d = {d:.3g} A, i_q = {q:.3g} A: record longer, or more there."
            )
    if fit.shared_resistance >= _large_share(fit):
        warnings.append(f"{_on_wide_curve(fit)} If R alone matters, measure it with direct current.")
    return tuple(warnings)


def _on_calibration(evidence: Gathered, fit: FullFit, calibrations: Sequence[Calibration]) -> tuple[str, ...]:
    """Return warnings of sensor faults and of maps that are not reciprocal."""
    warnings = [c.sentence for c in calibrations if c.name == "resolver_offset" and not c.applied]
    if not fit.spec.reciprocal and evidence.settings.maps == "auto":
        warnings.append(not_reciprocal_warning(fit))
    warnings += dict.fromkeys(c.sentence for c in calibrations if c.doubtful)
    for c in calibrations:
        largest = _LARGE_OFFSET * evidence.i_max if c.unit == "A" else _LARGE_MISMATCH
        if c.name.startswith(("current_offset", "current_gain")) and c.applied and abs(c.value) > largest:
            warnings.append(f"{c.sentence} This is large: check the sensor.")
    return tuple(warnings)


def _statements(
    evidence: Gathered, fit: FullFit, inside: BoolArray, calibrations: Sequence[Calibration]
) -> tuple[str, ...]:
    """Say what determined the unknowns that the data alone leave open, where data are missing, and what helps most."""
    several = several_speeds(fit.speeds)
    relative = fit.sigma_resistance / max(abs(fit.solution.resistance), np.finfo(np.float64).tiny)
    by = (
        "the different speeds"
        if several
        else "the reciprocity of the maps"
        if fit.spec.reciprocal
        else "the changes of the currents alone"
    )
    if not several:
        advice = "a second recording at another speed, ideally in the other direction"
    elif inside.mean() < 0.5 * np.pi / 4:
        advice = "a trajectory that fills the current disc"
    else:
        advice = "a longer recording: all standard errors fall with the square root of its duration"
    return (
        (
            f"Resistance and the rotation of the flux map are separated by {by}; the standard error of the resistance "
            f"is {100 * relative:.2g} %."
        ),
        (
            "The resistance includes the part of the inverter's drop that is linear over the whole current range; the "
            "inverter curve is the rest, flat at large currents."
        ),
        "A common gain error of all currents or all voltages scales the result and cannot be detected in these data.",
        *([_COMPENSATION] if fit.spec.lag else []),
        *([_on_crossings(fit)] if fit.crossings > 1 else []),
        *([_on_wide_curve(fit)] if 0 < fit.shared_resistance < _large_share(fit) else []),
        *dict.fromkeys(c.sentence for c in calibrations),
        _on_harmonics(fit),
        _on_region(evidence, inside),
        f"What would help most: {advice}.",
    )


def _on_crossings(fit: FullFit) -> str:
    return (
        f"Near zero crossings of the phase currents the residuals are {fit.crossings:.2g} times as large as current "
        "noise explains, as with a dead time that is not short against the ripple: the map rests on what lies between "
        "the crossings, and the inverter curve near zero current is a mean."
    )


def _large_share(fit: FullFit) -> float:
    return _LARGE_SHARE * abs(fit.solution.resistance)


def _on_wide_curve(fit: FullFit) -> str:
    return (
        "The inverter's drop still bends at large currents, where it resembles a resistance: depending on the shape of "
        f"its curve, {1e3 * fit.shared_resistance:.2g} mOhm belong to R or to the drop; their sum is not affected, and "
        "the standard errors include this."
    )


def _on_free_maps(fit: FullFit, sums: WindowSums) -> tuple[str, ...]:
    used = fit.selection.search.sums.windows
    if fit.spec.reciprocal or used == sums.windows:
        return ()
    return (
        (
            f"The free maps were fitted to {used} of {sums.windows} windows, evenly spread over the recordings: set "
            "maps to free to use all."
        ),
    )


def _on_fine_cells(fit: FullFit, sums: WindowSums) -> tuple[str, ...]:
    """Say that fine cells were used, and for which share of the windows."""
    cells = fit.model.resolution
    if not cells.finer_than_usual:
        return ()
    used = fit.selection.search.sums.windows
    some = "" if used == sums.windows else f", from {used} of {sums.windows} windows spread evenly over the recordings"
    return (
        (
            f"The map has finer detail than the usual {FLUX_CELLS} spline cells per axis can resolve: it was fitted "
            f"with {len(cells.d) - 1} cells along i_d and {len(cells.q) - 1} along i_q, down to "
            f"{min(np.diff(cells.d).min(), np.diff(cells.q).min()):.2g} A wide{some}."
        ),
    )


def _on_harmonics(fit: FullFit) -> str:
    found = [str(order) for order in fit.spec.orders if order > 2]
    if not found:
        return "No rotor-position harmonics stand out from the noise."
    return f"Rotor-position harmonics of orders {', '.join(found)} were identified and separated from the mean map."


def _on_region(evidence: Gathered, inside: BoolArray) -> str:
    grid = evidence.visits.grid()
    disc = np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max
    missing = disc & ~inside
    share = missing.sum() / max(disc.sum(), 1)
    if share < 0.02:
        return "The data cover the whole current disc."
    d, q = grid[missing][np.hypot(*grid[missing].T).argmin()]
    return (
        f"{100 * share:.0f} % of the current disc has no data, nearest to the origin at i_d = {d:.3g} A, "
        f"i_q = {q:.3g} A; there the map is a smooth continuation."
    )
