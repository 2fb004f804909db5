"""Residual of the voltage balance over the rotor position: what a model leaves unexplained, and at which angle.

The balance in the stator frame over a short window,

    int u_s = psi_s(t_1) - psi_s(t_0) + R int i_s + int drop_s,        psi_s = e^{j theta} f(i, theta),

is evaluated with quadrature rules of its own and shares no code with the regressions, so that their mistakes show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.types import FloatArray, IntArray, Samples

Flux = Callable[[FloatArray, FloatArray], FloatArray]
"""Returns psi_dq (W, 2), Wb, at currents i_dq (W, 2), A, and electrical angles (W,), rad."""

_SPAN = np.deg2rad(5.0)
"""Electrical angle of a window, rad: averaging attenuates an order h to ``sinc(h span / 2 pi)``, 0.99 at the 6th and
0.90 at the 18th."""
_LONGEST = 0.01  # s; of a window, where the rotor hardly turns


class Residual(NamedTuple):
    """Mean residual voltage of W windows."""

    angle: FloatArray
    """(W,) electrical angle at the middle of each window, rad, not wrapped."""
    voltage: FloatArray
    """(W, 2) commanded minus explained voltage, d and q at that angle, V."""
    time: FloatArray
    """(W,) time of data at the middle of each window, s: gaps are left out."""
    i_dq: FloatArray
    """(W, 2) measured current at the middle of each window, A."""
    commanded: FloatArray
    """(W,) amplitude of the mean voltage that was commanded, V."""

    @classmethod
    def none(cls) -> Residual:
        """Return the residual of no windows."""
        return cls(np.zeros(0), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), np.zeros(0))

    @classmethod
    def joined(cls, parts: Sequence[Residual]) -> Residual:
        """Put the windows of several parts one after the other."""
        return cls(*(np.concatenate(arrays) for arrays in zip(cls.none(), *parts, strict=True)))


class TimeBins(NamedTuple):
    """Statistics over T equal bins of the time of data; NaN in empty bins."""

    time: FloatArray
    """(T,) centres, s."""
    mean: FloatArray
    """(T, 2), V."""
    rms: FloatArray
    """(T, 2), V; of everything in the bin, its mean included."""


class AngleBins(NamedTuple):
    """Statistics over B equal bins of one electrical turn; NaN in empty bins."""

    angle: FloatArray
    """(B,) means of the angles in each bin, rad, from 0 to 2 pi; centres of empty bins."""
    mean: FloatArray
    """(B, 2), V."""
    rms: FloatArray
    """(B, 2), V; of everything in the bin, its mean included."""


class PlaneBins(NamedTuple):
    """Statistics over square cells of the current plane; NaN in empty cells."""

    i_d: FloatArray
    """(D,) centres, A, equally spaced."""
    i_q: FloatArray
    """(Q,) centres, A, likewise."""
    mean: FloatArray
    """(D, Q, 2), V."""
    rms: FloatArray
    """(D, Q, 2), V; of everything in the cell, its mean included."""
    commanded: float
    """Voltage that was commanded, rms over all windows, d and q alike, V: what the residual is a share of."""


def residual_voltage(samples: Samples, flux: Flux, resistance: float, drop: tuple[FloatArray, FloatArray]) -> Residual:
    """Evaluate the voltage balance over adjacent windows of a few degrees.

    The commanded voltage is held over each sample; phase currents are linear between samples; the drop is integrated
    by Simpson's rule. A window has at least one sample and lasts 10 ms at most.

    Parameters
    ----------
    samples : Samples
        Corrected for the sensor faults that the model was corrected for.
    flux : callable
        Flux linkages over current and angle.
    resistance : float
        Ohm.
    drop : (C,) float, (C,) or (C, 3) float
        Phase currents, A, increasing, and the inverter's drop there, V, of all phases or of each.

    Returns
    -------
    Residual
        Empty where no run has two samples.
    """
    period = samples.sample_period
    i_s, u_s = frames.space_vector(samples.i_abc), frames.space_vector(samples.u_abc)
    curves = np.broadcast_to(drop[1].reshape(len(drop[0]), -1), (len(drop[0]), 3))

    def drop_s(i_abc: FloatArray) -> frames.ComplexArray:
        of_phases = [np.interp(i, drop[0], curve) for i, curve in zip(i_abc.T, curves.T, strict=True)]
        return frames.space_vector(np.stack(of_phases, axis=1))

    at_samples, between = drop_s(samples.i_abc), drop_s((samples.i_abc[1:] + samples.i_abc[:-1]) / 2)
    loss = resistance * (i_s[1:] + i_s[:-1]) / 2 + (at_samples[1:] + at_samples[:-1] + 4 * between) / 6
    balance = np.append(0j, np.cumsum(period * (u_s[:-1] - loss)))
    commanded = np.append(0j, np.cumsum(period * u_s[:-1]))
    parts = []
    for run in samples.runs():
        turn = float(np.abs(samples.speed[run]).mean()) * period
        length = max(1, int(min(_SPAN / turn if turn else np.inf, _LONGEST / period)))
        ends = np.arange(run.start, run.stop, length)
        angle = samples.angle[ends]
        i_dq = frames.as_pairs(i_s[ends] * np.exp(-1j * angle))
        psi = flux(i_dq, angle)
        psi_s = (psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * angle)
        middle = angle[:-1] + np.angle(np.exp(1j * np.diff(angle))) / 2
        residual = np.diff(balance[ends] - psi_s) / (length * period)
        parts.append(
            Residual(
                middle,
                frames.as_pairs(residual * np.exp(-1j * middle)),
                period * (ends[:-1] + ends[1:]) / 2,
                (i_dq[:-1] + i_dq[1:]) / 2,
                np.abs(np.diff(commanded[ends])) / (length * period),
            )
        )
    return Residual.joined(parts)


def over_angle(residual: Residual, bins: int = 72) -> AngleBins:
    """Average a residual in equal bins of the electrical angle.

    Parameters
    ----------
    bins : int
        Of one electrical turn.
    """
    angle = residual.angle % (2 * np.pi)
    place = np.minimum((angle / (2 * np.pi) * bins).astype(np.int64), bins - 1)
    count, mean, rms = _binned(place, residual.voltage, bins)
    centre, found = (np.arange(bins) + 0.5) * 2 * np.pi / bins, np.bincount(place, angle, bins) / count
    return AngleBins(np.where(np.isnan(count), centre, found), mean, rms)


def over_time(residual: Residual, bins: int = 400) -> TimeBins:
    """Average a residual in equal bins of the time of data.

    Parameters
    ----------
    bins : int
        Fewer when there are not at least eight windows for each.
    """
    windows = len(residual.time)
    bins = max(1, min(bins, windows // 8))
    end = float(residual.time.max(initial=0.0)) or 1.0
    place = np.minimum((residual.time / end * bins).astype(np.int64), bins - 1)
    _, mean, rms = _binned(place, residual.voltage, bins)
    return TimeBins((np.arange(bins) + 0.5) * end / bins, mean, rms)


def over_plane(residual: Residual, i_max: float, bins: int = 24) -> PlaneBins:
    """Average a residual in square cells of the current plane.

    Parameters
    ----------
    i_max : float
        Radius of the disc that the cells cover, A; currents beyond it count in the outermost.
    bins : int
        Cells from -i_max to i_max; fewer when a disc of them would hold less than eight windows each.
    """
    windows = len(residual.time)
    bins = max(2, min(bins, int(math.sqrt(windows / 8))))
    column, row = np.clip(((residual.i_dq / i_max + 1) * bins / 2).astype(np.int64), 0, bins - 1).T
    _, mean, rms = _binned(column * bins + row, residual.voltage, bins**2)
    axis = i_max * ((np.arange(bins) + 0.5) * 2 / bins - 1)
    commanded = float(np.sqrt(np.mean(residual.commanded**2) / 2)) if windows else math.nan
    return PlaneBins(axis, axis, mean.reshape(bins, bins, 2), rms.reshape(bins, bins, 2), commanded)


def _binned(place: IntArray, voltage: FloatArray, bins: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return count (B,), mean (B, 2) and rms (B, 2) of voltages (W, 2) in the bins they fall into; NaN where empty."""
    count = np.bincount(place, minlength=bins).astype(np.float64)
    count[count == 0] = np.nan
    mean = np.stack([np.bincount(place, values, bins) / count for values in voltage.T], axis=1)
    rms = np.sqrt(np.stack([np.bincount(place, values**2, bins) / count for values in voltage.T], axis=1))
    return count, mean, rms
