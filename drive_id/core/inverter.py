"""Shape of the inverter's voltage drop over the phase current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray


@dataclass(frozen=True)
class TanhShape:
    """The paper's one-parameter shape, ``drop = u_e tanh(i / i_s)`` per phase (``eq:voltage_disturbance``).

    The paper prints tanh of amperes, which is a scale of 1 A, and the opposite sign: its disturbance is added to the
    commanded voltage, ours is the drop that the inverter takes away, positive for positive current.

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
