"""Standard errors of a fit, consistent for heteroscedastic and autocorrelated residuals, from batches of time."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, pairwise, zip_longest

import numpy as np
from scipy import sparse

from drive_id.core.full.lack_of_fit import GroupSums, LackOfFit
from drive_id.core.full.solver import CurrentNoise, FullSolution
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import Windows, interval
from drive_id.core.numerics.threads import MOST_THREADS, in_threads
from drive_id.types import TINY, FloatArray

_BATCH = 0.05
"""Residuals of windows that start within this time are treated as dependent, others as independent, s."""
SIGNIFICANCE = 5.0
"""Standard errors by which an effect must differ from zero, or R change with a wider inverter curve, to be kept."""
_SERIES, _CONVERGED = 16, 1e-3
"""Most terms of the binomial series of the leverage correction, and the term, relative to the sum, that ends it: far
below the uncertainty of a standard error."""
STUDENT = 1.21
"""Relative excess of Student's 97.5 % quantile over the normal one, per inverse degree of freedom: (1.96^2 + 1) / 4."""
_FEWEST = 6.0
"""Fewest degrees of freedom that are assumed, since their estimate is low by chance where there are few."""

_Batch = tuple[FloatArray, float, float, float]
"""Scores (M,), mean square residual, (Vs)^2, the same by current noise, and time, s."""


def sigma(changes: FloatArray) -> FloatArray:
    """Return the standard error (...) of a quantity from its changes (..., B) by batches of time.

    Few passes of the trajectory determine a quantity, so the standard error is uncertain itself and is widened like
    Student's distribution. The degrees of freedom follow from the fourth powers of the changes, which are three times
    the squared variance for B normal ones.
    """
    squares = changes**2
    total = squares.sum(axis=-1)
    freedom = 3 * total**2 / np.maximum(np.sum(squares**2, axis=-1), TINY)
    return np.asarray(np.sqrt(total) * (1 + STUDENT / np.maximum(freedom, _FEWEST)))


def changes_by_batch(sums: WindowSums, solution: FullSolution, column: int) -> FloatArray:
    """Return the change (B,) of one entry of the estimate by each batch of time.

    That of :func:`residual_statistics`, but with the mean leverage: it takes a projection instead of all scores.
    """
    kept, form = sums.kept(), np.zeros(sums.model.size)
    form[column], changes, rows = 1.0, [], 2.0 * sum(map(len, sums.kept()))
    by_row = solution.response(form)
    for segment in kept:
        terms = np.sum(sums.model.residuals(segment, by_row) * sums.model.residuals(segment, solution.estimate), axis=1)
        changes.append(np.add.reduceat(terms, _edges(segment)[:-1]))
    unused = max(rows - solution.unknowns, 1.0) / rows
    return np.asarray(np.concatenate(changes) * np.sqrt(2 * sums.windows / rows / unused))


def _edges(segment: Windows) -> list[int]:
    """Return where the batches of a segment begin, and its end."""
    return [0, *(1 + np.flatnonzero(np.diff(interval(segment.time, _BATCH)))), len(segment)]


def residual_statistics(
    sums: WindowSums, solution: FullSolution, noise: CurrentNoise
) -> tuple[FloatArray, FloatArray, FloatArray, LackOfFit]:
    """Evaluate the residuals of the kept windows.

    Returns
    -------
    changes : (size, B) float
        Change of the estimate by each batch.
    energy : (B,) float
        Comparable energy of each batch, (Vs)^2: the mean square residual, divided by what current noise causes in these
        windows where that is above average.
    time : (B,) float
        s.
    misfit : LackOfFit
    """
    model, kept = sums.model, sums.kept()
    through = sparse.csr_array(sparse.hstack([solution.basis, solution.estimate[:, None]]))
    covariance = solution.white_covariance  # cached before the threads start

    def evaluated(segments: Sequence[Windows]) -> tuple[list[list[_Batch]], GroupSums]:
        batches, groups = [], GroupSums(solution.basis.shape[1])
        for segment in segments:
            rows = model.design_times(segment, through, solution.spec.orders)
            expected = noise.expected(model, solution.estimate, segment)
            batches.append(_batch_scores(solution, covariance, segment, rows, expected))
            groups.add(segment, rows, expected, model.i_max)
        return batches, groups

    parts = in_threads(evaluated, [kept[number::MOST_THREADS] for number in range(MOST_THREADS)])
    (_, groups), *others = parts
    for _, other in others:
        groups.merge(other)
    in_order = (batches for together in zip_longest(*(part for part, _ in parts), fillvalue=()) for batches in together)
    scores, energy, square, time = (np.array(x) for x in zip(*chain.from_iterable(in_order), strict=True))
    share = sums.windows / max(sum(len(segment) for segment in kept), 1)
    usual = max(float(square.mean()), np.finfo(np.float64).tiny)
    changes = np.asarray(solution.basis @ solution.gain(np.sqrt(share) * scores.T))
    energy /= np.maximum(square / usual, 1.0)
    return changes, energy, time, groups.lack_of_fit(model, solution, share)


def _batch_scores(
    solution: FullSolution, covariance: FloatArray, segment: Windows, rows: FloatArray, expected: FloatArray
) -> list[_Batch]:
    """Return of each batch the scores (ZT)'e (M,), mean square residual, (Vs)^2, mean of ``expected``, and time, s.

    ``rows`` (N, 2, M + 1) are ZT and, last, the residuals r. The residuals e are corrected for leverage by CR2,
    ``e = (I - H)^{-1/2} r`` with ``H = Z cov Z'``, through the binomial series, which bounds the factor on residuals of
    full leverage.
    """
    residuals = rows[..., -1]
    out = []
    for start, end in pairwise(_edges(segment)):
        forms = rows[start:end, :, :-1].reshape(-1, solution.unknowns)
        met = np.flatnonzero(forms.any(axis=0))
        forms, covered = forms[:, met], covariance[np.ix_(met, met)]
        scale, score = solution.variant.factor.scale[met], forms.T @ residuals[start:end].ravel()
        total = score.copy()
        for k in range(1, _SERIES):
            score = (k - 0.5) / k * (forms.T @ (forms @ (covered @ score)))
            total += score
            if np.linalg.norm(score / scale) < _CONVERGED * np.linalg.norm(total / scale):
                break
        all_scores = np.zeros(solution.unknowns)
        all_scores[met] = total
        energy, square, time = (float(x[start:end].mean()) for x in (residuals**2, expected, segment.time))
        out.append((all_scores, energy, square, time))
    return out
