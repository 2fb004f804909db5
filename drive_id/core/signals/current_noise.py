"""Variances of the white noise of measured currents and angle, beside what rotor and inverter make them do."""

from __future__ import annotations

import numpy as np

from drive_id.types import FloatArray

_SLOW = 0.03
"""Electrical angle per sample, rad, up to which waves of the rotor position are gone from fourth differences: of order
18, 0.7 % of the amplitude are left."""
_LENGTH, _EVERY = 64, 1024
"""Samples over which waves of the rotor position are fitted, and one such stretch in so many samples: at 29 degrees per
sample and 0.163 % noise, 64 samples leave 0.23 %, 256 leave 0.49 %, and without a fit it is 1.8 %."""
_WAVES = (-18, -12, -6, 6, 12, 18)
"""Electrical orders of the currents in the rotor frame by rotor harmonics and the inverter's drop, which change with
the current."""
_FAULTS = (-2, -1, 0)
"""Orders by unequal gains and offsets of the sensors, and of the reference."""
POWER = 70.0
"""Squared fourth differences of white noise over its variance."""
_ANGLE_ORDER, _ANGLE_POWER = 8, 12870.0
"""Order of the differences of the angle, and their square over the variance of white noise: an error of the resolver of
1 degree in orders 1 and 2 of one pole pair leaves 0.006 degrees at 29 degrees per sample; fourth ones left 0.1."""


def noise_variance(i_dq: FloatArray, angle: FloatArray) -> float:
    """Return the variance of white noise in i_d and in i_q, A^2; 0 for fewer than five samples.

    The noise is what is left of fourth differences. At high speed, they hold ripple of the rotor position, of few
    samples per period. There, its orders are fitted to short stretches, and the median of these counts.

    Parameters
    ----------
    i_dq : (N, 2) float
        Currents in the rotor frame without a gap, A.
    angle : (N,) float
        Electrical angle, rad.
    """
    if len(i_dq) < 5:
        return 0.0
    differences = np.diff(i_dq[:, 0] + 1j * i_dq[:, 1], 4)
    turned = np.unwrap(angle)[2:-2]
    count = len(turned) // _LENGTH
    if not count or np.ptp(turned) < _SLOW * len(turned):
        return float(np.mean(np.abs(differences) ** 2)) / 2 / POWER
    chosen = slice(None, None, _EVERY // _LENGTH)
    left, place = (x[: count * _LENGTH].reshape(count, _LENGTH)[chosen] for x in (differences, turned))
    waves = [np.exp(1j * order * place) for order in (*_WAVES, *_FAULTS)]
    waves += [np.linspace(-1.0, 1.0, _LENGTH) * wave for wave in waves[: len(_WAVES)]]
    basis, _ = np.linalg.qr(np.stack(waves, axis=-1))
    squares = np.sum(np.abs(left) ** 2, axis=1)
    squares -= np.sum(np.abs(left[:, None] @ basis.conj()) ** 2, axis=(1, 2))
    turn = (place[:, -1:] - place[:, :1]) / (_LENGTH - 1)
    orders = np.array([*_WAVES, *_FAULTS, *_WAVES])
    taken = np.sum((2 * np.sin(orders * turn / 2)) ** 8, axis=1)  # by the fit of each, of white noise
    return float(np.median(squares / (POWER * _LENGTH - taken))) / 2


def angle_variance(angle: FloatArray) -> float:
    """Return the variance of white noise in the angle, rad^2; 0 for fewer than nine samples.

    The median over stretches counts: a glitch is no noise.

    Parameters
    ----------
    angle : (N,) float
        Electrical angle without a gap, rad.
    """
    if len(angle) <= _ANGLE_ORDER:
        return 0.0
    squares = np.square(np.diff(np.unwrap(angle), _ANGLE_ORDER)) / _ANGLE_POWER
    count = len(squares) // _LENGTH
    if not count:
        return float(np.mean(squares))
    return float(np.median(squares[: count * _LENGTH].reshape(count, _LENGTH).mean(axis=1)))
