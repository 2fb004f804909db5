"""Shapes of the inverter's voltage drop over the phase current."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drive_id.core.numerics.compiled import compiled
from drive_id.types import FloatArray

_FLAT = 1e-5  # steps of the current, relative to the scale of a curve, over which its mean is that in the middle
_SERIES_BELOW = 0.02  # relative difference, below which the logarithm would cancel
WIDE = 2  # curves that bend so far out that R can hardly be separated from them
_FINEST = 800.0  # largest current over the scale of the steepest curve


@dataclass(frozen=True)
class TanhShape:
    """The paper's one-parameter shape, ``drop = u_e tanh(i / i_s)`` per phase (``eq:voltage_disturbance``).

    The paper prints tanh of amperes, a scale of 1 A, with the opposite sign: its disturbance is added to the commanded
    voltage; our drop is subtracted from it, positive for positive current.
    """

    current_scale: float = 1.0  # i_s, A

    def __call__(self, i_abc: FloatArray) -> FloatArray:
        """Return the drop for a voltage error of 1 V at phase currents of any shape, A."""
        return np.asarray(np.tanh(i_abc / self.current_scale))


@dataclass(frozen=True, eq=False)
class CapacitiveShapes:
    """Odd saturating curves whose sums fit the drop of real inverters, method ``full``.

    With x = i / scale each is x/2 for |x| < 1 and sign(x) (1 - 1/(2|x|)) beyond: the law of a dead time during which
    the current charges the capacitances of the legs. All tend to 1; a drop that is linear over the whole range counts
    as resistance.
    """

    scales: FloatArray  # (S,), A, increasing

    @classmethod
    def up_to(cls, i_max: float) -> CapacitiveShapes:
        """Return ten curves with scales from i_max / 800 to about 0.6 i_max, A, each twice the previous.

        The last two bend so far out that R can hardly be separated from them, see :attr:`usual`.
        """
        return cls(i_max / _FINEST * 2.0 ** np.arange(10, dtype=np.float64))

    @property
    def i_max(self) -> float:
        """Largest current for which they are meant, A."""
        return _FINEST * float(self.scales[0])

    @property
    def usual(self) -> int:
        """Number of curves, from the first, that the drop of most inverters needs: up to about i_max / 6."""
        return len(self.scales) - WIDE

    @cached_property
    def coarse(self) -> CapacitiveShapes:
        """Every second of the usual curves: enough for effects that are small beside the drop."""
        return CapacitiveShapes(self.scales[: self.usual : 2])

    def coarse_of(self, values: FloatArray) -> FloatArray:
        """Return those of the coarse curves (G, L, 3) among values of all (G, S, 3)."""
        return values[:, : self.usual : 2]

    def __call__(self, i: FloatArray) -> FloatArray:
        """Return the curves (..., S) at phase currents (...), A."""
        x = np.asarray(i)[..., None] / self.scales
        return np.where(np.abs(x) < 1, x / 2, np.sign(x) * (1 - 0.5 / np.maximum(np.abs(x), 1)))

    def integrals(self, i_abc: FloatArray, period: float) -> FloatArray:
        """Integrate over time, exactly for currents that are linear between samples.

        Parameters
        ----------
        i_abc : (N, 3) float
            Phase currents, A.
        period : float
            s.

        Returns
        -------
        (N, S, 3) float
            Integrals from the first sample on, s.
        """
        out = np.zeros((len(i_abc), len(self.scales), 3))
        _integrate(np.ascontiguousarray(i_abc), np.ascontiguousarray(self.scales), period, out)
        return out


@compiled("const f8[:, ::1], const f8[::1], f8, f8[:, :, ::1]")
def _integrate(i_abc: FloatArray, scales: FloatArray, period: float, out: FloatArray) -> None:
    """Integrate the curves, see :meth:`CapacitiveShapes.integrals`; the first of ``out`` (N, S, 3) are given."""
    inverse = 1.0 / scales  # divisions are slow
    for k in range(1, len(i_abc)):
        for phase in range(3):
            a, b = i_abc[k - 1, phase], i_abc[k, phase]
            step, start, end = b - a, abs(a), abs(b)
            low, high = min(start, end), max(start, end)
            sign = 0.0 if a * b <= 0.0 else math.copysign(1.0, b)
            falling = _mean_reciprocal(low, high) if sign and high > scales[0] else 0.0
            for number in range(len(scales)):
                scale = scales[number]
                if high <= scale:
                    mean = 0.25 * (a + b) * inverse[number]
                elif sign and low >= scale:
                    mean = sign * (1.0 - 0.5 * scale * falling)
                elif abs(step) < _FLAT * scale:  # where the difference quotient cancels
                    x = 0.5 * (a + b) * inverse[number]
                    mean = drop_shape(x)
                else:
                    mean = scale * (_primitive(end * inverse[number]) - _primitive(start * inverse[number])) / step
                out[k, number, phase] = out[k - 1, number, phase] + period * mean


@compiled("f8")
def drop_shape(x: float) -> float:
    """Return the curve of scale 1 at x."""
    return 0.5 * x if abs(x) < 1.0 else math.copysign(1.0 - 0.5 / abs(x), x)


@compiled("f8")
def _primitive(x: float) -> float:
    """Return the integral of the curve of scale 1 from 0 to x >= 0."""
    return 0.25 * x * x if x < 1.0 else x - 0.75 - 0.5 * math.log(x)


@compiled("f8, f8")
def _mean_reciprocal(low: float, high: float) -> float:
    """Return the mean of 1 / x between two positive numbers."""
    total = low + high
    u = (high - low) / total
    if u > _SERIES_BELOW:
        return math.log(high / low) / (high - low)
    x = u * u
    return 2.0 * (1.0 + x * (1 / 3 + x * (1 / 5 + x * (1 / 7 + x * (1 / 9))))) / total
