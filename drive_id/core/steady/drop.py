"""The inverter's drop in d and q under sinusoidal currents: the fundamental of its curve, in phase with the current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.types import BoolArray, FloatArray

_ANGLES = 720  # of a turn, for the fundamental
_SHARP = 1e-6  # scale of a curve that jumps at zero current, by i_max


@dataclass(frozen=True, eq=False)
class DropShapes:
    """Odd curves of one phase that saturate at 1, each by one scale, with x = |i| / scale.

    Capacitive: x/2 for x < 1, then 1 - 1/(2x), the law of a dead time during which the current charges the capacitances
    of the legs. Hard: x for x < 1, then 1.
    """

    scales: FloatArray  # (S,), A, positive
    hard: BoolArray  # (S,)
    usual: float  # standard deviation of the amplitude before any data, V

    @classmethod
    def up_to(cls, i_max: float, usual: float) -> DropShapes:
        """Return a jump, five hard curves with scales up to i_max / 6 and five capacitive ones up to i_max / 12.

        Wider ones are hardly told from R.
        """
        scales = i_max / 12 / 2.0 ** np.arange(4, -1, -1)
        hard = np.repeat([True, True, False], [1, len(scales), len(scales)])
        return cls(np.concatenate([[_SHARP * i_max], 2 * scales, scales]), hard, usual)

    def __call__(self, i: FloatArray) -> FloatArray:
        """Return the curves (..., S) at phase currents (...), A."""
        x = np.abs(np.asarray(i)[..., None]) / self.scales
        soft = np.where(x < 1, x / 2, 1 - 0.5 / np.maximum(x, 1))
        return np.sign(np.asarray(i))[..., None] * np.where(self.hard, np.minimum(x, 1), soft)

    def fundamentals(self, amplitude: FloatArray) -> FloatArray:
        """Return the amplitude of the fundamental (N, S) of the drop under sinusoidal currents (N,), A; 4/pi at most.

        The harmonics of the drop average out over a turn, or are zero-sequence.
        """
        angle = (np.arange(_ANGLES) + 0.5) * (2 * np.pi / _ANGLES)
        wave = np.cos(angle)
        return np.asarray(2 * np.mean(self(amplitude[:, None] * wave) * wave[:, None], axis=1))

    def vectors(self, i_dq: FloatArray) -> FloatArray:
        """Return the drop in d and q (N, 2, S) at currents (N, 2), A, for curves of 1 V; zero at zero current."""
        amplitude = np.hypot(*i_dq.T)
        direction = i_dq / np.maximum(amplitude, np.finfo(float).tiny)[:, None]
        return np.asarray(direction[:, :, None] * self.fundamentals(amplitude)[:, None, :])
