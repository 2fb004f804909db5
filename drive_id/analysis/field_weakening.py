"""Operation within limits of current and voltage: torque-speed envelope, current references over torque and speed.

Both are searches along one line that shrink around the best point: over i_d, with the largest i_q that keeps the
limits, or with the i_q that gives the torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.analysis.bands import combined
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.operation import Operation, changes
from drive_id.core.numerics.bisection import largest_possible
from drive_id.types import TINY, BoolArray, FloatArray

_LINES = 121  # candidates of i_d, both signs
_ROWS = 61  # candidates of i_q, one sign
_WIDTH = 6  # points to both sides in the search for references
_SHRINK = 0.6  # factor on their step in each round
_ROUNDS = 24  # of this search: the step ends at 5e-6 of the first
_NARROWINGS = 11  # rounds of the search for the envelope
_NARROW_LINES = 9  # lines of i_d between the neighbours of the best one
_NARROW_ROWS = 41  # candidates of i_q on each
_ROUGH_BISECTIONS = 12  # of i_q on each line in the first round: to choose lines
_MIDDLE_BISECTIONS = 20  # in the rounds between: to choose the best of them
_BISECTIONS = 45  # in the last round: to rounding
_NEWTON_STEPS = 4  # in i_q, from a linear interpolation
_IRON_REACH = 1.05  # largest current of the map relative to the limit of the stator current, with iron loss
_TOLERANCE = 1e-9  # relative excess of a limit that counts as kept
_ACTIVE = 1e-4  # relative distance within which a limit counts as active
_SAME = 1e-6  # relative distance from the largest torque within which it is taken instead
_BROKEN = 1e3  # rank of a point beyond a limit, above that of any within
_DIFFERENCE = 1e-4  # step of numeric derivatives, in i_max


@dataclass(frozen=True)
class DriveLimits:
    """Largest amplitudes of stator current, A, and of voltage, V."""

    i_max: float
    u_max: float

    def broken(self, points: Operation) -> FloatArray:
        """Return by how much points exceed the limits, relative to the limits; 0 within them."""
        excess = np.maximum(points.current / self.i_max, points.voltage / self.u_max) - 1
        return np.where(excess > _TOLERANCE, excess, 0.0)

    def active(self, points: Operation) -> tuple[BoolArray, BoolArray]:
        """Return where current and voltage are at their limits."""
        return points.current > (1 - _ACTIVE) * self.i_max, points.voltage > (1 - _ACTIVE) * self.u_max

    def names(self, points: Operation) -> NDArray[np.str_]:
        """Name the limits that are active at points (...): none, current, voltage, both, or unreachable for NaN."""
        current, voltage = self.active(points)
        words = np.array(["none", "current", "voltage", "both"])[current + 2 * voltage]
        return np.where(np.isfinite(points.current), words, "unreachable")


def envelope(model: MachineModel, limits: DriveLimits, speed: FloatArray, *, sign: float = 1.0) -> Operation:
    """Return the points of largest torque (``sign`` 1) or most negative torque (-1) at mechanical speeds (N,), rad/s.

    NaN where no current within its limit keeps the voltage.
    """
    speed = np.asarray(speed, np.float64)
    i_dq, psi = _candidates(model, limits, sign)
    i_d, i_q = i_dq[:, 0, 0], i_dq[0, :, 1]
    kept = np.stack([limits.broken(Operation.of_flux(model, i_dq, psi, np.array(w))) == 0 for w in speed])
    lines = np.broadcast_to(i_d, (len(speed), len(i_d)))
    farthest = _last_kept(model, limits, lines, (i_q, kept), speed, _ROUGH_BISECTIONS)
    best = _best_line(model, limits, lines, farthest, speed, sign)
    step = i_d[1] - i_d[0]
    for k in range(_NARROWINGS):
        lines = np.clip(best[:, :1] + step * np.linspace(-1.0, 1.0, _NARROW_LINES), i_d[0], i_d[-1])
        rows = np.linspace(0.0, i_q[-1], _NARROW_ROWS)
        tried = np.stack(np.broadcast_arrays(lines[..., None], rows), axis=-1)
        kept = limits.broken(Operation.at(model, tried, speed[:, None, None])) == 0
        bisections = _BISECTIONS if k + 1 == _NARROWINGS else _MIDDLE_BISECTIONS
        farthest = _last_kept(model, limits, lines, (rows, kept), speed, bisections)
        best = _best_line(model, limits, lines, farthest, speed, sign)
        step *= 2 / (_NARROW_LINES - 1)
    return _kept(limits, Operation.at(model, best, speed))


def _last_kept(
    model: MachineModel,
    limits: DriveLimits,
    i_d: FloatArray,
    rows: tuple[FloatArray, BoolArray],
    speed: FloatArray,
    bisections: int,
) -> FloatArray:
    """Return the largest i_q (S, D) within the limits at i_d (S, D); NaN where there is none.

    ``rows`` are candidates of i_q (Q,), from zero on, and where they keep the limits (S, D, Q).
    """
    i_q, kept = rows
    last = len(i_q) - 1 - kept[..., ::-1].argmax(axis=-1)
    low, high = i_q[last], i_q[np.minimum(last + 1, len(i_q) - 1)]
    for _ in range(bisections):
        middle = 0.5 * (low + high)
        good = limits.broken(Operation.at(model, np.stack([i_d, middle], axis=-1), speed[:, None])) == 0
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(kept.any(axis=-1), low, np.nan)


def _best_line(
    model: MachineModel, limits: DriveLimits, i_d: FloatArray, i_q: FloatArray, speed: FloatArray, sign: float
) -> FloatArray:
    """Return the currents (S, 2) of largest torque of a sign among (S, D); some current where none keeps the limits."""
    torque = sign * model.torque(i_d, np.nan_to_num(i_q))
    chosen = np.where(np.isfinite(i_q), torque, -np.inf).argmax(axis=1)
    rows = np.arange(len(speed))
    best = np.stack([i_d[rows, chosen], i_q[rows, chosen]], axis=-1)
    return np.where(np.isfinite(best), best, np.array([-limits.i_max, 0.0]))


def references(
    model: MachineModel, limits: DriveLimits, torque: FloatArray, motoring: Operation, braking: Operation
) -> Operation:
    """Return the points of least stator current for torques (N,), Nm, at mechanical speeds (S,), rad/s, as (S, N).

    Where a torque cannot be reached, it is the nearest one that can: that of the envelope.

    Parameters
    ----------
    torque : (N,) float
        Nm.
    motoring, braking : Operation
        (S,) points of :func:`envelope` of both signs, which tell the speeds.
    """
    speed = motoring.speed
    wanted = np.broadcast_to(torque, (len(speed), len(torque)))
    i_dq = np.full((*wanted.shape, 2), np.nan)
    for sign, end in ((1.0, motoring), (-1.0, braking)):
        own = np.flatnonzero(torque >= 0 if sign > 0 else torque < 0)
        if len(own):
            i_dq[:, own] = _least_current(model, limits, torque[own], speed, sign)
            beyond = sign * wanted[:, own] >= (1 - _SAME) * sign * end.torque[:, None]
            i_dq[:, own] = np.where(beyond[..., None], end.i_dq[:, None], i_dq[:, own])
    return _kept(limits, Operation.at(model, i_dq, np.broadcast_to(speed[:, None], wanted.shape)))


def corner_speed(model: MachineModel, limits: DriveLimits) -> float:
    """Return the mechanical speed up to which the largest torque within the current limit needs no field weakening."""
    point = envelope(model, limits, np.zeros(1))
    if not np.isfinite(point.torque[0]) or limits.active(point)[1][0]:
        return 0.0

    def voltage(speed: float) -> float:
        return float(Operation.at(model, point.i_dq, np.array([speed])).voltage[0])

    high = limits.u_max / max(float(np.hypot(*model.psi_dq(*point.i_dq[0]))) * model.known_pole_pairs(), 1e-12)
    while voltage(high) < limits.u_max:
        high *= 2
    return largest_possible(lambda speed: voltage(speed) < limits.u_max, high)


def top_speed(model: MachineModel, limits: DriveLimits, most: float) -> float:
    """Return the mechanical speed up to ``most``, rad/s, at which positive torque is still possible."""

    def possible(speed: float) -> bool:
        found = float(envelope(model, limits, np.array([speed])).torque[0])
        return bool(np.isfinite(found) and found > 0)

    return most if possible(most) else largest_possible(possible, most, 12)


def sigma_envelope(model: MachineModel, limits: DriveLimits, points: Operation) -> FloatArray:
    """Return the standard errors of the largest torques (N,), Nm: those at fixed limits, not at fixed currents.

    With the gradients of torque, voltage and current by the map's current, the torque changes to first order by its own
    change minus the change of an active voltage limit times its multiplier.
    """
    changed = changes(model, points, ("torque", "voltage"))
    if changed is None:
        return np.full(len(points.torque), np.nan)
    by_t, by_u, by_i = _gradients(model, limits, points.i_dq, points.speed)
    at_current, at_voltage = limits.active(points)
    alone = np.sum(by_t * by_u, axis=-1) / np.maximum(np.sum(by_u**2, axis=-1), TINY)
    cross = by_u[..., 0] * by_i[..., 1] - by_u[..., 1] * by_i[..., 0]
    both = by_t[..., 0] * by_i[..., 1] - by_t[..., 1] * by_i[..., 0]
    both = np.divide(both, cross, out=alone.copy(), where=np.abs(cross) > 0)
    multiplier = np.where(at_voltage, np.where(at_current, both, alone), 0.0)
    sigma = combined(changed["torque"] - multiplier * changed["voltage"])
    return np.where(points.inside(model), sigma, np.nan)


def _gradients(
    model: MachineModel, limits: DriveLimits, i_dq: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives (N, 2) of torque, voltage and current with respect to the map's current (N, 2), A."""
    step = _DIFFERENCE * limits.i_max
    sides = [[Operation.at(model, i_dq + side * step * axis, speed) for side in (1, -1)] for axis in np.eye(2)]

    def slopes(name: str) -> FloatArray:
        differences = [np.asarray(getattr(a, name) - getattr(b, name), np.float64) for a, b in sides]
        return np.asarray(np.stack(differences, axis=-1) / (2 * step))

    return slopes("torque"), slopes("voltage"), slopes("current")


