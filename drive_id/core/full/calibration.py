"""Faults of the sensors, estimated from what they break: a machine's mirror symmetry and its sixfold periodicity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.fit import FullFit
from drive_id.core.full.model import CONSTANT, SENSOR_ORDERS
from drive_id.core.full.windows import MOST_DELAY
from drive_id.types import FloatArray, Samples

_SIGNIFICANCE = 3.0
_AGREEMENT, _LEAST_SHOWN, _LEAST_EXPLAINED = 0.5, 5e-4, 0.5
_QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])
"""Multiplication by j."""


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
    doubtful : bool
        Whether the data contradict that it is this fault, or a fault that can be taken out.
    """

    name: str
    value: float
    sigma: float
    unit: str
    applied: bool
    sentence: str
    doubtful: bool = False


def rotated(i_dq: FloatArray, angle: float) -> FloatArray:
    """Turn vectors (..., 2) by an angle, rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(i_dq @ np.array([[cosine, sine], [-sine, cosine]]))


def calibrate_currents(fit: FullFit, i_dq: FloatArray, i_max: float) -> list[Calibration]:
    """Estimate offsets and gain mismatch of the current sensors.

    With measured currents i = i_true + o + G i_true*, o the offset's space vector and G that of the mismatch, the flux
    over the measured current gains ``-f'(i) e^{-j theta} o - f'(i) e^{-2 j theta} G i*``, to first order: harmonics of
    order 1 and 2. The resistive drop of the wrong current adds ``-j R / omega`` times the same vector to the latter,
    and the offset gives a constant voltage in the stator frame, ``-(R + r) o`` with the mean slope r of the inverter's
    curve, if it is symmetrical. A constant voltage without its harmonic is one of the commanded voltages; a second
    harmonic of another shape is no mismatch, and is not taken out of the currents.

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
    out = _offsets(fit, i_dq, i_max)
    traced = _traced(fit, SENSOR_ORDERS[1], i_dq)
    what = "mismatch of the current gains"
    if traced is None:
        return out + _entries("current_gain_mismatch", "1", what, (np.zeros(2), np.full(2, np.nan)), 1.0, applied=False)
    shown = bool(np.any(np.abs(traced.value) > _SIGNIFICANCE * traced.sigma))
    applied = shown and traced.explained > _LEAST_EXPLAINED
    entries = _entries("current_gain_mismatch", "1", what, (traced.value, traced.sigma), 1.0, applied=applied)
    if shown and not applied:
        reason = (
            "The flux has a second harmonic that is no mismatch of the current gains: the voltages' gains differ, the "
            "resolver is eccentric, or the machine is asymmetric. It was fitted, too."
        )
        entries = [replace(entry, sentence=reason, doubtful=True) for entry in entries]
    return out + entries


@dataclass(frozen=True, eq=False)
class _Traced:
    """A harmonic as the effect of one vector: its value and deviation (2,), and the share of the harmonic explained."""

    value: FloatArray
    sigma: FloatArray
    explained: float


def _offsets(fit: FullFit, i_dq: FloatArray, i_max: float) -> list[Calibration]:
    """Take a constant voltage for an offset of the currents, or where the flux contradicts, for one of the voltages."""
    voltage, changes = fit.solution.residual[CONSTANT], fit.changes[CONSTANT]
    sigma = np.sqrt(np.sum(changes**2, axis=1))
    resistance = fit.solution.resistance + fit.drop_slope
    offset, spread = -voltage / resistance, sigma / abs(resistance)
    shown = bool(np.any(np.abs(voltage) > _SIGNIFICANCE * sigma))
    currents = "offset of the measured currents"
    if not shown or _flux_shows(fit, offset, spread, i_dq):
        return _entries("current_offset", "A", currents, (offset, spread), i_max, applied=shown)
    none = _entries("current_offset", "A", currents, (np.zeros(2), np.full(2, np.nan)), i_max, applied=False)
    height = float(np.sqrt(fit.total_voltage)) / fit.duration
    return none + _entries("voltage_offset", "V", "offset of the voltages", (voltage, sigma), height, applied=True)


def _flux_shows(fit: FullFit, offset: FloatArray, sigma: FloatArray, i_dq: FloatArray) -> bool:
    """Tell whether the flux has the first harmonic that an offset of the currents (2,), A, would give it, or may have.

    A part that is constant in the stator frame shows in no voltage and is left open.
    """
    order = SENSOR_ORDERS[0]
    cosine, sine = _effects(fit, order, i_dq)
    expected = np.concatenate([(cosine @ offset).ravel(), (sine @ offset).ravel()])
    constant = _constants(len(i_dq))
    expected = expected - constant @ np.linalg.lstsq(constant, expected)[0]
    largest = float(np.abs(fit.model.flux.rows(i_dq).dot(fit.solution.residual[fit.model.map])).max())
    if np.sqrt(np.mean(expected**2)) < _LEAST_SHOWN * largest:
        return True  # too small to be seen there
    traced = _traced(fit, order, i_dq)
    if traced is None:
        return False
    allowed = _AGREEMENT * np.hypot(*offset) + _SIGNIFICANCE * (np.hypot(*sigma) + np.hypot(*traced.sigma))
    return bool(np.hypot(*(offset - traced.value)) < allowed)


