"""Rows of the paper's regression for any flux model: the voltage balance per sample, ``eq:single_row``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.core import frames
from drive_id.core.maps.flux_models import BasisRows, FluxModel
from drive_id.core.maps.inverter_curve import TanhShape
from drive_id.types import BoolArray, FloatArray, Samples

RESISTANCE, VOLTAGE_ERROR, VOLTAGE, FLUX = 0, 1, 2, 3
"""Columns of Z; those of the flux parameters begin at FLUX."""


@dataclass(frozen=True, eq=False)
class SampleIntegrals:
    """Terms of ``eq:single_row`` for M pairs of consecutive samples.

    Parameters
    ----------
    v : (M, 2) float
        Integral of the commanded voltage, Vs.
    q1 : (M, 2) float
        Integral of the current, As.
    q4 : (M, 2) float
        Integral of the inverter's shape as a drop (the paper's with opposite sign), s.
    half_turn : (M,) float
        omega T / 2, rad.
    rows : BasisRows
        B at the M + 1 samples: Q_2 is ``half_turn J (B^{k+1} + B^k)``, Q_3 is ``B^{k+1} - B^k``.
    inside : (M,) bool
        Both samples lie where the flux model is defined.
    valid : (M,) bool
        The same, and neither is left out.
    """

    v: FloatArray
    q1: FloatArray
    q4: FloatArray
    half_turn: FloatArray
    rows: BasisRows
    inside: BoolArray
    valid: BoolArray

    def dense(self, parameters: int) -> FloatArray:
        """Return Z as (M, 2, 3 + parameters), for a bounded number of samples."""
        basis = self.rows.dense(parameters)
        total = self.half_turn[:, None, None] * (basis[1:] + basis[:-1])
        flux = basis[1:] - basis[:-1] + np.stack([-total[:, 1], total[:, 0]], axis=1)
        return np.concatenate([np.stack([self.q1, self.q4, self.v], axis=-1), flux], axis=-1)


def sample_integrals(
    samples: Samples, part: slice, model: FluxModel, shape: TanhShape, left_out: BoolArray | None = None
) -> SampleIntegrals:
    """Integrate all terms over each sample within a run.

    Parameters
    ----------
    samples : Samples
    part : slice
        M + 1 samples within one run.
    model : FluxModel
    shape : TanhShape
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
