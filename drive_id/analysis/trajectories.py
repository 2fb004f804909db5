"""Current trajectories: maximum torque per ampere (MTPA) and per volt (MTPV)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drive_id.analysis.bands import combined
from drive_id.analysis.machine import MachineModel
from drive_id.types import TINY, BoolArray, FloatArray

_ANGLES = 181  # candidates per half turn
_ZOOMS = 14  # rounds of search, each with half the step: down to 1e-6 rad
_WIDTH = 4  # steps to both sides in each round
_BISECTIONS = 40  # of the angle of an MTPV point: to rounding
_CIRCLES = 61  # on which the beginning of the MTPV locus is looked for
_FINE_CIRCLES, _FINE_ANGLES = 241, 361  # of the grid that tells the largest torque at a flux: to 3e-4 of that at i_max
_BETWEEN = 17  # circles between the last one without and the first one with it
_LOST = 1e-4  # share of the torque at the same flux that a point of MTPV may give away; else the locus is elsewhere
_NARROWINGS = 4  # times that those are refined: to 3e-7 of i_max
_ANGLE_STEP = np.deg2rad(1.0)  # for differences of the torque along a circle


@dataclass(frozen=True, eq=False)
class CurrentLocus:
    """Points (N,) on circles of constant current amplitude.

    Parameters
    ----------
    current : (N,) float
        Amplitude, A, increasing.
    i_d, i_q : (N,) float
        A.
    psi_d, psi_q : (N,) float
        Wb.
    torque, sigma_torque : (N,) float
        Nm; the standard error is NaN outside the data, or where it is not known.
    sigma_angle : (N,) float
        Of the angle atan2(i_q, i_d), rad; NaN likewise.
    inside : (N,) bool
        Whether data support the point; elsewhere it rests on the continuation of the map.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    torque: FloatArray
    sigma_torque: FloatArray
    sigma_angle: FloatArray
    inside: BoolArray

    def __len__(self) -> int:
        return len(self.current)


def mtpa(model: MachineModel, i_max: float, points: int = 41, *, sign: float = 1.0) -> CurrentLocus:
    """Return the largest torque on circles of current amplitude, 0 to ``i_max`` (A).

    Parameters
    ----------
    i_max : float
        A.
    sign : float
        -1 for the most negative torque, with i_q <= 0.
    """
    current = np.linspace(0.0, i_max, points)
    angle = best_angle(lambda i, a: sign * model.torque(i * np.cos(a), i * np.sin(a)), current, sign)
    return _trajectory(model, current, angle, combined(mtpa_angle_changes(model, current, angle)))


def mtpv(model: MachineModel, i_max: float, points: int = 41) -> CurrentLocus:
    """Return the points of largest torque at a given flux (voltage, without resistance), by current amplitude.

    On each circle it is the point beyond the MTPA angle, towards less flux, where torque and flux have parallel
    gradients; the locus begins at the characteristic current and is empty when that exceeds ``i_max``.
    """
    most = _torque_by_flux(model, i_max)
    start, exists = 0.0, _mtpv_angle(model, np.linspace(0.0, i_max, _CIRCLES)[1:], most)
    known = np.isfinite(exists)
    if not known[-1]:
        return _trajectory(model, np.zeros(0), np.zeros(0), np.zeros(0))
    last_without = np.flatnonzero(~known)
    if len(last_without):
        low, high = ((last_without[-1] + 1 + k) * i_max / (_CIRCLES - 1) for k in (0, 1))
        for _ in range(_NARROWINGS):
            tried = np.linspace(low, high, _BETWEEN)
            first = max(1, int(np.isfinite(_mtpv_angle(model, tried[1:], most)).argmax()) + 1)
            low, high = tried[first - 1], tried[first]
        start = high
    current = np.linspace(start, i_max, points)
    angle = _mtpv_angle(model, current, most)
    if start == 0.0:
        angle[0] = angle[1]
    found = np.isfinite(angle)
    current, angle = current[found], angle[found]
    return _trajectory(model, current, angle, _mtpv_error(model, current, angle))


