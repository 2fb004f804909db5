"""A flux map sampled on the axes of a table, which every format writes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from drive_id.analysis.machine import MachineModel
from drive_id.analysis.ripple import TorqueRipple
from drive_id.common.version import VERSION
from drive_id.errors import ConfigurationError, CoverageError
from drive_id.exchange.exports.axes import default_axis
from drive_id.exchange.exports.options import ExportOptions
from drive_id.result.result import Result
from drive_id.types import BoolArray, FloatArray

_PER_PERIOD = 12  # angles per period of the highest harmonic: linear interpolation is off by 3 % of it
_LEAST_ANGLES = 4  # of a table over the angle, without harmonics too
_NEGLIGIBLE = 0.01  # amplitude of a harmonic, by the largest flux, that may be left out
_COARSE = 0.01  # error of bilinear interpolation, by the largest flux, above which it is told
_BEYOND = 1.5  # reach of the map, in i_max: overshoot of a simulated current
_FARTHEST = 3.0  # reach of the map for a wider table, in i_max: continued to 10 times i_max, it takes a minute


class AtZero(NamedTuple):
    """Inductances L_d and L_q for control, H, and psi_d, Wb, at zero current."""

    l_d: float
    l_q: float
    magnet: float


@dataclass(frozen=True, eq=False)
class MapTable:
    """A result on the axes of a table.

    Arrays over the current plane are indexed [i_d, i_q]. Where there are no data they are NaN, unless the table is
    filled; ``inside`` tells.
    """

    result: Result
    machine: MachineModel  # continued beyond the data
    i_d: FloatArray  # (D,), A
    i_q: FloatArray  # (Q,), A
    filled: bool = False  # points without data hold the continuation of the map
    identified: MachineModel | None = None  # where ``machine`` has the nearest monotone map instead of this one
    remarks: list[str] = field(default_factory=list)  # sentences of the writers on what the file holds

    @classmethod
    def of(cls, result: Result, options: ExportOptions, *, simulated: bool = True) -> MapTable:
        """Sample a result, or the nearest monotone map if it is to be simulated.

        Raises CoverageError when no point of the table has data.
        """
        i_d, i_q = (default_axis(result.i_max) if axis is None else axis for axis in (options.i_d, options.i_q))
        asked = max(float(np.abs(axis).max()) for axis in (i_d, i_q))
        reach = min(max(_BEYOND * result.i_max, asked), _FARTHEST * result.i_max)
        machine = MachineModel.of(result, pole_pairs=options.pole_pairs, u_dc=options.u_dc, reach=reach)
        whole = machine.rising if simulated else machine
        table = cls(result, whole, i_d, i_q, options.filled, None if machine.monotone_inside else machine)
        if not table.inside.any():
            raise CoverageError("No point of the table has data: choose a smaller --range.")
        return table

    def on(self, i_d: FloatArray, i_q: FloatArray) -> MapTable:
        """Return the table of the same map on other axes (D,), (Q,), A."""
        return replace(self, i_d=i_d, i_q=i_q)

    @cached_property
    def fold(self) -> str:
        """A sentence on a map that is not monotone where there are data, and what the table holds of it; else empty."""
        if self.identified is None:
            return ""
        told = self.identified.fold
        if self.machine is self.identified:
            return f"{told} The table holds the map as it was identified."
        psi = np.stack([self.identified.psi_dq(*self.grid), self.machine.psi_dq(*self.grid)])
        moved = float(np.hypot(*(psi[1] - psi[0]))[self.inside].max())
        share = 100 * moved / float(np.hypot(*psi[0])[self.inside].max())
        return (
            f"{told} The file holds the nearest monotone map, whose fluxes differ by at most {moved:.2g} Wb "
            f"({share:.2g} %) within the data."
        )

    @cached_property
    def grid(self) -> tuple[FloatArray, FloatArray]:
        """i_d and i_q of all points, (D, Q) each, A."""
        i_d, i_q = np.meshgrid(self.i_d, self.i_q, indexing="ij")
        return i_d, i_q

    @cached_property
    def inside(self) -> BoolArray:
        """Where there are data, (D, Q)."""
        return self.machine.inside(*self.grid)

    @property
    def missing(self) -> int:
        """Number of points without data."""
        return int(np.count_nonzero(~self.inside))

    def masked(self, values: FloatArray) -> FloatArray:
        """Return values (D, Q, ...), NaN at points without data unless the table is filled."""
        if self.filled:
            return values
        return np.where(self.inside.reshape(*self.inside.shape, *[1] * (values.ndim - 2)), values, np.nan)

    @cached_property
    def psi(self) -> tuple[FloatArray, FloatArray]:
        """psi_d and psi_q, (D, Q) each, Wb: those of the result where it has data."""
        psi_d, psi_q = self.machine.psi_dq(*self.grid)
        return self.masked(psi_d), self.masked(psi_q)

    @cached_property
    def sigma(self) -> tuple[FloatArray, FloatArray]:
        """Standard errors of psi_d and psi_q, (D, Q) each, Wb; NaN without data."""
        return self.machine.flux_map.sigma(*self.grid)

    @cached_property
    def inductances(self) -> FloatArray:
        """Incremental inductances (D, Q, 2, 2), H."""
        return self.masked(self.machine.inductances(*self.grid))

    @cached_property
    def torque(self) -> FloatArray:
        """1.5 p (psi_d i_q - psi_q i_d), (D, Q), Nm; raises ConfigurationError without pole pairs."""
        (i_d, i_q), (psi_d, psi_q) = self.grid, self.psi
        return np.asarray(1.5 * self.machine.known_pole_pairs() * (psi_d * i_q - psi_q * i_d))

    @cached_property
    def quantities(self) -> dict[str, tuple[FloatArray, str, str]]:
        """Values (D, Q), unit and description by name; the torque where the pole pairs are known."""
        found = {f"psi_{x}": (psi, "Wb", f"flux linkage, {x} axis") for x, psi in zip("dq", self.psi, strict=True)}
        found |= {
            f"sigma_{x}": (sigma, "Wb", f"standard error of psi_{x}") for x, sigma in zip("dq", self.sigma, strict=True)
        }
        if self.machine.pole_pairs is not None:
            found["torque"] = self.torque, "N m", "torque, averaged over the rotor position"
        for j, a in enumerate("dq"):
            for k, b in enumerate("dq"):
                found[f"L_{a}{b}"] = self.inductances[..., j, k], "H", f"incremental inductance, dpsi_{a}/di_{b}"
        return found

    @cached_property
    def harmonics(self) -> tuple[tuple[int, FloatArray], ...]:
        """Order and amplitudes (D, Q, 4), Wb, of psi_d cos, psi_d sin, psi_q cos, psi_q sin, of each harmonic."""
        ripple, found = self._ripple, []
        for order, *surfaces in zip(ripple.orders, ripple.cosines, ripple.sines, strict=True):
            amplitudes = np.stack([surface.values(*self.grid) for surface in surfaces], axis=-1)
            found.append((order, self.masked(amplitudes.reshape(*self.inside.shape, 4))))
        return tuple(found)

    @cached_property
    def _ripple(self) -> TorqueRipple:
        return TorqueRipple.of(self.machine)

    def repeating(self, span: float) -> MapTable:
        """Return this table with only those harmonics that repeat after an electrical angle, rad.

        Raises ConfigurationError when one that does not is larger than a hundredth of the largest flux.
        """
        kept = []
        largest = float(np.nanmax(np.hypot(*self.psi)))
        found = self.machine.flux_map
        for harmonic, (order, amplitudes) in zip(found.harmonics, self.harmonics, strict=True):
            periods = order * span / (2 * np.pi)
            if abs(periods - round(periods)) < 1e-9:
                kept.append(harmonic)
            elif np.nanmax(np.abs(amplitudes)) > _NEGLIGIBLE * largest:
                raise ConfigurationError(
                    f"The harmonic of order {order} does not repeat after {np.degrees(span):g} degrees electrical, as "
                    "this format assumes: export another format."
                )
        return replace(self, machine=replace(self.machine, flux_map=replace(found, harmonics=tuple(kept))))

    def angles(self, span: float | None = None) -> FloatArray:
        """Return electrical angles from 0 over a span, without its end, spaced finely enough for all harmonics, rad.

        Default: over the period that all harmonics share.
        """
        span = 2 * np.pi / np.gcd.reduce([order for order, _ in self.harmonics]) if span is None else span
        periods = max((math.ceil(order * span / (2 * np.pi)) for order, _ in self.harmonics), default=0)
        count = max(_LEAST_ANGLES, _PER_PERIOD * periods)
        return np.arange(count, dtype=np.float64) * (span / count)

    def psi_theta(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return psi_d and psi_q (D, Q, H), Wb, at electrical angles (H,), rad."""
        psi_d, psi_q = (np.repeat(psi[..., None], len(theta), axis=-1) for psi in self.psi)
        for order, amplitudes in self.harmonics:
            cosine, sine = np.cos(order * theta), np.sin(order * theta)
            psi_d += amplitudes[..., 0, None] * cosine + amplitudes[..., 1, None] * sine
            psi_q += amplitudes[..., 2, None] * cosine + amplitudes[..., 3, None] * sine
        return psi_d, psi_q

    def torque_theta(self, theta: FloatArray) -> FloatArray:
        """Return the torque (D, Q, H), Nm, at electrical angles (H,), rad, without the cogging at zero current.

        Raises ConfigurationError when the pole pairs are unknown.
        """
        ripple = self._ripple.over_angle(*self.grid, theta) if self.harmonics else np.zeros(len(theta))
        return self.masked(self.torque[..., None] + ripple)

    @cached_property
    def at_zero(self) -> AtZero:
        """What controllers with one number for all currents need."""
        L = self.machine.control_inductances(0.0, 0.0)
        return AtZero(float(L[0, 0]), float(L[1, 1]), float(self.machine.psi_dq(0.0, 0.0)[0]))

    @cached_property
    def interpolation_error(self) -> float:
        """Largest distance of bilinear interpolation in the table from the map, where there are data, Wb."""
        i_d, i_q = (axis[:-1] + np.diff(axis) / 2 for axis in (self.i_d, self.i_q))
        d, q = np.meshgrid(i_d, i_q, indexing="ij")
        apart = []
        for nodes, between in zip(self.machine.psi_dq(*self.grid), self.machine.psi_dq(d, q), strict=True):
            corners = nodes[:-1, :-1] + nodes[1:, :-1] + nodes[:-1, 1:] + nodes[1:, 1:]
            apart.append(corners / 4 - between)
        return float(np.hypot(*apart)[self.machine.inside(d, q)].max(initial=0.0))

    @property
    def coarse(self) -> str:
        """A sentence where bilinear interpolation is far off; else empty."""
        if self.interpolation_error <= _COARSE * float(np.nanmax(np.hypot(*self.psi))):
            return ""
        return f"The table is coarse: choose a larger --grid, or read it with splines. {self.source}"

    @property
    def source(self) -> str:
        """Sentences on where the table is from, its units, and its error."""
        result = self.result
        since = f" of {result.provenance.date}" if result.provenance.date else ""
        held = result.provenance.temperature
        of_winding = "" if held is None else f" R is that at {held:g} degrees Celsius."
        off, largest = self.interpolation_error, float(np.nanmax(np.hypot(*self.psi)))
        return (
            f"Written by drive_id {VERSION}: result{since} by method {result.method}. Units: A and V "
            f"(peak), Wb, H, ohm, Nm. Between the points, bilinear interpolation is off by at most {off:.2g} Wb "
            f"({100 * off / largest:.2g} % of the largest flux).{of_winding} {self.fold}".rstrip()
        )

    def facts(self) -> dict[str, str | float | int]:
        """Return the known facts about the machine and the table, by name; SI units."""
        machine, result = self.machine, self.result
        texts = {"machine": plain(result.machine), "method": result.method, "source": self.source}
        numbers = {
            "resistance": machine.resistance,
            "sigma_resistance": result.sigma_resistance,
            "pole_pairs": machine.pole_pairs,
            "i_max": machine.i_max,
            "u_dc": machine.u_dc,
            "filled": int(self.filled),
        }
        known = {name: value for name, value in numbers.items() if value is not None and math.isfinite(value)}
        return {name: text for name, text in texts.items() if text} | known

    def known_resistance(self) -> float:
        """Return the resistance, ohm; raises ConfigurationError when it is unknown."""
        if not np.isfinite(self.machine.resistance):
            raise ConfigurationError(
                "The result does not tell the resistance, which this format needs: import the map with --resistance."
            )
        return self.machine.resistance


def plain(text: str) -> str:
    """Return text for a comment: on one line, and no cell of it is a formula."""
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    return printable.replace(",", ";").replace("\t", " ")
