"""Sensor faults: offset and gain mismatch of the currents, offset of the resolver, delay of the voltages."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import lsqr

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.delay import Delay
from drive_id.core.full.effects.effect import VOLTAGE_MISMATCH, Calibration
from drive_id.core.full.fit import FullFit
from drive_id.core.full.model import CONSTANT, RESISTANCE
from drive_id.core.full.standard_errors import sigma as fitted_sigma
from drive_id.core.full.windows import MOST_DELAY, SEARCHED
from drive_id.core.maps.flux_models import BasisRows, jacobian
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.types import TINY, BoolArray, FloatArray, Samples

_SIGNIFICANCE = 3.0
"""Standard errors from which on a deviation of a sensor is told."""
_LARGEST_ANGLE = np.deg2rad(20.0)
"""Offset of the angle beyond which the map has left the disc of the currents too far to be mirrored."""
_TRIED = 5
"""Angles tried on each side before the refinement: every 4 degrees."""
_STEPS, _SETTLED = 30, 1e-9
"""Most steps of the refinement, and the step at which it has converged, rad."""
_LARGEST_ASYMMETRY = 0.01
"""Largest asymmetry of a mirror-symmetric machine at the best angle, relative to the largest flux."""
_LEAST_MIRRORED = 0.3
"""Least range of i_q with mirror images, relative to i_max."""
_LEAST_LOST = 1e-3
"""Share of the voltages that a filter takes from which on it is warned of: what moves the flux by 0.1 %."""
_OF_VOLTAGES = ("lost", "level")
"""What entries tell of a gain common to all voltages that is not known, as a share."""
_AT_A_TIME = 32
"""Changes of the map whose asymmetry is formed at a time."""
_MIRROR = np.array([1.0, -1.0])
"""Signs of d and q in the mirror image."""
CURRENT_ROTATION, RESOLVER_OFFSET = "current_rotation", "resolver_offset"


def rotated(i_dq: FloatArray, angle: float) -> FloatArray:
    """Turn vectors (..., 2) by an angle, rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(i_dq @ np.array([[cosine, sine], [-sine, cosine]]))


def calibrate_currents(fit: FullFit, i_max: float) -> list[Calibration]:
    """Report the offsets of currents and voltages, and unequal gains of the current sensors, that no effect reports.

    Without an offset of the currents in the fit, a constant voltage in the stator frame is ``-(R + r) o`` by an offset
    o too small to be seen in the flux, r being the mean slope of a symmetric inverter curve. If the flux contradicts o,
    or if the fit has an offset of the currents, it is an offset of the commanded voltages.

    Parameters
    ----------
    i_max : float
        A.

    Returns
    -------
    list of Calibration
        Real and imaginary part of offset and mismatch; zero sequence and common gain cannot be observed.
    """
    out, none = [], (np.zeros(2), np.full(2, np.nan))
    if "current_gains" not in fit.spec.effects:
        out += _entries("current_gain_mismatch", "1", none, 1.0, applied=False)
    voltage, sigma = fit.solution.estimate[CONSTANT], np.sqrt(np.sum(fit.assessment.changes[CONSTANT] ** 2, axis=1))
    of_voltage = bool(np.any(np.abs(voltage) > _SIGNIFICANCE * sigma))
    if "current_offset" not in fit.spec.effects:
        resistance = fit.solution.resistance + fit.assessment.drop_slope
        found = -voltage / resistance, sigma / abs(resistance)
        if not of_voltage or _flux_allows(fit, *found):
            return out + _entries("current_offset", "A", found, i_max, applied=of_voltage)
        out += _entries("current_offset", "A", none, i_max, applied=False)
    height = float(np.sqrt(fit.total_voltage)) / fit.assessment.duration
    return out + (_entries("voltage_offset", "V", (voltage, sigma), height, applied=True) if of_voltage else [])


