"""Cross products of the rows of the paper's regression, from the few entries that are not zero."""

from __future__ import annotations

import numpy as np

from drive_id.core.maps.flux_models import ColumnArray
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray


@compiled
def add_rows(
    known: FloatArray,
    half_turn: FloatArray,
    valid: BoolArray,
    column: ColumnArray,
    value: FloatArray,
    gram: FloatArray,
) -> None:
    """Add the cross products of the rows of M pairs of samples to ``gram``.

    While the trajectory stays in one cell of the basis, neighbours share their columns: the products are summed in a
    small dense matrix and scattered only when the cell changes. ``known`` is (M, 2, 3): q_1, q_4, v.
    """
    width = column.shape[2]
    narrow, wide = 3 + 2 * width, 3 + 4 * width
    row_d, row_q = np.zeros(wide), np.zeros(wide)
    local = np.zeros((narrow, narrow))
    where = np.zeros(wide, np.int32)
    where[:3] = np.arange(3)
    pending = -1  # sample whose columns the local matrix is of
    for k in range(len(known)):
        if not valid[k]:
            continue
        row_d[:3], row_q[:3] = known[k, 0], known[k, 1]
        if pending >= 0 and not _same_columns(column[pending], column[k]):
            _scatter(local, column[pending], where, gram)
            pending = -1
        if _same_columns(column[k], column[k + 1]):
            for j in range(width):
                row_d[3 + j] = value[k + 1, 0, j] - value[k, 0, j]
                row_q[3 + j] = half_turn[k] * (value[k + 1, 0, j] + value[k, 0, j])
                row_d[3 + width + j] = -half_turn[k] * (value[k + 1, 1, j] + value[k, 1, j])
                row_q[3 + width + j] = value[k + 1, 1, j] - value[k, 1, j]
            _add_outer(row_d, row_q, local)
            pending = k
        else:
            for e in range(2):
                sign = 2.0 * e - 1.0
                at = 3 + 2 * width * e
                for j in range(width):
                    where[at + j], where[at + width + j] = 3 + column[k + e, 0, j], 3 + column[k + e, 1, j]
                    row_d[at + j], row_q[at + j] = sign * value[k + e, 0, j], half_turn[k] * value[k + e, 0, j]
                    row_d[at + width + j] = -half_turn[k] * value[k + e, 1, j]
                    row_q[at + width + j] = sign * value[k + e, 1, j]
            for a in range(wide):
                for b in range(wide):
                    gram[where[a], where[b]] += row_d[a] * row_d[b] + row_q[a] * row_q[b]
    if pending >= 0:
        _scatter(local, column[pending], where, gram)


@compiled
def _same_columns(first: ColumnArray, second: ColumnArray) -> bool:
    for j in range(first.shape[1]):  # noqa: SIM110  # numba compiles loops, not generators
        if first[0, j] != second[0, j] or first[1, j] != second[1, j]:
            return False
    return True


@compiled
def _add_outer(row_d: FloatArray, row_q: FloatArray, local: FloatArray) -> None:
    """Add the outer products of both rows to the lower triangle of ``local``."""
    for a in range(len(local)):
        x, y = row_d[a], row_q[a]
        line = local[a]
        for b in range(a + 1):
            line[b] += x * row_d[b] + y * row_q[b]


@compiled
def _scatter(local: FloatArray, column: ColumnArray, where: ColumnArray, gram: FloatArray) -> None:
    """Add the symmetric matrix, given by its lower triangle, to ``gram`` and clear it."""
    width = column.shape[1]
    for j in range(width):
        where[3 + j], where[3 + width + j] = 3 + column[0, j], 3 + column[1, j]
    for a in range(len(local)):
        for b in range(a):
            gram[where[a], where[b]] += local[a, b]
            gram[where[b], where[a]] += local[a, b]
        gram[where[a], where[a]] += local[a, a]
        local[a] = 0.0
