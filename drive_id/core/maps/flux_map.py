"""The flux map: flux linkages on a grid of currents, and as smooth functions of any current; rotor harmonics on it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from drive_id.core.maps.surfaces import Surfaces
from drive_id.errors import ConfigurationError, CoverageError
from drive_id.types import BoolArray, FloatArray, IntArray, ranges_table

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
    harmonics : tuple of HarmonicMap
        Of the rotor position, on the same grid.
    inner : FluxMap, optional
        The map that this one continues: where there are data, its slopes hold.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    sigma_d: FloatArray
    sigma_q: FloatArray
    inside: BoolArray
    enclosed: BoolArray | None = None
    harmonics: tuple[HarmonicMap, ...] = field(default=(), kw_only=True)
    inner: FluxMap | None = field(default=None, kw_only=True)

    @classmethod
    def of(
        cls,
        i_d: FloatArray,
        i_q: FloatArray,
        psi: FloatArray,
        sigma: FloatArray,
        inside: BoolArray,
        harmonics: tuple[HarmonicMap, ...] = (),
    ) -> FluxMap:
        """Return the map of fluxes and standard errors (D, Q, 2), Wb, on a grid."""
        (psi_d, psi_q), (sigma_d, sigma_q) = (np.moveaxis(values, -1, 0) for values in (psi, sigma))
        return cls(i_d, i_q, psi_d, psi_q, sigma_d, sigma_q, inside, harmonics=harmonics)

    def __repr__(self) -> str:
        d, q = (f"{axis[0]:.4g} to {axis[-1]:.4g} A" for axis in (self.i_d, self.i_q))
        size = f"{len(self.i_d)} x {len(self.i_q)}"
        return f"<FluxMap {size}, i_d {d}, i_q {q}, data at {self.inside.sum()} points>"

    @cached_property
    def largest(self) -> float:
        """Largest amplitude of the flux linkage where there are data, Wb; 0 without data."""
        return float(np.hypot(self.psi_d, self.psi_q)[self.inside].max(initial=0.0))

    @cached_property
    def known(self) -> BoolArray:
        """Where the map answers (D, Q): there are data, or samples enclose the current."""
        return self.inside if self.enclosed is None else self.inside | self.enclosed

    @cached_property
    def whole(self) -> FluxMap:
        """The map whose points count as inside wherever it answers."""
        return self if self.enclosed is None else replace(self, inside=self.known, enclosed=None)

    @cached_property
    def psi(self) -> FloatArray:
        """Both flux linkages (D, Q, 2), Wb."""
        return np.stack([self.psi_d, self.psi_q], axis=-1)

    @cached_property
    def sigmas(self) -> FloatArray:
        """Standard errors of both (D, Q, 2), Wb."""
        return np.stack([self.sigma_d, self.sigma_q], axis=-1)

    @cached_property
    def typical_inductances(self) -> tuple[float, float]:
        """Medians of L_dd and L_qq between grid points with data, H: the slopes of a continuation beyond them."""
        by_d, by_q = np.diff(self.psi_d, axis=0) / np.diff(self.i_d)[:, None], np.diff(self.psi_q) / np.diff(self.i_q)
        known = self.inside
        return float(np.median(by_d[known[1:] & known[:-1]])), float(np.median(by_q[known[:, 1:] & known[:, :-1]]))

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
        return np.where(cells.inside[..., None, None], self.surfaces.slopes(*np.moveaxis(i_dq, -1, 0)), np.nan)

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
        """Return psi_d, psi_q (..., 2), Wb, at currents (..., 2), A, also outside the data; linear beyond the grid.

        What the map holds outside the data is a continuation for simulations, not a measurement.
        """
        return self.surfaces.values(*np.moveaxis(i_dq, -1, 0))

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

    def flux(self, i_dq: FloatArray, angle: FloatArray) -> FloatArray:
        """Return what :meth:`continued` does, with the harmonics at angles (...), rad."""
        psi, (d, q) = self.continued(i_dq), np.moveaxis(i_dq, -1, 0)
        for h in self.harmonics:
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
    def surfaces(self) -> Surfaces:
        """Both flux linkages as functions of any current."""
        psi = self.psi_d, self.psi_q
        if self.inner is None:
            return Surfaces.over(self.i_d, self.i_q, *psi)
        return Surfaces.around(self.inner.surfaces, self.inside, self.i_d, self.i_q, psi)

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
        return np.nan_to_num(i_dq, posinf=0.0, neginf=0.0), cells


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
        supported = flux_map.known.ravel()[corners] | (weights == 0)
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

    @classmethod
    def of(cls, order: int, cosine: FloatArray, sine: FloatArray) -> HarmonicMap:
        """Return the harmonic of amplitudes (D, Q, 2), Wb."""
        return cls(order, cosine[..., 0], sine[..., 0], cosine[..., 1], sine[..., 1])
