"""The quantities that are asked for first: magnet flux, inductances, R, drop and torque, with their standard errors."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.quantity import Quantity
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.types import BoolArray, FloatArray

_NODES = 6
"""Grid points along each axis through which a polynomial is laid around a current."""
_COARSE = np.linspace(0.0, np.pi, 361)  # rad: angles of the current, half a degree apart, among which MTPA is refined
_FINE = np.deg2rad(np.linspace(-1.5, 1.5, 25))
"""Angles, rad, at which MTPA is searched; the torque is flat there, so 0.1° cost 2e-6 of it."""
_RADII = (1.0, 0.98, 0.95, 0.9, 0.8, 0.7, 0.6, 0.5)
"""Of the circle of the peak torque, in i_max: the first whose MTPA has data around it."""
_SLOPES = 0.95
"""The largest of these for inductances: nearer to the edge of the data, slopes are off by up to 5 %."""
_ENCLOSED = " No sample lies there: the map and its error follow from those around."
_BESIDE = " The data end beside it: the map and its error are continued by one grid step."
_WORST = 0.5
"""Standard error of a value, relative, beyond which its note says so."""


def headline(
    drive: IdentifiedDrive, *, pole_pairs: int | None = None, temperature: float | None = None,
    rated: float | None = None,
) -> tuple[Quantity, ...]:  # fmt: skip
    """Return what is asked for first; what is not known is left out.

    Where samples only enclose a current, the standard error tells how well the map is known there: such a value needs
    the joint errors of a fit, as inductances away from zero current do. These are told at the rated current, A, or else
    at 95 % of i_max. Without pole pairs there is no torque. The temperature is that to which R refers, degrees Celsius,
    where known.
    """
    wanted = (rated / drive.i_max,) if rated and rated < _SLOPES * drive.i_max else ()
    peak, loaded = _peak_torque(drive, _RADII) if drive.origin.turning else None, None
    if drive.origin.slopes:
        loaded = _peak_torque(drive, (*wanted, *(share for share in _RADII if share <= _SLOPES)))
    found = [*_at_zero_current(drive), *(() if loaded is None else loaded.inductances(drive))]
    if math.isfinite(drive.resistance):
        at = "" if temperature is None else f" at {temperature:g} °C"
        warm = "At the temperature of the recording." if drive.origin.fitted and not at else ""
        linear = "With the linear part of the inverter's drop." if drive.origin.inverter else ""
        note = " ".join(filter(None, (warm, linear)))
        found.append(Quantity(f"R{at}", drive.resistance, drive.sigma_resistance, "Ω", note))
    if drive.origin.inverter:
        note = "Of one phase at large current, without its linear part, which is in R."
        found.append(Quantity("Inverter drop", drive.voltage_error, drive.sigma_voltage_error, "V", note))
    found.append(Quantity("i_max", drive.i_max, math.nan, "A", "Radius of the current disc."))
    if pole_pairs:
        points = {point.where(drive): point for point in (loaded if wanted else None, peak) if point}
        found += [quantity for point in points.values() for quantity in point.torques(drive, pole_pairs)]
    return tuple(replace(q, size=drive.sizes.get(q.unit, math.nan)) for q in (*found, *_of_shaft(drive)))


def _at_zero_current(drive: IdentifiedDrive) -> tuple[Quantity, ...]:
    names, note = ("ψ_PM", "L_d at zero current", "L_q at zero current"), "Incremental."
    linear = drive.linear
    if linear is not None:
        values = (linear.psi_pm, linear.l_d, linear.l_q)
        sigmas = (linear.sigma_psi_pm, linear.sigma_l_d, linear.sigma_l_q)
        rows = zip(names, values, sigmas, ("Wb", "H", "H"), strict=True)
        return tuple(Quantity(*row) for row in rows if math.isfinite(row[2]))
    usable = _usable(drive)
    told = [(0, *each) for each in usable] + [(1, each, _BESIDE) for each, said in usable if said]
    tried = ((_Local.at(drive, 0.0, 0.0, where, beyond), said) for beyond, where, said in told)
    local, said = next(filter(lambda each: each[0] is not None, tried), (None, ""))
    if local is None:
        return ()
    found = [local.inductance(axis, name, note + said) for axis, name in enumerate(names[1:])]
    if drive.origin.turning:
        sigma = _sigma(local.changes[0]) if said else float(drive.flux_map.sigma(0.0, 0.0)[0])
        found.insert(0, Quantity(names[0], float(local.psi[0]), sigma, "Wb", "At zero current." + said))
    return tuple(_noted(quantity) if said else quantity for quantity in found)


def _usable(drive: IdentifiedDrive) -> list[tuple[BoolArray, str]]:
    """Return where values may be told, (D, Q), and what must be said: with data first, then enclosed by them."""
    enclosed = [] if drive.error_modes is None else [(drive.error_modes.known, _ENCLOSED)]
    return [(drive.flux_map.inside, ""), *enclosed]


def _of_shaft(drive: IdentifiedDrive) -> tuple[Quantity, ...]:
    mechanics = drive.mechanics
    if mechanics is None or mechanics.sigma_inertia == 0.0:  # it was given
        return ()
    note = "By the torque of the map." if mechanics.gain is None else "By the torque of the map and the added inertia."
    return (Quantity("J", mechanics.inertia, mechanics.sigma_inertia, "kg m²", note),)


def _peak_torque(drive: IdentifiedDrive, radii: Iterable[float]) -> _Local | None:
    """Return the current of the largest positive torque on the first circle with data around it; radii in i_max."""
    found, anywhere = drive.flux_map, np.ones_like(drive.flux_map.inside)
    for radius in (share * drive.i_max for share in radii):
        d, q = radius * np.cos(_COARSE), radius * np.sin(_COARSE)
        rough = _COARSE[(found.sampled(found.psi_d, d, q) * q - found.sampled(found.psi_q, d, q) * d).argmax()]
        tried = ((radius * np.cos(angle), radius * np.sin(angle)) for angle in rough + _FINE)
        points = filter(None, (_Local.at(drive, *point, anywhere) for point in tried))
        summit = max(points, key=lambda point: float(point.per_pair[0]), default=None)
        if summit is None:
            continue
        found_there = (_Local.at(drive, summit.i_d, summit.i_q, usable) for usable, _ in _usable(drive))
        if (best := next(filter(None, found_there), None)) is not None:
            return best if best.per_pair[0] > 0 else None
    return None


def slopes(values: NDArray[Any], usable: BoolArray, axis: FloatArray, along: int) -> FloatArray:
    """Return the slopes (..., D, Q) of values over an equally spaced axis, the last or (-2) the last but one.

    By the polynomials of the headline, whose standard errors are calibrated: differences of neighbours smooth the short
    waves by which joint errors tell those of slopes. NaN where no polynomial goes through usable points (D, Q) alone.
    """
    values, usable = np.moveaxis(values.astype(np.float64), along, -1), np.moveaxis(usable, along, -1)
    runs, whole = (np.lib.stride_tricks.sliding_window_view(x, _NODES, axis=-1) for x in (values, usable))
    out, several = np.full(values.shape, np.nan), runs.shape[-2]
    for before in sorted(range(_NODES), key=lambda k: (abs(2 * k + 1 - _NODES), -k)):  # points, most evenly first
        there = out[..., before : before + several]
        new = np.isnan(there) & whole.all(axis=-1)
        there[new] = (runs @ _weights(axis[:_NODES], axis[before])[1])[new]
    return np.moveaxis(out, -1, along)


@dataclass(frozen=True, eq=False)
class _Local:
    """Flux linkages and incremental inductances at a current, and their changes by M independent causes of error.

    M is 0 where the joint errors are not known.
    """

    i_d: float  # A
    i_q: float  # A
    psi: FloatArray  # (2,), Wb
    changes: FloatArray  # (2, M), Wb
    slopes: FloatArray  # (2,), dpsi_d/di_d and dpsi_q/di_q, H
    slope_changes: FloatArray  # (2, M), H

    @classmethod
    def at(cls, drive: IdentifiedDrive, i_d: float, i_q: float, usable: BoolArray, beyond: int = 0) -> _Local | None:
        """Evaluate the polynomial through usable grid points that encloses a current; None where there is none.

        Of all such polynomials, the one whose points lie most evenly around the current, which may lie up to ``beyond``
        grid steps outside of them. ``usable`` is (D, Q).
        """
        found, modes = drive.flux_map, drive.error_modes
        starts_d, starts_q = (_starts(axis, x, beyond) for axis, x in ((found.i_d, i_d), (found.i_q, i_q)))
        pairs = sorted((d_off + q_off, m, n) for d_off, m in starts_d for q_off, n in starts_q)
        for _, m, n in pairs:
            at = np.s_[..., m : m + _NODES, n : n + _NODES]
            if usable[at].all():
                break
        else:
            return None
        (w_d, v_d), (w_q, v_q) = _weights(found.i_d[m : m + _NODES], i_d), _weights(found.i_q[n : n + _NODES], i_q)
        psi = [values[at] for values in (found.psi_d, found.psi_q)]
        none = np.zeros((0, *psi[0].shape))
        errors = [none, none] if modes is None else [values[at] for values in (modes.psi_d, modes.psi_q)]
        slopes = ((v_d, w_q), (w_d, v_q))
        return cls(
            i_d=float(i_d),
            i_q=float(i_q),
            psi=np.array([w_d @ x @ w_q for x in psi]),
            changes=np.array([w_d @ x @ w_q for x in errors]),
            slopes=np.array([d @ x @ q for x, (d, q) in zip(psi, slopes, strict=True)]),
            slope_changes=np.array([d @ x @ q for x, (d, q) in zip(errors, slopes, strict=True)]),
        )

    def where(self, drive: IdentifiedDrive) -> str:
        """Name a current of the largest torque of its amplitude."""
        radius = math.hypot(self.i_d, self.i_q)
        return "i_max, MTPA" if math.isclose(radius, drive.i_max) else f"{radius:.4g} A, MTPA"

    def inductances(self, drive: IdentifiedDrive) -> tuple[Quantity, ...]:
        """Return both incremental inductances at a current of the largest torque."""
        note = f"Incremental, at {self.currents}."
        found = tuple(self.inductance(k, f"L_{axis} at {self.where(drive)}", note) for k, axis in enumerate("dq"))
        return tuple(_noted(quantity) for quantity in found if math.isfinite(quantity.sigma))

    def torques(self, drive: IdentifiedDrive, pole_pairs: int) -> tuple[Quantity, Quantity]:
        """Return the largest torque of this amplitude of the current, and that by the amplitude."""
        (torque, change), radius = (1.5 * pole_pairs * x for x in self.per_pair), math.hypot(self.i_d, self.i_q)
        sigma, where, note = _sigma(change), self.where(drive), f"Air-gap torque at {self.currents}."
        whole = Quantity(f"Torque at {where}", float(torque), sigma, "Nm", note)
        per_current = "Of the amplitude of the current."
        return whole, Quantity(f"Torque per A at {where}", float(torque) / radius, sigma / radius, "Nm/A", per_current)

    @property
    def currents(self) -> str:
        """The current, in words."""
        return f"i_d = {self.i_d:.4g} A, i_q = {self.i_q:.4g} A".replace("-", "\N{MINUS SIGN}")

    @property
    def per_pair(self) -> tuple[FloatArray, FloatArray]:
        """Torque over 1.5 p, and its changes (M,), Nm."""
        return tuple(x[0] * self.i_q - x[1] * self.i_d for x in (self.psi, self.changes))

    def inductance(self, axis: int, name: str, note: str) -> Quantity:
        """Return one incremental inductance."""
        return Quantity(name, float(self.slopes[axis]), _sigma(self.slope_changes[axis]), "H", note)


def _noted(quantity: Quantity) -> Quantity:
    """Return a quantity with a word in its note where its standard error leaves little of it."""
    known = quantity.sigma < _WORST * quantity.value
    return quantity if known else replace(quantity, note=f"The data hardly define it. {quantity.note}")


def _sigma(changes: FloatArray) -> float:
    """Return the standard error of changes (M,) by independent causes; NaN where they are not known."""
    return float(np.linalg.norm(changes)) if len(changes) else math.nan


def _starts(axis: FloatArray, x: float, beyond: int) -> list[tuple[float, int]]:
    """Return the first of each run of grid points up to ``beyond`` steps from a current, after its distance from it."""
    several, reach = min(_NODES, len(axis)), beyond * float(axis[1] - axis[0])
    first, last = axis[: len(axis) - several + 1], axis[several - 1 :]
    runs = np.flatnonzero((first - reach <= x) & (x <= last + reach))
    return [(abs(float(axis[k : k + several].mean()) - x), int(k)) for k in runs]


def _weights(axis: FloatArray, x: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights of values at grid points in their polynomial at x, and in its slope there."""
    width = float(axis[-1] - axis[0])
    powers = ((axis - x) / width) ** np.arange(len(axis))[:, None]
    one = np.eye(len(axis))[:2] * [[1.0], [1.0 / width]]
    value, slope = np.linalg.solve(powers, one.T).T
    return value, slope