def _candidates(model: MachineModel, limits: DriveLimits, sign: float) -> tuple[FloatArray, FloatArray]:
    """Return currents on a grid over the half plane (D, Q, 2), A, and their fluxes."""
    reach = limits.i_max * (_IRON_REACH if model.iron.known else 1.0)
    i_d = np.linspace(-reach, reach, _LINES)
    i_q = sign * np.linspace(0.0, reach, _ROWS)
    i_dq = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1)
    return i_dq, np.stack(model.psi_dq(i_dq[..., 0], i_dq[..., 1]), axis=-1)


def _kept(limits: DriveLimits, points: Operation) -> Operation:
    """Return points, NaN where a limit is exceeded."""
    good = limits.broken(points) == 0
    masked = {
        name: np.where(good if values.ndim == good.ndim else good[..., None], values, np.nan)
        for name, values in vars(points).items()
    }
    return Operation(**masked | {"speed": points.speed})


def _least_current(
    model: MachineModel, limits: DriveLimits, torque: FloatArray, speed: FloatArray, sign: float
) -> FloatArray:
    """Return currents of the map (S, N, 2), A, that give torques of one sign with the least stator current.

    Along the line of constant torque, i_q is a function of i_d.
    """
    i_dq, psi = _candidates(model, limits, sign)
    pairs = 1.5 * model.known_pole_pairs()
    on_grid = sign * pairs * (psi[..., 0] * i_dq[..., 1] - psi[..., 1] * i_dq[..., 0])
    i_d, i_q = i_dq[:, 0, 0], i_dq[0, :, 1]
    start = np.array([_first_crossing(on_grid, i_q, sign * value) for value in torque])  # (N, D)
    lines = _on_torque(model, np.broadcast_to(i_d, start.shape), start, torque[:, None])
    best = np.empty((len(speed), len(torque), 2))
    for k, w in enumerate(speed):
        rank = _rank(limits, Operation.at(model, lines, np.array(w)))
        best[k] = lines[np.arange(len(torque)), rank.argmin(axis=1)]
    offsets = np.linspace(-1.0, 1.0, 2 * _WIDTH + 1)
    step = i_d[1] - i_d[0]
    for k in range(_ROUNDS):
        tried = best[..., 0, None] + _WIDTH * step * offsets
        steps = _NEWTON_STEPS if k < 3 else 2
        curve = _on_torque(model, tried, np.broadcast_to(best[..., 1, None], tried.shape), torque[:, None], steps)
        rank = _rank(limits, Operation.at(model, curve, speed[:, None, None]))
        chosen = rank.argmin(axis=-1)[..., None, None]
        best, step = np.take_along_axis(curve, chosen, axis=2)[:, :, 0], _SHRINK * step
    return best


