"""Method ``full``: the fit over windows, calibrated, and drawn up as maps on a grid."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import ORIGINS
from drive_id.common.temperature import REFERENCE_TEMPERATURE
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.full import calibration
from drive_id.core.full.calibration import rotated
from drive_id.core.full.effect_report import (
    OUTLYING,
    effect_entries,
    effect_refused,
    misfit_found,
    not_reciprocal_warning,
    unseen_warning,
)
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.effect import MOST_PARTS, Calibration, parts
from drive_id.core.full.fit import EarlierFit, FullFit, fit_full
from drive_id.core.full.linearized import DELAY
from drive_id.core.full.model import MAGNET, RESISTANCE
from drive_id.core.full.selection import LEAST_HEATING
from drive_id.core.full.standard_errors import sigma as fitted_sigma
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import LONGEST_WINDOW, SHORT_ANGLE, WINDOW_ANGLE, Windows
from drive_id.core.maps.coverage import FLUX_CELLS, enclosed, smoothed
from drive_id.core.maps.error_modes import ErrorModes, error_modes
from drive_id.core.maps.flux_map import FluxMap, HarmonicMap
from drive_id.core.maps.flux_models import BasisRows
from drive_id.core.methods.method import CURVE_POINTS, EffectVoltages, Estimate, Limits, check_sums
from drive_id.core.methods.parameters import FitReport
from drive_id.errors import DataError
from drive_id.types import TINY, BoolArray, FloatArray, Samples

_POINTS = 256
"""Points of the map per batch of standard errors."""
_AVERAGED = 4
"""Samples over which the simulation averages the voltage that effects take."""
_LEAST_OUTLYING = 0.01  # rms residual of an outlying batch of time, over the voltages, from which on its time is told
_MOST_TURN = np.deg2rad(26.0)
"""Electrical angle per sample, rad, beyond which R of one speed is not known: at 24 degrees it was 2 % off, within its
error, at 29 degrees 22 % at seven standard errors. A window has two samples there."""
_LEAST_TURN = 0.75  # of a window's angle and duration: shorter ones do not rotate slowly
_LOCKED_TURN = np.deg2rad(2.0)
"""Electrical angle that a locked rotor may give: a 24th harmonic changes by its amplitude within it."""
_NEARLY_ALL = (0.01, 0.99)  # quantiles of the angles, without which noise of the resolver would count as motion
_FEW_POINTS = 0.005  # share of the map's points that may be uncertain
_LARGE_SIGMA = 0.01  # standard error over the largest flux of an uncertain point
_LARGE_SHARE = 0.01
"""Of R, by which the shape of a wide inverter curve changes R."""
_LARGE_OFFSET = 0.005  # of a current sensor, in i_max, for a warning
_LARGE_MISMATCH = 0.01  # of gains, for a warning
_SURE = 2.0  # standard errors by which either must exceed that
_LIMITS = Limits(unexplained=0.05, refused=0.2, mad=0.03, reversed=0.005, remedy="passive_maps", impossible=True)
_FEW_COVERED = 0.5  # share of the disc with data below which more of it helps most
_WHOLE_DISC = 0.02  # share of the disc without data up to which it is whole
_INNER = 0.9  # of its radius, where the disc has no hole if it is whole: at the rim, noise makes some


@dataclass(frozen=True)
class FullMethod:
    """Linear least squares over windows, with rotor harmonics, an inverter curve and calibration."""

    limits: Limits = _LIMITS

    def conclude(self, evidence: Evidence, inside: BoolArray, earlier: EarlierFit | None = None) -> Estimate:
        """Fit, calibrate, and evaluate maps and curve.

        Raises DataError when there are fewer windows than unknowns, or the delay of the voltages jumps or drifts far
        within a recording.
        """
        locked = _locked(evidence)
        if locked:
            evidence = _without_rotation(evidence)
        sums = _finished(evidence)
        fit = _fitted(evidence, sums, earlier)
        grid = evidence.visits.grid()
        found = _calibrations(evidence, fit, grid, inside)
        offset = next((c.value for c in found if c.name == calibration.RESOLVER_OFFSET and c.applied), 0.0)
        frame = TrueFrame(fit, offset, relative=locked)
        psi = frame.flux(grid)
        sigma, everywhere = _sigmas(frame, grid, inside)
        told = [said for said in (misfit_found(fit), unseen_warning(fit)) if said is not None]
        warnings = (
            *(said for said in told if said.kind == "warning"),
            *_on_parts(fit, misfit=bool(told)),
            *_on_map(evidence, fit, psi, sigma, inside),
            *_on_calibration(evidence, fit, found),
        )
        earlier, hidden = EarlierFit.of(fit), calibration.by_hidden_faults(fit, found, grid[inside])
        if hidden.any():
            fit = _with_hidden_faults(fit, hidden)
            frame = replace(frame, fit=fit)
            sigma, everywhere = _sigmas(frame, grid, inside)
        current = np.linspace(-evidence.i_max, evidence.i_max, CURVE_POINTS)
        drops, deviation = _inverter(fit, current)
        unknowns = fit.solution.basis.shape[1]
        share = sums.windows / (sums.windows + sums.outside)
        return Estimate(
            resistance=fit.solution.resistance,
            sigma_resistance=fit.sigma(RESISTANCE),
            voltage_error=float(drops[-1].mean()),
            sigma_voltage_error=float(deviation[-1]),
            inverter_current=current,
            inverter_voltage=drops.mean(axis=1),
            flux_map=FluxMap.of(
                evidence.visits.i_d,
                evidence.visits.i_q,
                psi,
                sigma,
                inside,
                tuple(HarmonicMap.of(order, *frame.harmonic(order, grid)) for order in fit.spec.orders),
            ),
            drop=(current, drops.mean(axis=1)),
            effects=_effect_voltages(evidence, fit),
            report=FitReport(
                samples_used=round((evidence.samples - evidence.idle) * share),
                rows=2 * sums.windows,
                parameters=unknowns,
                rank=unknowns,
                condition=float(1.0 / np.min(fit.solution.variant.factor.diagonal)),
                residual_rms=fit.solution.residual_rms / evidence.sample_period,
            ),
            unexplained=float(fit.solution.residual_rms / np.sqrt(max(fit.total_voltage, TINY))),
            outlying_time=_outlying_time(fit),
            warnings=warnings,
            sigma_inverter_voltage=deviation,
            phase_voltages=drops if fit.spec.per_phase else None,
            calibrations=tuple(found),
            magnet_coefficient=_magnet_coefficient(fit),
            statements=(
                *(said for said in told if said.kind != "warning"),
                *_statements(evidence, fit, inside, found),
                *_on_effort(fit, sums),
            ),
            fit=earlier,
            error_modes=_error_modes(frame, grid, enclosed(inside), everywhere, current, deviation),
        )


@dataclass(frozen=True, eq=False)
class TrueFrame:
    """The fitted maps as functions of the true current, corrected for the resolver's offset."""

    fit: FullFit
    angle: float  # measured minus true electrical angle, rad
    relative: bool = False  # whether fluxes are those minus the flux at zero current

    def rows(self, i_dq: FloatArray) -> BasisRows:
        """Return the rows of the fluxes at true currents (N, 2), A, in the measured frame."""
        rows = self.fit.model.flux.rows(rotated(i_dq, -self.angle))
        if not self.relative:
            return rows
        zero = self.fit.model.flux.rows(np.zeros_like(i_dq))
        return BasisRows(np.append(rows.column, zero.column, axis=2), np.append(rows.value, -zero.value, axis=2))

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_dq (..., 2), Wb, averaged over the rotor position, at currents (..., 2), A."""
        rows = self.rows(i_dq.reshape(-1, 2))
        return rotated(rows.dot(self.fit.solution.estimate[self.fit.model.map]), self.angle).reshape(i_dq.shape)

    def harmonic(self, order: int, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the amplitudes of cos(h theta) and sin(h theta), (..., 2) each, Wb, theta being the true angle."""
        model = self.fit.model
        rows = model.harmonic.rows(rotated(i_dq.reshape(-1, 2), -self.angle))
        halves = np.split(self.fit.solution.estimate[model.harmonics[order]], 2)
        a, b = (rotated(rows.dot(half), self.angle).reshape(i_dq.shape) for half in halves)
        cosine, sine = np.cos(order * self.angle), np.sin(order * self.angle)
        return a * cosine + b * sine, b * cosine - a * sine

    def slope_rows(self, i_dq: FloatArray) -> BasisRows:
        """Return the rows of dpsi_d/di_d and dpsi_q/di_q at true currents (N, 2), A, in the measured frame."""
        by_d, by_q = self.fit.model.flux.slope_rows(rotated(i_dq, -self.angle))
        column, value = (
            np.stack([getattr(by_d, name)[:, 0], getattr(by_q, name)[:, 1]], axis=1) for name in ("column", "value")
        )
        return BasisRows(column, value)