def _entries(
    name: str, unit: str, what: str, found: tuple[FloatArray, FloatArray], size: float, *, applied: bool
) -> list[Calibration]:
    entries = []
    for axis, x, dx in zip(("alpha", "beta"), *found, strict=True):
        said = f"The {axis} part of the {what} is {x:.3g} +- {dx:.2g}{'' if unit == '1' else ' ' + unit}"
        sentence = f"{said} ({100 * abs(x) / size:.2f} %)." if applied else f"No {what} stands out from the noise."
        entries.append(Calibration(f"{name}_{axis}", float(x), float(dx), unit, applied, sentence))
    return entries


def _products_with(i_dq: FloatArray) -> FloatArray:
    """Return the matrices (N, 2, 2) of the multiplication of a complex number with the currents."""
    d, q = i_dq.T
    return np.stack([np.stack([d, -q], axis=-1), np.stack([q, d], axis=-1)], axis=1)


def _effects(fit: FullFit, order: int, i_dq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a sensor's vector does to the amplitudes of cosine and sine of its harmonic, (N, 2, 2) each."""
    by_d, by_q = (rows.dot(fit.solution.residual[fit.model.map]) for rows in fit.model.flux.slope_rows(i_dq))
    jacobian = np.stack([by_d, by_q], axis=-1)  # (N, flux, current)
    if order == SENSOR_ORDERS[0]:
        vector = np.broadcast_to(np.eye(2), (len(i_dq), 2, 2))
    else:
        fast = np.abs(fit.speeds) > 0.1 * np.abs(fit.speeds).max()
        jacobian = jacobian + fit.solution.resistance * float(np.mean(1 / fit.speeds[fast])) * _QUARTER
        vector = _products_with(i_dq * np.array([1.0, -1.0]))
    cosine = np.einsum("nab,nbc->nac", -jacobian, vector)
    sine = np.einsum("nab,bc,ncd->nad", jacobian, _QUARTER, vector)  # e^{-j h theta} = cos h theta - j sin h theta
    return cosine, sine


def _constants(count: int) -> FloatArray:
    """Return the amplitudes (4 N, 2) of the first harmonic that a constant flux in the stator frame has."""
    return np.concatenate([np.tile(np.eye(2), (count, 1)), np.tile(-_QUARTER, (count, 1))])


def _traced(fit: FullFit, order: int, i_dq: FloatArray) -> _Traced | None:
    """Trace a sensor's harmonic back to its vector, by least squares on the amplitudes; None where there is none."""
    if order not in fit.choice.orders:
        return None
    space, columns = fit.model.space(order), fit.model.harmonics[order]
    rows = space.rows(i_dq)
    regressors = np.concatenate([part.reshape(-1, 2) for part in _effects(fit, order, i_dq)])
    if order == SENSOR_ORDERS[0]:
        regressors = np.hstack([regressors, _constants(len(i_dq))])

    def amplitudes(gamma: FloatArray) -> FloatArray:
        halves = np.split(gamma, 2)
        return np.concatenate([rows.dot(half).reshape(2 * len(i_dq), -1) for half in halves])

    found = amplitudes(fit.solution.residual[columns][:, None])
    value = np.linalg.lstsq(regressors, found)[0]
    left = float(np.sum((found - regressors @ value) ** 2) / np.sum(found**2))
    moves = np.linalg.lstsq(regressors, amplitudes(fit.changes[columns]))[0][:2]
    return _Traced(value[:2, 0], np.sqrt(np.sum(moves**2, axis=1)), 1.0 - left)


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
        reason = f"The voltages act as recorded ({found}, which is not distinct from none, or too small to matter)."
        return Calibration(name, fit.delay, fit.sigma_delay, "samples", False, reason)
    if abs(taken) >= MOST_DELAY:
        sentence = (
            f"The voltages seem to act {found} later than recorded, at the end of what can be taken out: align the "
            "recorded voltages with the currents."
        )
        return Calibration(name, taken, fit.sigma_delay, "samples", True, sentence, doubtful=True)
    sentence = f"The voltages were taken to act {found} later than recorded, for which the maps are reciprocal."
    return Calibration(name, taken, fit.sigma_delay, "samples", True, sentence)


def corrected(samples: Samples, calibrations: Sequence[Calibration]) -> Samples:
    """Return samples without the faults that were found and applied; runs become shorter by no sample."""
    found = {entry.name: entry.value for entry in calibrations if entry.applied}
    i_s, u_s = frames.space_vector(samples.i_abc), frames.space_vector(samples.u_abc)
    u_s = u_s - complex(found.get("voltage_offset_alpha", 0.0), found.get("voltage_offset_beta", 0.0))
    i_s = i_s - complex(found.get("current_offset_alpha", 0.0), found.get("current_offset_beta", 0.0))
    mismatch = complex(found.get("current_gain_mismatch_alpha", 0.0), found.get("current_gain_mismatch_beta", 0.0))
    i_s = i_s - mismatch * i_s.conj()
    delay = found.get("voltage_delay", 0.0)
    if delay:
        u_s = np.concatenate([_delayed(u_s[run], delay) for run in samples.runs()])
    return replace(
        samples,
        i_abc=frames.phases(i_s),
        u_abc=frames.phases(u_s),
        angle=samples.angle - found.get("resolver_offset", 0.0),
    )


def _delayed(u_s: ComplexArray, delay: float) -> ComplexArray:
    """Return the mean over each sample of a held voltage that acts later."""
    place = np.arange(len(u_s)) - delay
    first = np.floor(place).astype(np.int64)
    share = place - first
    last = len(u_s) - 1
    return np.asarray((1 - share) * u_s[np.clip(first, 0, last)] + share * u_s[np.clip(first + 1, 0, last)])
