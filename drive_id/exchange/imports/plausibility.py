"""Check whether a map is plausible in our conventions, and if not, which conventions would make it so."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from drive_id.common.messages import Message
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.conventions import Conventions, converted
from drive_id.exchange.imports.points import MapPoints
from drive_id.types import FloatArray, IntArray

_MOST_POINTS = 1500  # at which slopes are estimated
_NEIGHBOURS = 9  # through which a plane is fitted: a node of a grid and those around it
_RISING = 0.95  # share of points at which each flux must rise with the current of its axis
_ASYMMETRY = 0.25
"""Largest ``L_dq - L_qd``, rms, relative to the rms inductance: iron loss and noise of measured maps leave less."""
_MAGNET = 0.02  # flux at zero current, relative to the largest, from which on there is a magnet with a direction
_TORQUE = 0.1  # relative difference allowed between a file's torque and that of its map
_INDUCTANCE = (1e-6, 5.0)  # H
_LARGE_FLUX = 2.0
"""Flux linkage beyond that of most machines, Wb: at 50 Hz it induces 628 V, more than an inverter on 1000 V gives."""
_LARGEST_FLUX = 50.0  # Wb; ship drives reach 30, and 50 mWb are a small machine
_OFF_NEIGHBOURS = 5.0  # distance of an outlier from the plane through its neighbours, by the distances of those
_OFF = 0.03  # the same by the largest flux
_TIME_CONSTANT = (3e-5, 20.0)  # s
_AMPLITUDES = ("current", "flux")


@np.errstate(over="ignore", invalid="ignore")
def _faults(points: MapPoints) -> list[str]:
    """Describe in parts of sentences what is implausible in a map that should be in our conventions."""
    slopes, at_zero = _local_slopes(points.i_dq, points.mean_psi_dq)
    if not len(slopes):
        return ["its points lie on lines, so that they tell no inductances"]
    largest = float(np.hypot(*points.mean_psi_dq.T).max())
    if largest > _LARGEST_FLUX:
        return [f"its flux linkage reaches {largest:.3g} Wb, as if it were in mWb (then --flux-scale 0.001)"]
    found = _monotone(slopes) or _reciprocal(slopes) or _sized(slopes, points.scalars.get("resistance"))
    if at_zero is not None:
        found = found + _magnet(at_zero, points.mean_psi_dq)
    return found + _torque(points)


def check_plausible(points: MapPoints, conventions: Conventions, transposed: Callable[[], MapPoints | None]) -> None:
    """Refuse a map that the assumed conventions of its file make implausible, naming those that would not.

    ``transposed`` returns the same points with the indices of their grid exchanged; None when they needed no order.

    Raises ConfigurationError when the map is implausible.
    """
    ours = converted(points, conventions)
    found = _faults(ours)
    if not found:
        return
    odd = outlier(ours.i_dq, ours.mean_psi_dq)
    if odd is not None and not _faults(_without(ours, odd)):
        raise ConfigurationError(f"The map is not plausible: {'; '.join(found)}, which is for one point. {odd}")
    hint = _hint(points, conventions, transposed())
    raise ConfigurationError(f"The map is not plausible: {'; '.join(found)}; {hint}.")


def _hint(points: MapPoints, assumed: Conventions, transposed: MapPoints | None) -> str:
    """Return which options would make a map plausible, with as few changes as possible."""
    names: tuple[str, ...] = ("axis", "order", "sign", "magnet", "q_axis")
    names += _AMPLITUDES if points.torque is not None else ()
    fitting: list[Conventions] = []
    for other in assumed.alternatives(names):
        if fitting and len(other.differing(assumed)) > len(fitting[0].differing(assumed)):
            break
        turned = other.order != assumed.order and points.shape is not None
        source = transposed if turned else points
        if source is None or source.axis not in (None, other.axis):  # the file itself may state its axis
            continue
        if not _faults(converted(source, other)):
            fitting.append(other)
    if fitting:
        options = " or ".join(f"'{' '.join(other.differing(assumed))}'" for other in fitting)
        return f"it would be plausible with {options}"
    return (
        "no choice of axes, signs and order makes it plausible: check which columns or fields are read, and their "
        "units (--current-scale, --flux-scale)"
    )


def _without(points: MapPoints, odd: Message) -> MapPoints:
    """Return the points without an outlier and those beside it, which it may be taken for."""
    away = (points.i_dq - [odd.values["i_d"], odd.values["i_q"]]) / np.ptp(points.i_dq, axis=0)
    kept = np.argsort(np.hypot(*away.T))[_NEIGHBOURS:]
    torque = None if points.torque is None else points.torque[kept]
    return replace(points, i_dq=points.i_dq[kept], psi_dq=points.psi_dq[kept], torque=torque)


def _local_slopes(i_dq: FloatArray, psi_dq: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """Return inductances (M, 2, 2), H, at up to 1500 of points (N, 2) in A and Wb, by planes through neighbours.

    And psi_dq at zero current (2,), Wb; None when the points do not reach zero current.
    """
    x, scale, spread = _in_steps(i_dq)
    tree = cKDTree(x)
    chosen = x[:: max(1, len(x) // _MOST_POINTS)]
    _, near = tree.query(chosen, k=_NEIGHBOURS)
    slopes, known, _ = _planes(i_dq[near], psi_dq[near], chosen / spread * scale)
    distance, around = tree.query(np.zeros((1, 2)), k=_NEIGHBOURS)
    typical = float(np.median(tree.query(chosen, k=2)[0][:, 1]))
    _, fits, values = _planes(i_dq[around], psi_dq[around], np.zeros((1, 2)))
    reaches = bool(fits[0]) and distance[0, 0] <= 3 * typical
    return slopes[known], values[0] if reaches else None


def _in_steps(i_dq: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return currents in steps of their grid, so that both axes count the same, the ranges, and the steps in each."""
    scale = np.ptp(i_dq, axis=0)
    spread = np.array([len(np.unique(np.round(i_dq[:, k] / scale[k], 6))) for k in range(2)])
    return i_dq / scale * spread, scale, spread


