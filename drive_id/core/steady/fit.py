"""Identify a drive from operating points: choose the model, weight the points, solve, and assess the result.

u_d = R i_d - omega psi_q + drop_d,    u_q = R i_q + omega psi_d + drop_q
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from drive_id.common.quantity import counted
from drive_id.common.temperature import COPPER, REFERENCE_TEMPERATURE
from drive_id.core.frames import J
from drive_id.core.steady.drop import DropShapes
from drive_id.core.steady.effects import EFFECTS, Effect, effect_columns
from drive_id.core.steady.flux_bases import AffineBasis, CoEnergyBasis, FluxBasis, linearized
from drive_id.core.steady.operating_points import OperatingPoints
from drive_id.core.steady.regression import Equations, Posterior, solved
from drive_id.errors import CoverageError, StandstillError
from drive_id.types import BoolArray, FloatArray

REACH = 1.05  # half width of the map by i_max
MAP_POINTS = 15  # least number of distinct currents, mirror images counted once, for maps instead of inductances
DISTINCT = 0.05  # distance of distinct currents, by i_max
_MAP_SPREAD = 0.3  # least range of i_d and of |i_q|, by i_max, for maps
_SAME_SPEED = 0.05  # distance, by the largest speed, within which points count as of one speed
_STANDSTILL = 0.01
"""Speed, by the largest, below which the fluxes induce nothing to speak of and a drop is not averaged over a turn."""
_NEAR_ZERO = 0.02  # current, by i_max, below which the drop is not known from the mean current
_SPARE = 4  # least number of equations more than unknowns to test for effects
USUAL_DROP = 0.03  # standard deviation of the drop before any data, by the DC-link voltage
_DROP_AT_REST = 0.3  # rms deviation of the drop at standstill from its mean over all angles, per volt of its amplitude
_CELLS = 10  # cells of the splines per axis; the penalty of the roughness, not their number, limits the detail
_BENDS = ((0.0, 0.0), (2.0, 0.0), (2.0, 3.0))  # bend and relief of the bases that compete where there are maps
_VAGUE = 10.0  # width of the weak prior, in units of what the voltages and currents suggest
_PASSES = 2  # times that the weights, which depend on the map, are renewed by a solution
_MISFIT = 1.25  # residuals, by the noise of the points, from which the misfit of the model counts as noise, too
_RARE = 3e-5  # probability with which chance alone makes an effect seem significant
_OUTLYING = 6.0
"""Size of a whitened residual, in typical ones, from which a point is left out: Gaussian ones exceed it with 1.5e-8."""
_MOST_OUTLYING = 0.1  # share of the points: if more are far away, it is the model that is wrong
_FEW = 20  # points below which the typical size is not known well enough to leave any out
_FLOOR = 1e-6  # least noise, by the voltage: exact data must not give infinite weights


@dataclass(frozen=True, eq=False, kw_only=True)
class _Weighed:
    """A solution and its weights."""

    points: OperatingPoints  # those used
    basis: FluxBasis
    effects: tuple[Effect, ...]  # found significant, and fitted
    shapes: DropShapes
    equations: Equations
    posterior: Posterior  # columns: R, effects, flux coefficients, and last the amplitude of the drop
    whitening: FloatArray  # (P, 2, 2)
    residual: FloatArray  # (P, 2), V
    misfit: float = float("nan")  # rms of the residuals, by the noise of the points; NaN where that is not known
    estimated: bool  # the noise, from the residuals

    @property
    def columns(self) -> slice:
        """Those of the flux coefficients."""
        first = 1 + len(self.effects)
        return slice(first, first + self.basis.parameters)

    @property
    def gamma(self) -> FloatArray:
        """Flux coefficients (C,)."""
        return self.posterior.mean[self.columns]


@dataclass(frozen=True, eq=False, kw_only=True)
class StaticFit(_Weighed):
    """A drive identified from operating points."""

    widening: float  # factor on all standard errors, so that +-1.96 hold 95 % although the noise is estimated
    outlying: int  # points left out

    @property
    def maps(self) -> bool:
        """Whether maps were fitted, not only inductances."""
        return isinstance(self.basis, CoEnergyBasis)

    @property
    def condition(self) -> float:
        """Condition number of the covariance, columns scaled."""
        by = np.sqrt(np.maximum(np.diag(self.posterior.covariance), np.finfo(float).tiny))
        return float(np.sqrt(np.linalg.cond(self.posterior.covariance / by / by[:, None])))

    def of(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return values and standard errors (...) of linear functions (..., C) of the flux coefficients."""
        covariance = self.posterior.covariance[self.columns, self.columns]
        variance = np.einsum("...i,ij,...j->...", rows, covariance, rows, optimize=True)
        return rows @ self.gamma, self.widening * np.sqrt(np.maximum(variance, 0.0))

    def coefficient(self, column: int) -> tuple[float, float]:
        """Return one coefficient of the posterior and its standard error."""
        sigma = np.sqrt(max(self.posterior.covariance[column, column], 0.0))
        return float(self.posterior.mean[column]), self.widening * float(sigma)

    def flux(self, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the fluxes and their standard errors (N, 2), Wb, at currents (N, 2), A."""
        return self.of(self.basis.rows(i_dq))

    def drop_curve(self, current: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the drop of one phase and its standard error (N,), V, at phase currents (N,), A."""
        found = self.posterior
        curves = self.shapes(current)
        mean = curves @ (found.shapes * found.drop_mean)
        square = curves**2 @ (found.shapes * found.drop_square)
        return np.asarray(mean), self.widening * np.sqrt(np.maximum(square - mean**2, 0.0))


def fit_points(points: OperatingPoints, i_max: float, u_dc: float | None = None) -> StaticFit:
    """Identify a drive from operating points.

    Parameters
    ----------
    i_max : float
        Radius of the current disc, A.
    u_dc : float, optional
        DC-link voltage, V, which tells how large a drop may be. Default: the least that gives these voltages.

    Raises
    ------
    StandstillError
        When the machine never turns.
    CoverageError
        When there are too few points, or none with current.
    """
    fastest = float(np.abs(points.speed).max())
    if not fastest > 0:
        raise StandstillError("The speed of all operating points is zero: record points while the machine turns.")
    if not points.i_max > 0:
        raise CoverageError("The current of all operating points is zero: record points with current.")
    bases = _bases(points, i_max)
    usual = USUAL_DROP * (u_dc or np.sqrt(3) * float(np.hypot(*points.u_dq.T).max()))
    shapes = DropShapes.up_to(i_max, usual)
    moving = int(turning(points).sum())
    unknowns = 1 + bases[0].free
    if moving < 2 or 2 * len(points) <= unknowns:
        raise CoverageError(
            f"There are {counted(len(points), 'operating point')} at rest, {moving} of them "
            f"turning, for {counted(unknowns, 'unknown')}: "
            "record at least 4 points with different i_d and i_q."
        )
    found = _weighed(points, bases, shapes)
    outlying = _outlying(found)
    if outlying.any():
        found = _weighed(points.chosen(~outlying), bases, shapes)
    freedom = len(found.equations.y) - found.posterior.effective if found.estimated else found.points.freedom
    widening = float(stdtrit(max(freedom, 1.0), 0.975)) / 1.959964
    return StaticFit(**vars(found), widening=widening, outlying=int(outlying.sum()))


def distinct_currents(i_dq: FloatArray, distance: float) -> FloatArray:
    """Return the currents (N, 2), with abs(i_q), that are not closer than this to an earlier one."""
    found: list[FloatArray] = []
    for i in np.column_stack([i_dq[:, 0], np.abs(i_dq[:, 1])]):
        if not found or np.hypot(*(np.array(found) - i).T).min() >= distance:
            found.append(i)
    return np.array(found).reshape(-1, 2)


def turning(points: OperatingPoints) -> BoolArray:
    """Return (P,) at which points the machine turns, so that its fluxes induce voltages."""
    return np.asarray(np.abs(points.speed) > _STANDSTILL * np.abs(points.speed).max())


def distinct_speeds(points: OperatingPoints) -> list[float]:
    """Return the speeds that differ by more than 5 % of the largest, rad/s."""
    found: list[float] = []
    for speed in np.sort(points.speed):
        if not found or speed - found[-1] > _SAME_SPEED * np.abs(points.speed).max():
            found.append(float(speed))
    return found


def _bases(points: OperatingPoints, i_max: float) -> list[FluxBasis]:
    """Return the bases to choose from: splines where the points allow it, or the affine machine."""
    distinct = distinct_currents(points.i_dq[turning(points)], DISTINCT * i_max)
    if len(distinct) < MAP_POINTS or np.ptp(distinct, axis=0).min() < _MAP_SPREAD * i_max:
        return [AffineBasis()]
    return [CoEnergyBasis(REACH * i_max, _CELLS, bend, relief) for bend, relief in _BENDS]


def _weighed(points: OperatingPoints, bases: list[FluxBasis], shapes: DropShapes) -> _Weighed:
    """Return the solution with weights that follow from the scatter of the points, and from the misfit of the model."""
    known = points.covariance is not None
    covariance = np.broadcast_to(np.eye(2), (len(points), 2, 2)) * float(np.mean(points.u_dq**2)) * 1e-4
    found = _best(points, bases, (), shapes, covariance, 0.0)
    for _ in range(_PASSES):
        covariance = _noise(found)
        found = _best(points, bases, (), shapes, covariance, float(known))
    while (chosen := _next_effect(found, covariance)) is not None:
        basis = replace(found.basis, odd=found.basis.odd or chosen.odd)
        effects = found.effects if chosen.odd else (*found.effects, chosen)
        for _ in range(_PASSES):  # the columns of effects depend on the map
            found = _best(points, [basis], effects, shapes, covariance, float(known), found)
            covariance = _noise(found)
    misfit = float(np.sqrt(found.posterior.scale)) if known else float("nan")
    if known and found.posterior.scale > _MISFIT**2:
        found = _matched(found, covariance)
    return replace(found, misfit=misfit, estimated=not known or misfit > _MISFIT)


def _best(
    points: OperatingPoints,
    bases: list[FluxBasis],
    effects: tuple[Effect, ...],
    shapes: DropShapes,
    covariance: FloatArray,
    least_scale: float,
    before: _Weighed | None = None,
) -> _Weighed:
    """Solve with each basis and return the likeliest."""
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    found = []
    drops = shapes.vectors(points.i_dq)
    for basis in bases:
        columns = _columns(points, basis, effects, before)
        equations = _equations(points, basis, columns, drops, 1 / shapes.usual, whitening, least_scale)
        posterior = solved(equations)
        drop = drops @ (posterior.shapes * posterior.drop_mean)
        found.append(
            _Weighed(
                points=points,
                basis=basis,
                effects=effects,
                shapes=shapes,
                equations=equations,
                posterior=posterior,
                whitening=whitening,
                residual=points.u_dq - (columns @ posterior.mean[: columns.shape[2]] + drop),
                estimated=least_scale == 0,
            )
        )
    return min(found, key=lambda entry: entry.posterior.evidence)


def _columns(
    points: OperatingPoints, basis: FluxBasis, effects: tuple[Effect, ...], before: _Weighed | None
) -> FloatArray:
    """Return the voltages (P, 2, C) of R, effects and fluxes."""
    heating = np.ones(len(points))
    if points.winding_temperature is not None:
        heating = 1 + COPPER * (points.winding_temperature - REFERENCE_TEMPERATURE)
    resistive = heating[:, None] * points.i_dq
    induced = points.speed[:, None, None] * np.einsum("ab,nbc->nac", J, basis.rows(points.i_dq))
    more = [effect_columns(effect, points, before.basis, before.gamma) for effect in effects] if before else []
    return np.concatenate([resistive[..., None], *more, induced], axis=2)


def _equations(
    points: OperatingPoints,
    basis: FluxBasis,
    columns: FloatArray,
    drops: FloatArray,
    drop_prior: float,
    whitening: FloatArray,
    least_scale: float,
) -> Equations:
    count = columns.shape[2]
    first = count - basis.parameters
    penalty = np.zeros((count, count))
    penalty[first:, first:] = basis.penalty
    ohm, henry = scales(points)
    prior = np.zeros((0, count))
    if isinstance(basis, AffineBasis):
        prior = np.zeros((2, count))
        prior[0, 0] = 1 / (_VAGUE * ohm)
        prior[1, first + 1 : first + 3] = np.array([1.0, -1.0]) / (_VAGUE * henry)

    def white(values: FloatArray) -> FloatArray:
        rows = np.einsum("nab,nb...->na...", whitening, values)
        return np.asarray(rows.reshape(2 * len(points), *values.shape[2:]))

    return Equations(
        y=white(points.u_dq),
        columns=white(columns),
        drops=white(drops),
        penalty=penalty,
        rank=basis.parameters - basis.free,
        prior=prior,
        drop_prior=drop_prior,
        log_volume=basis.log_volume,
        least_scale=least_scale,
    )


def scales(points: OperatingPoints) -> tuple[float, float]:
    """Return a resistance and an inductance of the size that voltages, currents and speeds suggest."""
    voltage = float(np.sqrt(np.mean(points.u_dq**2)))
    ohm = voltage / points.i_max
    return ohm, ohm / float(np.abs(points.speed).max())


def _noise(found: _Weighed) -> FloatArray:
    """Return the covariance (P, 2, 2) of the equations' errors, V^2, by the present estimate."""
    points = found.points
    drop = abs(float(found.posterior.shapes @ found.posterior.drop_mean))
    psi, inductance = linearized(found.basis, found.gamma, points.i_dq)
    amplitude = np.hypot(*points.i_dq.T)
    if points.covariance is None:
        size = float(np.sum(found.residual**2)) / max(found.equations.freedom, 1)
        size = max(size, _FLOOR**2 * float(np.mean(points.u_dq**2)))
        relative = 1 + (points.speed / np.abs(points.speed).max()) ** 2
        out = (size * relative / relative.mean())[:, None, None] * np.eye(2)
    else:
        resistive = found.posterior.mean[0] + 4 / np.pi * drop / np.maximum(amplitude, _NEAR_ZERO * points.i_max)
        by_current = resistive[:, None, None] * np.eye(2) + points.speed[:, None, None] * (J @ inductance)
        gradient = np.concatenate(
            [-by_current, np.broadcast_to(np.eye(2), by_current.shape), -(psi @ J.T)[..., None]], axis=2
        )
        out = np.einsum("nai,nij,nbj->nab", gradient, points.covariance, gradient)
        out += np.eye(2) * _FLOOR**2 * float(np.mean(points.u_dq**2))
    unsure = np.where(amplitude < _NEAR_ZERO * points.i_max, 1.0, np.where(turning(points), 0.0, _DROP_AT_REST))
    return np.asarray(out + (unsure * drop)[:, None, None] ** 2 * np.eye(2))


def _next_effect(found: _Weighed, covariance: FloatArray) -> Effect | None:
    """Return the effect that improves the fit most, or None where none is significant."""
    points, spare = found.points, found.equations.freedom
    several = len(distinct_speeds(points)) > 1
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    freedom = points.freedom or spare
    threshold = float(stdtrit(freedom, 1 - _RARE)) ** 2
    best, gain = None, 0.0
    for effect in EFFECTS:
        done = effect in found.effects or (effect.odd and found.basis.odd)
        if done or (effect.several_speeds and not several) or spare < _SPARE:
            continue
        columns = effect_columns(effect, points, found.basis, found.gamma)
        white = np.einsum("nab,nbk->nak", whitening, columns).reshape(2 * len(points), -1)
        improvement = _improvement(found, white) - white.shape[1] * threshold
        if improvement > gain:
            best, gain = effect, improvement
    return best


def _improvement(found: _Weighed, columns: FloatArray) -> float:
    """Return the chi square of further columns (N, K), given all others."""
    system, posterior = found.equations, found.posterior
    whole = np.column_stack([system.columns, system.drops @ posterior.shapes])
    count = system.columns.shape[1]
    unit = float(np.sum(system.columns**2) / np.trace(system.penalty)) if system.rank else 0.0
    matrix = whole.T @ whole
    matrix[:count, :count] += posterior.weight * unit * system.penalty + system.prior.T @ system.prior
    matrix[count, count] += system.drop_prior**2
    by = 1 / np.sqrt(np.diag(matrix))
    own = by[:, None] * np.linalg.lstsq(by[:, None] * matrix * by, by[:, None] * (whole.T @ columns), rcond=1e-13)[0]
    projected = columns - whole @ own
    residual = system.y - whole @ posterior.mean
    information = projected.T @ columns
    score = columns.T @ residual
    freedom = max(system.freedom - columns.shape[1], 1)
    gain = float(score @ np.linalg.lstsq(information, score, rcond=1e-10)[0])
    left = max(posterior.scale * system.freedom - gain, 0.0) / freedom
    return float(gain / max(left, system.least_scale, 1e-12 * gain, np.finfo(float).tiny))


def _matched(found: _Weighed, covariance: FloatArray) -> _Weighed:
    """Add the misfit of the model to the noise, so that residuals and weights agree."""
    points = found.points
    speed = np.abs(points.speed) / np.abs(points.speed).max()
    relative = (0.1 + speed) ** 2
    low, high = 0.0, 10 * float(np.mean(found.residual**2)) / float(np.mean(relative))
    best = found
    for _ in range(18):
        middle = (low + high) / 2
        wider = covariance + (middle * relative)[:, None, None] * np.eye(2)
        best = _best(points, [found.basis], found.effects, found.shapes, wider, 0.0, found)
        if best.posterior.scale > 1:
            low = middle
        else:
            high = middle
        if abs(best.posterior.scale - 1) < 0.02:
            break
    return best


def _outlying(found: _Weighed) -> BoolArray:
    """Return (P,) which few points are far from the model that describes all others."""
    white = np.einsum("nab,nb->na", found.whitening, found.residual)
    size = np.hypot(*white.T)
    typical = float(np.median(size)) / 1.1774
    far: BoolArray = size > _OUTLYING * max(typical, np.finfo(float).tiny)
    if len(far) < _FEW or far.sum() > _MOST_OUTLYING * len(far):
        return np.zeros_like(far)
    return far
