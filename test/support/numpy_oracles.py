"""Independent versions in numpy of the compiled kernels: oracles, written differently and slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from drive_id.core.numerics import bspline
from drive_id.types import BoolArray, FloatArray, IntArray

_CHUNK = 1024
"""Pairs of samples whose rows are formed at a time: they stay in the cache of the processor."""


def tensor_rows(
    i_dq: FloatArray,
    axes: FloatArray,
    count_d: int,
    count_q: int,
    order_d: int,
    order_q: int,
    column: NDArray[np.int32],
    value: FloatArray,
) -> None:
    """Evaluate the tensor-product splines at all currents, see :mod:`drive_id.core.maps.flux_models`."""
    cells, factors = [], []
    for x, (low, width), count, order in zip(i_dq.T, axes, (count_d, count_q), (order_d, order_q), strict=True):
        position = np.maximum(np.nan_to_num((x - low) / width, posinf=np.inf, neginf=-np.inf), 0.0)
        cell = np.minimum(position, count - 4).astype(np.int64)
        factor = np.empty((4, len(x)))
        if order == 0:
            bspline.weights.function(np.minimum(position - cell, 1.0), factor)
        else:
            bspline.slopes.function(np.minimum(position - cell, 1.0), width, factor)
        cells.append(cell[:, None] + np.arange(4))
        factors.append(factor.T)
    index = (cells[0][:, :, None] * count_q + cells[1][:, None, :]).reshape(-1, 16)
    column[:, 0], column[:, 1] = index, index + count_d * count_q
    value[:] = (factors[0][:, :, None] * factors[1][:, None, :]).reshape(-1, 1, 16)


def add_rows(
    known: FloatArray,
    half_turn: FloatArray,
    valid: BoolArray,
    column: NDArray[np.int32],
    value: FloatArray,
    gram: FloatArray,
) -> None:
    """Add the cross products of the rows of pairs of samples, see :mod:`drive_id.core.paper.rows`."""
    size = len(gram)
    pairs = np.flatnonzero(valid)
    for start in range(0, len(pairs), _CHUNK):
        part = pairs[start : start + _CHUNK]
        turn = half_turn[part, None]
        rows = np.zeros((len(part), 2, size))
        rows[:, :, :3] = known[part]
        for end, sign in ((part, -1.0), (part + 1, 1.0)):
            d, q = value[end, 0], value[end, 1]
            entries = np.stack([np.hstack([sign * d, -turn * q]), np.hstack([turn * d, sign * q])], axis=1)
            columns = 3 + np.hstack([column[end, 0], column[end, 1]])
            place = np.arange(2 * len(part)).reshape(-1, 2, 1) * size + columns[:, None]
            rows += np.bincount(place.ravel(), entries.ravel(), rows.size).reshape(rows.shape)
        flat = rows.reshape(-1, size)
        gram += flat.T @ flat


def mark_rests(i_dq: FloatArray, least: float, period: float, longest: float, rest: int, idle: BoolArray) -> int:
    """Mark samples after a long rest, see :mod:`drive_id.core.numerics.scans`."""
    step = np.arange(1, len(i_dq) + 1)
    quiet = np.hypot(i_dq[:, 0], i_dq[:, 1]) < least
    resting = step - np.maximum.accumulate(np.where(quiet, -rest, step))
    idle[:] = resting * period > longest
    return int(resting[-1]) if len(resting) else rest


def spline_values(x: FloatArray, knots: FloatArray, degree: int, cell: IntArray, w: FloatArray) -> None:
    """Evaluate B-splines by the Cox-de Boor recursion, see :mod:`drive_id.core.numerics.bspline`."""
    edges = knots[degree : len(knots) - degree]
    x = np.clip(x, edges[0], edges[-1])
    cell[:] = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    knot, w[:, 0] = cell + degree, 1.0
    for order in range(1, degree + 1):
        left, right = knots[knot[:, None] + np.arange(1 - order, 1)], knots[knot[:, None] + np.arange(1, order + 1)]
        share = w[:, :order] / (right - left)
        w[:, :order] = (right - x[:, None]) * share
        w[:, order] = 0.0
        w[:, 1 : order + 1] += (x[:, None] - left) * share


def tensor_products(
    cell_d: IntArray,
    w_d: FloatArray,
    cell_q: IntArray,
    w_q: FloatArray,
    count_q: int,
    offset: int,
    column: NDArray[np.int32],
    value: FloatArray,
) -> None:
    """Multiply splines of two axes, see :mod:`drive_id.core.numerics.bspline`."""
    first = (cell_d[:, None] + np.arange(w_d.shape[1])) * count_q + offset
    second = cell_q[:, None] + np.arange(w_q.shape[1])
    column[:] = (first[:, :, None] + second[:, None, :]).reshape(len(column), -1)
    value[:] = (w_d[:, :, None] * w_q[:, None, :]).reshape(len(value), -1)


def add_end(
    column: NDArray[np.int32],
    value: FloatArray,
    turn: FloatArray,
    start: IntArray,
    factor: FloatArray,
    first: IntArray,
    unknown: IntArray,
    share: FloatArray,
    out: FloatArray,
) -> None:
    """Add the flux at one end of windows, times a sparse matrix, see :mod:`drive_id.core.full.model`."""
    size, window = len(first) - 1, np.arange(len(column))[:, None]
    rows = np.zeros((len(column), 2, size))
    d, q = value[:, 0], value[:, 1]
    for begin, part in zip(start, factor, strict=True):
        cosine, sine = (turn * part[:, None]).T[:, :, None]
        for row, component, term in ((0, 0, cosine * d), (0, 1, -sine * q), (1, 0, sine * d), (1, 1, cosine * q)):
            rows[window, row, begin + column[:, component]] += term
    t = sparse.csr_array((share, unknown, first), (size, out.shape[2]))
    out += (rows.reshape(-1, size) @ t).reshape(out.shape)


def dense_rows(integrals, parameters):
    """Return Z of sample integrals of the paper's regression as (M, 2, 3 + parameters)."""
    basis = integrals.rows.dense(parameters)
    total = integrals.half_turn[:, None, None] * (basis[1:] + basis[:-1])
    flux = basis[1:] - basis[:-1] + np.stack([-total[:, 1], total[:, 0]], axis=1)
    return np.concatenate([np.stack([integrals.q1, integrals.q4, integrals.v], axis=-1), flux], axis=-1)