def characteristic_current(model: MachineModel) -> tuple[float, float, bool]:
    """Return the current that cancels the flux, A, its standard error, and whether it lies within the data.

    The steady short-circuit current at high speed; NaN where the continued map reaches no zero flux.
    """
    d, q = (float(x) for x in model.current(0.0, 0.0))
    size = float(np.hypot(d, q))
    if not np.isfinite(size):
        return np.nan, np.nan, False
    inside, sigma = bool(model.inside(d, q)), np.nan
    if model.errors is not None and inside:
        at = np.array(d), np.array(q)
        changes = np.linalg.solve(model.inductances(d, q), model.errors.fluxes(*at).T).T
        along = np.array([d, q]) / size if size > 0 else np.array([-1.0, 0.0])
        sigma = float(combined(changes @ along))
    return size, sigma, inside


def best_angle(figure: Callable[[FloatArray, FloatArray], FloatArray], current: FloatArray, sign: float) -> FloatArray:
    """Return the angles (N,) in the half plane ``sign * i_q >= 0`` where figure(current, angle) is largest."""
    start = np.linspace(0.0, np.pi, _ANGLES) * sign
    values = figure(current[:, None], start)
    angle, step = start[values.argmax(axis=1)], np.pi / (_ANGLES - 1)
    offsets = np.linspace(-1.0, 1.0, 2 * _WIDTH + 1)
    for _ in range(_ZOOMS):
        tried = angle[:, None] + step * offsets
        chosen = figure(current[:, None], tried).argmax(axis=1)
        angle, step = tried[np.arange(len(angle)), chosen], step / 2
    return _polished(figure, current, angle)


def _polished(
    figure: Callable[[FloatArray, FloatArray], FloatArray], current: FloatArray, angle: FloatArray
) -> FloatArray:
    """Move to the vertex of the parabola through three close points: values alone locate a maximum only roughly."""
    step = 1e-3
    left, middle, right = (figure(current, angle + k * step) for k in (-1, 0, 1))
    curvature = left - 2 * middle + right
    shift = np.divide(0.5 * (left - right), curvature, out=np.zeros_like(angle), where=curvature < 0)
    return angle + step * np.clip(shift, -1.0, 1.0)