def outlier(i_dq: FloatArray, psi_dq: FloatArray) -> Message | None:
    """Describe the point (N, 2) that lies off the plane through its neighbours as they do not; None without one."""
    x, _, _ = _in_steps(i_dq)
    _, near = cKDTree(x).query(x, k=min(_NEIGHBOURS, len(i_dq)))
    _, known, expected = _planes(i_dq[near[:, 1:]], psi_dq[near[:, 1:]], i_dq)
    off = np.where(known, np.hypot(*(psi_dq - expected).T), 0.0)
    usual = np.median(off[near[:, 1:]], axis=1)
    suspect = (off > _OFF_NEIGHBOURS * usual) & (off > _OFF * np.hypot(*psi_dq.T).max())
    if not suspect.any():
        return None
    worst = int(np.argmax(np.where(suspect, off, 0.0)))
    d, q = i_dq[worst]
    return Message("import_outlier", i_d=d, i_q=q, off=off[worst])


def large_flux(psi_dq: FloatArray) -> Message | None:
    """Describe fluxes (N, 2), Wb, that are larger than those of most machines, as if in mWb; None for usual ones."""
    largest = float(np.hypot(*psi_dq.T).max())
    if largest <= _LARGE_FLUX:
        return None
    return Message("import_large_flux", flux=largest, voltage=2 * np.pi * 50 * largest)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _planes(i_dq: FloatArray, psi_dq: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a plane to each (M) group of K points; return slopes (M, 2, 2), which of them hold, and values at (M, 2)."""
    offset = i_dq - at[:, None]
    size = np.abs(offset).max(axis=(1, 2), keepdims=True)
    columns = np.concatenate([np.ones_like(offset[..., :1]), offset / size], axis=-1)
    normal = np.einsum("mka,mkb->mab", columns, columns)
    known = np.isfinite(normal).all(axis=(1, 2))  # not points within less than numbers can tell
    normal[~known] = np.eye(3)
    known &= np.linalg.cond(normal) < 1e6  # not points on one line
    normal[~known] = np.eye(3)
    found = np.linalg.solve(normal, np.einsum("mka,mkb->mab", columns, psi_dq))
    slopes = np.swapaxes(found[:, 1:], 1, 2) / size
    return slopes, known, found[:, 0]


def _monotone(slopes: FloatArray) -> list[str]:
    shares = [float(np.mean(slopes[:, k, k] > 0)) for k in range(2)]
    return [
        f"psi_{name} rises with i_{name} at {100 * share:.0f} % of the points only"
        for name, share in zip("dq", shares, strict=True)
        if share < _RISING
    ]


def _reciprocal(slopes: FloatArray) -> list[str]:
    difference = float(np.sqrt(np.mean((slopes[:, 0, 1] - slopes[:, 1, 0]) ** 2)))
    size = float(np.sqrt(np.mean(np.abs(slopes[:, 0, 0] * slopes[:, 1, 1]))))
    if difference <= _ASYMMETRY * size:
        return []
    return [f"it is not reciprocal, dpsi_d/di_q - dpsi_q/di_d being {100 * difference / size:.0f} % of L"]


def _sized(slopes: FloatArray, resistance: float | None) -> list[str]:
    typical = float(np.median(np.sqrt(np.abs(slopes[:, 0, 0] * slopes[:, 1, 1]))))
    low, high = _INDUCTANCE
    if not low <= typical <= high:
        return [f"its typical inductance is {typical:.3g} H, not between {low:g} and {high:g} H"]
    low, high = _TIME_CONSTANT
    if resistance is not None and not low <= typical / resistance <= high:
        return [f"L / R is {typical / resistance:.3g} s, not between {low:g} and {high:g} s"]
    return []


def _magnet(at_zero: FloatArray, psi_dq: FloatArray) -> list[str]:
    d, q = at_zero
    if math.hypot(d, q) < _MAGNET * float(np.hypot(*psi_dq.T).max()):
        return []
    if d > 0 and abs(q) < 0.35 * d:
        return []
    return [f"the flux linkage at zero current is ({d:.3g}, {q:.3g}) Wb in (d, q), not along +d"]


def torque_ratio(points: MapPoints) -> float | None:
    """Return the file's torque over ``3/2 (psi_d i_q - psi_q i_d)``, the number of pole pairs; None without torque."""
    if points.torque is None:
        return None
    known = np.isfinite(points.torque)
    psi, current, torque = points.mean_psi_dq[known], points.i_dq[known], points.torque[known]
    product = 1.5 * (psi[:, 0] * current[:, 1] - psi[:, 1] * current[:, 0])
    power = float(product @ product)
    return float(product @ torque) / power if power > 0 else None


def _torque(points: MapPoints) -> list[str]:
    ratio, pairs = torque_ratio(points), points.scalars.get("pole_pairs")
    if ratio is None:
        return []
    if ratio <= 0:
        return ["its torque has the opposite sign of psi_d i_q - psi_q i_d"]
    if pairs is None:
        if abs(ratio - round(ratio)) <= _TORQUE * ratio and round(ratio) >= 1:
            return []
        return [f"its torque is {ratio:.3g} times 3/2 (psi_d i_q - psi_q i_d), which is no number of pole pairs"]
    if abs(ratio / pairs - 1) <= _TORQUE:
        return []
    return [f"its torque is {ratio / pairs:.3g} times that of the map with {pairs:g} pole pairs"]
