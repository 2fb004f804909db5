"""The difference of two results: maps, torque, resistance, inverter curve."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.quantity import Tabled, measured, plain
from drive_id.core.validation.metrics import nrmse
from drive_id.errors import ConfigurationError, CoverageError
from drive_id.result.result import Result
from drive_id.types import BoolArray, FloatArray

_CURVE_POINTS = 201  # of the difference of two inverter curves
_AGREEING = 4.0  # joint standard errors that the largest of some hundred differences hardly exceeds by chance
_OTHER_MACHINE = 0.08
"""NRMSE beyond which no temperature explains a difference: a neodymium magnet loses 0.12 % per kelvin, so 65 K."""

_INTERPOLATED = 1e-4
"""NRMSE up to which tables of one map differ by the interpolation between their points: 0.003 % after an export."""
_OTHER_LINK = 0.005
"""Relative difference of two DC-link voltages from which on it can be told in the fluxes."""
_LIKE_LINK = (0.2, 0.5)
"""Shares of that difference by which the scale of each flux linkage may be off: at least, and with large errors."""


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Tabled):
    """Result A minus result B where both have data, on a grid of currents.

    Differences are NaN where one of the results has no data.

    Parameters
    ----------
    first, second : drive_id.Identification
        A and B.
    i_d, i_q : (D,), (Q,) float
        A.
    common : (D, Q) bool
        Where both have data.
    difference : (D, Q, 2) float
        Of psi_d and psi_q, Wb.
    sigma : (D, Q, 2) float
        Joint standard error of the differences, root of the sum of squares, Wb. One that is unknown counts as zero, so
        that a fit can be judged against an imported map; NaN where both are unknown.
    nrmse : (float, float)
        Of psi_d and psi_q: rms difference over the largest absolute flux of B.
    torque : (D, Q) float or None
        Difference, Nm; None when the pole pairs of both are not known and equal.
    second_torque : float
        Largest absolute torque of B, Nm; NaN without torque.
    curve_current, curve_difference : (C,) float or None
        Difference of the inverter curves, V, over the phase current, A; None when one of the results has no curve.
    """

    first: Result
    second: Result
    i_d: FloatArray
    i_q: FloatArray
    common: BoolArray
    difference: FloatArray
    sigma: FloatArray
    nrmse: tuple[float, float]
    torque: FloatArray | None
    second_torque: float
    curve_current: FloatArray | None
    curve_difference: FloatArray | None

    @property
    def in_sigma(self) -> FloatArray:
        """Differences in units of their joint standard error, (D, Q, 2); NaN where unknown."""
        usable = np.isfinite(self.sigma) & (self.sigma > 0)
        return self.difference / np.where(usable, self.sigma, np.nan)

    @property
    def resistance(self) -> float:
        """Difference of the resistances, ohm; NaN when one is unknown."""
        return self.first.resistance - self.second.resistance

    @property
    def resistance_in_sigma(self) -> float:
        """The same in units of the joint standard error; NaN where unknown."""
        sigma = float(_joint(np.array(self.first.sigma_resistance), np.array(self.second.sigma_resistance)))
        return self.resistance / sigma if math.isfinite(sigma) and sigma > 0 else math.nan

    def worst(self) -> tuple[float, float, FloatArray]:
        """Return i_d and i_q, A, of the largest difference ``hypot(d, q)``, and that difference (2,), Wb."""
        place = np.unravel_index(np.nanargmax(np.hypot(*np.moveaxis(self.difference, -1, 0))), self.common.shape)
        return float(self.i_d[place[0]]), float(self.i_q[place[1]]), self.difference[place]

    @property
    def largest_in_sigma(self) -> float:
        """Largest difference of the fluxes and of R in units of their joint standard errors; NaN if none is known."""
        units = np.abs([*self.in_sigma.ravel(), self.resistance_in_sigma])
        return float(np.nanmax(units)) if np.isfinite(units).any() else math.nan

    @property
    def verdict(self) -> str:
        """Whether both can be of the same machine, two or three sentences."""
        largest, apart = self.largest_in_sigma, f"The fluxes differ by {100 * max(self.nrmse):.3g} % NRMSE"
        if math.isfinite(largest):
            apart += f", and the largest difference, R included, is {largest:.3g} joint standard errors"
        if max(self.nrmse) > _OTHER_MACHINE:
            told = "These are different machines, or maps in different units, axes or signs."
        elif math.isnan(largest):
            told = "It may be the same machine: without standard errors nothing more can be said."
        elif largest <= _AGREEING:
            told = "The same machine, as far as the standard errors can tell."
        elif max(self.nrmse) < _INTERPOLATED and not abs(self.resistance_in_sigma) > _AGREEING:
            told = "The same machine: tables of one map differ as much by interpolation."
        else:
            told = (
                "It may be the same machine at another temperature or with other sensor gains, but the standard errors "
                "alone do not explain the difference."
            )
            told = self.by_link or f"{told}{self.by_temperature}"
        return f"{apart}. {told}"

    @property
    def by_temperature(self) -> str:
        """A sentence, behind a blank, on the temperatures of R where these are not the same, or one is not known."""
        one, two = (x.provenance.temperature for x in (self.first, self.second))
        if one == two:
            return ""
        of_a, of_b = ("as recorded" if t is None else f"at {t:g} °C" for t in (one, two))
        return f" R of A holds {of_a}, R of B {of_b}."

    @property
    def by_link(self) -> str:
        """A sentence on the DC link where its voltages differ and both flux linkages by this ratio; else empty.

        Fluxes are proportional to the voltages: they scale with the link by which a drive reckons, or inversely with
        that which it does not know.
        """
        one, two = self.first.u_dc, self.second.u_dc
        if one is None or two is None or abs(ratio := math.log(one / two)) < _OTHER_LINK:
            return ""
        own = np.stack(self.first.drive.flux_map.psi_dq(*np.meshgrid(self.i_d, self.i_q, indexing="ij")), axis=-1)
        own, apart, sigma = (x[self.common] for x in (own, self.difference, self.sigma))
        power = ((own - apart) ** 2).sum(axis=0)
        scale = np.log1p((apart * (own - apart)).sum(axis=0) / power)
        vague = np.nan_to_num(np.abs(own - apart) * sigma).sum(axis=0) / power  # as if all erred alike
        least, most = (share * abs(ratio) for share in _LIKE_LINK)
        near = np.clip(2.0 * vague, least, most)
        if not (np.abs(np.abs(scale) - abs(ratio)) <= near).all() or len({*np.sign(scale)}) != 1 or not scale.all():
            return ""
        told = " and ".join(f"{100 * math.expm1(value):+.2g} %" for value in scale)
        return (
            f"The DC link can explain it: {measured(one, unit='V')} in A and {measured(two, unit='V')} in B are "
            f"{100 * math.expm1(ratio):+.2g} %, and ψ_d and ψ_q differ by {told}. Check with which link each drive "
            "reckoned."
        )

    @property
    def summary(self) -> str:
        """Names of A and B, and the verdict."""
        return f"{self.title}\n{self.verdict}"

    @property
    def title(self) -> str:
        """What is compared."""
        first, second = (f"{x.machine or 'unknown machine'} ({x.method})" for x in (self.first, self.second))
        return f"A − B where both have data; A: {first}, B: {second}"

    def rows(self) -> list[tuple[str, ...]]:
        """Return quantity, difference, and the same in joint standard errors, as ``drive-id compare`` prints them."""
        tree, told = self.tree(), self.first.told
        rows: list[tuple[str, ...]] = [("Quantity", "Difference", "Std. errors")]

        def sigmas(value: float | None) -> str:
            return "unknown" if value is None else f"{value:.3g}".replace("-", "\N{MINUS SIGN}")

        for axis in "dq":
            rms = f"{told(tree[f'rms_{axis}'], unit='Wb')} ({100 * tree[f'nrmse_{axis}']:.4g} %)"
            rows.append((f"ψ_{axis}, rms (NRMSE)", rms, sigmas(tree[f"rms_{axis}_in_sigma"])))
        worst = tree["worst"]
        size = math.hypot(worst["psi_d"], worst["psi_q"])
        rows.append(("ψ, largest", told(size, unit="Wb"), sigmas(tree["largest_in_sigma"])))
        rows.append(("  at i_d, i_q", f"{measured(worst['i_d'], unit='A')}, {measured(worst['i_q'], unit='A')}", ""))
        known = "unknown" if tree["resistance"] is None else told(tree["resistance"], unit="Ω")
        rows.append(("R", known, sigmas(tree["resistance_in_sigma"])))
        for what, key, unit in (("Inverter curve", "inverter_curve", "V"), ("Torque", "torque", "Nm")):
            if (found := tree[key]) is not None:
                pair = f"{measured(found['rms'], unit=unit)} ({measured(found['largest'], unit=unit)})"
                rows.append((f"{what}, rms (largest)", pair, ""))
        return [*rows, ("Points compared", str(tree["points"]), "")]

    def tree(self) -> dict[str, Any]:
        """Return all figures as plain values; None if unknown."""
        i_d, i_q, worst = self.worst()
        units = self.in_sigma
        torque, relative = None, None
        if self.torque is not None:
            torque = {"rms": _rms(self.torque), "largest": float(np.nanmax(np.abs(self.torque)))}
            relative = torque["rms"] / self.second_torque if self.second_torque > 0 else None
        tree = {
            "verdict": self.verdict,
            "points": int(np.count_nonzero(self.common)),
            "nrmse_d": self.nrmse[0],
            "nrmse_q": self.nrmse[1],
            "rms_d": _rms(self.difference[..., 0]),
            "rms_q": _rms(self.difference[..., 1]),
            "rms_d_in_sigma": _rms(units[..., 0]),
            "rms_q_in_sigma": _rms(units[..., 1]),
            "largest_in_sigma": float(np.nanmax(np.abs(units))) if np.isfinite(units).any() else math.nan,
            "worst": {"i_d": i_d, "i_q": i_q, "psi_d": float(worst[0]), "psi_q": float(worst[1])},
            "resistance": self.resistance,
            "resistance_in_sigma": self.resistance_in_sigma,
            "inverter_curve": None
            if self.curve_difference is None
            else {"rms": _rms(self.curve_difference), "largest": float(np.abs(self.curve_difference).max())},
            "torque": torque,
            "nrmse_torque": relative,
        }
        found: dict[str, Any] = plain(tree)
        return found


def compare(first: Result | str | Path, second: Result | str | Path) -> Comparison:
    """Compare two results.

    Parameters
    ----------
    first, second : drive_id.Identification or path
        A and B, or their folders; differences are A minus B.

    Returns
    -------
    Comparison
        On the grid of A.

    Raises
    ------
    CoverageError
        When the results have no currents in common.
    ConfigurationError
        When all flux linkages of B are zero, or the rotor was locked for one of them only.
    """
    first, second = (x if isinstance(x, Result) else Result.load(x) for x in (first, second))
    found, other = first.drive.flux_map, second.drive.flux_map
    grid = np.meshgrid(found.i_d, found.i_q, indexing="ij")
    psi, psi_other = (np.stack(each.psi_dq(*grid), axis=-1) for each in (found, other))
    difference = psi - psi_other
    common = np.asarray(np.isfinite(difference).all(axis=-1))
    if not common.any():
        raise CoverageError("The two results have no currents in common: compare maps of the same machine.")
    sigma = _joint(*(np.stack(each.sigma(*grid), axis=-1) for each in (found, other)))
    if not np.abs(psi_other[common]).max(axis=0).all():
        raise ConfigurationError("A flux linkage of the second result is zero everywhere: compare with another result.")
    if first.origin.turning != second.origin.turning:
        raise ConfigurationError(
            "One of the results is of a locked rotor, so its fluxes lack those of the magnets: compare it with another "
            "one of a locked rotor."
        )
    pairs = first.pole_pairs if first.origin.turning else None
    torque, largest = None, math.nan
    if pairs is not None and pairs == second.pole_pairs:
        own, others = (1.5 * pairs * (x[..., 0] * grid[1] - x[..., 1] * grid[0]) for x in (psi, psi_other))
        torque, largest = own - others, float(np.nanmax(np.abs(np.where(common, others, np.nan))))
    apart = nrmse(psi[common], psi_other[common])
    return Comparison(
        first, second, found.i_d, found.i_q, common, difference, sigma, apart, torque, largest, *_curves(first, second)
    )


def _curves(first: Result, second: Result) -> tuple[FloatArray | None, FloatArray | None]:
    if not (first.origin.inverter and second.origin.inverter):
        return None, None
    curves = (first.inverter_curve, second.inverter_curve)
    reach = min(float(np.abs(curve.current).max()) for curve in curves)
    current = np.linspace(-reach, reach, _CURVE_POINTS)
    drops = [np.interp(current, curve.current, curve.voltage) for curve in curves]
    return current, drops[0] - drops[1]


def _joint(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the root sum of squares of the known standard errors; NaN where both are unknown."""
    known = np.isfinite(first) | np.isfinite(second)
    joint = np.hypot(np.where(np.isfinite(first), first, 0.0), np.where(np.isfinite(second), second, 0.0))
    return np.where(known, joint, np.nan)


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan
