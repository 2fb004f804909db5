"""Shapes of the inverter's voltage drop over the phase current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray


@dataclass(frozen=True)
class TanhShape:
    """The paper's one-parameter shape, ``drop = u_e tanh(i / i_s)`` per phase (``eq:voltage_disturbance``).

    The paper prints tanh of amperes, a scale of 1 A, with the opposite sign: its disturbance is added to the commanded
    voltage; our drop is subtracted from it, positive for positive current.

    Parameters
    ----------
    current_scale : float
        i_s, A.

    Raises
    ------
    ConfigurationError
        When the scale is not positive.
    """

    current_scale: float = 1.0

    def __post_init__(self) -> None:
        if not self.current_scale > 0:
            raise ConfigurationError(f"The inverter's current scale is {self.current_scale} A: it must be positive.")

    def __call__(self, i_abc: FloatArray) -> FloatArray:
        """Return the drop for a voltage error of 1 V at phase currents of any shape, A."""
        return np.asarray(np.tanh(i_abc / self.current_scale))


@dataclass(frozen=True, eq=False)
class CapacitiveShapes:
    """Odd saturating curves whose sums fit the drop of real inverters, method ``full``.

    With x = i / scale each is x/2 for |x| < 1 and sign(x) (1 - 1/(2|x|)) beyond: the law of a dead time during which
    the current charges the capacitances of the legs. All tend to 1; a drop that is linear over the whole range counts
    as resistance.

    Parameters
    ----------
    scales : (S,) float
        A, increasing.
    """

    scales: FloatArray

    @classmethod
    def up_to(cls, i_max: float) -> CapacitiveShapes:
        """Return ten curves with scales from i_max / 800 to about 0.6 i_max, A, each twice the previous.

        The last two bend so far out that R can hardly be separated from them, see :attr:`usual`.
        """
        return cls(i_max / 800 * 2.0 ** np.arange(10, dtype=np.float64))

    @property
    def usual(self) -> int:
        """Number of curves, from the first, that the drop of most inverters needs: up to about i_max / 6."""
        return len(self.scales) - 2

    @property
    def coarse(self) -> CapacitiveShapes:
        """Every second of the usual curves: enough for effects that are small beside the drop."""
        return CapacitiveShapes(self.scales[: self.usual : 2])

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
        step = np.diff(i_abc, axis=0)
        for number, scale in enumerate(self.scales):
            x = np.abs(i_abc) / scale
            beyond = np.maximum(x, 1.0)
            primitive = scale * (np.minimum(x, 1.0) ** 2 / 4 + (beyond - 1) - 0.5 * np.log(beyond))
            flat = np.abs(step) < 1e-5 * scale  # where the difference quotient cancels
            middle = CapacitiveShapes(self.scales[number : number + 1])(i_abc[:-1] + step / 2)[..., 0]
            mean = np.where(flat, middle, np.diff(primitive, axis=0) / np.where(flat, 1.0, step))
            np.cumsum(period * mean, axis=0, out=out[1:, number])
        return out
