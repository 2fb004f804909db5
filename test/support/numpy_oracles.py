"""Independent versions in numpy of the compiled kernels: oracles, written differently and slow."""

from __future__ import annotations

import numpy as np

from drive_id.types import BoolArray, FloatArray


def mark_rests(i_dq: FloatArray, least: float, period: float, longest: float, rest: int, idle: BoolArray) -> int:
    """Mark samples after a long rest, see :mod:`drive_id.core.numerics.scans`."""
    step = np.arange(1, len(i_dq) + 1)
    quiet = np.hypot(i_dq[:, 0], i_dq[:, 1]) < least
    resting = step - np.maximum.accumulate(np.where(quiet, -rest, step))
    idle[:] = resting * period > longest
    return int(resting[-1]) if len(resting) else rest


def dense_rows(integrals, parameters):
    """Return Z of sample integrals of the paper's regression as (M, 2, 3 + parameters)."""
    basis = integrals.rows.dense(parameters)
    total = integrals.half_turn[:, None, None] * (basis[1:] + basis[:-1])
    flux = basis[1:] - basis[:-1] + np.stack([-total[:, 1], total[:, 0]], axis=1)
    return np.concatenate([np.stack([integrals.q1, integrals.q4, integrals.v], axis=-1), flux], axis=-1)