def _parallel(model: MachineModel, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Return the cross product of the gradients of torque and half the squared flux (...), per 1.5 p."""
    psi = np.stack(model.psi_dq(i_d, i_q), axis=-1)
    return _cross(psi, model.inductances(i_d, i_q), i_d, i_q)


def _cross(psi: FloatArray, slopes: FloatArray, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    torque = slopes[..., 0, :] * i_q[..., None] - slopes[..., 1, :] * i_d[..., None]
    torque = torque + np.stack([-psi[..., 1], psi[..., 0]], axis=-1)
    flux = np.einsum("...ab,...a->...b", slopes, psi)
    return np.asarray(torque[..., 0] * flux[..., 1] - torque[..., 1] * flux[..., 0])


def _mtpv_angle(model: MachineModel, current: FloatArray, most: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Return the angles (N,) of the locus on circles (N,), A; NaN where there is none.

    ``most`` tells the largest torque up to flux amplitudes, see :func:`_torque_by_flux`.
    """

    def torque(i: FloatArray, a: FloatArray) -> FloatArray:
        return model.torque(i * np.cos(a), i * np.sin(a))

    def cross(i: FloatArray, a: FloatArray) -> FloatArray:
        return _parallel(model, i * np.cos(a), i * np.sin(a))

    start = best_angle(torque, current, 1.0)
    ahead = [np.hypot(*model.psi_dq(current * np.cos(a), current * np.sin(a))) for a in (start + 1e-3, start - 1e-3)]
    direction = np.where(ahead[0] < ahead[1], 1.0, -1.0)
    reach = np.where(direction > 0, np.pi - start, start)
    share = np.linspace(0.0, 1.0, _ANGLES)
    angles = start[:, None] + (direction * reach)[:, None] * share
    values = cross(current[:, None], angles)
    before = np.sign(values[:, :1])
    turned = (values[:, :-1] * before > 0) & (values[:, 1:] * before <= 0)  # from a rise of the torque to a fall
    turned[:, -1] &= np.abs(np.sin(angles[:, -1])) > 0  # on the d axis itself there is no torque
    best, kept = np.full(len(current), np.nan), np.zeros(len(current))
    for _ in range(int(turned.sum(axis=1).max(initial=0))):
        first, rows = turned.argmax(axis=1), np.flatnonzero(turned.any(axis=1))
        low, high = angles[rows, first[rows]], angles[rows, first[rows] + 1]
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            rising = cross(current[rows], middle) * before[rows, 0] >= 0
            low, high = np.where(rising, middle, low), np.where(rising, high, middle)
        i_d, i_q = current[rows] * np.cos(low), current[rows] * np.sin(low)
        reached = model.torque(i_d, i_q)
        # The grid of currents may know of next to no torque at so small a flux: more than twice as much tells no more.
        share = reached / np.maximum(most(np.hypot(*model.psi_dq(i_d, i_q))), 0.5 * np.abs(reached))
        better = share > np.maximum(kept[rows], 1 - _LOST)
        best[rows[better]], kept[rows[better]] = low[better], share[better]
        turned[rows, first[rows]] = False
    return best


def _torque_by_flux(model: MachineModel, i_max: float) -> Callable[[FloatArray], FloatArray]:
    """Return a function of flux amplitudes, Wb: the largest torque, Nm, up to them on a grid of currents."""
    size, angle = np.meshgrid(np.linspace(0.0, i_max, _FINE_CIRCLES), np.linspace(0.0, np.pi, _FINE_ANGLES))
    i_d, i_q = size * np.cos(angle), size * np.sin(angle)
    known = model.inside(i_d, i_q)
    flux, torque = np.hypot(*model.psi_dq(i_d, i_q))[known], model.torque(i_d, i_q)[known]
    order = np.argsort(flux)
    flux, torque = flux[order], np.maximum.accumulate(torque[order])

    def most(limit: FloatArray) -> FloatArray:
        at = np.searchsorted(flux, limit, side="right") - 1
        return np.where(at >= 0, np.maximum(torque[np.maximum(at, 0)], TINY), TINY)

    return most


def _trajectory(model: MachineModel, current: FloatArray, angle: FloatArray, sigma_angle: FloatArray) -> CurrentLocus:
    i_d, i_q = current * np.cos(angle) + 0.0, current * np.sin(angle) + 0.0  # no negative zeros
    psi_d, psi_q = model.psi_dq(i_d, i_q)
    inside = model.inside(i_d, i_q)
    return CurrentLocus(
        current=current,
        i_d=i_d,
        i_q=i_q,
        psi_d=psi_d,
        psi_q=psi_q,
        torque=model.torque(i_d, i_q),
        sigma_torque=model.sigma_torque(i_d, i_q),
        sigma_angle=np.where(inside, sigma_angle, np.nan),
        inside=inside,
    )


def mtpa_angle_changes(model: MachineModel, current: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the changes (M, N), rad, of the angle where the torque's slope along the circle vanishes, by each cause.

    NaN (1, N) where the errors of slopes are not known.
    """
    if model.errors is None or not model.errors.joint:
        return np.full((1, len(angle)), np.nan)
    at = [(current * np.cos(a), current * np.sin(a)) for a in (angle - _ANGLE_STEP, angle, angle + _ANGLE_STEP)]
    torque = [model.torque(*point) for point in at]
    curvature = (torque[0] - 2 * torque[1] + torque[2]) / _ANGLE_STEP**2
    slopes = (model.torque_changes(*at[2]) - model.torque_changes(*at[0])) / (2 * _ANGLE_STEP)
    return np.asarray(slopes / np.where(curvature < 0, -curvature, np.nan))


def _mtpv_error(model: MachineModel, current: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the standard error (N,) of the angle where the gradients are parallel, rad."""
    if model.errors is None or not model.errors.joint:
        return np.full(len(angle), np.nan)
    i_d, i_q = current * np.cos(angle), current * np.sin(angle)
    psi, slopes = np.stack(model.psi_dq(i_d, i_q), axis=-1), model.inductances(i_d, i_q)
    pairs = zip(model.errors.fluxes(i_d, i_q), model.errors.inductances(i_d, i_q), strict=True)
    now = _cross(psi, slopes, i_d, i_q)
    changes = np.array([_cross(psi + own, slopes + own_slopes, i_d, i_q) - now for own, own_slopes in pairs])
    sides = [
        _parallel(model, current * np.cos(a), current * np.sin(a))
        for a in (angle + 0.1 * _ANGLE_STEP, angle - 0.1 * _ANGLE_STEP)
    ]
    slope = (sides[0] - sides[1]) / (0.2 * _ANGLE_STEP)
    return np.asarray(combined(changes) / np.where(slope != 0, np.abs(slope), np.nan))
