"""Weights on windows near zero crossings of the phase currents, where the drop is not a function of the current.

With a hard dead time, the drop depends on the currents at the switching instants, including their ripple, and a phase
whose current reaches zero within the dead time stays at zero. Away from the crossings the drop is constant for any dead
time. If the residuals of short windows with a crossing clearly exceed those of short windows without one, the fit is
repeated over the short windows. Their weights depend on the clearance from zero and fall with the excess over noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drive_id.core.full.model import FullModel
from drive_id.core.full.solver import LEAST_SAVED, LEAST_TOLD, CurrentNoise, FullSolution, Solver
from drive_id.core.full.window_sums import WindowSums
from drive_id.core.full.windows import SEARCHED, Windows
from drive_id.types import TINY, FloatArray, IntArray

_EDGES = np.array([0.0, 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08])
"""Lower edges of the classes of clearance, relative to i_max."""
_CLEAR = 5
"""First class with full weight in the first fit."""
_FIRST = 1e-3
"""Weight of windows near crossings in the first fit: small, and enough where no others are."""
_POWER = 4.0
"""Exponent of the excess: the misfit at a crossing is the same in each pass and does not average out like noise."""
_ABOVE_CLEAR = 1.15
"""Rms over noise of windows with a crossing, relative to windows clear of crossings, from which on crossings disturb: a
misfit of the map is in both."""
_ROUNDS = 2
"""Of weighting: bounds the time."""
_USUAL = 0.95
"""Share of the windows that is used, those with the smallest squares."""
_FEWEST = 32
"""Fewest windows of a class: their mean square is within a quarter."""


def between_crossings(
    sums: WindowSums, solver: Solver, solution: FullSolution, noise: CurrentNoise
) -> tuple[WindowSums, float] | None:
    """Return weighted sums over short windows if the drop near zero crossings biases the fit, else None.

    With them comes the rms of the residuals of windows with a crossing over that which noise in the currents explains.

    Parameters
    ----------
    solver : Solver
        Of these sums.
    solution : FullSolution
        The fit to them.
    """
    model, short = sums.model, Windows.joined(sums.kept_short())
    clear = _classes(short, model.i_max) >= _CLEAR
    if 2 * clear.sum() < solution.basis.shape[1] or not crossings_exceed(solver, solution, short, noise.at_ends):
        return None
    spec = replace(solution.spec, crossing=False)
    weights = np.where(np.arange(len(_EDGES)) >= _CLEAR, 1.0, _FIRST)

    def weighted(windows: Windows) -> Windows:
        return replace(windows, short=~windows.short, weight=weights[_classes(windows, model.i_max)])

    for _ in range(_ROUNDS):
        found = Solver.over(sums.changed(weighted, short=True)).solve(spec)
        excess = _excess(model, found, short, noise)
        weights = np.maximum(excess / max(1.0, excess[_CLEAR:].min()), 1.0) ** -_POWER
    return sums.changed(weighted, short=True), float(excess[0])


def crossings_exceed(
    solver: Solver,
    solution: FullSolution,
    short: Windows,
    expected_by: Callable[[FullModel, FloatArray, Windows], FloatArray],
) -> bool:
    """Tell whether residuals of short windows with a crossing exceed noise and those of windows clear of crossings.

    Parameters
    ----------
    expected_by : callable
        :meth:`CurrentNoise.at_ends`, or :meth:`CurrentNoise.expected`, which includes noise through the drop.
    """
    some = short.thinned(SEARCHED)
    number = _classes(some, solver.model.i_max)
    squares = np.square(solver.model.residuals(some, solution.estimate)).sum(axis=1)
    expected = expected_by(solver.model, solution.estimate, some)
    crossing, clear = number == 0, number >= _CLEAR
    if min(crossing.sum(), clear.sum()) < _FEWEST:
        return False
    excess, usual = (_ratio(squares[own], expected[own]) for own in (crossing, clear))
    voltage = (excess - 1.0) * expected[crossing].mean()
    least = max(LEAST_TOLD**2, _ABOVE_CLEAR**2 * usual)
    return bool(excess > least and voltage > LEAST_SAVED**2 * solver.total_voltage)


def _excess(model: FullModel, solution: FullSolution, windows: Windows, noise: CurrentNoise) -> FloatArray:
    """Return the ratio of the rms residual to noise in each class, or of the next class if one has no windows."""
    number = _classes(windows, model.i_max)
    squares = np.square(model.residuals(windows, solution.estimate)).sum(axis=1)
    expected = noise.at_ends(model, solution.estimate, windows)
    out = np.ones(len(_EDGES))
    for k in reversed(range(len(_EDGES))):
        own = number == k
        enough = own.sum() >= _FEWEST
        out[k] = np.sqrt(_ratio(squares[own], expected[own])) if enough else out[min(k + 1, len(_EDGES) - 1)]
    return out


def _ratio(squares: FloatArray, expected: FloatArray) -> float:
    """Return the squared residuals relative to noise, without the largest, which a short disturbance may cause."""
    shares = np.sort(squares / np.maximum(expected, TINY))
    mean = (1.0 - (1.0 - _USUAL) * (1.0 - np.log(1.0 - _USUAL))) / _USUAL  # of that share of unit complex noise
    return float(shares[: max(1, int(_USUAL * len(shares)))].mean() / mean)


def _classes(windows: Windows, i_max: float) -> IntArray:
    """Return the class (N,) of clearance of each window."""
    return np.asarray(np.searchsorted(_EDGES * i_max, windows.clearance, side="right") - 1)