def _flux_allows(fit: FullFit, offset: FloatArray, sigma: FloatArray) -> bool:
    """Tell whether an offset of the currents (2,), A, agrees with the one that the flux shows, within their errors."""
    solver = fit.selection.solver
    share, shown = solver.saving(fit.solution, fit.model.effect("current_offset"))
    of_flux = np.hypot(*shown) / np.sqrt(max(share * fit.solution.rows, TINY))
    return bool(np.hypot(*(offset - shown)) < _SIGNIFICANCE * np.hypot(of_flux, np.hypot(*sigma)))


def _entries(
    name: str, unit: str, found: tuple[FloatArray, FloatArray], size: float, *, applied: bool
) -> list[Calibration]:
    entries = []
    for axis, x, dx in zip(("alpha", "beta"), *found, strict=True):
        values = {"value": x, "sigma": dx, "share": abs(x) / size}
        said = Message(f"{name}.fit", axis=axis, **values) if applied else Message(f"{name}.none")
        entries.append(Calibration(f"{name}_{axis}", float(x), float(dx), unit, applied, said))
    return entries


def calibrate_delay(fit: FullFit, wanted: bool, turn: float) -> Calibration:
    """Report the delay of the voltages used by the fit.

    Voltages that are early by no multiple of half a sample were filtered before they were recorded, as measured ones
    are. A low-pass filter that delays by t takes ``(omega t)^2 / 2`` of them, too, which the data do not show. A
    multiple of half a sample is more likely the timing of a log, but the errors include the filter.

    Parameters
    ----------
    turn : float
        Electrical angle per sample, rms, rad.
    """
    found = fit.selection.search.found
    name, used, delay, sigma = "voltage_delay", fit.spec.delay, found.delay.value, found.delay.sigma
    if not wanted:
        return Calibration(name, used, 0.0, "samples", used != 0.0, Message("voltage_delay.set", value=used))

    def entry(value: float, wording: str, *, doubtful: bool = False, **more: float) -> Calibration:
        said = Message(wording, value=delay, sigma=sigma, **more)
        return Calibration(name, value, sigma, "samples", fit.spec.reciprocal and used != 0.0, said, doubtful)

    if used == 0.0 or not fit.spec.reciprocal:
        return entry(delay, "voltage_delay.none" if fit.spec.reciprocal else "voltage_delay.not_reciprocal")
    if abs(used) >= MOST_DELAY:
        return entry(used, "voltage_delay.limit", doubtful=True)
    estimated = Delay(used, sigma)
    if every := estimated.decimation:
        return entry(used, "voltage_delay.decimated", doubtful=True, early=-delay, every=max(2, every))
    lost = 0.5 * (turn * used) ** 2
    if used > 0 or lost < _LEAST_LOST:
        return entry(used, "voltage_delay")
    filtered = abs(used - estimated.nearest) > estimated.tolerance
    wording = "voltage_delay.filtered" if filtered else "voltage_delay.early"
    return entry(used, wording, doubtful=filtered, early=-delay, lost=lost)


