"""Course of the winding's temperature: the heat that the currents leave in it, less what it gives off.

With the heat ``h = int i^2 dt``, the thermal time constant tau and the growth g of the resistance by the largest rise,
the rise follows ``theta' = (1 + g theta / max theta) h' - theta / tau``: warm copper takes more heat. A winding that
settles sits in a stator that warms more slowly: a second course, with a constant of its own or heat that stays.
The constants are found from the data, as the frequency of a ripple is: those which explain most of what the fit leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.full.model import RESISTANCE, FullModel
from drive_id.core.full.windows import Windows
from drive_id.types import TINY, FloatArray, IntArray

_CONSTANTS = 465.0 * 0.6 ** np.arange(13)
"""Thermal time constants tried, s, from stators to the bare wires of small windings; between them by a parabola."""
_CHANGE = 0.1
"""Change of the inverse of a time constant, in those of the recording, for its derivative: less than data can tell."""
_APART = 2
"""Steps in that list by which the constants of two courses differ at least: 2.8 times."""
_STEPS = 2000
"""Of a course, over a recording: of 10 s, a trajectory's turn takes 20 and more of them."""
_PASSES = 3
"""In which the growth is taken relative to the largest rise with it: of 46 %, 0.3 % of the course are left."""
_NODES = 4000
"""Windows from which the heat over time is known, at most."""
_CLEAR = 16.0
"""Squared residuals, in those of one row, that a time constant must explain beyond heat that stays: four sigma."""


