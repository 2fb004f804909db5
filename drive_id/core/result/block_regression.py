"""Linear regression on products per block of time, whose scatter gives the standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.types import FloatArray


def grouped(blocks: list[FloatArray], wanted: int) -> list[FloatArray]:
    """Merge the products of neighbouring blocks to about the number wanted."""
    group = max(1, round(len(blocks) / wanted))
    return [np.sum(blocks[k : k + group], axis=0) for k in range(0, len(blocks), group)]


@dataclass(frozen=True, eq=False)
class BlockRegression:
    """Coefficients (K,) of some columns, their covariance (K, K), and the products over all blocks.

    Neighbouring residuals are correlated, so the covariance comes from the scatter of the scores between blocks.
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
        matrix = total[np.ix_(columns, columns)]
        scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
        inverse = np.linalg.pinv(matrix / scale / scale[:, None], hermitian=True) / scale / scale[:, None]
        coefficients = inverse @ total[columns, response]
        scores = blocks[:, columns, response] - blocks[:, columns][:, :, columns] @ coefficients
        count = len(blocks)
        covariance = count / max(count - 1, 1) * inverse @ (scores.T @ scores) @ inverse
        return cls(response, columns, coefficients, covariance, total)

    def estimate(self, column: int) -> tuple[float, float]:
        """Return a coefficient and its standard error."""
        k = self.columns.index(column)
        return float(self.coefficients[k]), float(np.sqrt(self.covariance[k, k]))

    def amplitude(self, column: int) -> tuple[float, float]:
        """Return the amplitude of a cosine and the sine behind it, and its standard error."""
        k = self.columns.index(column)
        both = self.coefficients[k : k + 2]
        amplitude = float(np.hypot(*both))
        direction = both / max(amplitude, np.finfo(np.float64).tiny)
        return amplitude, float(np.sqrt(direction @ self.covariance[k : k + 2, k : k + 2] @ direction))

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