def mirrored_points(i_d: FloatArray, i_q: FloatArray, inside: BoolArray, i_max: float) -> FloatArray:
    """Return currents (N, 2), A, of a grid that have data and whose mirror images in the d axis have data, too.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Equally spaced axes, A.
    inside : (D, Q) bool
        Nodes with data.
    i_max : float
        Radius of the current disc, A; none are returned if those with mirror images span too little of i_q.
    """
    step = i_q[1] - i_q[0]
    image = np.rint((-i_q - i_q[0]) / step).astype(np.int64)
    on_grid = (image >= 0) & (image < len(i_q))
    both = inside & on_grid & inside[:, np.where(on_grid, image, 0)]
    points = np.asarray(np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1)[both], np.float64)
    if np.abs(points[:, 1]).max(initial=0.0) < _LEAST_MIRRORED * i_max:
        return points[:0]
    return points[:: max(1, len(points) // SEARCHED)]


@dataclass(frozen=True, eq=False)
class _Symmetry:
    """A fitted map and its mirror image in the d axis, at currents (N, 2), A, rotated back by an angle."""

    fit: FullFit
    i_dq: FloatArray

    def _rows(self, angle: float) -> list[BasisRows]:
        return [self.fit.model.flux.rows(rotated(self.i_dq * sign, -angle)) for sign in (np.ones(2), _MIRROR)]

    def difference(self, angle: float) -> FloatArray:
        """Return the asymmetry (N, 2), Wb."""
        gamma = self.fit.solution.estimate[self.fit.model.map]
        return self._between(angle, *(rows.dot(gamma) for rows in self._rows(angle)))

    def along(self, angle: float, slope: FloatArray) -> FloatArray:
        """Return the product (B,) of a slope (N, 2) with the asymmetry of each change of the map."""
        changes = self.fit.assessment.changes[self.fit.model.map]
        weights = (rotated(slope * sign, -angle).ravel() for sign in (np.ones(2), -_MIRROR))
        rows = (each.sparse(len(changes)).T for each in self._rows(angle))
        return np.asarray(sum(map(operator.matmul, rows, weights)) @ changes)

    def shows(self, angle: float, left: float) -> bool:
        """Tell whether an asymmetry, Wb rms, is more than that of the changes by which the map is uncertain."""
        changes, rows, square = self.fit.assessment.changes[self.fit.model.map], self._rows(angle), 0.0
        for start in range(0, changes.shape[1], _AT_A_TIME):
            some = (each.dot(changes[:, start : start + _AT_A_TIME]) for each in rows)
            square += np.sum(self._between(angle, *(np.moveaxis(flux, -1, 0) for flux in some)) ** 2)
            if not left > _SIGNIFICANCE * np.sqrt(square / self.i_dq.size):
                return False  # mostly, few changes tell
        return True

    def _between(self, angle: float, one: FloatArray, other: FloatArray) -> FloatArray:
        return np.asarray(rotated(one, angle) - _MIRROR * rotated(other, angle))

    def slope(self, angle: float) -> FloatArray:
        """Return the derivative (N, 2) of the asymmetry by the angle, Wb/rad."""
        step = 1e-4
        return np.asarray((self.difference(angle + step) - self.difference(angle - step)) / (2 * step))

    def best_angle(self) -> float:
        """Return the angle, rad, that leaves least: by Gauss-Newton, from the best of a coarse scan."""
        tried = np.linspace(-_LARGEST_ANGLE, _LARGEST_ANGLE, 2 * _TRIED + 1)
        angle = float(tried[np.argmin([np.sum(self.difference(angle) ** 2) for angle in tried])])
        for _ in range(_STEPS):
            slope = self.slope(angle)
            change = -float(np.sum(slope * self.difference(angle)) / np.sum(slope**2))
            angle = min(max(angle + change, -_LARGEST_ANGLE), _LARGEST_ANGLE)
            if abs(change) < _SETTLED:
                break
        return angle


@one_blas_thread()
def calibrate_angle(fit: FullFit, i_dq: FloatArray) -> Calibration:
    """Estimate the resolver's offset from psi_d(i_d, -i_q) = psi_d(i_d, i_q), psi_q(i_d, -i_q) = -psi_q(i_d, i_q).

    An offset rotates currents and fluxes together, which no voltage shows. A machine whose rotor is not symmetric about
    its d axis lacks this symmetry, and then the offset cannot be estimated. A small skew of it looks like an offset of
    about its size, so what is left at the best angle, if it is more than the errors of the map, is an error of the
    offset.

    Parameters
    ----------
    i_dq : (N, 2) float
        Measured currents whose mirror images have data, too, A; see :func:`mirrored_points`.

    Returns
    -------
    Calibration
        Measured minus true electrical angle, rad.
    """
    name, unit = RESOLVER_OFFSET, "rad"
    if not len(i_dq):
        return Calibration(name, 0.0, float("nan"), unit, False, Message("resolver_offset.one_sided"))
    symmetry = _Symmetry(fit, i_dq)
    angle = symmetry.best_angle()
    slope = symmetry.slope(angle)
    sigma = float(np.linalg.norm(symmetry.along(angle, slope)) / np.sum(slope**2))
    left = float(np.sqrt(np.mean(symmetry.difference(angle) ** 2)))
    size = float(np.abs(fit.model.flux.rows(i_dq).dot(fit.solution.estimate[fit.model.map])).max())
    asymmetric = left > _LARGEST_ASYMMETRY * size or abs(angle) > 0.98 * _LARGEST_ANGLE
    skew = 0.0
    if not asymmetric and symmetry.shows(angle, left):
        skew = left / float(np.sqrt(np.mean(slope**2)))
    told = {"value": angle, "sigma": float(np.hypot(sigma, skew)), "asymmetry": left / size, "skew": skew}
    key = "resolver_offset"
    if asymmetric:
        key = "resolver_offset.asymmetric"
    elif abs(angle) < _SIGNIFICANCE * skew:
        key = "resolver_offset.skew"
    return Calibration(name, angle, told["sigma"], unit, key == name, Message(key, **told))


def with_lateness(fit: FullFit, found: Sequence[Calibration]) -> list[Calibration]:
    """Return calibrations whose offset of the angle includes that of a late angle at the one speed of the data.

    An offset that the map's symmetry shows does. Otherwise it is that of the late angle, and what keeps the symmetry
    from showing one is told with it, and is in its error.
    """
    steady = fit.steady
    if not steady or "angle_latency" not in fit.spec.effects:
        return list(found)
    own = fit.model.effect("angle_latency")
    late = -steady * float(fit.solution.estimate[own][0])
    sigma = abs(steady) * float(fitted_sigma(fit.assessment.changes[own])[0])
    unknown = Calibration(RESOLVER_OFFSET, 0.0, float("nan"), "rad", False, Message("resolver_offset.one_sided"))
    known = next((entry for entry in found if entry.name == RESOLVER_OFFSET), unknown)
    told = dict(known.message.values, late=late, late_sigma=sigma)
    if known.applied:
        offset = replace(known, message=Message("resolver_offset.with_lateness", **told))
    else:
        hidden = float(told.get("skew", 0.0))
        told["skew"] = float(np.hypot(sigma, max(hidden, abs(known.value - late)) if hidden else 0.0))
        key = "resolver_offset.asymmetric_lateness" if known.message.kind == "warning" else "resolver_offset.lateness"
        offset = replace(known, value=late, sigma=told["skew"], applied=True, message=Message(key, **told))
    return [*(entry for entry in found if entry.name != RESOLVER_OFFSET), offset]


def cross_talk(calibrations: Sequence[Calibration]) -> bool:
    """Tell whether the currents are turned by more than the mismatch of their gains.

    Two sensors of unequal gains, from which the third current is computed, turn them by half the mismatch, three
    sensors not at all.
    """
    mismatch, rotation = _sensor_faults(calibrations)
    return rotation > mismatch


def _applied(calibrations: Sequence[Calibration]) -> dict[str, float]:
    return {entry.name: entry.value for entry in calibrations if entry.applied}


def _of_axes(values: Mapping[str, float], name: str) -> complex:
    return complex(values.get(f"{name}_alpha", 0.0), values.get(f"{name}_beta", 0.0))


def _sensor_faults(calibrations: Sequence[Calibration]) -> tuple[float, float]:
    """Return the sizes of the mismatch of the current gains and of the rotation of the currents that are applied."""
    values = _applied(calibrations)
    return abs(_of_axes(values, "current_gain_mismatch")), abs(values.get(CURRENT_ROTATION, 0.0))


def common_gain(calibrations: Sequence[Calibration]) -> float:
    """Return the standard error of the common gain of the currents that unequal gains suggest."""
    return max(_sensor_faults(calibrations))


@one_blas_thread()
def by_hidden_faults(fit: FullFit, found: Sequence[Calibration], i_dq: FloatArray) -> FloatArray:
    """Return the changes (size, K) of the estimate by faults of the sensors that show in nothing but their company.

    Those are gain errors common to the phases, as large as their mismatch, as what a filter takes of the voltages, or
    as a slow variation of the DC link, within which the commands are right somewhere; and an offset of the angle as
    large as a skew of the machine makes it look. A phase with the gain 1 + e has a mismatch of abs(e) / 3 and adds
    e / 3 to the mean gain. Only the former can be seen, so the latter is as uncertain as the former is large: of
    independent errors, both have the same variance. Cross-talk between sensors turns the currents as well.

    Parameters
    ----------
    i_dq : (N, 2) float
        Currents with data, A.
    """
    values, of_currents = _applied(found), common_gain(found)
    model, estimate = fit.model, fit.solution.estimate
    of_voltage, of_current, of_angle = np.zeros((3, model.size))

    def by_flux(change: FloatArray) -> FloatArray:
        """Return the change of the map's coefficients that comes closest to one (N, 2) of the flux."""
        return np.asarray(lsqr(model.flux.rows(i_dq).sparse(model.flux.parameters), change.ravel())[0])

    def by_current(change: FloatArray) -> FloatArray:
        """Return the change (N, 2) of the flux by one (N, 2) of the currents, A."""
        return np.asarray(np.einsum("nab,nb->na", jacobian(model.flux, estimate[model.map], i_dq), change))

    told = [float(entry.message.values.get(key, 0.0)) for entry in found for key in _OF_VOLTAGES]
    if scale := float(np.linalg.norm([values.get(VOLTAGE_MISMATCH, 0.0), *told])):
        of_voltage[:] = scale * estimate
        of_voltage[model.effects] = 0.0
    if of_currents:
        # the same voltages at other currents: R i and f(i) are stretched along i
        of_current[RESISTANCE] = of_currents * fit.solution.resistance
        of_current[model.map] = by_flux(by_current(of_currents * i_dq))
    if skew := next((_skew(entry) for entry in found if entry.name == RESOLVER_OFFSET), 0.0):
        quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])  # currents and fluxes turn together
        turned = model.flux.rows(i_dq).dot(estimate[model.map]) @ quarter - by_current(i_dq @ quarter)
        of_angle[model.map] = by_flux(skew * turned)
    return np.stack([change for change in (of_voltage, of_current, of_angle) if change.any()] or [of_voltage], axis=1)


