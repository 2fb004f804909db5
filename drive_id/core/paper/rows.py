"""Rows of the paper's regression for any flux model, the voltage balance per sample, and their cross products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.maps.flux_models import BasisRows, ColumnArray, FluxModel
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, Samples

RESISTANCE, VOLTAGE_ERROR, VOLTAGE, FLUX = 0, 1, 2, 3
"""Columns of Z; those of the flux parameters begin at FLUX."""


@dataclass(frozen=True, eq=False)
class SampleIntegrals:
    """Terms of ``eq:single_row`` for M pairs of consecutive samples."""

    v: FloatArray  # (M, 2), of the commanded voltage, Vs
    q1: FloatArray  # (M, 2), of the current, As
    q4: FloatArray  # (M, 2), of the inverter's shape as a drop (the paper's with opposite sign), s
    half_turn: FloatArray  # (M,), omega T / 2, rad
    rows: BasisRows  # B at the M + 1 samples: Q_2 is half_turn J (B^{k+1} + B^k), Q_3 is B^{k+1} - B^k
    inside: BoolArray  # (M,), both samples lie where the flux model is defined
    valid: BoolArray  # (M,), the same, and neither is left out


def sample_integrals(
    samples: Samples, part: slice, model: FluxModel, shape: TanhShape, left_out: BoolArray | None = None
) -> SampleIntegrals:
    """Integrate all terms over each sample within a run.

    Parameters
    ----------
    part : slice
        M + 1 samples within one run.
    left_out : (N,) bool, optional
        Samples to leave out.

    Returns
    -------
    SampleIntegrals
        ``eq:udq_quadrature``, ``eq:idq_quadrature``, ``eq:B_quadrature`` and ``eq:disturbance_quadrature``.
    """
    period = samples.sample_period
    i_abc, angle = samples.i_abc[part], samples.angle[part]
    start_angle, speed = angle[:-1], samples.speed[part][:-1]
    drop_dq = frames.to_dq(shape(i_abc), angle)
    i_dq = frames.to_dq(i_abc, angle)
    contained = model.contains(i_dq)
    inside = contained[1:] & contained[:-1]
    used = np.ones(len(i_dq), np.bool_) if left_out is None else ~left_out[part]
    return SampleIntegrals(
        v=frames.integrate_held(samples.u_abc[part][:-1], start_angle, speed, period),
        q1=frames.integrate_linear(i_abc, start_angle, speed, period),
        q4=period / 2 * (drop_dq[1:] + drop_dq[:-1]),
        half_turn=speed * (period / 2),
        rows=model.rows(i_dq),
        inside=inside,
        valid=inside & used[1:] & used[:-1],
    )


@compiled("const f8[:, :, ::1], const f8[::1], const b1[::1], const i4[:, :, ::1], const f8[:, :, ::1], f8[:, ::1]")
def add_rows(
    known: FloatArray, half_turn: FloatArray, valid: BoolArray, column: ColumnArray, value: FloatArray, gram: FloatArray
) -> None:
    """Add the cross products of the rows of M pairs of samples to ``gram``.

    Within one cell of the basis consecutive samples share their columns: products are summed in a small dense matrix
    that is scattered when the cell changes. ``known`` is (M, 2, 3): q_1, q_4, v.
    """
    width = column.shape[2]
    narrow, wide = 3 + 2 * width, 3 + 4 * width
    row_d, row_q = np.zeros(wide), np.zeros(wide)
    local = np.zeros((narrow, narrow))
    where = np.zeros(wide, np.int32)
    where[1], where[2] = 1, 2
    pending = -1  # sample whose columns the local matrix has
    for k in range(len(known)):
        if not valid[k]:
            continue
        for j in range(3):
            row_d[j], row_q[j] = known[k, 0, j], known[k, 1, j]
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
                for b in range(a):
                    product = row_d[a] * row_d[b] + row_q[a] * row_q[b]
                    gram[where[a], where[b]] += product
                    gram[where[b], where[a]] += product
                gram[where[a], where[a]] += row_d[a] * row_d[a] + row_q[a] * row_q[a]
    if pending >= 0:
        _scatter(local, column[pending], where, gram)


@compiled("const i4[:, ::1], const i4[:, ::1]")
def _same_columns(first: ColumnArray, second: ColumnArray) -> bool:
    for j in range(first.shape[1]):  # noqa: SIM110  # numba compiles loops, not generators
        if first[0, j] != second[0, j] or first[1, j] != second[1, j]:
            return False
    return True


@compiled("f8[::1], f8[::1], f8[:, ::1]")
def _add_outer(row_d: FloatArray, row_q: FloatArray, local: FloatArray) -> None:
    """Add the outer products of both rows to the lower triangle of ``local``."""
    for a in range(len(local)):
        x, y = row_d[a], row_q[a]
        line = local[a]
        for b in range(a + 1):
            line[b] += x * row_d[b] + y * row_q[b]


@compiled("f8[:, ::1], const i4[:, ::1], i4[::1], f8[:, ::1]")
def _scatter(local: FloatArray, column: ColumnArray, where: ColumnArray, gram: FloatArray) -> None:
    """Add the symmetric matrix, given by its lower triangle, to ``gram`` and clear it."""
    width = column.shape[1]
    for j in range(width):
        where[3 + j], where[3 + width + j] = 3 + column[0, j], 3 + column[1, j]
    for a in range(len(local)):
        for b in range(a):
            gram[where[a], where[b]] += local[a, b]
            gram[where[b], where[a]] += local[a, b]
            local[a, b] = 0.0
        gram[where[a], where[a]] += local[a, a]
        local[a, a] = 0.0
