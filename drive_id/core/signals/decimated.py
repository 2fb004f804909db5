"""Logs that hold every n-th sample of the control: the mean of the voltages between two logged samples."""

from __future__ import annotations

import numpy as np

from drive_id.types import FloatArray, IntArray


def mean_voltages(
    u_dq: FloatArray, angle: FloatArray, speed: FloatArray, period: float, every: int, run_starts: IntArray
) -> FloatArray:
    """Return the mean over each logged period of voltages that were held for an n-th of it: alpha and beta (N, 2), V.

    In the rotor frame the voltages change slowly: those that were not logged are interpolated there linearly, and each
    is held in the stator frame for a period of the control. The last sample of a run has no successor and is held.

    Takes the logged voltages d and q (N, 2), V, at angles (N,), rad, and speeds (N,), rad/s, the period of the log, s,
    the number n of samples of the control per logged one, and the first sample (S,) of each gap-free run.
    """
    u = u_dq[:, 0] + 1j * u_dq[:, 1]
    following = np.append(u[1:], u[-1])
    ends = np.append(run_starts[1:], len(u)) - 1
    following[ends] = u[ends]
    turn = speed * period / every
    mean = np.zeros(len(u), np.complex128)
    for k in range(every):
        mean += (u + (following - u) * (k / every)) * np.exp(1j * (angle + k * turn))
    mean /= every
    return np.stack([mean.real, mean.imag], axis=-1)