def _skew(offset: Calibration) -> float:
    """Return the offset of the angle, rad, that a skew of the machine hides or feigns."""
    skew = float(offset.message.values.get("skew", 0.0))
    return skew if offset.applied or not skew else max(skew, abs(offset.value))


def corrected(samples: Samples, calibrations: Sequence[Calibration]) -> Samples:
    """Return samples corrected for the applied faults; no sample is lost."""
    found = _applied(calibrations)
    i_s, u_s = frames.space_vector(samples.i_abc), frames.space_vector(samples.u_abc)
    u_s, i_s = u_s - _of_axes(found, "voltage_offset"), i_s - _of_axes(found, "current_offset")
    turn = 1 - 1j * found.get(CURRENT_ROTATION, 0.0)
    i_s = i_s * turn - _of_axes(found, "current_gain_mismatch") * i_s.conj()
    delay = found.get("voltage_delay", 0.0)
    if delay:
        u_s = np.concatenate([_delayed(u_s[run], delay) for run in samples.runs()])
    return replace(
        samples,
        i_abc=frames.phases(i_s),
        u_abc=frames.phases(u_s),
        angle=samples.angle - found.get(RESOLVER_OFFSET, 0.0),
    )


def _delayed(u_s: ComplexArray, delay: float) -> ComplexArray:
    """Return the mean over each sample of a held voltage that acts ``delay`` samples later."""
    place = np.arange(len(u_s), dtype=np.float64)
    return np.interp(place - delay, place, u_s)