def _finished(evidence: Evidence) -> WindowSums:
    """Return the sums of the fit; raises DataError where they are too few, or the rotor of a locked one turned."""
    assert evidence.windows is not None
    sums = evidence.windows.finished()
    if sums.windows < sums.model.flux.parameters:
        raise DataError(Message("few_windows", windows=sums.windows))
    triangles = sums.triangles()
    check_sums(triangles, sum(each[0] for each in triangles))  # those of the voltages come first
    return _at_one_position(sums) if _locked(evidence) else sums


def _fitted(evidence: Evidence, sums: WindowSums, earlier: EarlierFit | None) -> FullFit:
    """Fit; raises DataError where signals are late by more than the fit follows, at once or bit by bit."""
    fit = fit_full(
        sums, evidence.settings, evidence.turn, evidence.current_variance, earlier,
        angle_variance=evidence.angle_variance, interpolation_variance=evidence.interpolation_variance,
    )  # fmt: skip
    if (refused := effect_refused(fit)) is not None:
        raise DataError(refused)
    if (jump := fit.assessment.jump) is not None:
        where = {"later": jump.later, "time": jump.time, "recording": jump.recording + 1}
        if np.isfinite(jump.drift):
            raise DataError(Message("fast_clock.unknown", drift=1e6 * abs(jump.drift), **where))
        raise DataError(Message("delay_jump", **where))
    return fit


