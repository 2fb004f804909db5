"""Sums over samples that take no temporary arrays: visits of a grid, rests near zero current, bends of the current."""

from __future__ import annotations

import math

from drive_id.core import vectorized
from drive_id.core.compiled import compiled, compiled_or
from drive_id.types import BoolArray, FloatArray, IntArray


@compiled_or(vectorized.count_visits)
def count_visits(i_dq: FloatArray, edges_d: FloatArray, edges_q: FloatArray, count: IntArray) -> None:
    """Count samples (N, 2), A, in the cells (D, Q) between equally spaced edges (D + 1,) and (Q + 1,)."""
    per_d = (len(edges_d) - 1) / (edges_d[-1] - edges_d[0])
    per_q = (len(edges_q) - 1) / (edges_q[-1] - edges_q[0])
    for k in range(len(i_dq)):
        d, q = i_dq[k, 0], i_dq[k, 1]
        if edges_d[0] <= d <= edges_d[-1] and edges_q[0] <= q <= edges_q[-1]:
            count[_cell(d, edges_d, per_d), _cell(q, edges_q, per_q)] += 1


@compiled
def _cell(x: float, edges: FloatArray, per_unit: float) -> int:
    """Return the cell that holds ``x``, which lies within the edges: the guess, put right where rounding misled it."""
    cell = min(int((x - edges[0]) * per_unit), len(edges) - 2)
    while x < edges[cell]:
        cell -= 1
    while cell < len(edges) - 2 and x >= edges[cell + 1]:
        cell += 1
    return cell


@compiled_or(vectorized.mark_rests)
def mark_rests(i_dq: FloatArray, least: float, period: float, longest: float, rest: int, idle: BoolArray) -> int:
    """Mark in ``idle`` (N,) the samples that come after a longer rest than allowed.

    Parameters
    ----------
    i_dq : (N, 2) float
        Of one run, A.
    least : float
        Amplitude below which the current rests, A.
    period, longest : float
        Sample period, and how long a rest may last, s.
    rest : int
        Samples of rest before these.
    idle : (N,) bool

    Returns
    -------
    int
        Samples of rest at the end.
    """
    for k in range(len(i_dq)):
        rest = rest + 1 if math.hypot(i_dq[k, 0], i_dq[k, 1]) < least else 0
        idle[k] = rest * period > longest
    return rest


@compiled_or(vectorized.bend_square)
def bend_square(i_dq: FloatArray) -> float:
    """Return the sum of the squared second differences of the currents (N, 2) of one run, A^2."""
    total = 0.0
    for k in range(2, len(i_dq)):
        for axis in range(2):
            bend = i_dq[k, axis] - 2.0 * i_dq[k - 1, axis] + i_dq[k - 2, axis]
            total += bend * bend
    return total
