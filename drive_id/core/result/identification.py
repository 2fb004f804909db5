"""The result of a fit: flux map, harmonics, resistance, inverter curve and a report on the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from drive_id.core.methods.parameters import FitReport, Parameters
from drive_id.errors import ConfigurationError, CoverageError
from drive_id.origins import ORIGINS, Origin
from drive_id.types import BoolArray, FloatArray, IntArray, ranges_table

if TYPE_CHECKING:  # drawing a map needs neither numba nor scipy
    from scipy.interpolate import RectBivariateSpline

    from drive_id.core.validation.simulated_current import SimulatedCurrent

Outside = Literal["nan", "raise"]


@dataclass(frozen=True, eq=False, repr=False)
class FluxMap:
    """Flux linkages on a grid of currents, and as smooth functions of any current.

    Between the grid points, the fluxes are the cubic (not-a-knot) spline through the stored values, so a map gives the
    same numbers before it is saved and after it is loaded. A current lies *inside* when all corners of its grid cell
    that have a weight in bilinear interpolation are marked ``inside``, or ``enclosed``.

    Parameters
    ----------
    i_d, i_q : (D,), (Q,) float
        Axes, A, strictly increasing, at least 4 points each.
    psi_d, psi_q : (D, Q) float
        Wb.
    sigma_d, sigma_q : (D, Q) float
        Standard errors of psi_d and psi_q, Wb; NaN where not known. They cover the scatter of the data, not the error
        of a model that is too simple. Infinite when the recording is too short to estimate them.
    inside : (D, Q) bool
        The data support the map here; elsewhere it is a continuation of typical slope.
    enclosed : (D, Q) bool, optional
        Where samples only enclose the current, and the joint errors of a fit tell how well the continuation is known:
        there, ``sigma_d`` and ``sigma_q`` hold its standard errors, and all that is asked of the map is answered.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    sigma_d: FloatArray
    sigma_q: FloatArray
    inside: BoolArray
    enclosed: BoolArray | None = None

    def __repr__(self) -> str:
        d, q = (f"{axis[0]:.4g} to {axis[-1]:.4g} A" for axis in (self.i_d, self.i_q))
        size = f"{len(self.i_d)} x {len(self.i_q)}"
        return f"<FluxMap {size}, i_d {d}, i_q {q}, data at {self.inside.sum()} points>"

    @cached_property
    def largest(self) -> float:
        """Largest amplitude of the flux linkage where there are data, Wb; 0 without data."""
        return float(np.hypot(self.psi_d, self.psi_q)[self.inside].max(initial=0.0))

    def grid(self) -> FloatArray:
        """Return the currents of all grid points, (D, Q, 2), A."""
        return np.stack(np.meshgrid(self.i_d, self.i_q, indexing="ij"), axis=-1)

    def psi_dq(self, i_d: ArrayLike, i_q: ArrayLike, outside: Outside = "nan") -> tuple[FloatArray, FloatArray]:
        """Return the flux linkages at currents.

        Parameters
        ----------
        i_d, i_q : float or array
            A; they broadcast against each other to shape (...). Series and DataArrays are taken as plain arrays: what
            is returned has no index; see :meth:`drive_id.Identification.to_xarray` for a map that has.
        outside : {"nan", "raise"}
            What to return for currents that samples do not even enclose: NaN, or a CoverageError.

        Returns
        -------
        psi_d, psi_q : (...) float
            Wb; for scalar currents, scalars.

        Raises
        ------
        CoverageError
            When a current lies outside the data, with ``outside="raise"``.
        ConfigurationError
            When the currents are not numbers or do not broadcast, or ``outside`` is neither of the two.
        """
        i_dq, cells = self._located(i_d, i_q, outside)
        psi = np.where(cells.inside[..., None], self.continued(i_dq), np.nan)
        return psi[..., 0][()], psi[..., 1][()]  # scalars of scalars

    def inductances(self, i_d: ArrayLike, i_q: ArrayLike, outside: Outside = "nan") -> FloatArray:
        """Return the incremental inductances: derivatives of the flux linkages with respect to the currents.

        Arguments and errors are those of :meth:`psi_dq`.

        Returns
        -------
        (..., 2, 2) float
            ``[[L_dd, L_dq], [L_qd, L_qq]]``, ``L_dq`` being dpsi_d/di_q, H.
        """
        i_dq, cells = self._located(i_d, i_q, outside)
        slopes = [self._evaluated(i_dq, order) for order in ((1, 0), (0, 1))]
        return np.where(cells.inside[..., None, None], np.stack(slopes, axis=-1), np.nan)

    def sigma(self, i_d: ArrayLike, i_q: ArrayLike, outside: Outside = "nan") -> tuple[FloatArray, FloatArray]:
        """Return the standard errors of the flux linkages, interpolated bilinearly.

        Arguments and errors are those of :meth:`psi_dq`.

        Returns
        -------
        sigma_d, sigma_q : (...) float
            Wb.
        """
        _, cells = self._located(i_d, i_q, outside)
        sigma_d, sigma_q = (np.where(cells.inside, cells.mean(x), np.nan)[()] for x in (self.sigma_d, self.sigma_q))
        return sigma_d, sigma_q

    def continued(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_d, psi_q (..., 2), Wb, at currents (..., 2), A, also outside the data; constant beyond the grid.

        What the map holds outside the data is a continuation for simulations, not a measurement.
        """
        return self._evaluated(i_dq, (0, 0))

    def _repr_html_(self) -> str:
        """Return the ranges of the map as a small table, for notebooks."""
        known = {f"{name}, Wb": getattr(self, name)[self.inside] for name in ("psi_d", "psi_q", "sigma_d", "sigma_q")}
        size = f"{len(self.i_d)} × {len(self.i_q)} points, {self.inside.sum()} with data"
        return ranges_table(f"Flux map of {size}", {"i_d, A": self.i_d, "i_q, A": self.i_q} | known)

    def bilinear(self, i_dq: FloatArray) -> FloatArray:
        """Return the same, interpolated bilinearly, which needs no scipy."""
        return np.stack([self.sampled(psi, i_dq[..., 0], i_dq[..., 1]) for psi in (self.psi_d, self.psi_q)], axis=-1)

    def sampled(self, values: FloatArray, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Interpolate values (D, Q) on this grid bilinearly at currents (...); beyond the axes, that at their end."""
        return self._held(i_d, i_q).mean(values)

    def ripple(self, harmonics: Sequence[HarmonicMap], i_dq: FloatArray, angle: FloatArray) -> FloatArray:
        """Return the flux (..., 2), Wb, of harmonics on this grid at currents (..., 2), A, and angles (...), rad."""
        psi, (d, q) = np.zeros(i_dq.shape), np.moveaxis(i_dq, -1, 0)
        for h in harmonics:
            cosine, sine = np.cos(h.order * angle), np.sin(h.order * angle)
            psi[..., 0] += self.sampled(h.psi_d_cos, d, q) * cosine + self.sampled(h.psi_d_sin, d, q) * sine
            psi[..., 1] += self.sampled(h.psi_q_cos, d, q) * cosine + self.sampled(h.psi_q_sin, d, q) * sine
        return psi

    def collected(self, weights: FloatArray, i_dq: FloatArray) -> FloatArray:
        """Return weights (N, C) at currents (N, 2) collected on the grid, (D, Q, C): the transpose of :meth:`sampled`.

        ``(collected(w, i) * values).sum() == w @ sampled(values, i)``, for any number of values at the cost of one.
        """
        cells, count = self._held(*i_dq.T), self.psi_d.size
        out = np.zeros((count, weights.shape[1]))
        for place, share in zip(cells.corners.T, cells.weights.T, strict=True):
            for c in range(weights.shape[1]):
                out[:, c] += np.bincount(place, share * weights[:, c], count)
        return out.reshape(*self.psi_d.shape, -1)

    def _held(self, i_d: FloatArray, i_q: FloatArray) -> _Cells:
        """Return the cells of currents, beyond the axes those at their end."""
        held = [np.clip(x, axis[0], axis[-1]) for x, axis in ((i_d, self.i_d), (i_q, self.i_q))]
        return _Cells.of(self, np.stack(held, axis=-1))

    @cached_property
    def _splines(self) -> tuple[RectBivariateSpline, RectBivariateSpline]:
        from scipy.interpolate import RectBivariateSpline  # noqa: PLC0415  # a fit does not need it

        return RectBivariateSpline(self.i_d, self.i_q, self.psi_d), RectBivariateSpline(self.i_d, self.i_q, self.psi_q)

    def _evaluated(self, i_dq: FloatArray, order: tuple[int, int]) -> FloatArray:
        known = np.nan_to_num(i_dq)
        fluxes = [spline.ev(known[..., 0], known[..., 1], dx=order[0], dy=order[1]) for spline in self._splines]
        return np.stack(fluxes, axis=-1)

    def _located(self, i_d: ArrayLike, i_q: ArrayLike, outside: Outside) -> tuple[FloatArray, _Cells]:
        if outside not in ("nan", "raise"):
            raise ConfigurationError(f"outside is '{outside}': it must be 'nan' or 'raise'.")
        try:
            given = [np.asarray(x) for x in (i_d, i_q)]
            if any(x.dtype.kind not in "biuf" for x in given):
                raise TypeError
            i_dq = np.stack(np.broadcast_arrays(*given), axis=-1).astype(np.float64)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(
                "i_d and i_q are not real currents of shapes that broadcast: give numbers or arrays, A."
            ) from error
        cells = _Cells.of(self, i_dq)
        if outside == "raise" and not cells.inside.all():
            d, q = i_dq[~cells.inside][0]
            raise CoverageError(
                f"The flux map has no data at i_d = {d:.4g} A, i_q = {q:.4g} A: stay within the recorded currents, or "
                'ask for NaN there by outside="nan".'
            )
        return i_dq, cells


@dataclass(frozen=True, eq=False)
class _Cells:
    """Corners of the grid cells that hold currents (...), and their weights in bilinear interpolation."""

    corners: IntArray  # (..., 4), of the grid points, row by row
    weights: FloatArray  # (..., 4)
    inside: BoolArray  # (...), the map is known at all corners that count

    @classmethod
    def of(cls, flux_map: FluxMap, i_dq: FloatArray) -> _Cells:
        (d, t), (q, s) = (_place(axis, i_dq[..., k]) for k, axis in enumerate((flux_map.i_d, flux_map.i_q)))
        columns = len(flux_map.i_q)
        first = d * columns + q
        corners = np.stack([first, first + 1, first + columns, first + columns + 1], axis=-1)
        weights = np.stack([(1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s], axis=-1)
        within = (t >= 0) & (t <= 1) & (s >= 0) & (s <= 1)  # False for NaN
        known = flux_map.inside if flux_map.enclosed is None else flux_map.inside | flux_map.enclosed
        supported = known.ravel()[corners] | (weights == 0)
        return cls(corners, weights, within & supported.all(axis=-1))

    def mean(self, values: FloatArray) -> FloatArray:
        """Return values (D, Q) interpolated bilinearly; corners without weight are ignored."""
        with np.errstate(invalid="ignore"):
            parts = np.where(self.weights != 0, self.weights * values.ravel()[self.corners], 0.0)
            return np.asarray(parts.sum(axis=-1))


def _place(axis: FloatArray, x: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell of an axis that holds each current, and the position in it, 0 to 1 within the axis."""
    cell = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    return cell, (x - axis[cell]) / (axis[cell + 1] - axis[cell])


@dataclass(frozen=True, eq=False)
class HarmonicMap:
    """Amplitudes of one rotor-position harmonic, ``cos(h theta)`` and ``sin(h theta)``, on the flux map's grid."""

    order: int  # h, electrical
    psi_d_cos: FloatArray  # (D, Q), Wb
    psi_d_sin: FloatArray  # (D, Q), Wb
    psi_q_cos: FloatArray  # (D, Q), Wb
    psi_q_sin: FloatArray  # (D, Q), Wb


@dataclass(frozen=True)
class LinearMachine:
    """The machine at zero current: ``psi_d = psi_pm + l_d i_d``, ``psi_q = l_q i_q``; method ``static``.

    Standard errors are infinite for what the points leave open.
    """

    psi_pm: float  # flux linkage of the magnets, Wb
    sigma_psi_pm: float  # its standard error, Wb
    l_d: float  # inductance, H
    sigma_l_d: float  # its standard error, H
    l_q: float  # inductance, H
    sigma_l_q: float  # its standard error, H


@dataclass(frozen=True)
class Cogging:
    """One harmonic of the cogging torque."""

    order: int  # electrical
    amplitude: float  # Nm
    sigma: float  # its standard error, Nm


@dataclass(frozen=True)
class TorqueFit:
    """What the shaft torque says of a flux map.

    The model is ``T = g 3/2 p (psi_d i_q - psi_q i_d) - T_f sign(w) - b w - T_c(theta) + T_0`` with the mechanical
    speed w; b and T_0 only where the speeds in the recording tell them from T_f.

    Parameters
    ----------
    gain, sigma_gain : float
        g and its standard error. A common gain error of voltages or currents, which the electrical signals do not show,
        makes it differ from 1.
    friction, sigma_friction : float
        T_f and its standard error, Nm. Where ``viscous_friction`` is None, it is all friction at the recorded speed;
        where ``offset`` is None, it includes the offset of the torque sensor.
    viscous_friction, sigma_viscous_friction : float or None
        b and its standard error, Nm s/rad.
    offset, sigma_offset : float or None
        T_0 of the torque sensor and its standard error, Nm.
    cogging : tuple of Cogging
        The significant harmonics of T_c.
    rms_map : float
        Difference, rms, between the torque of the map and the measured torque corrected for friction, cogging and
        offset, Nm.
    rms_residual : float
        The same with the gain, Nm.
    pole_pairs : int
    samples : int
        In the fit.
    """

    gain: float
    sigma_gain: float
    friction: float
    sigma_friction: float
    viscous_friction: float | None
    sigma_viscous_friction: float | None
    offset: float | None
    sigma_offset: float | None
    cogging: tuple[Cogging, ...]
    rms_map: float
    rms_residual: float
    pole_pairs: int
    samples: int


@dataclass(frozen=True)
class Mechanics:
    """What the motion of a free shaft says of its mechanics, by the torque T of the flux map.

    The model is ``g T = (J + dJ) dw/dt + b w + T_f sign(w) + T_0 + T_c(theta)`` with the mechanical speed w and the
    known inertia dJ of discs. A term that the motion cannot tell is None. Voltages and currents alone leave the common
    gain g open, by which all values scale: 1 is assumed unless an inertia is known.

    Parameters
    ----------
    inertia, sigma_inertia : float
        J without discs and its standard error, kg m^2; where it was given, that value and 0.
    friction, sigma_friction : float or None
        T_f, N m.
    viscous_friction, sigma_viscous_friction : float or None
        b, with the drag of the iron loss, N m s/rad.
    load, sigma_load : float or None
        T_0, against positive rotation, N m.
    cogging : tuple of Cogging
        The significant harmonics of T_c.
    gain, sigma_gain : float or None
        g: true torque over that of the map; None where no inertia is known.
    explained : float
        Share of the energy of the torque that the motion explains, 0 to 1.
    seconds : float
        Of data in the regression.
    cogging_visible : float or None
        Amplitude below which a harmonic would not have been reported, N m; None where none was looked for, and in
        results of earlier versions.
    """

    inertia: float
    sigma_inertia: float
    friction: float | None
    sigma_friction: float | None
    viscous_friction: float | None
    sigma_viscous_friction: float | None
    load: float | None
    sigma_load: float | None
    cogging: tuple[Cogging, ...]
    gain: float | None
    sigma_gain: float | None
    explained: float
    seconds: float
    cogging_visible: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class IdentifiedDrive(Parameters):
    """An identified drive: the parameters, the map and how good they are, without their origin."""

    method: str  # psm, joint, full, locked or static; imported for a map of another tool
    i_max: float  # radius of the current disc of the experiment, A
    flux_map: FluxMap
    report: FitReport
    harmonics: tuple[HarmonicMap, ...] = ()  # of the rotor position; method full
    torque: TorqueFit | None = None  # the recorded shaft torque against that of the map
    mechanics: Mechanics | None = None  # of a free shaft, by the torque of the map
    simulated: SimulatedCurrent | None = None  # where the MAD comes from; None when the result was read from files
    linear: LinearMachine | None = None  # magnet flux and inductances at zero current; method static

    @cached_property
    def answering(self) -> FluxMap:
        """The map that answers also where samples only enclose a current, with the standard errors of the fit there."""
        found, modes = self.flux_map, self.error_modes
        if modes is None or not (beyond := modes.known & ~found.inside).any():
            return found
        sigma_d, sigma_q = (
            np.where(beyond, np.linalg.norm(errors, axis=0), own)
            for errors, own in ((modes.psi_d, found.sigma_d), (modes.psi_q, found.sigma_q))
        )
        return replace(found, sigma_d=sigma_d, sigma_q=sigma_q, enclosed=beyond)

    @property
    def origin(self) -> Origin:
        """What results of this method hold, and the words for it."""
        return ORIGINS[self.method]

    @cached_property
    def sizes(self) -> dict[str, float]:
        """Sizes by SI unit, of this drive's fluxes, R and so on, by which all values of a kind have one unit."""
        found = self.flux_map
        i_d, i_q = found.grid()[found.inside].T
        slopes = found.inductances(i_d, i_q)
        steepest = np.maximum(slopes[..., 0, 0], slopes[..., 1, 1])
        known = steepest[np.isfinite(steepest)]
        inductance = float(np.median(known)) if known.size else 0.0
        sizes = {"Wb": found.largest, "Wb/K": found.largest, "H": inductance, "Ω": abs(self.resistance)}
        sizes |= {"A": self.i_max, "V": abs(self.voltage_error)}
        return {unit: size for unit, size in sizes.items() if size > 0}

    @property
    def sigma_drop(self) -> FloatArray | None:
        """Standard error of the inverter's curve (C,), V: of each current, or in proportion; None where unknown."""
        sigma, height = self.sigma_inverter_voltage, self.voltage_error
        if sigma is None and height and np.isfinite(self.sigma_voltage_error):
            sigma = np.abs(self.inverter_voltage / height) * self.sigma_voltage_error
        return sigma if sigma is not None and np.isfinite(sigma).all() else None

    def flux(self, i_dq: FloatArray) -> FloatArray:
        """Return psi_d, psi_q (N, 2), Wb, at currents (N, 2), A, of the fitted function where it is known."""
        if self.model is None or self.gamma is None:
            return self.flux_map.continued(i_dq)
        return self.model.rows(i_dq).dot(self.gamma)
