"""Faults of the sensors, estimated from what they break: a machine's mirror symmetry and its sixfold periodicity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from drive_id.core import frames
from drive_id.core.flux_models import BasisRows
from drive_id.core.frames import ComplexArray
from drive_id.core.full_fit import FullFit
from drive_id.core.full_model import CONSTANT, SENSOR_ORDERS
from drive_id.types import FloatArray, Samples

_SIGNIFICANCE = 3.0
_LARGEST_ANGLE = np.deg2rad(20.0)
_LARGEST_ASYMMETRY = 0.01
"""Of the largest flux, left at the best angle: of a machine that is mirror-symmetric there is no more."""


@dataclass(frozen=True)
class Calibration:
    """One estimated fault.

    Parameters
    ----------
    name : str
    value, sigma : float
        Estimate and its standard deviation.
    unit : str
    applied : bool
        The results are those of signals corrected by it.
    sentence : str
        What it is, and if it was not applied, why.
    """

    name: str
    value: float
    sigma: float
    unit: str
    applied: bool
    sentence: str


def rotated(i_dq: FloatArray, angle: float) -> FloatArray:
    """Turn vectors (..., 2) by an angle, rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(i_dq @ np.array([[cosine, sine], [-sine, cosine]]))


def calibrate_angle(fit: FullFit, i_dq: FloatArray) -> Calibration:
    """Estimate the resolver's offset from psi_d(i_d, -i_q) = psi_d(i_d, i_q), psi_q(i_d, -i_q) = -psi_q(i_d, i_q).

    An offset turns currents and fluxes together, which no voltage shows; a machine whose rotor is not symmetric to its
    d axis has no such symmetry, and then there is nothing to calibrate with.

    Parameters
    ----------
    fit : FullFit
    i_dq : (N, 2) float
        Currents with data, as measured, whose mirror images have data, too, A.

    Returns
    -------
    Calibration
        Measured minus true electrical angle, rad.
    """
    name, unit = "resolver_offset", "rad"
    if len(i_dq) < 16:
        return Calibration(name, 0.0, float("nan"), unit, False, "Too few mirrored currents to find an angle offset.")
    mirror = np.array([1.0, -1.0])

    def difference(angle: float, gamma: FloatArray) -> FloatArray:
        """Return by how much the map, turned back by an angle, breaks the symmetry, (N, 2) or (N, 2, K)."""
        sides = []
        for sign in (np.ones(2), mirror):
            rows = fit.model.flux.rows(rotated(i_dq * sign, -angle))
            sides.append(sign[:, None] * _turn_pairs(rows, gamma, angle))
        return np.asarray(sides[0] - sides[1])

    gamma = fit.solution.residual[fit.model.map][:, None]
    found = minimize_scalar(
        lambda angle: float(np.sum(difference(angle, gamma) ** 2)),
        bounds=(-_LARGEST_ANGLE, _LARGEST_ANGLE),
        method="bounded",
        options={"xatol": 1e-7},
    )
    angle, step = float(found.x), 1e-4
    slope = (difference(angle + step, gamma) - difference(angle - step, gamma)) / (2 * step)
    moves = difference(angle, fit.changes[fit.model.map])
    sigma = float(np.sqrt(np.sum(np.einsum("nak,na->k", moves, slope[..., 0]) ** 2)) / np.sum(slope**2))
    size = float(np.abs(fit.model.flux.rows(i_dq).dot(gamma)).max())
    asymmetry = float(np.sqrt(np.mean(difference(angle, gamma) ** 2))) / size
    degrees = f"{np.rad2deg(angle):+.3f} +- {np.rad2deg(sigma):.3f} degrees"
    if asymmetry > _LARGEST_ASYMMETRY or abs(angle) > 0.98 * _LARGEST_ANGLE:
        reason = (
            f"No angle makes the map mirror-symmetric ({100 * asymmetry:.1f} % are left at {degrees}): the machine is "
            "asymmetric, or the angle is far off, so no offset of the angle was taken out."
        )
        return Calibration(name, angle, sigma, unit, False, reason)
    sentence = f"The measured angle was taken to be {degrees} too large, for which the map is mirror-symmetric."
    return Calibration(name, angle, sigma, unit, True, sentence)


def _turn_pairs(rows: BasisRows, gamma: FloatArray, angle: float) -> FloatArray:
    psi = rows.dot(gamma)  # (N, 2, K)
    return np.asarray(np.moveaxis(rotated(np.moveaxis(psi, 1, -1), angle), -1, 1))


def calibrate_currents(fit: FullFit, i_dq: FloatArray, i_max: float) -> list[Calibration]:
    """Estimate offsets and gain mismatch of the current sensors.

    With measured currents i = i_true + o + G i_true*, o the offset's space vector and G that of the mismatch, the flux
    over the measured current gains ``-f'(i) e^{-2 j theta} G i*``, to first order, a harmonic of order 2. The resistive
    drop of the wrong current adds ``-j R / omega`` times the same vector to it, and that of the offset is a constant
    voltage in the stator frame, ``-(R + r) o`` with the mean slope r of the inverter's curve, if it is symmetrical.

    Parameters
    ----------
    fit : FullFit
    i_dq : (N, 2) float
        Currents with data, A.
    i_max : float
        A.

    Returns
    -------
    list of Calibration
        Of the offset and the mismatch, both real and imaginary part; a zero sequence and a common gain do not show.
    """
    resistance = fit.solution.resistance + fit.drop_slope
    offset = -fit.solution.residual[CONSTANT] / resistance
    sigma = np.sqrt(np.sum(fit.changes[CONSTANT] ** 2, axis=1)) / abs(resistance)
    shown = bool(np.any(np.abs(offset) > _SIGNIFICANCE * sigma))
    out = _entries("current_offset", "A", "offset of the measured currents", (offset, sigma), i_max, applied=shown)
    order = SENSOR_ORDERS[1]
    mismatch = np.zeros(2), np.full(2, np.nan)
    if order in fit.choice.orders:
        mismatch = _mismatch(fit, order, i_dq)
    shown = bool(np.any(np.abs(mismatch[0]) > _SIGNIFICANCE * mismatch[1]))
    return out + _entries("current_gain_mismatch", "1", "mismatch of the current gains", mismatch, 1.0, applied=shown)


