"""A function on a grid, bicubic in each cell, whose derivatives at the nodes are given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.types import FloatArray

_POWERS = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], np.float64)
"""From values and slopes at both ends of a cell of length 1 to the coefficients of a cubic polynomial."""


@dataclass(frozen=True, eq=False)
class Bicubic:
    """Build it by :meth:`through`.

    Parameters
    ----------
    x, y : (D,), (Q,) float
        Nodes, strictly increasing.
    coefficients : (D - 1, Q - 1, 4, 4) float
        Of the powers of the relative place in each cell along x and y.
    """

    x: FloatArray
    y: FloatArray
    coefficients: FloatArray

    @classmethod
    def through(
        cls, x: FloatArray, y: FloatArray, value: FloatArray, by_x: FloatArray, by_y: FloatArray, mixed: FloatArray
    ) -> Bicubic:
        """Take values and derivatives (D, Q) at the nodes; values and slopes are continuous everywhere."""
        h, k = np.diff(x)[:, None], np.diff(y)

        def ends(nodes: FloatArray, scale: FloatArray | float) -> FloatArray:
            corners = [[nodes[a : a - 1 or None, b : b - 1 or None] for b in (0, 1)] for a in (0, 1)]
            return np.moveaxis(np.array(corners) * scale, (0, 1), (2, 3))

        known = np.block([[ends(value, 1.0), ends(by_y, k)], [ends(by_x, h), ends(mixed, h * k)]])
        return cls(x, y, np.einsum("ia,dqab,jb->dqij", _POWERS, known, _POWERS))

    def ev(self, x: FloatArray, y: FloatArray, dx: int = 0, dy: int = 0) -> FloatArray:
        """Return the function, or a first derivative by x or y, at places (...) within the nodes."""
        d, u, h = _placed(self.x, x)
        q, v, k = _placed(self.y, y)
        along_x, along_y = _powers(u, dx), _powers(v, dy)
        found = np.einsum("...i,...ij,...j->...", along_x, self.coefficients[d, q], along_y)
        return np.asarray(found / (h**dx * k**dy))


def _placed(nodes: FloatArray, at: FloatArray) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Return cells, relative places in them and their lengths."""
    cell = np.clip(np.searchsorted(nodes, at, side="right") - 1, 0, len(nodes) - 2)
    length = nodes[cell + 1] - nodes[cell]
    return cell, np.asarray((at - nodes[cell]) / length), np.asarray(length)


def _powers(place: FloatArray, order: int) -> FloatArray:
    one, zero = np.ones_like(place), np.zeros_like(place)
    terms = (zero, one, 2 * place, 3 * place**2) if order else (one, place, place**2, place**3)
    return np.stack(terms, axis=-1)
