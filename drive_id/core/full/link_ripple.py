"""Frequency of a variation of the DC link that was not recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drive_id.core.full.effects.link import ripple_columns
from drive_id.core.full.model import FullModel
from drive_id.core.full.windows import Windows
from drive_id.types import TINY, FloatArray

_BANDS = (
    (0.2, 20.0),
    *((0.995 * nominal, 1.005 * nominal) for nominal in (100.0, 120.0, 300.0, 360.0, 600.0, 720.0)),
)
"""Slow control of the supply, and ripple of rectified mains, whose frequency may be 0.5 % off, Hz."""
_STRETCH = 60.0
"""Of each run, s, over which frequencies are compared: the number of frequencies grows with it."""
_STEPS_PER_TURN = 3.0
"""Frequencies tried for each turn by which the phase would drift over a stretch."""
_FINER = 8
"""Frequencies tried, over the whole runs, between two of the best neighbours."""


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
    step = 1 / (_STEPS_PER_TURN * min(_STRETCH, float(begun.max())))
    if near is None:
        tried = np.concatenate([np.arange(low, high + step, step) for low, high in _BANDS])
        near = float(max(tried, key=_saving(model, estimate, windows.part(begun <= _STRETCH))))
    saved, step = _saving(model, estimate, windows), step / _FINER
    best = max(near + step * np.arange(-_FINER, _FINER + 1), key=saved)
    before, at, after = (saved(best + sign * step) for sign in (-1, 0, 1))
    bend = 2 * at - before - after
    return float(best + (0.5 * step * (after - before) / bend if bend > 0 else 0.0)), at


def _saving(model: FullModel, estimate: FloatArray, windows: Windows) -> Callable[[float], float]:
    """Return the function of a frequency, Hz, that tells which share of the squared residuals it explains."""
    some = windows.scattered()
    left, weights = model.residuals(some, estimate), np.sqrt(some.weights)
    error = left[:, 0] + 1j * left[:, 1]
    total = max(float(np.vdot(error, error).real), TINY)
    runs, unweighted = [np.flatnonzero(some.run == run) for run in np.unique(some.run)], ripple_columns(some)

    def saved(frequency: float) -> float:
        columns, out = weights[:, None] * unweighted(frequency), 0.0
        for run in runs:
            moment = (columns[run].conj().T @ error[run]).real
            out += float(moment @ np.linalg.lstsq((columns[run].conj().T @ columns[run]).real, moment)[0])
        return out / total

    return saved