def _with_hidden_faults(fit: FullFit, changes: FloatArray) -> FullFit:
    """Return the fit with errors by changes (size, K) of the estimate that faults of the sensors may cause."""
    judged = fit.assessment
    sources = (*["sensors"] * changes.shape[1], *judged.sources)
    return replace(fit, assessment=replace(judged, changes=np.hstack([changes, judged.changes]), sources=sources))


def _locked(evidence: Evidence) -> bool:
    return not ORIGINS[evidence.settings.method].turning


def _position(windows: Iterable[Windows]) -> tuple[float, float]:
    """Return the mean electrical angle of windows, and the range of nearly all of them, rad."""
    angles = np.concatenate([part.angle[:, 0] for part in windows])
    mean = np.angle(np.mean(np.exp(1j * angles)))
    low, high = np.quantile(np.angle(np.exp(1j * (angles - mean))), _NEARLY_ALL)
    return float(mean), float(high - low)


def _without_rotation(evidence: Evidence) -> Evidence:
    """Return the evidence with settings for one map at one position, which shows no faults of the sensors."""
    settings = replace(
        evidence.settings, maps="reciprocal", search_orders=False, calibrate_delay=False, calibrate_angle=False,
        calibrate_currents=False,
    )  # fmt: skip
    return evidence.copy(settings)


def _at_one_position(sums: WindowSums) -> WindowSums:
    """Return the sums without harmonics; raises DataError unless the rotor stood at one position in all recordings."""
    _, turned = _position(sums.kept())
    if turned > _LOCKED_TURN:
        raise DataError(Message("not_locked", turned=turned))
    return sums.over(replace(sums.model, orders=())) if sums.model.orders else sums  # accumulated for another method


def _outlying_time(fit: FullFit) -> float | None:
    """Return when samples stand out from all others, in time of data, s."""
    judged = fit.assessment
    stands_out = judged.outlying > OUTLYING and judged.outlying_share > _LEAST_OUTLYING
    return judged.outlying_time if stands_out else None


def _magnet_coefficient(fit: FullFit) -> tuple[float, float] | None:
    if not fit.spec.magnet:
        return None
    return float(fit.solution.estimate[MAGNET]), fit.sigma(MAGNET)


def _calibrations(evidence: Evidence, fit: FullFit, grid: FloatArray, inside: BoolArray) -> list[Calibration]:
    settings = evidence.settings
    found = [calibration.calibrate_delay(fit, settings.calibrate_delay, evidence.turn)]
    found += effect_entries(fit)
    disc = inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    if settings.calibrate_angle:
        reached = min(evidence.i_max, evidence.reached or evidence.i_max)
        mirrored = calibration.mirrored_points(evidence.visits.i_d, evidence.visits.i_q, disc, reached)
        found.append(calibration.calibrate_angle(fit, mirrored))
    if settings.calibrate_currents:
        found += calibration.calibrate_currents(fit, evidence.i_max)
    return calibration.with_lateness(fit, found)