def _entries(
    name: str, unit: str, what: str, found: tuple[FloatArray, FloatArray], size: float, *, applied: bool
) -> list[Calibration]:
    entries = []
    for axis, x, dx in zip(("alpha", "beta"), *found, strict=True):
        said = f"The {axis} part of the {what} is {x:.3g} +- {dx:.2g}{' A' if unit == 'A' else ''}"
        sentence = f"{said} ({100 * abs(x) / size:.2f} %)." if applied else f"No {what} stands out from the noise."
        entries.append(Calibration(f"{name}_{axis}", float(x), float(dx), unit, applied, sentence))
    return entries


def _products_with(i_dq: FloatArray) -> FloatArray:
    """Return the matrices (N, 2, 2) of the multiplication of a complex number with the currents."""
    d, q = i_dq.T
    return np.stack([np.stack([d, -q], axis=-1), np.stack([q, d], axis=-1)], axis=1)


def _mismatch(fit: FullFit, order: int, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return real and imaginary part of G and their deviations, by least squares on the harmonic's amplitudes."""
    by_d, by_q = (rows.dot(fit.solution.residual[fit.model.map]) for rows in fit.model.flux.slope_rows(i_dq))
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # j
    fast = np.abs(fit.speeds) > 0.1 * np.abs(fit.speeds).max()
    lag = fit.solution.resistance * float(np.mean(1 / fit.speeds[fast]))
    jacobian = np.stack([by_d, by_q], axis=-1) + lag * quarter  # (N, flux, current)
    conjugate = _products_with(i_dq * np.array([1.0, -1.0]))
    space, columns = fit.model.space(order), fit.model.harmonics[order]
    rows = space.rows(i_dq)
    cosine = np.einsum("nab,nbc->nac", -jacobian, conjugate)
    sine = np.einsum("nab,bc,ncd->nad", jacobian, quarter, conjugate)  # e^{-j h theta} = cos h theta - j sin h theta
    regressors = np.concatenate([cosine.reshape(-1, 2), sine.reshape(-1, 2)])

    def solved(gamma: FloatArray) -> FloatArray:
        halves = np.split(gamma, 2)
        amplitudes = np.concatenate([rows.dot(half).reshape(2 * len(i_dq), -1) for half in halves])
        return np.asarray(np.linalg.lstsq(regressors, amplitudes)[0])

    value = solved(fit.solution.residual[columns][:, None])[:, 0]
    return value, np.sqrt(np.sum(solved(fit.changes[columns]) ** 2, axis=1))


def calibrate_delay(fit: FullFit, wanted: bool) -> Calibration:
    """Report the delay of the voltages that the fit took."""
    name, taken = "voltage_delay", fit.choice.delay
    if not wanted:
        sentence = f"The voltages act {taken:g} samples late, as set."
        return Calibration(name, taken, 0.0, "samples", taken != 0.0, sentence)
    if not fit.choice.reciprocal:
        reason = "The maps are not reciprocal, which leaves a delay of the voltages open: none was taken out."
        return Calibration(name, fit.delay, fit.sigma_delay, "samples", False, reason)
    found = f"{fit.delay:+.3f} +- {fit.sigma_delay:.3f} samples"
    if taken == 0.0:
        reason = f"The voltages act as recorded ({found}, which is not distinct from none)."
        return Calibration(name, fit.delay, fit.sigma_delay, "samples", False, reason)
    sentence = f"The voltages were taken to act {found} later than recorded, for which the maps are reciprocal."
    return Calibration(name, taken, fit.sigma_delay, "samples", True, sentence)


def corrected(samples: Samples, calibrations: Sequence[Calibration]) -> Samples:
    """Return samples without the faults that were found and applied; runs become shorter by no sample."""
    found = {entry.name: entry.value for entry in calibrations if entry.applied}
    i_s, u_s = frames.space_vector(samples.i_abc), frames.space_vector(samples.u_abc)
    i_s = i_s - complex(found.get("current_offset_alpha", 0.0), found.get("current_offset_beta", 0.0))
    mismatch = complex(found.get("current_gain_mismatch_alpha", 0.0), found.get("current_gain_mismatch_beta", 0.0))
    i_s = i_s - mismatch * i_s.conj()
    delay = found.get("voltage_delay", 0.0)
    if delay:
        u_s = np.concatenate([_delayed(u_s[run], delay) for run in samples.runs()])
    return replace(
        samples,
        i_abc=(i_s[:, None] * np.exp(-1j * frames.PHASE_SHIFTS)).real,
        u_abc=(u_s[:, None] * np.exp(-1j * frames.PHASE_SHIFTS)).real,
        angle=samples.angle - found.get("resolver_offset", 0.0),
    )


def _delayed(u_s: ComplexArray, delay: float) -> ComplexArray:
    """Return the mean over each sample of a held voltage that acts later."""
    place = np.arange(len(u_s)) - delay
    first = np.floor(place).astype(np.int64)
    share = place - first
    last = len(u_s) - 1
    return np.asarray((1 - share) * u_s[np.clip(first, 0, last)] + share * u_s[np.clip(first + 1, 0, last)])
