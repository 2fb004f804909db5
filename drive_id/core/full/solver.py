"""Method ``full``: penalized least squares on the accumulated windows, with every choice made on data left out.

All choices are congruences of the same accumulated matrix Z'Z, ``x -> Z T x``: reciprocal or free maps, the harmonics
in use, one inverter curve or one per phase. None needs a second pass over the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse

from drive_id.core.full.basis import PENALTIES, Choice, basis, delay_shares, roughness
from drive_id.core.full.model import RESISTANCE, SHIFT, VOLTAGE, FullModel
from drive_id.core.full.windows import SHIFTS
from drive_id.core.numerics.normal_equations import congruent, factorize, penalized, times
from drive_id.core.numerics.threads import in_threads
from drive_id.types import BoolArray, FloatArray, IntArray

_UNPREDICTABLE = 4.0


@dataclass(frozen=True, eq=False)
class FullSolution:
    """Estimate of all unknowns.

    Parameters
    ----------
    choice : Choice
    residual : (size,) float
        r with ``Z r`` the residuals, Vs: the estimate in the columns of its unknowns, -1 and the delay's shares in
        those of the voltage.
    basis : (size, M) sparse
        T, from unknowns to columns.
    factor : (M, M) float
        Lower triangular, of the penalized normal matrix divided by ``scale`` on both sides.
    scale : (M,) float
    sum_of_squares : float
        Of the residuals, (Vs)^2.
    rows : float
    """

    choice: Choice
    residual: FloatArray
    basis: sparse.csr_array
    factor: FloatArray
    scale: FloatArray
    sum_of_squares: float
    rows: float

    @property
    def residual_rms(self) -> float:
        """Vs."""
        return float(np.sqrt(max(self.sum_of_squares, 0.0) / max(self.rows, 1.0)))

    @property
    def resistance(self) -> float:
        """Ohm."""
        return float(self.residual[RESISTANCE])

    def gain(self, scores: FloatArray) -> FloatArray:
        """Return what scores (M, K), gradients of the sum of squares, change in the unknowns, (M, K)."""
        scaled = scores / self.scale[:, None]
        return np.asarray(linalg.cho_solve((self.factor, True), scaled, check_finite=False) / self.scale[:, None])

    def moved(self, pull: FloatArray) -> FloatArray:
        """Return what a gradient (size,) of half the sum of squares changes in the estimate, (size,)."""
        return np.asarray(self.basis @ self.gain(np.asarray(self.basis.T @ pull)[:, None])[:, 0])

    def half_gain(self, queries: FloatArray) -> FloatArray:
        """Return Q (M, K) with Q'Q the covariance of ``queries' x``, (M, K) linear forms, for white unit residuals."""
        scaled = queries / self.scale[:, None]
        return np.asarray(linalg.solve_triangular(self.factor, scaled, lower=True, check_finite=False))

    @cached_property
    def white_covariance(self) -> FloatArray:
        """Covariance (M, M) of the unknowns for white unit residuals."""
        return self.gain(np.eye(len(self.scale)))


class Solver:
    """Solves for any choice, on all folds or with one left out.

    Parameters
    ----------
    model : FullModel
    folds : (F, size, size) float
        Z'Z of each.
    counts : (F,) float
        Rows of each.
    """

    def __init__(self, model: FullModel, folds: FloatArray, counts: FloatArray) -> None:
        self.model = model
        self.folds = folds
        self.counts = counts
        self.total = folds.sum(axis=0)
        self._normals: dict[Choice, tuple[sparse.csr_array, FloatArray]] = {}

    @property
    def total_voltage(self) -> float:
        """Mean square of the integrated voltages, (Vs)^2."""
        return float(self.total[VOLTAGE, VOLTAGE] / max(float(self.counts.sum()), 1.0))

    def solve(self, choice: Choice, noise: sparse.csr_array | None = None) -> FullSolution:
        """Fit to all folds, or to what further noise (P, P) would make of them, see ``noise_correction``."""
        t, normal = self._normal(choice)
        voltage = self._voltage(choice)
        if noise is not None:
            normal = normal + self._further(t, noise)
        factor, scale = factorize(normal + self._penalty(t, choice.penalty))
        moment = t.T @ times(self.total, voltage)
        x = linalg.cho_solve((factor, True), moment / scale) / scale
        residual = t @ x - voltage
        squares = float(residual @ self.total @ residual)
        return FullSolution(choice, residual, t, factor, scale, squares, float(self.counts.sum()))

    def shrinkage(self, solution: FullSolution) -> FloatArray:
        """Return what the penalties change in the estimate, to first order, (size,)."""
        return solution.moved(roughness(self.model, self.total, solution.choice.penalty) @ solution.residual)

    def left_out(
        self,
        choice: Choice,
        penalties: Sequence[float] = (),
        folds: Sequence[int] | IntArray | None = None,
        noise: sparse.csr_array | None = None,
    ) -> FloatArray:
        """Return the sum of squared residuals per row of each fold in the fit to the others, (Vs)^2.

        Parameters
        ----------
        choice : Choice
        penalties : sequence of float
            To try in place of the choice's own.
        folds : sequence of int
            Those to leave out, one at a time; default: each.
        noise : (P, P) sparse
            As for :meth:`solve`, spread evenly over the folds.

        Returns
        -------
        (F, P) float

        Notes
        -----
        The penalty is one of the map alone: all else is eliminated once per fold,
        ``S = A_mm - A_mn A_nn^-1 A_nm``, and ``S + lambda P`` is solved for each penalty lambda.
        """
        (t, normal), voltage = self._normal(choice), self._voltage(choice)
        tried = [self._penalty(t, penalty) for penalty in penalties or (choice.penalty,)]
        moment = t.T @ times(self.total, voltage)
        in_map = np.asarray(abs(t[self.model.map]).sum(axis=0)).ravel() > 0
        further = 0.0 if noise is None else self._further(t, noise)

        def errors(number: int) -> list[float]:
            fold = self.folds[number]
            own, product = congruent(t, fold) + further / len(self.folds), times(fold, voltage)
            own_moment, square = t.T @ product, voltage @ product
            estimates = penalized(normal + further - own, moment - own_moment, tried, in_map)
            return [
                max(x @ (own @ x - 2 * own_moment) + square, 0.0) / max(self.counts[number], 1.0) for x in estimates
            ]

        return np.array(in_threads(errors, range(len(self.folds)) if folds is None else [int(k) for k in folds]))

    def smoothest(self, choice: Choice) -> tuple[Choice, FloatArray]:
        """Return the choice with the penalty that predicts the folds best, and its errors (F,), (Vs)^2."""
        errors = self.left_out(choice, PENALTIES)
        best = int(np.argmin(errors[predictable(errors.min(axis=1))].mean(axis=0)))
        return replace(choice, penalty=PENALTIES[best]), errors[:, best]

    def saving(self, solution: FullSolution, further: slice) -> float:
        """Return the share of the sum of squared residuals that unknowns of further columns would take away."""
        left = self._left(solution, np.arange(further.start, further.stop))
        moment = self.total[further] @ solution.residual
        scale = np.sqrt(np.maximum(np.diag(left), np.finfo(np.float64).tiny))
        found = np.linalg.lstsq(left / scale[:, None] / scale, moment / scale, rcond=1e-9)[0]
        return float((moment / scale) @ found / max(solution.sum_of_squares, np.finfo(np.float64).tiny))

    def delay(self, solution: FullSolution) -> tuple[float, float, float]:
        """Estimate by how many samples the voltages act later than recorded.

        A delay turns the flux of a constant speed by omega delta: only the reciprocity of the maps, or several speeds,
        tell it from a flux.

        Parameters
        ----------
        solution : FullSolution
            Of all else, without a delay.

        Returns
        -------
        delay, sigma : float
            The latter for white residuals, samples.
        squares : float
            Sum of squares of the residuals with it, (Vs)^2.
        """
        columns = np.r_[VOLTAGE, SHIFT]
        left = self._left(solution, columns)
        best, least, bend = 0.0, np.inf, 1.0
        for low in SHIFTS:
            start, end = (np.concatenate([[1.0], -delay_shares(low + e)]) for e in (0.0, 1.0))
            step = end - start
            bend_here = float(step @ left @ step)
            where = float(np.clip(-(step @ left @ start) / max(bend_here, 1e-300), 0.0, 1.0))
            at = start + where * step
            if float(at @ left @ at) < least:
                best, least, bend = low + where, float(at @ left @ at), bend_here
        sigma = float(np.sqrt(max(least, 0.0) / max(float(self.counts.sum()), 1.0) / max(bend, 1e-300)))
        return best, sigma, least

    def _left(self, solution: FullSolution, columns: IntArray) -> FloatArray:
        """Return the cross products of columns, less what the unknowns of a solution take of them."""
        half = solution.half_gain(np.asarray(solution.basis.T @ self.total[:, columns]))
        return np.asarray(self.total[np.ix_(columns, columns)] - half.T @ half)

    def _further(self, t: sparse.csr_array, noise: sparse.csr_array) -> FloatArray:
        """Return what noise adds to T'Z'ZT."""
        in_map = t[self.model.map]
        return np.asarray((in_map.T @ noise @ in_map).toarray())

    def _normal(self, choice: Choice) -> tuple[sparse.csr_array, FloatArray]:
        """Return T and T'Z'ZT, which neither the penalty nor the delay changes."""
        key = replace(choice, penalty=0.0, delay=0.0)
        if key not in self._normals:
            t = basis(self.model, choice)
            self._normals[key] = t, congruent(t, self.total)
        return self._normals[key]

    def _voltage(self, choice: Choice) -> FloatArray:
        """Return the combination (size,) of columns that is the integral of the voltage that acted."""
        voltage = np.zeros(self.model.size)
        voltage[VOLTAGE] = 1.0
        voltage[SHIFT] = -delay_shares(choice.delay)
        return voltage

    def _penalty(self, t: sparse.csr_array, penalty: float) -> FloatArray:
        return np.asarray((t.T @ roughness(self.model, self.total, penalty) @ t).toarray())


def predictable(errors: FloatArray) -> BoolArray:
    """Tell (F,) which folds the others can predict, by their squared errors (F,).

    What only one fold visits, such as the way from rest to the figure, would outweigh all else in a choice.
    """
    return np.asarray(errors <= _UNPREDICTABLE * np.median(errors))
