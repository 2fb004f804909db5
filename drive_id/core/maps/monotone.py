"""Flux maps with a convex co-energy, fitted to points: reciprocal and monotone on a whole rectangle of currents.

The co-energy is a tensor spline w of degree 4 whose cells are finer at zero current, see
:mod:`~drive_id.core.maps.coenergy`. The fit minimizes

    mean |psi(i_n) - psi_n|^2 / s^2 + weight * (squared second differences of the coefficients of the fluxes)

subject to convexity. In every cell, the Hessian of the co-energy is a polynomial of degree (4, 4) in Bernstein form
with 2 x 2 matrices as coefficients. It lies in their convex hull, so it is positive definite everywhere if all of them
are. This is sufficient, hardly more than necessary, and linear in w: the fit is a convex problem, solved by a barrier
method (:mod:`~drive_id.core.maps.convexity`) whose every iterate is convex.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from drive_id.common.quantity import counted
from drive_id.core.maps.coenergy import GradientSpline, bent_edges
from drive_id.core.maps.convexity import HessianForms, barrier_minimum
from drive_id.core.maps.flux_models import jacobian
from drive_id.core.maps.support import Support
from drive_id.core.numerics.normal_equations import solved
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.errors import ConfigurationError, DataError
from drive_id.types import BoolArray, FloatArray

DEGREE = 4  # of the co-energy: the inductances are continuous with their first derivatives
FEWEST_POINTS = 8  # from which a map is fitted
REACH = 1.3  # of the rectangle beyond the points, see :func:`fit_monotone`
MARGIN = 0.01  # least inductance relative to the typical one
_FEWEST_CELLS = 10  # along an axis: a bridge that saturates takes some
_MOST_CELLS = 20  # the time of a constrained fit grows with the sixth power of them
_CELLS_PER_ROOT = 1.0  # cells along an axis per root of the number of points
_BENDS = (1.0, 2.0, 3.0, 4.0)  # candidates: cells at zero current are up to 27 times narrower than at the rim
_WEIGHTS = np.geomspace(1e-11, 1e-1, 11)  # candidates of the roughness
_FINER = np.geomspace(0.1, 10, 5)[1:-1]  # factors around the best of them
DECLINE = 0.5
"""Beyond the points, slopes tend to fall with this power of the distance from zero current."""
_LEAST_BEYOND = 1e-8  # least weight of the slopes beyond the points: strong enough to hold there
_BEYOND = 3.0  # the same relative to that of the roughness: weak enough not to move the map within the points
_SITES = 2  # per cell along an axis, at which the slopes beyond the points are held
_STEP = 0.05  # relative, of the distance from zero current, for differences of these slopes
_FOLDS = 5  # of the cross-validation
_SEED = 20  # any: equal points give equal maps


@dataclass(frozen=True)
class Convexity:
    """What convexity cost: how far the data were from a monotone map."""

    active: bool
    """The constraints changed the map; otherwise the smooth map is convex with the same margin without them."""
    least_inductance: float  # no eigenvalue of the inductance matrix is smaller in the rectangle, H (a proven bound)
    residual_rms: float  # rms distance of the points from the map, Wb


@dataclass(frozen=True, eq=False)
class MonotoneMap:
    """A reciprocal and monotone flux map, smooth on a rectangle that exceeds the data.

    The inductances are continuous with their first derivatives. For currents beyond the rectangle, see :meth:`psi`.
    """

    space: GradientSpline  # its edges are those of the rectangle
    w: FloatArray  # (P,), coefficients of the co-energy in space.potential, J
    support: Support  # where the points are
    smoothness: float  # weight of the roughness, chosen by cross-validation unless given
    convexity: Convexity

    @property
    def low(self) -> FloatArray:
        """Lower corner of the rectangle (2,), A."""
        return np.array([self.space.d[0], self.space.q[0]])

    @property
    def high(self) -> FloatArray:
        """Upper corner of the rectangle (2,), A."""
        return np.array([self.space.d[-1], self.space.q[-1]])

    @cached_property
    def gamma(self) -> FloatArray:
        """Coefficients of the fluxes in ``space``, Wb."""
        return np.asarray(self.space.gradient @ self.w)

    def psi(self, i_dq: FloatArray) -> FloatArray:
        """Return the fluxes (..., 2), Wb, at currents (..., 2), A.

        Beyond the rectangle they are those at its edge: constant, and no longer strictly monotone.
        """
        flat = np.asarray(i_dq, np.float64).reshape(-1, 2)
        return self.space.rows(flat).dot(self.gamma).reshape(np.shape(i_dq))

    def inductances(self, i_dq: FloatArray) -> FloatArray:
        """Return the incremental inductances [[L_dd, L_dq], [L_qd, L_qq]] (..., 2, 2), H, at currents (..., 2), A.

        They are symmetric and positive definite; beyond the rectangle, those at its edge.
        """
        flat = np.asarray(i_dq, np.float64).reshape(-1, 2)
        return jacobian(self.space, self.gamma, flat).reshape(*np.shape(i_dq), 2)

    def inside(self, i_dq: FloatArray) -> BoolArray:
        """Tell (...) which currents (..., 2), A, have data around them; elsewhere the map is a continuation."""
        flat = np.asarray(i_dq, np.float64).reshape(-1, 2)
        return self.support.contains(flat).reshape(np.shape(i_dq)[:-1])


@one_blas_thread()
def fit_monotone(
    i_dq: FloatArray,
    psi_dq: FloatArray,
    sigma: FloatArray | None = None,
    *,
    reach: float = REACH,
    margin: float = MARGIN,
    smoothness: float | None = None,
    cells: int | None = None,
) -> MonotoneMap:
    """Fit a reciprocal and monotone flux map to points, on a grid or scattered.

    Parameters
    ----------
    i_dq : (N, 2) float
        Currents, A, on any places; repeated ones are averaged by the fit.
    psi_dq : (N, 2) float
        Flux linkages, Wb.
    sigma : (N, 2) float, optional
        Standard errors of the fluxes, Wb, positive; points count with ``1 / sigma^2``. Default: all points alike.
    reach : float
        The rectangle of the map exceeds that of the points, on each side, by ``reach - 1`` times their largest current
        amplitude. At least 1.
    margin : float
        Least eigenvalue of the inductance matrix, relative to the smaller of the mean slopes of psi_d over i_d and of
        psi_q over i_q. In the open interval 0 to 1.
    smoothness : float, optional
        Weight of the roughness. Default: by cross-validation.
    cells : int, optional
        Cells along each axis. Default: by the number of points.

    Raises
    ------
    DataError
        When there are too few points, values that are not finite, points on a line, or a flux that does not rise with
        its current on the whole (wrong signs or a swapped axis), which no monotone map describes.
    ConfigurationError
        When an option is out of range.
    """
    points = _Points.checked(i_dq, psi_dq, sigma)
    if not reach >= 1:
        raise ConfigurationError(f"reach is {reach}: the map must cover its points, give at least 1.")
    if not 0 < margin < 1:
        raise ConfigurationError(f"margin is {margin}: give a value above 0 and below 1.")
    if smoothness is not None and not smoothness > 0:
        raise ConfigurationError(f"smoothness is {smoothness}: it must be positive.")
    if cells is None:
        cells = int(np.clip(round(_CELLS_PER_ROOT * np.sqrt(len(points.i))), _FEWEST_CELLS, _MOST_CELLS))
    least = margin * points.slope
    problem, weight = _selected(points, reach, cells, smoothness)
    free = problem.free(weight)
    forms = HessianForms.of(problem.space.potential)
    active = forms.least_eigenvalue(free) < least
    w = problem.convex(weight, free, forms, least) if active else free
    ampere, weber = points.ampere, points.weber
    support = Support.of(points.i * ampere)
    convexity = Convexity(
        active=active,
        least_inductance=forms.least_eigenvalue(w) * weber / ampere,
        residual_rms=weber * _rms(problem.at_points(w) - points.psi),
    )
    space = GradientSpline(ampere * problem.space.d, ampere * problem.space.q, DEGREE)
    return MonotoneMap(space, weber * ampere * w, support, weight, convexity)


@dataclass(frozen=True, eq=False)
class _Points:
    """Points in units in which the largest current amplitude is 1 and so is the rms flux around its mean."""

    i: FloatArray  # (N, 2)
    psi: FloatArray  # (N, 2)
    weights: FloatArray  # (N, 2), of mean 1
    ampere: float  # unit of the currents, A
    weber: float  # unit of the fluxes, Wb

    @classmethod
    def checked(cls, i_dq: FloatArray, psi_dq: FloatArray, sigma: FloatArray | None) -> _Points:
        i, psi = np.asarray(i_dq, np.float64), np.asarray(psi_dq, np.float64)
        error = np.ones_like(psi) if sigma is None else np.asarray(sigma, np.float64)
        if i.ndim != 2 or i.shape[1] != 2 or psi.shape != i.shape or error.shape != i.shape:
            raise DataError(
                f"Currents of shape {i.shape}, fluxes of shape {psi.shape} and sigmas of shape {error.shape}: give "
                "(N, 2) for each."
            )
        if not (np.isfinite(i).all() and np.isfinite(psi).all() and np.isfinite(error).all() and (error > 0).all()):
            raise DataError(
                "Currents, fluxes or sigmas are not finite, or a sigma is not positive: leave such points out."
            )
        if len(i) < FEWEST_POINTS:
            raise DataError(f"A flux map cannot be made of {counted(len(i), 'point')}: give at least {FEWEST_POINTS}.")
        ampere = float(np.hypot(*i.T).max())
        deviations = psi - psi.mean(axis=0)
        weber = _rms(deviations)
        spread = np.linalg.svd(i - i.mean(axis=0), compute_uv=False)
        if not (ampere > 0 and weber > 0 and spread[1] > 1e-6 * spread[0]):
            raise DataError("The points lie on a line of the current plane, or the flux is constant: no map follows.")
        weights = error**-2.0
        return cls(i / ampere, psi / weber, weights / weights.mean(), ampere, weber)

    @cached_property
    def slope(self) -> float:
        """The smaller of the slopes of psi_d over i_d and psi_q over i_q in an affine map; raises DataError."""
        affine = np.column_stack([np.ones(len(self.i)), self.i])
        roots = np.sqrt(self.weights.T)
        slopes = [np.linalg.lstsq(r[:, None] * affine, r * psi)[0] for r, psi in zip(roots, self.psi.T, strict=True)]
        found = {"psi_d": slopes[0][1], "psi_q": slopes[1][2]}
        for name, slope in found.items():
            if not slope > 0:
                raise DataError(
                    f"{name} does not rise with i_{name[-1]} but falls by {-slope * self.weber / self.ampere:.3g} H on "
                    "the whole, which no machine does: check the signs and the order of the axes."
                )
        return float(min(found.values()))


@dataclass(frozen=True, eq=False)
class _Problem:
    """Least squares of the points and the roughness, both quadratic in the coefficients w (P,) of the co-energy."""

    points: _Points
    space: GradientSpline
    rows: sparse.csr_array  # (2 N, P), fluxes at the points, both fluxes of a point adjacent
    rough: FloatArray  # (P, P), matrix of the roughness
    beyond: FloatArray  # (P, P), of the slopes beyond the points

    @classmethod
    def over(cls, points: _Points, reach: float, cells: int, bend: float) -> _Problem:
        beyond = reach - 1
        low, high = points.i.min(axis=0) - beyond, points.i.max(axis=0) + beyond
        d, q = (bent_edges(*ends, cells, bend) for ends in zip(low, high, strict=True))
        space = GradientSpline(d, q, DEGREE)
        rows = space.potential.rows(points.i).sparse(space.potential.parameters)
        rough = (space.gradient.T @ space.roughness @ space.gradient).toarray()
        return cls(points, space, rows, rough, _continuation(space, points.i))

    def sums(self, chosen: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal matrix (P, P) and right side (P,) of the sum over chosen points (N,)."""
        rows = self.rows[np.repeat(chosen, 2)]
        weighted = rows.multiply(self.points.weights[chosen].ravel()[:, None]).tocsr()
        return (weighted.T @ rows).toarray(), np.asarray(weighted.T @ self.points.psi[chosen].ravel())

    @cached_property
    def _all(self) -> tuple[FloatArray, FloatArray]:
        return self.sums(np.ones(len(self.points.i), np.bool_))

    def _minimum(
        self, normal: FloatArray, right: FloatArray, weight: float, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return matrix and right side of the normal equations of some points with these sums."""
        matrix = normal / (2 * count) + max(_LEAST_BEYOND, _BEYOND * weight) * self.beyond + weight * self.rough
        return matrix, right / (2 * count)

    def free(self, weight: float) -> FloatArray:
        """Return the coefficients that minimize without constraints."""
        return solved(*self._minimum(*self._all, weight, len(self.points.i)))

    def convex(self, weight: float, start: FloatArray, forms: HessianForms, least: float) -> FloatArray:
        """Return the coefficients that minimize among those of a convex co-energy."""
        normal, right = self._minimum(*self._all, weight, len(self.points.i))
        tolerance = max(1e-10, 1e-3 * _rms(self.at_points(start) - self.points.psi) ** 2 / 4)
        return barrier_minimum(normal, right, forms, start, self.points.slope, least, tolerance)

    def errors(self, candidates: FloatArray) -> FloatArray:
        """Return the cross-validated errors of the unconstrained map for weights of the roughness."""
        normal, right = self._all
        fold = np.random.default_rng(_SEED).permutation(len(self.points.i)) % _FOLDS
        errors = np.zeros(len(candidates))
        for number in range(_FOLDS):
            left_out = fold == number
            own_normal, own_right = self.sums(left_out)
            rows, psi = self.rows[np.repeat(left_out, 2)], self.points.psi[left_out].ravel()
            count = int((~left_out).sum())
            for k, weight in enumerate(candidates):
                w = solved(*self._minimum(normal - own_normal, right - own_right, weight, count))
                errors[k] += self.points.weights[left_out].ravel() @ (rows @ w - psi) ** 2
        return errors

    def at_points(self, w: FloatArray) -> FloatArray:
        """Return the fluxes (N, 2) at the points."""
        return np.asarray(self.rows @ w).reshape(-1, 2)


def _continuation(space: GradientSpline, points: FloatArray) -> FloatArray:
    """Return the matrix (P, P) of the mean square of ``r dL/dr + DECLINE L`` beyond the points' hull.

    r is the distance from zero current or, where that is not within the hull, from the middle of the points.
    """
    support = Support.of(points)
    centre = np.zeros(2) if support.in_hull(np.zeros((1, 2))).all() else points.mean(axis=0)
    axes = [np.linspace(edges[0], edges[-1], _SITES * len(edges)) for edges in (space.d, space.q)]
    sites = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    further = centre + (1 + _STEP) * (sites - centre)
    chosen = ~support.in_hull(sites) & space.contains(further)
    if not chosen.any():
        return np.zeros((space.potential.parameters,) * 2)
    near, far = (_inductance_rows(space, i[chosen]) for i in (sites, further))
    change = ((1 + _STEP) ** DECLINE * far - near) / _STEP
    return np.asarray((change.T @ change).toarray() / chosen.sum())


def _inductance_rows(space: GradientSpline, i: FloatArray) -> sparse.csr_array:
    """Return the matrix (4 N, P) from coefficients of the co-energy to the incremental inductances at currents."""
    return sparse.csr_array(
        sparse.vstack([rows.sparse(space.parameters) @ space.gradient for rows in space.slope_rows(i)])
    )


def _selected(points: _Points, reach: float, cells: int, smoothness: float | None) -> tuple[_Problem, float]:
    """Return the problem and the weight of its roughness with the least cross-validated error."""
    weights = _WEIGHTS if smoothness is None else np.array([smoothness])
    problems = [_Problem.over(points, reach, cells, bend) for bend in _BENDS]
    errors = np.array([problem.errors(weights) for problem in problems])
    chosen, weight = np.unravel_index(errors.argmin(), errors.shape)
    problem, best = problems[chosen], float(weights[weight])
    if smoothness is None:
        finer = best * _FINER
        best = float(finer[problem.errors(finer).argmin()])
    return problem, best


def _rms(distances: FloatArray) -> float:
    """Return the rms length of vectors (N, 2)."""
    return float(np.sqrt(np.mean(np.sum(distances**2, axis=1))))
