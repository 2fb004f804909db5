"""From the points of a file to a flux map and its rotor-position harmonics on a grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice

import numpy as np
from scipy.interpolate import griddata

from drive_id.core.maps.continuation import continued
from drive_id.core.maps.flux_map import FluxMap, HarmonicMap
from drive_id.core.maps.monotone import fit_monotone
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.points import MapPoints
from drive_id.types import BoolArray, FloatArray, IntArray

_SAME = 1e-6  # currents that differ by less, relative to the range, are one
_FEWEST = 4  # nodes along an axis, which a cubic spline needs
_COMPLETE = 0.09
"""Share of the nodes of a grid that must be there: polar grids and scattered points have far more nodes than points."""
_MOST_NODES = 4_000_000  # of a grid: 32 MB for each array
_MOST_SCATTERED = 30_000  # points of a spline fit, whose time grows with them
_STEPS = 40  # about, of an axis for scattered points
_ROUND = (1.0, 2.0, 2.5, 5.0, 10.0)  # steps of such an axis, times a power of ten
_SMALL = 5e-4  # amplitude of a harmonic, relative to the largest flux, below which it is left out
_MOST_PERIODS = 6
"""Per electrical revolution: the fluxes of a three-phase machine repeat after 60 degrees at the earliest."""
_SYMMETRIC = 0.02  # flux psi_q at i_q = 0, relative to the largest, up to which a map over half the plane is mirrored


@dataclass(frozen=True, eq=False)
class Gridded:
    """A map on a grid."""

    flux_map: FluxMap
    mirrored: bool  # the file covers one sign of i_q; the other half is its mirror image
    scattered: bool  # the points do not form a grid: the map is a co-energy spline through them
    rms: float = 0.0  # distance of a spline from its points, Wb


@dataclass(frozen=True, eq=False)
class _Columns:
    """Values at N points: the mean fluxes, then cosine and sine amplitudes of each harmonic, and standard errors."""

    i_dq: FloatArray
    psi_dq: FloatArray
    orders: tuple[int, ...]
    amplitudes: FloatArray  # (N, K, 4): psi_d_cos, psi_d_sin, psi_q_cos, psi_q_sin
    sigma_dq: FloatArray


def gridded(points: MapPoints) -> Gridded:
    """Put points in our conventions on a grid; scattered points are first fitted by a reciprocal, monotone spline.

    Raises ConfigurationError when the rotor positions are not equally spaced, or there are too many scattered points.
    """
    orders, amplitudes = harmonics_of(points)
    sigma = points.sigma_dq if points.sigma_dq is not None else np.full(points.i_dq.shape, np.nan)
    columns, mirrored = _mirrored(_Columns(points.i_dq, points.mean_psi_dq, orders, amplitudes, sigma))
    (i_d, place_d), (i_q, place_q) = (_axis(values) for values in columns.i_dq.T)
    nodes = len(i_d) * len(i_q)
    if min(len(i_d), len(i_q)) >= _FEWEST and nodes <= _MOST_NODES and len(columns.i_dq) >= _COMPLETE * nodes:
        return _on_grid(columns, i_d, i_q, (place_d, place_q), mirrored=mirrored)
    if len(columns.i_dq) > _MOST_SCATTERED:
        raise ConfigurationError(
            f"The {len(points.i_dq)} points form no grid, and a spline through scattered ones takes {_MOST_SCATTERED} "
            "at most: leave some out."
        )
    return _splined(columns, mirrored=mirrored)


def harmonics_of(points: MapPoints) -> tuple[tuple[int, ...], FloatArray]:
    """Return the orders (K) of the rotor-position harmonics and their amplitudes (N, K, 4), Wb.

    The amplitudes are those of ``cos`` and ``sin`` of psi_d, then of psi_q.
    """
    count = points.psi_dq.shape[2]
    theta = points.theta
    if theta is None or count < 3:
        return (), np.zeros((len(points.i_dq), 0, 4))
    steps = np.diff(theta)
    step = float(steps.mean())
    if np.abs(steps - step).max() > 1e-3 * abs(step) or step <= 0:
        raise ConfigurationError("The rotor positions of the map are not equally spaced and increasing: resample it.")
    periods = 2 * np.pi / (count * step)
    if abs(periods - round(periods)) > 1e-3 * periods or not 1 <= round(periods) <= _MOST_PERIODS:
        raise ConfigurationError(
            f"The rotor positions span {np.degrees(count * step):.4g} degrees electrical, which is no whole fraction "
            "of a revolution of at least 60 degrees: give one period without its end point, and --angle mechanical if "
            "these are mechanical angles."
        )
    orders, amplitudes = [], []
    largest = float(np.abs(points.psi_dq).max())
    for k in range(1, count // 2 + 1):
        order = k * round(periods)
        phase = np.exp(-1j * order * theta) * ((1 if 2 * k == count else 2) / count)
        complex_amplitude = points.psi_dq @ phase  # (N, 2): psi = Re(a exp(j h theta))
        if np.abs(complex_amplitude).max() > _SMALL * largest:
            orders.append(order)
            amplitudes.append(np.stack([complex_amplitude.real, -complex_amplitude.imag], axis=-1).reshape(-1, 4))
    found = np.stack(amplitudes, axis=1) if amplitudes else np.zeros((len(points.i_dq), 0, 4))
    return tuple(orders), found


def _mirrored(columns: _Columns) -> tuple[_Columns, bool]:
    """Complete a map over one sign of i_q by its mirror image, ``psi_d(-i_q, -theta) = psi_d(i_q, theta)``."""
    i_q = columns.i_dq[:, 1]
    reach = float(np.abs(i_q).max())
    if i_q.min() < -0.02 * reach and i_q.max() > 0.02 * reach:
        return columns, False
    on_axis = np.abs(i_q) <= _SAME * reach
    largest = float(np.abs(columns.psi_dq).max())
    if np.abs(columns.psi_dq[on_axis, 1]).max(initial=0.0) > _SYMMETRIC * largest:
        return columns, False

    def both(values: FloatArray, *signs: float) -> FloatArray:
        return np.concatenate([values[~on_axis] * np.array(signs), values])

    return _Columns(
        both(columns.i_dq, 1.0, -1.0),
        both(columns.psi_dq, 1.0, -1.0),
        columns.orders,
        both(columns.amplitudes, 1.0, -1.0, -1.0, 1.0),
        both(columns.sigma_dq, 1.0, 1.0),
    ), True


def _axis(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the distinct values of one current, and which of them each point has."""
    order = np.argsort(values, kind="stable")
    begins = np.concatenate([[True], np.diff(values[order]) > _SAME * np.ptp(values)])
    place = np.empty(len(values), np.int64)
    place[order] = np.cumsum(begins) - 1
    found = values[order][begins]
    return np.where(np.abs(found) < _SAME * np.ptp(values), 0.0, found), place


