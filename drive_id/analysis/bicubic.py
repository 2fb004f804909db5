"""A function on a grid, bicubic in each cell, whose derivatives at the nodes are given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drive_id.types import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import NdPPoly


@dataclass(frozen=True, eq=False)
class Bicubic:
    """Build it by :meth:`through`."""

    cells: NdPPoly

    @classmethod
    def through(
        cls, x: FloatArray, y: FloatArray, value: FloatArray, by_x: FloatArray, by_y: FloatArray, mixed: FloatArray
    ) -> Bicubic:
        """Take values and derivatives (D, Q) at the nodes; values and slopes are continuous everywhere."""
        from scipy.interpolate import CubicHermiteSpline, NdPPoly  # noqa: PLC0415  # takes a while to load

        # along x, value and slope by y are cubic; their coefficients (4, D - 1, 2, Q) are so along y
        along_x = CubicHermiteSpline(x, np.stack([value, by_y], axis=1), np.stack([by_x, mixed], axis=1)).c
        along_y = CubicHermiteSpline(y, along_x[:, :, 0], along_x[:, :, 1], axis=2).c
        return cls(NdPPoly(along_y.transpose(2, 0, 3, 1), (x, y)))

    def ev(self, x: FloatArray, y: FloatArray, dx: int = 0, dy: int = 0) -> FloatArray:
        """Return the function, or a derivative by x and y, at places (...) within the nodes."""
        return np.asarray(self.cells((x, y), (dx, dy)))