def _sigmas(frame: TrueFrame, grid: FloatArray, inside: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the standard errors (D, Q, 2) of the fluxes where data are, and also where data only enclose, Wb."""
    around = enclosed(inside)
    spread = _spread(frame.fit, frame.rows(grid[around]))  # takes longest, and holds for both
    sigma = _sigma(frame, grid, inside, spread[:, inside[around]])
    return sigma, np.where(inside[..., None], sigma, _sigma(frame, grid, around, spread))


def _sigma(frame: TrueFrame, grid: FloatArray, inside: BoolArray, spread: FloatArray) -> FloatArray:
    """Return the standard errors (D, Q, 2) of the fluxes, Wb, from their :func:`_spread` at the points ``inside``.

    They include the flux that the model cannot follow, see :func:`~drive_id.core.full.lack_of_fit.missed_flux`, unless
    the residuals are those of the inverter near zero crossings, which short windows turn into much larger fluxes.
    """
    sigma = _by_residuals(spread, inside)
    missed = frame.fit.assessment.misfit.missed_at(rotated(grid[inside], -frame.angle), frame.fit.model.i_max)
    if missed.any() and np.isnan(frame.fit.crossings):
        sigma[inside] = np.sqrt(sigma[inside] ** 2 + missed)
    return sigma


def _spread(fit: FullFit, rows: BasisRows) -> FloatArray:
    """Return (3, N, 2) how far residuals spread forms of the map: as they are, as white ones with a prior, as these."""
    changes, consistent = fit.assessment.changes[fit.model.map], np.empty(rows.value.shape[:2])
    for start in range(0, len(consistent), _POINTS):  # in batches: memory grows with points times time batches
        part = slice(start, start + _POINTS)
        consistent[part] = fitted_sigma(BasisRows(rows.column[part], rows.value[part]).dot(changes))
    return np.stack([consistent, *fit.white_sigma(rows)])


def _by_residuals(spread: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the standard errors (D, Q, 2) of forms of the map at the grid points ``inside``, see :func:`_spread`.

    They are those for white residuals and a prior, scaled by how much more the residuals spread the forms around there
    than white ones would: the spread itself, from few passes of the trajectory, is uncertain at a single point.
    """

    def around(values: FloatArray) -> FloatArray:
        on_grid = np.zeros((*inside.shape, 2))
        on_grid[inside] = values**2
        return np.stack([smoothed(on_grid[..., axis], inside)[inside] for axis in range(2)], axis=-1)

    sigma, (consistent, both, white) = np.full((*inside.shape, 2), np.nan), spread
    usual = around(white)
    sigma[inside] = both * np.sqrt(np.divide(around(consistent), usual, out=np.ones_like(usual), where=usual > 0))
    return sigma


def _effect_voltages(evidence: Evidence, fit: FullFit) -> EffectVoltages | None:
    search = fit.selection.search
    kept = search.sums.kept()
    if not (fit.spec.effects or any(windows.conditioned for windows in kept)):
        return None
    columns = replace(search.found.columns, estimate=fit.solution.estimate)
    recordings = 1 + max(int(windows.recording.max()) for windows in kept)
    given = max(len(evidence.settings.temperatures), len(evidence.settings.u_dc))
    told = given in {0, recordings}  # merged evidence has the settings of its first recording
    conditions = [evidence.settings.conditions(number) for number in range(recordings if told else 1)]
    alike = told and len(set(conditions)) == 1
    of_recordings = [name for name in fit.spec.effects if CATALOGUE[name].of_recordings]
    simulated = not any(CATALOGUE[name].of_recorded_runs for name in fit.spec.effects)

    def voltages(pieces: Sequence[Samples]) -> tuple[list[FloatArray], bool]:
        whole = told and len(pieces) == recordings and sum(len(piece) for piece in pieces) >= evidence.samples
        known = conditions if whole else len(pieces) * conditions[:1]
        if whole or (alike and not of_recordings):
            return columns.voltages(pieces, _AVERAGED, known), simulated
        estimate = columns.estimate.copy()
        for name in of_recordings:
            estimate[fit.model.effect(name)] = 0.0
        return replace(columns, estimate=estimate).voltages(pieces, _AVERAGED, known), False

    return voltages


def _inverter(fit: FullFit, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the drop of each phase (C, 3), V, and the standard error of their mean (C,), V."""
    columns, shapes = fit.model.phase_columns(), fit.model.shapes(current)
    drops = shapes @ fit.solution.estimate[columns]
    forms = np.zeros((fit.model.size, len(current)))
    for phase in range(3):
        forms[columns[:, phase]] = shapes.T / 3
    return drops, fitted_sigma(forms.T @ fit.assessment.changes)


def _error_modes(
    frame: TrueFrame, grid: FloatArray, around: BoolArray, sigma: FloatArray, current: FloatArray, drops: FloatArray
) -> ErrorModes | None:
    """Return the joint errors, also where data only enclose the current, for a figure may need the map there.

    ``around`` tells where that is, ``sigma`` (D, Q, 2) are the standard errors there, Wb, and ``drops`` (C,) those of
    the inverter's curve at currents (C,), A.
    """
    fit, changes = frame.fit, frame.fit.assessment.changes
    columns, shapes = fit.model.phase_columns(), fit.model.shapes(current)
    curve = shapes @ changes[columns].mean(axis=1)
    others = np.concatenate([changes[[RESISTANCE]], curve[-1:], curve])
    errors = np.concatenate([[fit.sigma(RESISTANCE)], drops[-1:], drops])
    slope_rows, step = frame.slope_rows(grid[around]), grid[1, 1] - grid[0, 0]
    slope_rows = replace(slope_rows, value=slope_rows.value * step[:, None])
    return error_modes(
        changes[fit.model.map],
        frame.rows(grid[around]),
        sigma,
        around,
        (others, errors),
        lambda psi: rotated(psi, frame.angle),
        slopes=(slope_rows, _by_residuals(_spread(fit, slope_rows), around)[around]),
    )


def _on_map(
    evidence: Evidence, fit: FullFit, psi: FloatArray, sigma: FloatArray, inside: BoolArray
) -> Iterator[Message]:
    """Yield warnings of the windows and of the standard errors of the flux map."""
    locked = _locked(evidence)
    if locked:
        yield Message("locked_rotor", angle=_position(fit.selection.search.sums.kept())[0])
    share = SHORT_ANGLE / WINDOW_ANGLE if fit.crossings > 1 else 1.0
    # Windows that end sooner do so because the current changes fast, which tells flux and voltage errors apart, too.
    turn, duration = fit.assessment.turn, fit.assessment.duration
    slow = turn < _LEAST_TURN * share * WINDOW_ANGLE and duration > _LEAST_TURN * share * LONGEST_WINDOW
    if slow and not locked:
        yield Message("slow_rotation", turn=turn)
    if evidence.turn > _MOST_TURN and fit.spec.reciprocal and fit.steady is not None:
        yield Message("fast_rotation", turn=evidence.turn)
    grid = evidence.visits.grid()
    chosen = inside & (np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max)
    if chosen.any():
        uncertain = sigma[chosen].max(axis=1) > _LARGE_SIGMA * np.abs(psi[chosen]).max()
        if uncertain.mean() > _FEW_POINTS:
            d, q = grid[chosen][uncertain].mean(axis=0)
            told = {"points": uncertain.sum(), "of": chosen.sum(), "limit": _LARGE_SIGMA}
            if fit.assessment.open == DELAY:
                yield Message("sigma_large.delay", **told)
            elif fit.assessment.open:
                yield Message("sigma_large.open", effect=fit.assessment.open, **told)
            else:
                yield Message("sigma_large", **told, i_d=d, i_q=q)
    if fit.spec.wide and fit.shared_resistance >= _large_share(fit):
        yield Message("wide_curve.large", shared=fit.shared_resistance)


def _on_parts(fit: FullFit, *, misfit: bool) -> Iterator[Message]:
    """Yield a warning of more recordings than can have states of their own, where something is left to explain."""
    number = parts(fit.selection.search.sums.kept())
    if misfit and number > MOST_PARTS:
        yield Message("many_parts", parts=number, most=MOST_PARTS)


def _on_calibration(evidence: Evidence, fit: FullFit, calibrations: Sequence[Calibration]) -> Iterator[Message]:
    """Yield warnings of effects and faults of sensors, and of maps that are not reciprocal."""
    offsets = (c.message for c in calibrations if c.name == calibration.RESOLVER_OFFSET)
    yield from (message for message in offsets if message.kind == "warning")
    if not fit.spec.reciprocal and evidence.settings.maps == "auto":
        yield not_reciprocal_warning(fit)
    yield from dict.fromkeys(c.message for c in calibrations if c.doubtful)
    for c in calibrations:
        largest = _LARGE_OFFSET * evidence.i_max if c.unit == "A" else _LARGE_MISMATCH
        of_sensors = c.name.startswith(("current_offset", "current_gain", calibration.CURRENT_ROTATION))
        crossed = c.name == calibration.CURRENT_ROTATION and calibration.cross_talk(calibrations)
        surely = abs(c.value) - _SURE * c.sigma > largest
        if of_sensors and c.applied and (surely or crossed):
            yield Message(f"{c.message.code}.large", **c.message.values)


def _statements(
    evidence: Evidence, fit: FullFit, inside: BoolArray, calibrations: Sequence[Calibration]
) -> Iterator[Message]:
    """Yield what determined the unknowns that the data alone leave open, where data are missing, what helps most."""
    locked = _locked(evidence)
    relative = fit.sigma(RESISTANCE) / max(abs(fit.solution.resistance), TINY)
    by = ".locked" if locked else ".speeds" if fit.steady is None else ".reciprocity" if fit.spec.reciprocal else ""
    iron = any(CATALOGUE[name].family == "iron_loss" for name in fit.spec.effects)
    yield Message(f"separation{by}", share=relative, iron=iron)
    yield Message("linear_drop")
    gain = calibration.common_gain(calibrations)
    yield Message("common_gain.currents", share=gain) if gain else Message("common_gain")
    warm = float(np.concatenate([windows.magnet_heating for windows in fit.selection.search.sums.kept()]).mean())
    if abs(warm) > LEAST_HEATING and not fit.spec.magnet:
        yield Message("map_temperature", temperature=REFERENCE_TEMPERATURE + warm, least=LEAST_HEATING)
    if fit.spec.lag:
        yield Message("compensation_lags")
    if fit.crossings > 1:
        yield Message("zero_crossings", ratio=fit.crossings)
    large = fit.shared_resistance >= _large_share(fit)
    if fit.spec.wide and not large:  # larger: a warning
        yield Message("wide_curve", shared=fit.shared_resistance)
    elif large and not fit.spec.wide:
        yield Message("wide_curve.open", shared=fit.shared_resistance)
    yield from dict.fromkeys(c.message for c in calibrations if not (c.doubtful or c.message.kind == "warning"))
    orders = ", ".join(map(str, sorted(fit.spec.orders)))
    if not locked:
        yield Message("harmonics", orders=orders) if orders else Message("harmonics.none")
    yield _on_region(evidence, inside)
    few = inside.mean() < _FEW_COVERED * np.pi / 4
    yield Message("second_speed" if not locked and fit.steady is not None else "cover_disc" if few else "record_longer")


def _large_share(fit: FullFit) -> float:
    return _LARGE_SHARE * abs(fit.solution.resistance)


def _on_effort(fit: FullFit, sums: WindowSums) -> Iterator[Message]:
    """Yield for which share of the windows free maps or fine cells were used."""
    windows, cells = fit.selection.search.sums.windows, fit.model.resolution
    used = None if windows == sums.windows else windows
    if not fit.spec.reciprocal and used:
        yield Message("free_maps", used=used, windows=sums.windows)
    if cells.finer_than_usual:
        yield Message(
            "fine_cells",
            usual=FLUX_CELLS,
            cells_d=len(cells.d) - 1,
            cells_q=len(cells.q) - 1,
            width=min(np.diff(cells.d).min(), np.diff(cells.q).min()),
            used=used,
            windows=sums.windows,
        )


def _on_region(evidence: Evidence, inside: BoolArray) -> Message:
    grid = evidence.visits.grid()
    disc = np.hypot(grid[..., 0], grid[..., 1]) <= evidence.i_max
    missing = disc & ~inside
    share = missing.sum() / max(disc.sum(), 1)
    inner = np.hypot(grid[..., 0], grid[..., 1]) <= _INNER * evidence.i_max
    if share < _WHOLE_DISC and not (missing & inner).any():
        return Message("region.whole")
    d, q = grid[missing][np.hypot(*grid[missing].T).argmin()]
    return Message("region", share=share, i_d=d, i_q=q)