@dataclass(frozen=True, eq=False)
class WindingHeat:
    """Rise of the winding's temperature within each recording, relative to the largest one."""

    # (K,), time, gaps not counted, gaps, s, and heat, A^2 s, the latter since the recording's start, of some windows
    recording: IntArray
    time: FloatArray
    gaps: FloatArray
    heat: FloatArray
    constant: float = np.inf  # thermal time constant, s
    slow: float = np.inf  # the same of what warms beside it, more slowly
    growth: float = 0.0  # of R by all heat at its largest rise, relative

    @classmethod
    def of(cls, windows: Windows) -> WindingHeat:
        """Return the heat over all windows, none of which is given off."""
        some = windows.thinned(_NODES)
        return cls(some.recording, some.time, some.gaps, some.heat)

    def courses(self, windows: Windows) -> list[FloatArray]:
        """Return the rise (N,); where it settles, also its changes by the time constant and by slower heat."""
        rise = self(windows)
        if np.isinf(self.constant):
            return [rise]
        faster = 1 / (1 / self.constant + _CHANGE / float(self.time.max()))
        return [rise, *(replace(self, constant=each)(windows) - rise for each in (faster, self.slow))]

    def __call__(self, windows: Windows) -> FloatArray:
        """Return the relative rise (N,) in the middle of windows."""
        courses, largest = {}, 1e-12
        for number in np.unique(np.concatenate([self.recording, windows.recording])):
            known, own = self.recording == number, windows.recording == number
            time, first = np.unique(np.concatenate([self.time[known], windows.time[own]]), return_index=True)
            gaps = np.concatenate([self.gaps[known], windows.gaps[own]])[first]
            heat = np.concatenate([self.heat[known], windows.heat[own]])[first]
            steps = np.linspace(time[0], time[-1], _STEPS)
            courses[number] = steps + np.interp(steps, time, gaps), np.interp(steps, time, heat)
        clock = self.time + self.gaps
        until = {number: clock[self.recording == number].max(initial=-np.inf) for number in courses}
        for growth in (0.0, *_PASSES * (self.growth,)):
            risen = {number: self._risen(*course, growth / largest) for number, course in courses.items()}
            largest = max(float(rise[courses[k][0] <= until[k]].max(initial=1e-12)) for k, rise in risen.items())
        out = np.zeros(len(windows))
        for number, rise in risen.items():
            own = windows.recording == number
            middle = windows.time + windows.gaps + 0.5 * windows.duration
            out[own] = np.interp(middle[own], courses[number][0], rise)
        return out / largest

    def _risen(self, time: FloatArray, heat: FloatArray, growth: float) -> FloatArray:
        """Return the rise (K,), A^2 s, at times (K,), s, by heat (K,); ``growth`` per A^2 s."""
        rates = np.maximum(np.diff(time), TINY) / self.constant
        stays = np.exp(-rates)
        shares = np.where(rates > 0, -np.expm1(-rates) / np.maximum(rates, TINY), 1.0)
        rise = float(heat[0])
        course = [rise]
        for more, share, left in zip(np.diff(heat).tolist(), shares.tolist(), stays.tolist(), strict=True):
            rise = rise * left + more * share * (1.0 + growth * rise)
            course.append(rise)
        return np.array(course)

    def fitted(self, model: FullModel, estimate: FloatArray, kept: Sequence[Windows], divided: str) -> WindingHeat:
        """Return the heat with the time constants that explain most of the residuals, infinite unless clearly.

        Parameters
        ----------
        estimate : (size,) float
            With heating.
        divided : str
            What tells the parts of the data apart. If R differs between them, it is open in each: what the last time
            constants left to it, others may explain.
        """
        windows, own, estimate = Windows.joined(list(kept)), model.effect("copper_heating"), estimate.copy()
        growth = float(np.clip(estimate[own][0] / estimate[RESISTANCE], 0.0, 1.0))
        estimate[own] = 0.0
        current = np.sqrt(windows.weights) * windows.current
        steady = np.stack([current.real, current.imag], axis=1).ravel()
        part = np.repeat(getattr(windows, divided), 2) if estimate[model.effect("copper_recordings")].any() else None
        parts = [steady] if part is None else [steady * (part == number) for number in np.unique(part)]
        courses = [np.repeat(replace(self, constant=each, growth=growth)(windows), 2) for each in (np.inf, *_CONSTANTS)]
        rows = np.stack([model.residuals(windows, estimate).ravel(), *parts, *(course * steady for course in courses)])
        products, clear = rows @ rows.T, _CLEAR / rows.shape[1]

        def left(*chosen: int) -> float:
            columns = [*range(1, 1 + len(parts)), *(1 + len(parts) + number for number in chosen)]
            moment = products[0, columns]
            return float(products[0, 0] - moment @ np.linalg.lstsq(products[np.ix_(columns, columns)], moment)[0])

        constant, slow = _time_constants(left, clear)
        return replace(self, constant=constant, slow=slow, growth=growth)


def _time_constants(left: Callable[..., float], clear: float) -> tuple[float, float]:
    """Return the time constant of the winding and that of slower heat, s; infinite where the data do not clearly tell.

    Parameters
    ----------
    left : function
        Of the numbers of courses, 0 of heat that stays and then those of ``_CONSTANTS``: squares that they leave.
    clear : float
        Share of the squares that a time constant must explain.
    """
    constants = (np.inf, *_CONSTANTS)
    numbers = range(len(_CONSTANTS))  # without the fastest, which only is a neighbour of the parabola
    least = min(map(left, numbers))
    if left(0) - least <= clear * least:
        return np.inf, np.inf
    pairs = {slow: [left(slow, fast) for fast in numbers[slow + _APART :]] for slow in numbers[: -_APART - 1]}
    likely = min(pairs, key=lambda slow: min(pairs[slow]))
    least = min(pairs[likely])
    slow = likely if min(pairs[0]) - least > clear * least else 0
    fast = slow + _APART + int(np.argmin(pairs[slow]))
    before, at, after = (left(slow, number) for number in (fast - 1, fast, fast + 1))
    bend = before + after - 2 * at
    shift = float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0)) if bend > 0 else 0.0
    return float(constants[fast] * (_CONSTANTS[1] / _CONSTANTS[0]) ** shift), constants[slow]
