"""An identified drive as smooth functions of the current, as analyses and exports evaluate it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from drive_id.analysis.bands import BY_SPEED, ModelErrors, combined
from drive_id.analysis.iron_loss import IronLoss
from drive_id.common.quantity import counted, measured
from drive_id.common.temperature import COLDEST, COPPER, HOTTEST, REFERENCE_TEMPERATURE
from drive_id.core.maps.continuation import LongerGrid, continued
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.maps.flux_models import positive_definite
from drive_id.core.maps.surfaces import Surfaces
from drive_id.errors import ConfigurationError, CoverageError
from drive_id.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from drive_id.result.result import Result

_MARGIN = 1.25  # reach of the map, in i_max; a trajectory or a controller's overshoot may need more than the data cover
_ANGLES = 180  # over a half turn of the current, for the fundamental of the drop and the rim of the disc
_FEWEST = 16  # points with data from which a map can be continued
_CONSEQUENCE = (
    "Gains and exports for simulation use the nearest monotone map; a fit with monotone set finds one itself."
)
_LEAST_SLOPE = 0.05
"""Of the nearest monotone map relative to the typical one: a spline through its samples is up to 0.02 less steep."""
_HALVINGS = 4  # of the grid's steps at most, until splines through samples of that map are monotone as well
_RIM = 1.001
"""Current relative to i_max that counts as i_max."""


@dataclass(frozen=True, eq=False)
class MachineModel:
    """An identified drive as smooth functions of the current, continued beyond the data; build it by :meth:`of`.

    Currents broadcast against each other to shape (...). Where :meth:`inside` is false, values are a continuation with
    the typical slopes of the data; beyond the grid they are linear.

    Parameters
    ----------
    flux_map : FluxMap
        Continued to at least 1.25 i_max on both axes; ``inside`` tells where there are data, or data all around.
    i_max : float
        Radius of the current disc of the experiment, A.
    resistance : float
        With the linear part of the inverter's drop, ohm; NaN when unknown.
    pole_pairs, u_dc : int, float or None
        None when unknown; what needs them raises.
    inverter_current, inverter_voltage : (C,) float
        The drop of one phase, V, over its current, A.
    iron : IronLoss
    resistance_by_speed : float
        Rise of the resistance over the square of the electrical speed, by skin and proximity effect, ohm s^2/rad^2.
    temperature, magnet_temperature : float or None
        Degrees Celsius; None: as in the experiment.
    errors : ModelErrors or None
        None when the standard errors are not known.
    everywhere : Surfaces or None
        The map without and with data; None: that of ``flux_map``.
    """

    flux_map: FluxMap
    i_max: float
    resistance: float
    pole_pairs: int | None
    u_dc: float | None
    inverter_current: FloatArray
    inverter_voltage: FloatArray
    iron: IronLoss = field(default_factory=IronLoss)
    resistance_by_speed: float = 0.0
    temperature: float | None = None
    magnet_temperature: float | None = None
    errors: ModelErrors | None = None
    everywhere: Surfaces | None = None

    @classmethod
    def of(
        cls,
        result: Result,
        *,
        temperature: float | None = None,
        magnet_temperature: float | None = None,
        pole_pairs: int | None = None,
        u_dc: float | None = None,
        reach: float = 0.0,
    ) -> MachineModel:
        """Build the model of a result, fitted, loaded or imported.

        Parameters
        ----------
        result : drive_id.Identification
        temperature : float, optional
            Of the winding, degrees Celsius: R follows copper from its value at 20 degrees. Default: R as identified.
        magnet_temperature : float, optional
            Degrees Celsius: psi_d follows the identified coefficient of the magnet, if there is one. Default:
            ``temperature``.
        pole_pairs : int, optional
            Default: those of the result.
        u_dc : float, optional
            V. Default: that of the result.
        reach : float
            To which both axes of the map are continued at least, A.

        Raises
        ------
        ConfigurationError
            When a value is not positive or not finite, the temperature is out of range, or the rotor was locked.
        CoverageError
            When the map has hardly any data.
        """
        result.check_turning()
        pairs, link = result.pole_pairs if pole_pairs is None else pole_pairs, result.u_dc if u_dc is None else u_dc
        if pairs is not None and pairs < 1:
            raise ConfigurationError(f"pole_pairs is {pairs}: give a whole number of at least 1.")
        if link is not None and not (np.isfinite(link) and link > 0):
            raise ConfigurationError(f"u_dc is {link} V: it must be a positive number.")
        magnet = temperature if magnet_temperature is None else magnet_temperature
        for name, value in (("temperature", temperature), ("magnet_temperature", magnet)):
            if value is not None and not COLDEST <= value <= HOTTEST:
                raise ConfigurationError(
                    f"{name} is {value} degC: it must be between {COLDEST:g} and {HOTTEST:g} degC."
                )
        found = result.flux_map.whole
        if found.inside.sum() < _FEWEST:
            raise CoverageError(
                f"The flux map has only {counted(found.inside.sum(), 'point')} with data: at least "
                f"{_FEWEST} are needed; record "
                "more of the current disc."
            )
        longer = LongerGrid.around(found, max(_MARGIN * result.i_max, reach))
        flux_map, coefficient = longer.flux_map(), result.drive.magnet_coefficient
        if magnet is not None and coefficient is not None:
            warmed = flux_map.psi_d + coefficient[0] * (magnet - REFERENCE_TEMPERATURE)
            flux_map = replace(flux_map, psi_d=warmed)
        factor = 1.0 if temperature is None else 1 + COPPER * (temperature - REFERENCE_TEMPERATURE)
        warmer = 0.0 if magnet is None else magnet - REFERENCE_TEMPERATURE
        return cls(
            flux_map=flux_map,
            i_max=result.i_max,
            resistance=result.resistance * factor,
            pole_pairs=pairs,
            u_dc=link,
            inverter_current=result.inverter_curve.current,
            inverter_voltage=result.inverter_curve.voltage,
            iron=IronLoss.of(result),
            # warm copper conducts the currents within a conductor less
            resistance_by_speed=sum(x.value for x in result.calibrations if x.name == BY_SPEED and x.applied) / factor,
            temperature=temperature,
            magnet_temperature=magnet,
            errors=ModelErrors.of(result.drive, longer, warmer=factor, magnet=warmer),
        )

    def inside(self, i_d: ArrayLike, i_q: ArrayLike) -> BoolArray:
        """Return (...) where the map rests on data; elsewhere it is extrapolated.

        At i_max, which an experiment just reaches, grid cells have corners without data: there, the current that is one
        cell nearer to zero decides.
        """
        d, q = _currents(i_d, i_q)
        size = np.hypot(d, q)
        cell = self.cell
        rim = (size > self.i_max - cell) & (size <= _RIM * self.i_max)
        inward = np.where(rim, 1 - cell / np.maximum(size, cell), 1.0)
        return np.isfinite(self.flux_map.psi_dq(inward * d, inward * q)[0])

    @property
    def cell(self) -> float:
        """Largest diagonal of a cell of the map's grid, A."""
        return float(np.hypot(*(np.diff(axis).max() for axis in (self.flux_map.i_d, self.flux_map.i_q))))

    def psi_dq(self, i_d: ArrayLike, i_q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return psi_d and psi_q (...), Wb, averaged over the rotor position."""
        psi = self._surfaces.values(*_currents(i_d, i_q))
        return psi[..., 0][()], psi[..., 1][()]

    def inductances(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return the incremental inductances [[L_dd, L_dq], [L_qd, L_qq]] (..., 2, 2), H; L_dq is dpsi_d/di_q."""
        return self._surfaces.slopes(*_currents(i_d, i_q))

    def apparent_inductances(self, i_d: ArrayLike, i_q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return L_d = (psi_d - psi_d(0, i_q)) / i_d and L_q = (psi_q - psi_q(i_d, 0)) / i_q (...), H.

        The magnet's flux, with its change by the other axis, is left out, so that both are finite everywhere: at zero
        current they are the incremental inductances.
        """
        d, q = _currents(i_d, i_q)
        zero = np.zeros_like(d)
        psi, without_d, without_q = (self._surfaces.values(*at) for at in ((d, q), (zero, q), (d, zero)))
        at_zero_d, at_zero_q = self.inductances(zero, q)[..., 0, 0], self.inductances(d, zero)[..., 1, 1]
        near = 1e-6 * self.i_max
        l_d = np.where(np.abs(d) > near, (psi - without_d)[..., 0] / np.where(np.abs(d) > near, d, 1.0), at_zero_d)
        l_q = np.where(np.abs(q) > near, (psi - without_q)[..., 1] / np.where(np.abs(q) > near, q, 1.0), at_zero_q)
        return l_d[()], l_q[()]

    def torque(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return the torque 1.5 p (psi_d i_q - psi_q i_d) (...), Nm.

        Raises
        ------
        ConfigurationError
            When the pole pairs are unknown.
        """
        d, q = _currents(i_d, i_q)
        psi_d, psi_q = self.psi_dq(d, q)
        return np.asarray(1.5 * self.known_pole_pairs() * (psi_d * q - psi_q * d))[()]

    def sigma_torque(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return the standard error of the torque (...), Nm; NaN outside the data and where it is not known."""
        d, q = _currents(i_d, i_q)
        return np.where(self.inside(d, q), combined(self.torque_changes(d, q)), np.nan)[()]

    def torque_changes(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Return the changes of the torque (M, ...), Nm, with each cause of error; NaN without any known."""
        if self.errors is None:
            return np.full((1, *i_d.shape), np.nan)
        psi = self.errors.fluxes(i_d, i_q)
        return np.asarray(1.5 * self.known_pole_pairs() * (psi[..., 0] * i_q - psi[..., 1] * i_d))

    def sigma_inductances(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return the standard errors (..., 2, 2) of the incremental inductances, H; NaN as for the torque."""
        d, q = _currents(i_d, i_q)
        if self.errors is None:
            return np.full((*d.shape, 2, 2), np.nan)
        sigma = combined(self.errors.inductances(d, q))
        return np.where(self.inside(d, q)[..., None, None], sigma, np.nan)

    def current(self, psi_d: ArrayLike, psi_q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the currents i_d, i_q (...), A, for flux linkages, Wb: the inverse map.

        Where the map is not monotone, that of the nearest monotone map. NaN where no such flux is reached. Whether the
        currents lie within the data, :meth:`inside` tells.
        """
        wanted = np.stack(_currents(psi_d, psi_q), axis=-1)
        i_dq = self.inverted.inverse(wanted.reshape(-1, 2)).reshape(wanted.shape)
        return i_dq[..., 0][()], i_dq[..., 1][()]

    def known_pole_pairs(self) -> int:
        """Return the number of pole pairs.

        Raises
        ------
        ConfigurationError
            When it is unknown.
        """
        if self.pole_pairs is None:
            raise ConfigurationError(
                "The result does not tell the number of pole pairs, which torque and speed need: give --pole-pairs "
                "(pole_pairs)."
            )
        return self.pole_pairs

    def known_u_dc(self) -> float:
        """Return the DC-link voltage, V.

        Raises
        ------
        ConfigurationError
            When it is unknown.
        """
        if self.u_dc is None:
            raise ConfigurationError(
                "The result does not tell the DC-link voltage, which the voltage limit needs: give --u-dc (u_dc), V."
            )
        return self.u_dc

    @cached_property
    def _fundamental(self) -> tuple[FloatArray, FloatArray]:
        """Return amplitudes of the current (N,), A, and of the drop's fundamental (N,), V."""
        angle = (np.arange(_ANGLES) + 0.5) * (np.pi / _ANGLES)
        amplitude = np.linspace(0.0, max(float(self.inverter_current[-1]), _MARGIN * self.i_max), 257) ** 2
        amplitude /= np.sqrt(amplitude[-1])  # denser near zero, where the curve is steep
        phase = np.interp(amplitude[:, None] * np.cos(angle), self.inverter_current, self.inverter_voltage)
        return amplitude, 2 * np.mean(phase * np.cos(angle), axis=1)

    def inverter_drop(self, i_d: ArrayLike, i_q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the fundamental of the inverter's drop in d and q (...), V, in phase with the current."""
        d, q = _currents(i_d, i_q)
        size = np.hypot(d, q)
        ratio = np.interp(size, *self._fundamental) / np.where(size > 0, size, np.inf)
        return (ratio * d)[()], (ratio * q)[()]

    @cached_property
    def monotone(self) -> bool:
        """Whether each flux belongs to one current: the map is monotone at all nodes of its grid and between them."""
        return bool(self._rising[0].all())

    @cached_property
    def monotone_inside(self) -> bool:
        """Whether the map is monotone where there are data, so that its incremental inductances serve as gains."""
        rising, inside = self._rising
        return bool(rising[inside].all())

    @cached_property
    def _rising(self) -> tuple[BoolArray, BoolArray]:
        """Tell at nodes and between them where the inductance matrix is positive definite, and where data are."""
        i_d, i_q = np.meshgrid(*self._nodes, indexing="ij")
        return positive_definite(self._surfaces.slopes(i_d, i_q)), self.inside(i_d, i_q)

    @property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        """Currents of the grid's nodes and between them along both axes, A."""
        return halved(self.flux_map.i_d), halved(self.flux_map.i_q)

    def control_inductances(self, i_d: ArrayLike, i_q: ArrayLike) -> FloatArray:
        """Return incremental inductances (..., 2, 2), H, that are positive definite where there are data.

        They are those of the map if it is monotone where there are data, else those of the nearest monotone map.

        Raises
        ------
        CoverageError
            When they are not positive definite nevertheless.
        """
        d, q = _currents(i_d, i_q)
        found = (self._surfaces if self.monotone_inside else self.inverted).slopes(d, q)
        wrong = ~positive_definite(found) & self.inside(d, q)
        if wrong.any():
            raise CoverageError(
                f"The incremental inductances are not positive at {int(wrong.sum())} of {wrong.size} currents, even "
                f"those of the nearest monotone map, first at i_d = {d[wrong][0]:.4g} A, i_q = {q[wrong][0]:.4g} A: no "
                "gains follow from this map; record it again or leave its outliers out."
            )
        return found

    @cached_property
    def inductance_range(self) -> tuple[float, float]:
        """The smallest and largest incremental inductance, in any direction, within i_max where there are data, H."""
        turn = np.linspace(0, 2 * np.pi, _ANGLES, endpoint=False)
        rim = self.i_max * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        points = np.concatenate([self.flux_map.grid().reshape(-1, 2), rim])
        kept = (np.hypot(*points.T) <= _RIM * self.i_max) & self.inside(*points.T)
        found = self.control_inductances(*points[kept].T)
        sizes = np.linalg.eigvalsh(0.5 * (found + np.swapaxes(found, -1, -2)))
        return float(sizes.min()), float(sizes.max())

    @cached_property
    def inverted(self) -> Surfaces:
        """The map used for the inverse: the map itself if it is monotone, else the nearest monotone map."""
        if self.monotone:
            return self._surfaces
        from drive_id.core.maps.monotone import REACH, fit_monotone  # noqa: PLC0415  # only the inverse needs it

        found, grid = self.flux_map, self.flux_map.grid()
        points, psi = grid[found.inside], found.psi[found.inside]
        reach = 1 + float(np.abs(grid).max() / np.hypot(points[:, 0], points[:, 1]).max())
        whole = fit_monotone(points, psi, reach=max(REACH, reach), margin=_LEAST_SLOPE)
        i_d, i_q = found.i_d, found.i_q
        for _ in range(_HALVINGS):
            samples = whole.psi(np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1))
            surfaces = Surfaces.over(i_d, i_q, samples[..., 0], samples[..., 1])
            i_d, i_q = halved(i_d), halved(i_q)
            if positive_definite(surfaces.slopes(*np.meshgrid(i_d, i_q, indexing="ij"))).all():
                break
        return surfaces

    @cached_property
    def rising(self) -> MachineModel:
        """The drive with a map that is monotone everywhere, as a simulation needs it.

        Where there are data, it is the map itself if that is monotone there, else the nearest monotone map.
        """
        if self.monotone:
            return self
        found, grid = self.flux_map, self.flux_map.grid()
        nearest = np.moveaxis(self.inverted.values(grid[..., 0], grid[..., 1]), -1, 0)
        there = replace(found, psi_d=nearest[0], psi_q=nearest[1])
        whole = replace(self, flux_map=there, everywhere=self.inverted)
        if not self.monotone_inside:
            return whole
        away = np.stack([found.psi_d, found.psi_q]) - nearest
        psi_d, psi_q = nearest + continued(away, found.inside, (found.i_d, found.i_q), (0.0, 0.0))
        kept = replace(self, flux_map=replace(found, psi_d=psi_d, psi_q=psi_q))
        return kept if kept.monotone else whole

    @property
    def fold(self) -> str:
        """A sentence on where the map is not monotone although there are data."""
        axes, (rising, inside) = self._nodes, self._rising
        wrong = np.argwhere(inside & ~rising)
        d, q = (axis[place] for axis, place in zip(axes, wrong.T, strict=True))
        slopes = self.inductances(d, q)
        own = np.stack([slopes[:, 0, 0], slopes[:, 1, 1]])
        axis, k = np.unravel_index(own.argmin(), own.shape)
        name, lowest = "dq"[int(axis)], measured(float(own[axis, k]), unit="H", size=float(np.abs(own).max()))
        return (
            f"The map is not monotone everywhere, it folds: at {len(wrong)} of {int(inside.sum())} currents within the "
            f"data the inductances are not positive definite, and L_{name}{name} falls to {lowest} "
            f"at i_d = {d[k]:.3g} A, i_q = {q[k]:.3g} A, which no machine does."
        )

    @property
    def _surfaces(self) -> Surfaces:
        return self.everywhere or self.flux_map.surfaces


def folded(result: Result) -> str:
    """Return the sentence on where the map of a result folds; empty where it does not, or is too small to tell."""
    if not result.origin.turning or result.flux_map.known.sum() < _FEWEST:
        return ""
    model = MachineModel.of(result)
    return "" if model.monotone_inside else f"{model.fold} {_CONSEQUENCE}"


def halved(axis: FloatArray, cells: BoolArray | None = None) -> FloatArray:
    """Return an axis (N,) with its cells halved, or those of them that ``cells`` (N - 1,) marks."""
    middle = axis[:-1] + np.diff(axis) / 2
    return np.sort(np.append(axis, middle if cells is None else middle[cells]))


def _currents(i_d: ArrayLike, i_q: ArrayLike) -> tuple[FloatArray, FloatArray]:
    try:
        d, q = np.broadcast_arrays(np.asarray(i_d, np.float64), np.asarray(i_q, np.float64))
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"d and q values must be numbers of shapes that broadcast ({error}).") from error
    return d, q