def _rank(limits: DriveLimits, points: Operation) -> FloatArray:
    broken = limits.broken(points)
    rank = np.where(broken > 0, _BROKEN * (1 + broken), points.current / limits.i_max)
    return np.where(np.isfinite(rank), rank, np.inf)


def _first_crossing(values: FloatArray, i_q: FloatArray, wanted: float) -> FloatArray:
    """Return the i_q (D,) at which values (D, Q) first reach the wanted value, NaN where they do not."""
    reached = values >= wanted
    k = reached.argmax(axis=1)
    rows, before = np.arange(len(values)), np.maximum(k - 1, 0)
    low, high = values[rows, before], values[rows, k]
    share = np.divide(wanted - low, high - low, out=np.zeros_like(low), where=high > low)
    return np.where(reached.any(axis=1), i_q[before] + np.clip(share, 0.0, 1.0) * (i_q[k] - i_q[before]), np.nan)


def _on_torque(
    model: MachineModel, i_d: FloatArray, i_q: FloatArray, torque: FloatArray, steps: int = _NEWTON_STEPS
) -> FloatArray:
    """Return currents (..., 2) of given torques at given i_d, by Newton's method in i_q; NaN where it fails."""
    factor, largest = 1.5 * model.known_pole_pairs(), 0.1 * model.i_max
    for _ in range(steps):
        psi_d, psi_q = model.psi_dq(i_d, i_q)
        slopes = model.inductances(i_d, i_q)
        slope = psi_d + slopes[..., 0, 1] * i_q - slopes[..., 1, 1] * i_d
        error = torque / factor - (psi_d * i_q - psi_q * i_d)
        i_q = i_q + np.clip(np.divide(error, slope, out=np.zeros_like(error), where=slope != 0), -largest, largest)
    found = model.torque(i_d, i_q)
    good = np.abs(found - torque) <= 1e-6 * (np.abs(torque) + np.nanmax(np.abs(found), initial=1e-9))
    return np.stack([i_d, np.where(good, i_q, np.nan)], axis=-1)
