"""The iron loss that a fit identified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drive_id.analysis.bands import IRON_LOSS
from drive_id.types import FloatArray

if TYPE_CHECKING:
    from drive_id.result.result import Result


@dataclass(frozen=True)
class IronLoss:
    """The iron-loss current, in phase with the induced voltage e at electrical speed omega.

    ``i_fe = (conductance + hysteresis / abs(omega) + coercivity / abs(e)) e``; the map's current is the stator current
    minus i_fe.
    """

    conductance: float = 0.0  # S
    hysteresis: float = 0.0  # S rad/s
    coercivity: float = 0.0  # A

    @classmethod
    def of(cls, result: Result) -> IronLoss:
        """Return the iron loss that a fit identified, zero if it identified none."""
        found = {entry.name: entry.value for entry in result.calibrations if entry.applied}
        return cls(*(found.get(name, 0.0) for name in IRON_LOSS))

    @property
    def known(self) -> bool:
        """Whether any iron loss was identified."""
        return self != IronLoss()

    def changed(self, by: FloatArray) -> IronLoss:
        """Return this loss with changes (3,) of its parts."""
        return IronLoss(*(float(x) for x in np.array([self.conductance, self.hysteresis, self.coercivity]) + by))

    def current(self, e_dq: FloatArray, speed: FloatArray) -> FloatArray:
        """Return i_fe (..., 2), A, for induced voltages (..., 2), V, at electrical speeds (...), rad/s."""
        size, turning = np.hypot(e_dq[..., 0], e_dq[..., 1]), np.abs(speed)
        share = self.conductance + self.hysteresis / np.where(turning > 0, turning, np.inf)
        share = share + self.coercivity / np.where(size > 0, size, np.inf)
        return np.asarray(share[..., None] * e_dq)