def _on_grid(
    columns: _Columns, i_d: FloatArray, i_q: FloatArray, places: tuple[IntArray, IntArray], *, mirrored: bool
) -> Gridded:
    shape = (len(i_d), len(i_q))
    inside: BoolArray = np.zeros(shape, np.bool_)
    inside[places] = True
    if np.count_nonzero(inside) < len(columns.i_dq):
        raise ConfigurationError(
            "The map has several values at the same currents: leave one point for each pair of currents, or name the "
            "column of the rotor position."
        )

    def whole(values: FloatArray, slopes: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        placed = np.zeros(shape)
        placed[places] = values
        return placed if inside.all() else continued(placed, inside, (i_d, i_q), slopes)

    psi_d, psi_q = columns.psi_dq.T
    slope_d, slope_q = (float(np.polyfit(i, psi, 1)[0]) for i, psi in zip(columns.i_dq.T, (psi_d, psi_q), strict=True))
    sigma = np.full((2, *shape), np.nan)
    sigma[:, places[0], places[1]] = columns.sigma_dq.T
    psi_d, psi_q = whole(psi_d, (slope_d, 0.0)), whole(psi_q, (0.0, slope_q))
    harmonics = tuple(
        HarmonicMap(order, *(whole(columns.amplitudes[:, k, part]) for part in range(4)))
        for k, order in enumerate(columns.orders)
    )
    flux_map = FluxMap(i_d, i_q, psi_d, psi_q, sigma[0], sigma[1], inside, harmonics=harmonics)
    return Gridded(flux_map, mirrored, scattered=False)


def _splined(columns: _Columns, *, mirrored: bool) -> Gridded:
    """Fit a reciprocal, monotone map to scattered points and sample it on a grid with round steps."""
    weighted = np.isfinite(columns.sigma_dq).all() and (columns.sigma_dq > 0).all()
    fitted = fit_monotone(columns.i_dq, columns.psi_dq, columns.sigma_dq if weighted else None)
    i_d, i_q = (_round_axis(float(x.min()), float(x.max())) for x in columns.i_dq.T)
    grid = np.stack(np.meshgrid(i_d, i_q, indexing="ij"), axis=-1)
    inside, psi = fitted.inside(grid), fitted.psi(grid)

    def laid(values: FloatArray) -> FloatArray:
        """Interpolate values (N, ...) linearly to the grid, NaN outside the points: (D, Q, ...)."""
        return np.asarray(griddata(columns.i_dq, values, grid, method="linear"))

    amplitudes = laid(columns.amplitudes.reshape(len(columns.i_dq), -1))
    known = inside & np.isfinite(amplitudes).all(axis=-1)
    parts = (continued(one, known, (i_d, i_q), (0.0, 0.0)) for one in np.moveaxis(amplitudes, -1, 0))
    harmonics = tuple(HarmonicMap(order, *islice(parts, 4)) for order in columns.orders)
    sigma = np.where(inside[..., None], laid(columns.sigma_dq), np.nan)
    flux_map = FluxMap.of(i_d, i_q, psi, sigma, inside, harmonics)
    return Gridded(flux_map, mirrored, scattered=True, rms=fitted.convexity.residual_rms)


def _round_axis(low: float, high: float) -> FloatArray:
    """Return points of a round step through zero that cover a range with about 40 steps, A."""
    wanted = (high - low) / _STEPS
    power = 10.0 ** math.floor(math.log10(wanted))
    step = min((factor * power for factor in _ROUND), key=lambda value: abs(math.log(value / wanted)))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return np.array([float(f"{k * step:.12g}") for k in range(first, last + 1)])
