"""Judge a map by a recording that it was not fitted to: by the voltage balance over windows, cell by cell.

Over each window of the recording the map predicts the change of the flux in the stator frame (see
:mod:`drive_id.core.full.windows`). What the measured voltages say besides,

    int u_s - R int i_s - int drop_s - [e^{j theta} f(i, theta)] = [e^{j theta} df(i)] + dR int i_s + k int drop_s,

gives df, the map's error, constant in each of some cells of the current plane, together with changes of resistance and
drop, by weighted least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drive_id.analysis.iron_loss import IronLoss
from drive_id.common.settings import Checked, setting
from drive_id.common.temperature import COPPER, REFERENCE_TEMPERATURE
from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.calibration import corrected
from drive_id.core.full.windows import WindowCutter, Windows
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.core.result.identification import TorqueFit
from drive_id.core.result.torque import fit_torque
from drive_id.errors import CoverageError
from drive_id.result.result import Result
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

_ACROSS = 8  # cells across the current disc
_FEWEST = 40  # ends of windows in a cell that counts
_BLOCK = 0.05  # duration of the blocks whose scatter gives the standard errors, s: several windows, which overlap
_MOST_BLOCKS = 400  # of a recording: longer ones get longer blocks
_WARM = 0.05  # standard deviation expected of R, relative, where no temperature is recorded: that of 13 K
_LINK = 0.05  # the same of the drop, which follows the DC link
_NO_MAGNET = 0.02  # flux at zero current by the largest, below which its change is not judged
_RESOLVED = 0.5  # standard error by the limit, above which a figure is not judged
_FLUX = 0.3  # of the map's error, relative to the largest flux: bounds what standstill leaves open


@dataclass(frozen=True)
class VerificationLimits(Checked):
    """What passes; None: not judged."""

    rms_in_sigma: float | None = setting(
        1.5, "largest rms of the differences of the fluxes", unit="standard errors", minimum=0.0
    )
    worst_in_sigma: float | None = setting(
        5.0, "largest difference of a flux in any cell", unit="standard errors", minimum=0.0
    )
    flux: float | None = setting(None, "largest difference of a flux in any cell", unit="% of the largest", minimum=0.0)
    negligible: float = setting(
        0.05,
        "difference of the fluxes that passes in any number of standard errors",
        unit="% of the largest",
        minimum=0.0,
    )
    magnet: float | None = setting(None, "largest difference of the magnet's flux", unit="%", minimum=0.0)
    resistance: float | None = setting(None, "largest difference of the resistance", unit="%", minimum=0.0)
    drop: float | None = setting(None, "largest difference of the inverter's drop", unit="%", minimum=0.0)
    torque: float | None = setting(None, "largest difference of the measured torque", unit="%", minimum=0.0)
    coverage: float = setting(20.0, "least share of the map's disc that is recorded", unit="%", minimum=0.0)


_NO_ZERO = "no current near zero was recorded, or there is no magnet"
GOLDEN = VerificationLimits(rms_in_sigma=None, worst_in_sigma=None, magnet=3.0, resistance=5.0)
"""Limits at the end of a line, where the map is that of a golden sample: a magnet 27 K or copper 13 K warmer."""


@dataclass(frozen=True)
class Judgement:
    """One figure against its limit; ``passed`` is None where there is no limit, or it was not measured."""

    name: str
    value: float
    limit: float | None
    unit: str
    passed: bool | None
    reason: str = ""  # why it is not judged although there is a limit; beyond it, how much it is


@dataclass(frozen=True, eq=False)
class Verification:
    """A map against a recording that it was not fitted to."""

    i_dq: FloatArray  # (K, 2), mean currents in the cells, A
    difference: FloatArray  # (K, 2), recording minus map, psi_d and psi_q, Wb
    sigma: FloatArray  # (K, 2), standard errors of the differences with those of the map, Wb
    windows: IntArray  # (K,), ends of windows in each cell
    largest: float  # largest flux of the map, Wb
    coverage: float  # share of the map's disc that is recorded
    magnet: tuple[float, float]  # change of psi_d at zero current relative to the result, with standard error; or NaN
    resistance: tuple[float, float]  # likewise
    drop: tuple[float, float]  # likewise
    torque: TorqueFit | None  # the measured torque against that of the map; None where it was not recorded

    @property
    def in_sigma(self) -> FloatArray:
        """Differences (K, 2) in standard errors."""
        return self.difference / self.sigma

    def judged(self, limits: VerificationLimits) -> tuple[Judgement, ...]:
        """Compare all figures with limits."""
        sizes, percent = np.abs(self.difference), 100 / self.largest
        rms = float(np.sqrt(np.mean(self.in_sigma**2))), percent * float(np.sqrt(np.mean(sizes**2)))
        beyond = sizes[np.abs(self.in_sigma) > (limits.worst_in_sigma or 0.0)]
        worst = float(np.abs(self.in_sigma).max()), percent * float(beyond.max(initial=0.0))
        in_sigma = (
            _in_sigma("Flux, rms of all cells", *rms, limits.rms_in_sigma, limits.negligible),
            _in_sigma("Flux, worst cell", *worst, limits.worst_in_sigma, limits.negligible),
        )
        flux, covered = percent * float(sizes.max()), 100 * self.coverage
        unmeasured = "no torque was recorded, or the pole pairs are unknown"
        torque = (np.nan, np.nan) if self.torque is None else (self.torque.gain - 1.0, 0.0)
        return (
            *in_sigma,
            _measured("Flux, largest difference", (flux / 100, 0.0), limits.flux, "% of the largest flux"),
            _measured("Magnet flux", self.magnet, limits.magnet, "%", _NO_ZERO),
            _measured("Resistance", self.resistance, limits.resistance, "%"),
            _measured("Inverter drop", self.drop, limits.drop, "%"),
            _measured("Torque", torque, limits.torque, "%", unmeasured),
            Judgement("Disc recorded, at least", covered, limits.coverage, "%", covered >= limits.coverage),
        )


def _in_sigma(name: str, value: float, percent: float, limit: float | None, negligible: float) -> Judgement:
    """Judge a difference of ``percent`` of the largest flux in standard errors."""
    unit = "standard errors"
    if limit is None or value <= limit:
        return Judgement(name, value, limit, unit, None if limit is None else True)
    passed, share = percent <= negligible, f"{percent:.2g} % of the largest flux"
    return Judgement(name, value, limit, unit, passed, f"only {share}" if passed else share)


def _measured(
    name: str, change: tuple[float, float], limit: float | None, unit: str, missing: str = "it was not recorded"
) -> Judgement:
    """Judge a relative change with its standard error: not where that is too large for the limit."""
    value, sigma = 100 * abs(change[0]), 100 * change[1]
    if limit is None:
        return Judgement(name, value, limit, unit, None)
    if not np.isfinite(value):
        return Judgement(name, value, limit, unit, None, missing)
    if sigma > _RESOLVED * limit and value <= limit + sigma / _RESOLVED:
        return Judgement(name, value, limit, unit, None, f"its standard error is {sigma:.2g} %")
    return Judgement(name, value, limit, unit, value <= limit)


def verify(result: Result, samples: Samples) -> Verification:
    """Judge a map by a recording that it was not fitted to.

    Parameters
    ----------
    samples : Samples
        Of the same machine, or of one that should be like it; currents at random points, the rotor turning.

    Raises
    ------
    CoverageError
        When hardly any of the recording lies within the data of the map.
    ConfigurationError
        When the rotor was locked for the result.
    """
    result.check_turning()
    found, shapes = result.drive.flux_map, CapacitiveShapes.up_to(result.i_max)
    cutter, known = WindowCutter(shapes), corrected(samples, result.calibrations)
    windows, psi, column, counts = _cells(result, Windows.joined([*cutter.cut(known), *cutter.finish()]))
    by_drop, factor = _drop(result, shapes, windows), np.ones(len(windows))
    if samples.winding_temperature is not None and result.provenance.temperature is not None:
        factor += COPPER * (windows.heating + REFERENCE_TEMPERATURE - result.provenance.temperature)
    by_resistance = result.resistance * factor * windows.current
    response = windows.voltage - by_resistance - by_drop - np.diff(psi, axis=1)[:, 0]
    columns = np.zeros((len(windows), 2 * len(counts) + 2), np.complex128)
    for end, sign in enumerate((-1.0, 1.0)):
        turned = sign * np.exp(1j * windows.angle[:, end])
        for axis, part in enumerate((turned, 1j * turned)):
            np.add.at(columns, (np.arange(len(windows)), 2 * column[:, end] + axis), part)
    columns[:, -2], columns[:, -1] = by_resistance, by_drop
    largest = found.largest
    spread = 1e-3 if samples.winding_temperature is not None else _WARM
    spread = max(result.sigma_resistance / result.resistance, spread) if result.resistance > 0 else spread
    prior = np.append(np.full(2 * len(counts), _FLUX * largest), [spread, _LINK])
    value, own = _solved(columns, response, windows.time, prior)
    ends, cell = windows.i_dq.reshape(-1, 2), column.ravel()
    i_dq = np.stack([np.bincount(cell, x) for x in ends.T], axis=-1) / np.bincount(cell)[:, None]
    sigmas = np.stack([found.sampled(np.nan_to_num(x), *i_dq.T) for x in (found.sigma_d, found.sigma_q)], axis=-1)
    centre = (np.arange(_ACROSS) + 0.5) * 2 / _ACROSS - 1
    torque = None
    if samples.shaft_torque is not None and result.pole_pairs is not None:
        torque = fit_torque(found, [known], result.pole_pairs)
    difference, sigma = value[:-2].reshape(-1, 2), np.hypot(own[:-2].reshape(-1, 2), sigmas)
    return Verification(
        i_dq=i_dq,
        difference=difference,
        sigma=sigma,
        windows=counts,
        largest=largest,
        coverage=min(1.0, len(counts) / int((np.hypot(centre[:, None], centre) <= 1).sum())),
        magnet=_magnet(result, i_dq, difference[:, 0], sigma[:, 0]),
        resistance=(float(value[-2]), float(own[-2])),
        drop=(float(value[-1]), float(own[-1])),
        torque=torque,
    )


def _magnet(result: Result, i_dq: FloatArray, difference: FloatArray, sigma: FloatArray) -> tuple[float, float]:
    """Return the mean change of psi_d in the cells next to zero current over the magnet's flux, with standard error.

    NaN without such a cell, or where the magnet gives hardly any flux.
    """
    found, near = result.flux_map, np.abs(i_dq).max(axis=1) < 2 * result.i_max / _ACROSS
    magnet = float(found.psi_dq(0.0, 0.0)[0])
    if not near.any() or not abs(magnet) > _NO_MAGNET * found.largest:
        return np.nan, np.nan
    weight = 1 / sigma[near] ** 2
    return float(weight @ difference[near] / weight.sum() / magnet), float(1 / np.sqrt(weight.sum()) / abs(magnet))


def _cells(result: Result, windows: Windows) -> tuple[Windows, ComplexArray, IntArray, IntArray]:
    """Return the windows (N) within the data of the map, the map's flux and the cell at both ends (N, 2), and counts.

    Raises CoverageError when there are hardly any.
    """
    psi, kept = _stator_flux(result, windows)
    place = np.floor((windows.i_dq / result.i_max + 1) * (_ACROSS / 2)).astype(np.int64)
    number = place[..., 0] * _ACROSS + place[..., 1]
    places, counts = np.unique(number[kept], return_counts=True)
    kept &= np.isin(number, places[counts >= _FEWEST]).all(axis=1)
    if not kept.any():
        raise CoverageError(
            "Hardly any of the recording lies within the data of the map: record currents of the same disc, for at "
            "least some seconds while the rotor turns."
        )
    _, column, counts = np.unique(number[kept], return_inverse=True, return_counts=True)
    return windows.part(kept), psi[kept], column.reshape(-1, 2), counts


def _stator_flux(result: Result, windows: Windows) -> tuple[ComplexArray, BoolArray]:
    """Return the flux of the map at both ends of windows (N, 2), Wb, stator frame, and which windows (N,) have it."""
    found, iron, i_dq = result.drive.flux_map, IronLoss.of(result), windows.i_dq
    if iron.known:
        psi_d, psi_q = found.psi_dq(*np.moveaxis(i_dq, -1, 0))
        e_dq = windows.speed[..., None] * np.stack([-psi_q, psi_d], axis=-1)
        i_dq = i_dq - iron.current(e_dq, windows.speed)
    known = np.isfinite(found.psi_dq(*np.moveaxis(i_dq, -1, 0))[0]).all(axis=1)
    psi = found.flux(i_dq, windows.angle) @ np.array([1, 1j])
    return psi * np.exp(1j * windows.angle), np.asarray(known)


def _drop(result: Result, shapes: CapacitiveShapes, windows: Windows) -> ComplexArray:
    """Return the integral of the identified drop over windows (N,), Vs."""
    curve = result.inverter_curve
    if not (result.origin.inverter and np.any(curve.voltage)):
        return np.zeros(len(windows), np.complex128)
    phases = curve.voltage[:, None] if curve.phases is None else curve.phases
    of_phase = np.linalg.lstsq(shapes(curve.current), np.broadcast_to(phases, (len(phases), 3)), rcond=1e-9)[0]
    return frames.space_vector(np.einsum("nsp,sp->np", windows.shape, of_phase)) * windows.drop_scale


def _solved(
    columns: ComplexArray, response: ComplexArray, time: FloatArray, prior: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients (K,) and standard errors, given their standard deviations before the recording.

    Neighbouring windows overlap, so the standard errors come from the scatter of the scores between blocks of time.
    """
    span = float(time[-1] - time[0])
    block = np.minimum(time - time[0], span) // max(_BLOCK, span / _MOST_BLOCKS)
    starts = np.unique(block, return_index=True)[1]
    rows = np.concatenate([columns.real[:, None], columns.imag[:, None]], axis=1)  # (N, 2, K)
    seen = np.stack([response.real, response.imag], axis=1)
    matrix = np.einsum("nrk,nrl->kl", rows, rows, optimize=True) * prior * prior[:, None]
    noise = float(np.mean(seen**2))
    target = np.einsum("nrk,nr->k", rows, seen) * prior
    for _ in range(3):  # the noise is what the solution leaves
        inverse = np.linalg.inv(matrix + noise * np.eye(len(prior)))
        value = inverse @ target
        left = seen - rows @ (value * prior)
        noise = max(float(np.mean(left**2)), 1e-12 * float(np.mean(seen**2)))
    scores = np.add.reduceat(np.einsum("nrk,nr->nk", rows, left), starts, axis=0) * prior
    used = float(np.trace(inverse @ matrix))
    freedom = len(starts) / max(len(starts) - 1.0, 1.0) * (1 + used / max(2.0 * len(response) - used, 1.0))
    covariance = inverse @ (freedom * scores.T @ scores + noise**2 * np.eye(len(prior))) @ inverse
    return value * prior, np.sqrt(np.diag(covariance)) * prior
