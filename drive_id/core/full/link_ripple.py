"""Frequency of a variation of the DC link that was not recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drive_id.core.full.effects.link import RippleShape
from drive_id.core.full.model import FullModel
from drive_id.core.full.windows import Windows
from drive_id.types import TINY, FloatArray

_BANDS = (
    (0.2, 20.0),
    *((0.995 * nominal, 1.005 * nominal) for nominal in (100.0, 120.0, 300.0, 360.0, 600.0, 720.0)),
)
"""Slow control of the supply, and ripple of rectified mains, whose frequency may be 0.5 % off, Hz."""
_SLOWEST = 0.5
"""Turns of the slowest variation within the longest run: a drift of 1 % passed for heat, and was 0.2 % of the flux."""
_STRETCH = 60.0
"""Of each run, s, over which frequencies are compared: the number of frequencies grows with it."""
_STEPS_PER_TURN = 3.0
"""Frequencies tried for each turn by which the phase would drift over a stretch."""
_FINER = 8
"""Frequencies tried, over the whole runs, between two of the best neighbours."""
_TURNED = 0.05
"""Angle, rad, by which ripples that share their integrals over a window may differ at its end: 0.05 % of these."""
_SINGULAR = 1e-9
"""Determinant, relative, of sine and cosine in a run that is so short beside a turn that it tells nothing."""


def ripple_frequency(
    model: FullModel, estimate: FloatArray, kept: Sequence[Windows], near: float | None = None
) -> tuple[float, float]:
    """Return the frequency at which a variation explains most of the residuals, Hz, and which share of their square.

    Parameters
    ----------
    estimate : (size,) float
        Without a variation.
    near : float, optional
        Centre of the search, Hz; default: all bands.
    """
    windows = Windows.joined(list(kept))
    _, run = np.unique(windows.run, return_inverse=True)
    first = np.full(run.max() + 1, np.inf)
    np.minimum.at(first, run, windows.time)
    begun = windows.time - first[run]
    (lowest, highest), *mains = _BANDS
    bands = [(min(lowest, _SLOWEST / float(begun.max())), highest), *mains]
    step = 1 / (_STEPS_PER_TURN * min(_STRETCH, float(begun.max())))
    if near is None:
        tried = np.concatenate([np.arange(low, high + step, step) for low, high in bands])
        near = float(tried[np.argmax(_saved(model, estimate, windows.part(begun <= _STRETCH), tried))])
    low, high = min(bands, key=lambda band: max(band[0] - near, near - band[1]))
    finer = step * np.arange(-1 - 1 / _FINER, 1 + 1.5 / _FINER, 1 / _FINER)
    tried = np.clip(near, low + finer[-1], high - finer[-1]) + finer  # beyond a band, a ripple would stand for a gain
    saved = _saved(model, estimate, windows, tried)
    best = 1 + int(np.argmax(saved[1:-1]))
    before, at, after = saved[best - 1 : best + 2]
    bend = 2 * at - before - after
    return float(tried[best] + (0.5 * step / _FINER * (after - before) / bend if bend > 0 else 0.0)), float(at)


def _saved(model: FullModel, estimate: FloatArray, windows: Windows, frequencies: FloatArray) -> FloatArray:
    """Return which share (F,) of the squared residuals ripples of frequencies (F,), Hz, explain.

    In each run, cosine and sine are fitted by least squares. With P and Q for a window's integrals ahead and behind,
    e for its residual and phi for the angle in its middle, they need ``M = sum (conj(P) e + Q conj(e)) e^{-j phi}``,
    ``G = sum P conj(Q) e^{2j phi}`` and ``T = sum |P|^2 + |Q|^2`` only, as a Lomb-Scargle periodogram does.
    """
    some = windows.scattered()
    left, weights, shape = model.residuals(some, estimate), np.sqrt(some.weights), RippleShape.of(some)
    error, runs = left[:, 0] + 1j * left[:, 1], [np.flatnonzero(some.run == run) for run in np.unique(some.run)]
    reach, out = _TURNED / (np.pi * float(shape.duration.max())), np.zeros(len(frequencies))
    for group in np.split(np.arange(len(frequencies)), _beginnings(frequencies, reach)):
        ahead, behind = (weights * side for side in shape.integrals(float(frequencies[group].mean())))
        for run in runs:
            p, q, e = ahead[run], behind[run], error[run]
            turned = np.exp(-2j * np.pi * frequencies[group, None] * shape.middle[run])
            moment, both = turned @ (p.conj() * e + q * e.conj()), (turned * turned).conj() @ (p * q.conj())
            total = float(np.vdot(p, p).real + np.vdot(q, q).real)
            determinant = np.maximum(total**2 - 4 * np.abs(both) ** 2, _SINGULAR * max(total, TINY) ** 2)
            out[group] += (total * np.abs(moment) ** 2 - 2 * (both * moment**2).real) / determinant
    return np.asarray(out / max(float(np.vdot(error, error).real), TINY))


def _beginnings(frequencies: FloatArray, reach: float) -> list[int]:
    """Return where a group of frequencies ends, as the next is beyond a reach, Hz, of its first."""
    out, first = [], 0
    for number, frequency in enumerate(frequencies):
        if abs(frequency - frequencies[first]) > reach:
            out.append(number)
            first = number
    return out
