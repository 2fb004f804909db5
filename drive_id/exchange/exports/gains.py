"""Gains of the current controllers over the current plane, with the delay of the drive and the phase margin it leaves.

Each controller cancels the pole of its axis, ``kp = a L(i)`` and ``ki = a R``, so that the open loop is
``a e^{-s T_d} / s``: its phase margin is ``pi/2 - a T_d``, whatever the current. The delay T_d is one sample of
computation and half a sample of the modulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import FloatArray, IntArray

_DELAY = 1.5
"""Samples from the measured current to the mean of the voltage that answers it."""
_PLL = 0.2
"""Bandwidth of the observer of the angle relative to that of the current controllers, which it must not follow."""
_Q15 = 2**15 - 1


@dataclass(frozen=True, eq=False)
class ControlGains:
    """Gains of both current controllers.

    Parameters
    ----------
    bandwidth : float
        a, rad/s: as wanted, or what the phase margin allows.
    delay, phase_margin : float
        T_d, s, and the margin that is left, rad; NaN where no sample period is given.
    l_dd, l_qq : (D, Q) float
        Incremental inductances, H, of the nearest monotone map; without data, at least the smallest within i_max.
    resistance : float
        Ohm; NaN when unknown.
    """

    bandwidth: float
    delay: float
    phase_margin: float
    l_dd: FloatArray
    l_qq: FloatArray
    resistance: float

    @classmethod
    def of(cls, table: MapTable, options: ExportOptions) -> ControlGains:
        """Choose the bandwidth, and evaluate the inductances on the axes of a table.

        Raises CoverageError when the map gives no positive inductances.
        """
        machine = table.machine
        found = np.diagonal(machine.control_inductances(*table.grid), axis1=-2, axis2=-1)
        safe = np.where(table.inside[..., None], found, np.maximum(found, machine.least_inductance))
        bandwidth, delay, margin = options.bandwidth, math.nan, math.nan
        if options.sample_period is not None:
            delay = _DELAY * options.sample_period
            bandwidth = min(bandwidth, (math.pi / 2 - math.radians(options.phase_margin)) / delay)
            margin = math.pi / 2 - bandwidth * delay
        return cls(bandwidth, delay, margin, safe[..., 0], safe[..., 1], machine.resistance)

    @property
    def pll(self) -> tuple[float, float]:
        """Gains of a critically damped loop that follows the angle, 1/s and 1/s^2."""
        rate = _PLL * self.bandwidth
        return 2 * rate, rate**2


def q15(values: FloatArray) -> tuple[IntArray, int]:
    """Return values as int16 numbers, and the shift: ``value = number * 2^-shift``, the largest in 15 bits.

    Raises ConfigurationError when all values are zero, or not finite.
    """
    largest = float(np.abs(values).max(initial=0.0))
    if not (largest > 0 and math.isfinite(largest)):
        raise ConfigurationError("The gains are zero or not finite: check resistance and map.")
    shift = math.floor(math.log2(_Q15 / largest))
    return np.rint(values * 2.0**shift).astype(np.int64), shift
