"""Recordings whose truth is known in closed form, made without the simulator.

The current follows a prescribed smooth trajectory exactly; the held voltage of each sample is what the balance in the
stator frame demands, ``T u = psi_s(t+T) - psi_s(t) + int (R i_s + drop_s)``, its integral by Gauss-Legendre quadrature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from drive_id.core import frames
from drive_id.types import BoolArray, FloatArray, Samples

Flux = Callable[[FloatArray], FloatArray]


def saturating_flux(i_dq: FloatArray) -> FloatArray:
    """Return the flux of an interior-magnet machine of 300 A with saturation and cross-saturation, Wb.

    It is no gradient: method ``full`` divides cells and frees its maps before it has a map of it, which takes long.
    """
    i_d, i_q = i_dq[..., 0] / 300, i_dq[..., 1] / 300
    root = np.sqrt(1 + 0.6 * i_d**2 + 2.0 * i_q**2)
    return np.stack([0.08 + 0.06 * i_d / root, 0.13 * i_q / root], axis=-1)


def reciprocal_flux(i_dq: FloatArray) -> FloatArray:
    """Return the gradient of 0.08 i_d + 30 sqrt(1 + 0.6 x^2 + 1.3 y^2), x and y being currents over 300 A, in Wb."""
    x, y = i_dq[..., 0] / 300, i_dq[..., 1] / 300
    root = np.sqrt(1 + 0.6 * x**2 + 1.3 * y**2)
    return np.stack([0.08 + 0.06 * x / root, 0.13 * y / root], axis=-1)


def tanh_drop(i_abc: FloatArray) -> FloatArray:
    """Return the drop of an inverter, V."""
    return 4.0 * np.tanh(i_abc)


def spline_free_current(t: FloatArray, i_max: float) -> FloatArray:
    phase = 2 * np.pi * 1.1 * t
    return i_max * np.stack([np.cos(phase) * np.sin(2 * np.pi * 3.7 * t), np.sin(phase)], axis=-1)


def record(
    flux: Flux = saturating_flux,
    *,
    resistance: float = 0.02,
    drop: Callable[[FloatArray], FloatArray] = np.zeros_like,
    speed: float = 209.0,
    duration: float = 10.0,
    period: float = 1e-4,
    i_max: float = 300.0,
    noise: float = 0.0,
    seed: int = 0,
    current: Callable[[FloatArray, float], FloatArray] = spline_free_current,
) -> Samples:
    count = round(duration / period)
    t = np.arange(count + 1) * period
    nodes, gauss = np.polynomial.legendre.leggauss(5)

    def stator_current(at: FloatArray) -> FloatArray:
        return frames.to_abc(current(at, i_max), speed * at)

    psi_dq = flux(current(t, i_max))
    psi_s = (psi_dq[:, 0] + 1j * psi_dq[:, 1]) * np.exp(1j * speed * t)
    loss = np.zeros(count, np.complex128)
    for node, weight in zip(nodes, gauss, strict=True):
        i_abc = stator_current(t[:-1] + (node + 1) / 2 * period)
        loss += weight / 2 * frames.space_vector(resistance * i_abc + drop(i_abc))
    u_s = np.diff(psi_s) / period + loss
    rng = np.random.default_rng(seed)
    return Samples(
        stamp=np.rint(t[:-1] * 1e9).astype(np.int64) + 1_700_000_000_000_000_000,
        i_abc=stator_current(t[:-1]) + noise * rng.standard_normal((count, 3)),
        u_abc=(u_s[:, None] * np.exp(-1j * frames.PHASE_SHIFTS)).real,
        angle=np.angle(np.exp(1j * speed * t[:-1])),
        speed=np.full(count, speed),
        sample_period=period,
    )


def single_vectors(u_abc: FloatArray) -> FloatArray:
    """Return the vectors of an inverter that keep the integral nearest to that of voltages; its link varies by 1 %."""
    u_s = frames.space_vector(u_abc)
    vectors = 1.3 * np.abs(u_s).max() * np.append(np.exp(1j * np.pi / 3 * np.arange(6)), 0.0)
    chosen, missed = np.zeros_like(u_s), 0j
    for k, wanted in enumerate(u_s):
        missed += wanted
        chosen[k] = vectors[np.abs(missed - vectors).argmin()]
        missed -= chosen[k]
    return frames.phases(chosen * (1 + 0.01 * np.sin(np.arange(len(u_s)) / 300)))


def warmed(samples: Samples, rises: dict[float, float]) -> Samples:
    """Return what the drive logs if R rises, by ohms for each time constant, s, while the currents heat the winding."""
    heat, rise = np.sum(samples.i_abc**2, axis=1), np.zeros(len(samples))
    for constant, most in rises.items():
        course = lfilter([samples.sample_period], [1.0, samples.sample_period / constant - 1.0], heat)
        rise += most * course / course.max()
    current = samples.i_abc + 0.5 * np.diff(samples.i_abc, axis=0, append=samples.i_abc[-1:])  # in the middle of each
    return replace(samples, u_abc=samples.u_abc + rise[:, None] * current)


def cut(samples, start, stop):
    """Return a part as the join hands it on: with the last sample of the part before."""
    goes_on = start > 0 and start not in samples.run_starts
    return samples.part(start - goes_on, stop), goes_on


def only(samples: Samples, kept: BoolArray) -> Samples:
    """Return the samples that a mask (N,) keeps; behind each gap, a run begins."""
    return samples.chosen(kept, np.append(True, ~kept[:-1]))


def every(samples: Samples, n: int) -> Samples:
    """Return what a log of every n-th sample holds."""
    first = np.arange(len(samples)) == 0
    return replace(samples.chosen(np.arange(len(samples)) % n == 0, first), sample_period=n * samples.sample_period)
