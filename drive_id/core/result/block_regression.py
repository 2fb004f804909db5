"""Linear regression in time whose residuals are correlated, with standard errors that know it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.types import TINY, FloatArray

SIGNIFICANT = 30.0
"""Wald statistic of a harmonic, of two degrees of freedom, from which on it is reported."""
_SAME_GAIN = 2e-3  # difference from 1 that is none, however small its standard error
_LARGEST_LEVERAGE = 0.98
"""Of a block, beyond which its residual is all rounding."""


def is_one(gain: float, sigma: float) -> bool:
    """Tell whether a common gain is 1 as far as its standard error tells."""
    return abs(gain - 1) <= max(2 * sigma, _SAME_GAIN)


def grouped(blocks: list[FloatArray], wanted: int) -> list[FloatArray]:
    """Merge the products of neighbouring blocks to about the number wanted."""
    group = max(1, round(len(blocks) / wanted))
    return [np.sum(blocks[k : k + group], axis=0) for k in range(0, len(blocks), group)]


def _solved(total: FloatArray, response: int, columns: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients (K,) of columns of any scale, of products (C, C), and the pseudo-inverse (K, K)."""
    matrix = total[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(np.diag(matrix), TINY))
    inverse = np.linalg.pinv(matrix / scale / scale[:, None], hermitian=True) / scale / scale[:, None]
    return inverse @ total[columns, response], np.asarray(inverse)


@dataclass(frozen=True, eq=False)
class BlockRegression:
    """Coefficients (K,) of some columns, their covariance (K, K), and the products over all blocks.

    Neighbouring residuals are correlated, so the covariance comes from the scatter of the scores between blocks, or
    from their spectrum at the lowest frequencies.
    """

    response: int
    columns: list[int]
    coefficients: FloatArray
    covariance: FloatArray
    total: FloatArray

    @classmethod
    def of(cls, blocks: FloatArray, response: int, columns: list[int]) -> BlockRegression:
        """Solve for the columns, of products (B, C, C)."""
        total = blocks.sum(axis=0)
        coefficients, inverse = _solved(total, response, columns)
        scores = blocks[:, columns, response] - blocks[:, columns][:, :, columns] @ coefficients
        count = len(blocks)
        covariance = count / max(count - 1, 1) * inverse @ (scores.T @ scores) @ inverse
        return cls(response, columns, coefficients, covariance, total)

    @classmethod
    def of_series(
        cls,
        data: FloatArray,
        response: int,
        columns: list[int],
        cosines: int,
        more: FloatArray | None = None,
        *,
        block: int = 1,
    ) -> BlockRegression:
        """Solve for the columns, indices of C like the response, of equidistant rows (N, C).

        The covariance is the equally weighted cosine estimate: the mean periodogram of the scores at the ``cosines``
        lowest frequencies k / 2 N, from 1 to below N. What repeats faster than these is no scatter of the mean. The
        residuals are those of rows that had no part in the solution, one ``block`` of neighbours with correlated errors
        left out at a time (CR3): a few rows of large leverage, as from the run-up of a shaft, draw the solution to
        their errors and so hide these.

        ``more`` (M, K) are products of the columns chosen with independent errors of the response, one standard error
        each.
        """
        total, count, chosen = data.T @ data, len(data), data[:, columns]
        coefficients, inverse = _solved(total, response, columns)
        residual = data[:, response] - chosen @ coefficients
        whole = count - count % block
        for rows, size in ((slice(0, whole), block), (slice(whole, count), count - whole)):
            if size:
                own, left = chosen[rows].reshape(-1, size, len(columns)), residual[rows].reshape(-1, size, 1)
                shares, modes = np.linalg.eigh(own @ inverse @ own.swapaxes(1, 2))
                left = modes.swapaxes(1, 2) @ left / (1 - np.minimum(shares, _LARGEST_LEVERAGE))[..., None]
                residual[rows] = (modes @ left).ravel()
        scores = chosen * residual[:, None]
        waves = np.cos(np.pi * np.arange(1, cosines + 1)[:, None] * (np.arange(count) + 0.5) / count)
        amplitudes = np.sqrt(2 / cosines) * waves @ scores
        if more is not None:
            amplitudes = np.concatenate([amplitudes, more])
        return cls(response, columns, coefficients, inverse @ (amplitudes.T @ amplitudes) @ inverse, total)

    def estimate(self, column: int) -> tuple[float, float]:
        """Return a coefficient and its standard error."""
        k = self.columns.index(column)
        return float(self.coefficients[k]), float(np.sqrt(self.covariance[k, k]))

    def amplitude(self, column: int) -> tuple[float, float]:
        """Return the amplitude of a cosine and the sine behind it, and its standard error."""
        k = self.columns.index(column)
        both = self.coefficients[k : k + 2]
        amplitude = float(np.hypot(*both))
        direction = both / max(amplitude, TINY)
        return amplitude, float(np.sqrt(direction @ self.covariance[k : k + 2, k : k + 2] @ direction))

    def scatter(self, column: int) -> float:
        """Return the standard error of a cosine and the sine behind it, in the direction that is known least."""
        k = self.columns.index(column)
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[k : k + 2, k : k + 2])[-1]))

    def wald(self, column: int) -> float:
        """Return the Wald statistic of a cosine and the sine behind it."""
        k = self.columns.index(column)
        both = self.coefficients[k : k + 2]
        return float(both @ np.linalg.pinv(self.covariance[k : k + 2, k : k + 2]) @ both)

    def rms(self, coefficients: FloatArray, rows: float) -> float:
        """Return the rms over rows of the response minus the columns with these coefficients."""
        every = [self.response, *self.columns]
        weights = np.append(1.0, -coefficients)
        return float(np.sqrt(max(weights @ self.total[np.ix_(every, every)] @ weights, 0.0) / rows))
