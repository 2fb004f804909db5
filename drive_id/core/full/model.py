"""The regression of method ``full``: its columns, the unknowns behind them, and the penalties.

    int u_s + delta [shifts] = R (1 + alpha dT) int i_s + u_0 dt + sum_j c_j int h_j(i)_s + t sum of crossings
                               + sum_j l_j int (h_j(i) - h_j(i'))_s + k dT [e^{j theta}]
                               + [e^{j theta} (f(i) + sum_h a_h(i) cos h theta + b_h(i) sin h theta)] at the ends

f is the flux map averaged over the rotor position; a_h, b_h are its harmonics, on a coarser grid; u_0 is a constant
voltage in the stator frame. i' is the current one sample earlier, turned with the rotor: a drive that compensates its
inverter from measured currents uses that one, so the difference remains.

Every variant of the model is a sparse matrix T from the unknowns to the columns: ``Z T x`` with one accumulated Z'Z.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import sparse

from drive_id.common.temperature import COPPER
from drive_id.core.frames import ComplexArray
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.resolution import Resolution
from drive_id.core.full.windows import EARLIEST, SHIFTS, Terms, held_shares
from drive_id.core.maps.coenergy import GradientSpline, PotentialSpline
from drive_id.core.maps.flux_models import ColumnArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.core.numerics.compiled import compiled
from drive_id.types import TINY, BoolArray, FloatArray, IntArray

FLUX_DEGREE, HARMONIC_DEGREE = 4, 3
"""Of the co-energies of map and harmonics."""

VOLTAGE, RESISTANCE = 0, 1  # columns of all variants, as the slices below
CONSTANT = slice(2, 4)
SHIFT = slice(4, 5 + len(SHIFTS))  # by each of SHIFTS, and last by the voltage before an end, turned on
MAGNET = SHIFT.stop


def _layout(widths: dict[str, int]) -> dict[str, slice]:
    ends = np.cumsum(list(widths.values())).tolist()
    return {name: slice(end - width, end) for (name, width), end in zip(widths.items(), ends, strict=True)}


EFFECTS = _layout({name: effect.width for name, effect in CATALOGUE.items()} | {"remainder": 2})
"""Candidate effects and their columns relative to the first one; last, their second-order remainder, and
minus the part of their columns that moved currents and angles hold, which have no unknown."""

EFFECT_COLUMNS = max(columns.stop for columns in EFFECTS.values())

PENALTIES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Candidate weights of the map's roughness, relative to the mean diagonal of Z'Z over the map."""

_HARMONIC_RIDGE = 0.1
"""Relative to the mean diagonal of Z'Z over the map; over a harmonic it is many times larger. If the trajectory is
synchronous with the rotor, so that harmonics and map cannot be separated, the flux is assigned to the map."""

_GROUP = 128
"""Most windows per product: smaller groups have fewer nonzero columns but need more calls."""
_CURVE_POINTS = 101
"""Currents, dense near zero, at which shapes of the drop are compared."""
_DROP_RIDGE = 1e-7  # likewise of the shapes of the curve: they are nearly dependent
_EFFECT_RIDGE = 1e-9
"""Relative to the mean diagonal of Z'Z over the columns: only keeps the factorization of columns without data."""


Space = GradientSpline | PotentialSpline


@dataclass(frozen=True, eq=False)
class Layout:
    """Columns of flux map and harmonics, which follow all other columns."""

    start: int  # first column of the map
    flux: Space  # functions of the map, and of the amplitudes of a rotor-position harmonic
    harmonic: Space
    orders: tuple[int, ...]  # harmonics in the order of their columns

    @cached_property
    def map(self) -> slice:
        """Columns of the flux map."""
        return slice(self.start, self.start + self.flux.parameters)

    @cached_property
    def harmonics(self) -> dict[int, slice]:
        """Columns of each harmonic, those of a_h before those of b_h."""
        width = 2 * self.harmonic.parameters
        starts = [self.map.stop + number * width for number in range(len(self.orders))]
        return {order: slice(start, start + width) for order, start in zip(self.orders, starts, strict=True)}

    @cached_property
    def size(self) -> int:
        """Number of columns."""
        return int((self.harmonics[self.orders[-1]] if self.orders else self.map).stop)

    def maps(self, angle: FloatArray, orders: Sequence[int]) -> dict[Space, list[tuple[int, FloatArray]]]:
        """Return for each space the first columns of the maps in it and their factors (N,)."""
        maps: dict[Space, list[tuple[int, FloatArray]]] = {self.flux: [(self.map.start, np.ones(len(angle)))]}
        for order in orders:
            start = self.harmonics[order].start
            maps.setdefault(self.harmonic, []).append((start, np.cos(order * angle)))
            maps[self.harmonic].append((start + self.harmonic.parameters, np.sin(order * angle)))
        return maps


@dataclass(frozen=True, eq=False)
class FullModel:
    """Spline spaces of the flux map and its harmonics, and the layout of the columns.

    Parameters
    ----------
    low, high : (2,) float
        Range of the map in i_d and i_q, A.
    i_max : float
        Radius of the current disc, A.
    orders : tuple of int
        Candidate rotor-position harmonics, electrical.
    reciprocal : bool
        Sum over the columns of reciprocal maps only, a third fewer, see :attr:`summed`.
    cells: Resolution, optional
        Cells of the map and its harmonics; default: the usual ones.
    """

    low: FloatArray
    high: FloatArray
    i_max: float
    orders: tuple[int, ...]
    _: KW_ONLY
    reciprocal: bool = False
    cells: Resolution | None = None

    @cached_property
    def resolution(self) -> Resolution:
        """Cells of the map and its harmonics."""
        return self.cells or Resolution.usual(self.low, self.high)

    @cached_property
    def shapes(self) -> CapacitiveShapes:
        """Shapes of the inverter's drop."""
        return CapacitiveShapes.up_to(self.i_max)

    @cached_property
    def flux(self) -> GradientSpline:
        """Space of the flux map."""
        return GradientSpline(self.resolution.d, self.resolution.q, FLUX_DEGREE)

    @cached_property
    def harmonic(self) -> GradientSpline:
        """Space of the amplitudes of a rotor-position harmonic."""
        return GradientSpline.within(self.low, self.high, self.resolution.harmonic, HARMONIC_DEGREE)

    @cached_property
    def drops(self) -> slice:
        """Columns of the inverter's shapes, [shape, phase] row-major."""
        return slice(MAGNET + 1, MAGNET + 1 + 3 * len(self.shapes.scales))

    @cached_property
    def lags(self) -> slice:
        """Columns of the drop that remains after compensation with the currents one sample earlier."""
        return slice(self.drops.stop, self.drops.stop + len(self.shapes.coarse.scales))

    @cached_property
    def crossing(self) -> int:
        """Column of the time by which the step of the drop is early."""
        return int(self.lags.stop)

    @cached_property
    def effects(self) -> slice:
        """Columns of the effects that depend on the map, see :mod:`drive_id.core.full.effects`."""
        return slice(self.crossing + 1, self.crossing + 1 + EFFECT_COLUMNS)

    def effect(self, name: str) -> slice:
        """Columns of one effect."""
        start, own = self.effects.start, EFFECTS[name]
        return slice(start + own.start, start + own.stop)

    @cached_property
    def columns(self) -> Layout:
        """Columns of free maps."""
        return Layout(self.effects.stop, self.flux, self.harmonic, self.orders)

    @cached_property
    def summed(self) -> Layout:
        """Columns of the sums over windows: co-energies instead of fluxes if reciprocal."""
        if not self.reciprocal:
            return self.columns
        return Layout(self.effects.stop, self.flux.potential, self.harmonic.potential, self.orders)

    @cached_property
    def expansion(self) -> sparse.csr_array:
        """S (size, summed.size): ``Z S`` are the columns of the sums."""
        if not self.reciprocal:
            return sparse.csr_array(sparse.eye_array(self.size))
        blocks = [sparse.eye_array(self.map.start), self.flux.gradient]
        return sparse.csr_array(sparse.block_diag(blocks + 2 * len(self.orders) * [self.harmonic.gradient]))

    @property
    def map(self) -> slice:
        """Columns of the flux map."""
        return self.columns.map

    @property
    def harmonics(self) -> dict[int, slice]:
        """Columns of each harmonic, those of a_h before those of b_h."""
        return self.columns.harmonics

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.columns.size

    def phase_columns(self) -> IntArray:
        """Return the columns of the inverter's shapes as (S, 3)."""
        return np.arange(self.drops.start, self.drops.stop).reshape(-1, 3)

    def coarse_drop(self, estimate: FloatArray) -> FloatArray:
        """Return the coefficients (L,) of the coarse shapes whose sum is the mean drop of the phases, V."""
        return np.asarray(self._coarsened @ estimate[self.phase_columns()].mean(axis=1))

    @cached_property
    def _coarsened(self) -> FloatArray:
        """Coefficients (L, S) of the coarse shapes that fit each shape best."""
        current = self.i_max * np.linspace(0.0, 1.0, _CURVE_POINTS) ** 2
        return np.asarray(np.linalg.lstsq(self.shapes.coarse(current), self.shapes(current))[0])

    def contains(self, windows: Terms) -> BoolArray:
        """Tell (N,) which windows start and end within the range of the map."""
        inside = self.flux.contains(windows.i_dq.reshape(-1, 2)).reshape(-1, 2)
        return np.asarray(inside.all(axis=1))

    def nonzero_columns(self, windows: Terms) -> Iterator[tuple[FloatArray, IntArray]]:
        """Yield the nonzero columns of all windows in the sums, (2 N, C), and their indices (C,), increasing.

        They come in groups of windows that are close in current: these share most nonzero basis functions.
        """
        order, edges = _neighbours(windows.i_dq.reshape(len(windows), -1))
        beside, weight = self._beside_flux(windows), windows.weight
        known = np.flatnonzero(beside.any(axis=(0, 1)))
        beside = beside.take(known, axis=2)
        ends = list(self._ends(windows.i_dq[order], windows.angle[order], self.summed, self.orders))
        for begin, end in pairwise(edges):
            group = order[begin:end]
            used = [met(column, begin, end, space.parameters) for space, column, *_ in ends]
            starts = [start for *_, start, _ in ends]
            columns = [(start[:, None] + own).ravel() for start, own in zip(starts, used, strict=True)]
            indices = np.concatenate([known, *columns])
            rows = np.zeros((len(group), 2, len(indices)))
            rows[:, :, : len(known)], first = beside[group], len(known)
            for (_, column, value, turn, _, factor), own, filled in zip(ends, used, columns, strict=True):
                add_ends(column, value, turn, factor, own, begin, first, rows)
                first += len(filled)
            if weight is not None:
                rows *= np.sqrt(weight[group])[:, None, None]
            yield rows.reshape(-1, len(indices)), indices

    def residuals(self, windows: Terms, estimate: FloatArray) -> FloatArray:
        """Return Z times an estimate (size,), (N, 2), Vs."""
        orders = [order for order, columns in self.harmonics.items() if estimate[columns].any()]
        return self.design_times(windows, sparse.csr_array(estimate[:, None]), orders)[..., 0]

    def design_times(self, windows: Terms, t: sparse.csr_array, orders: Sequence[int]) -> FloatArray:
        """Return Z T (N, 2, M) for T (size, M) without forming Z; the rows of T of other ``orders`` are empty."""
        out = np.zeros((len(windows), 2, t.shape[1]))
        known = self._beside_flux(windows)
        beside = t[: known.shape[2]].toarray()
        used, met = np.flatnonzero(beside.any(axis=0)), np.flatnonzero(beside.any(axis=1))
        out[:, :, used] = known[:, :, met] @ beside[np.ix_(met, used)]
        for _, column, value, turn, start, factor in self._ends(windows.i_dq, windows.angle, self.columns, orders):
            for of_end in zip(column, value, turn, factor, strict=True):
                add_end(*of_end, start, t.indptr, t.indices, t.data, out)
        return out if windows.weight is None else out * np.sqrt(windows.weight)[:, None, None]

    def by_conditions(self, windows: Terms, estimate: FloatArray) -> ComplexArray:
        """Return what temperatures and the DC link add (N,) to the balance at their references, Vs."""
        zero = np.zeros(len(windows))
        reference = replace(windows, heating=zero, magnet_heating=zero, drop_scale=zero + 1)
        added = self._beside_flux(windows) - self._beside_flux(reference)
        pairs = added @ estimate[: added.shape[2]]
        return np.asarray(pairs[:, 0] + 1j * pairs[:, 1])

    def map_squares(self, windows: Terms) -> float:
        """Return the sum of the squares of the columns of a free map."""
        first, last = (self.flux.rows(windows.i_dq[:, end]).sparse(self.flux.parameters) for end in (0, 1))
        turn = np.repeat(np.cos(windows.angle[:, 1] - windows.angle[:, 0]), 2)
        squares = first.power(2).sum(axis=1) + last.power(2).sum(axis=1) - 2 * turn * first.multiply(last).sum(axis=1)
        return float(np.repeat(windows.weights, 2) @ squares)

    def _beside_flux(self, windows: Terms) -> FloatArray:
        """Return the columns (N, 2, K) before those of the flux, or before the effects if the windows have none."""
        count, (a, b, c) = len(windows), np.moveaxis(windows.shape * windows.drop_scale[:, None, None], -1, 0)
        out = np.zeros((count, 2, self.effects.start if windows.effects is None else self.map.start))
        magnet = windows.magnet_heating * np.diff(np.exp(1j * windows.angle), axis=1)[:, 0]
        known: list[tuple[slice | int, ComplexArray]] = [
            (VOLTAGE, windows.voltage),
            (RESISTANCE, windows.current * (1 + COPPER * windows.heating)),
            (CONSTANT, windows.duration[:, None] * np.array([1, 1j])),
            (SHIFT, np.append(windows.shifted, _turned_on(windows)[:, None], axis=1)),
            (MAGNET, magnet),
            (self.lags, windows.lag * windows.drop_scale[:, None]),
            (self.crossing, windows.crossing),
            *([] if windows.effects is None else [(self.effects, windows.effects)]),
        ]
        for at, column in known:
            out[:, 0, at], out[:, 1, at] = column.real, column.imag
        by_phase = out[:, :, self.drops].reshape(count, 2, -1, 3)
        by_phase[:, 0] = np.stack([2 * a, -b, -c], axis=-1) / 3
        by_phase[:, 1, :, 1], by_phase[:, 1, :, 2] = b / np.sqrt(3), -c / np.sqrt(3)
        return out

    def _ends(
        self, i_dq: FloatArray, angle: FloatArray, layout: Layout, orders: Sequence[int]
    ) -> Iterator[tuple[Space, ColumnArray, FloatArray, FloatArray, IntArray, FloatArray]]:
        """Yield the flux at both ends of all windows, space by space, as arguments of the kernels."""
        turn = np.ascontiguousarray(np.stack([np.cos(angle.T), np.sin(angle.T)], axis=-1))
        turn[0] *= -1.0
        first, last = (layout.maps(angle[:, end], orders) for end in (0, 1))
        for space, maps in first.items():
            rows = space.rows(np.concatenate([i_dq[:, 0], i_dq[:, 1]]))
            shape = 2, len(angle), *rows.column.shape[1:]
            start = np.array([start for start, _ in maps])
            factor = np.array([[factor for _, factor in own] for own in (maps, last[space])])
            yield space, rows.column.reshape(shape), rows.value.reshape(shape), turn, start, factor


def _neighbours(ends: FloatArray) -> tuple[IntArray, list[int]]:
    """Return an order (N,) in which windows that are close in currents (N, 4) adjoin, and the edges of their groups."""
    groups, done = [np.arange(len(ends))], []
    while groups:
        group = groups.pop()
        if len(group) <= _GROUP:
            done.append(np.sort(group))
            continue
        widest, half = int(np.argmax(np.ptp(ends[group], axis=0))), len(group) // 2
        order = np.argpartition(ends[group, widest], half)
        groups += [group[order[half:]], group[order[:half]]]
    return np.concatenate(done), np.cumsum([0, *map(len, done)]).tolist()


@compiled("const i4[:, :, :, ::1], i8, i8, i8")
def met(column: ColumnArray, begin: int, end: int, functions: int) -> IntArray:
    """Return which functions of so many, increasing, are not zero at an end of windows, see :func:`add_ends`."""
    used = np.zeros(functions, np.bool_)
    for side in range(2):
        for n in range(begin, end):
            for axis in range(2):
                for k in range(column.shape[3]):
                    used[column[side, n, axis, k]] = True
    return np.flatnonzero(used)


@compiled(
    "const i4[:, :, :, ::1], const f8[:, :, :, ::1], const f8[:, :, ::1], const f8[:, :, ::1], const i8[::1], i8, i8, "
    "f8[:, :, ::1]"
)
def add_ends(
    column: ColumnArray, value: FloatArray, turn: FloatArray, factor: FloatArray, used: IntArray, begin: int,
    first: int, out: FloatArray,
) -> None:  # fmt: skip
    """Add the flux at both ends of some windows, for all maps in one space, to the regression's rows.

    Parameters
    ----------
    column, value : (2, N, 2, K)
        Basis functions at the ends, see :class:`~drive_id.core.maps.flux_models.BasisRows`.
    turn : (2, N, 2) float
        Cosine and sine of the angle, times the sign of the end.
    factor : (2, P, N) float
        Factor on each map.
    used : (U,) int
        Functions that have a column, the same of each map.
    begin, first : int
        First of the windows, and column of the first function.
    out : (..., 2, C) float
        Of the windows from ``begin`` on.
    """
    place = np.zeros(used[-1] + 1, np.int64)
    for j in range(len(used)):
        place[used[j]] = first + j
    for n in range(len(out)):
        for side in range(2):
            at = begin + n
            for p in range(factor.shape[1]):
                cosine, sine = turn[side, at, 0] * factor[side, p, at], turn[side, at, 1] * factor[side, p, at]
                for k in range(column.shape[3]):
                    d, q = place[column[side, at, 0, k]] + p * len(used), place[column[side, at, 1, k]] + p * len(used)
                    by_d, by_q = value[side, at, 0, k], value[side, at, 1, k]
                    out[n, 0, d] += cosine * by_d
                    out[n, 1, d] += sine * by_d
                    out[n, 0, q] -= sine * by_q
                    out[n, 1, q] += cosine * by_q


@compiled(
    "const i4[:, :, ::1], const f8[:, :, ::1], const f8[:, ::1], const f8[:, ::1], const i8[::1], "
    "const i4[::1], const i4[::1], const f8[::1], f8[:, :, ::1]"
)
def add_end(
    column: ColumnArray, value: FloatArray, turn: FloatArray, factor: FloatArray, start: IntArray, first: ColumnArray,
    unknown: ColumnArray, share: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    """Add the flux at one end of the windows, likewise, to the regression's rows times a matrix T.

    Parameters
    ----------
    start : (P,) int
        First column of each map.
    first : (size + 1,) int
        Index of the first entry of each row of T.
    unknown, share : (E,)
        Columns and values of the entries.
    out : (N, 2, M) float
    """
    for n in range(column.shape[0]):
        for p in range(len(start)):
            cosine, sine = turn[n, 0] * factor[p, n], turn[n, 1] * factor[p, n]
            for k in range(column.shape[2]):
                d, q = start[p] + column[n, 0, k], start[p] + column[n, 1, k]
                for entry in range(first[d], first[d + 1]):
                    term = value[n, 0, k] * share[entry]
                    out[n, 0, unknown[entry]] += cosine * term
                    out[n, 1, unknown[entry]] += sine * term
                for entry in range(first[q], first[q + 1]):
                    term = value[n, 1, k] * share[entry]
                    out[n, 0, unknown[entry]] -= sine * term
                    out[n, 1, unknown[entry]] += cosine * term


@dataclass(frozen=True)
class ModelSpec:
    """One variant of the model."""

    reciprocal: bool  # the maps are gradients of a co-energy
    orders: tuple[int, ...]  # harmonics
    per_phase: bool = False  # one inverter curve per phase
    inverter: bool = True  # with an inverter curve at all
    wide: int = 0  # number of shapes of the inverter's curve beyond the usual ones
    constant: bool = True  # with a constant voltage in the stator frame
    penalty: float = PENALTIES[0]  # on the map's roughness
    delay: float = 0.0  # time by which the voltages act later than recorded, samples
    magnet: bool = False  # with a magnet flux that changes with temperature
    lag: bool = False  # with the remainder of a compensation that uses the currents one sample earlier
    crossing: bool = False  # with a time by which the steps of the drop are early
    effects: tuple[str, ...] = ()  # names in ``EFFECTS`` that are fitted


def delay_shares(delay: float) -> FloatArray:
    """Return the weights (K,) of the shift columns for a delay in samples, -4 to 4.

    A delay between ``EARLIEST`` and 0, as decimated logs have, would take a share of the sample that begins at the end
    of a window: where the controller answers at once to the noise of the current there, that predicts the noise, and
    such a delay was missed. It takes the voltage before the end instead, turned on with the rotor.
    """
    if EARLIEST < delay < 0:
        return np.append(np.zeros(len(SHIFTS)), delay)
    return np.append(held_shares(delay), 0.0)


def _turned_on(windows: Terms) -> ComplexArray:
    """Return by how much the integral (N,) changes per sample by which the voltages act early, Vs."""
    ahead = windows.held_after(1.0)
    return np.asarray(windows.period * (ahead[:, 1] - ahead[:, 0]))


def map_basis(model: FullModel, spec: ModelSpec) -> sparse.csr_array:
    """Return the part (summed.size, K) of T, from a variant's unknowns to columns of the sums, for map and harmonics.

    Raises ValueError if the maps are free and the columns of the sums are reciprocal.
    """
    if model.reciprocal and not spec.reciprocal:
        raise ValueError("Free maps need sums over the columns of free maps, see WindowSums.freed.")
    layout = model.summed

    def of_map(space: GradientSpline) -> sparse.coo_array:
        if not spec.reciprocal:
            return sparse.eye_array(space.parameters, format="coo")
        potentials = space.potential.parameters  # without the constant part of the co-energy
        constant = sparse.eye_array(potentials, potentials - 1, k=-1, format="coo")
        return constant if model.reciprocal else sparse.coo_array(space.gradient @ constant)

    amplitudes = of_map(model.harmonic)
    starts = [layout.harmonics[order].start + half for order in spec.orders for half in (0, amplitudes.shape[0])]
    return _placed(layout.size, [(layout.map.start, of_map(model.flux)), *((start, amplitudes) for start in starts)])


def own_basis(model: FullModel, spec: ModelSpec) -> sparse.csr_array:
    """Return the part (summed.size, J) of T for the other unknowns."""
    own = [(columns.start, sparse.eye_array(columns.stop - columns.start)) for columns in _own_columns(model, spec)]
    if spec.inverter:
        shapes = model.shapes.usual + spec.wide
        drops = np.eye(3 * shapes) if spec.per_phase else np.kron(np.eye(shapes), np.ones((3, 1)))
        own.append((model.drops.start, sparse.coo_array(drops)))
    return _placed(model.summed.size, own)


def _placed(size: int, blocks: Sequence[tuple[int, sparse.coo_array]]) -> sparse.csr_array:
    """Return the blocks side by side, each from its first row on of so many."""
    row = np.concatenate([first + np.arange(block.shape[0], dtype=np.int32) for first, block in blocks])
    beside = sparse.block_diag([block for _, block in blocks], format="coo")
    of_block, unknown = beside.coords
    return sparse.csr_array((beside.data, (row[of_block], unknown)), shape=(size, beside.shape[1]))


def _own_columns(model: FullModel, spec: ModelSpec) -> Iterator[slice]:
    """Yield the columns of a variant with an unknown for each, those of the maps apart."""
    yield slice(RESISTANCE, RESISTANCE + 1)
    if spec.constant:
        yield CONSTANT
    if spec.magnet:
        yield slice(MAGNET, MAGNET + 1)
    if spec.inverter and spec.crossing:
        yield slice(model.crossing, model.crossing + 1)
    if spec.lag:
        yield model.lags
    for name in spec.effects:
        yield model.effect(name)


def roughness(model: FullModel, total: FloatArray, penalty: float, unit: float | None = None) -> sparse.csr_array:
    """Return the penalty on the columns (size, size): second differences of the map, slight ridges elsewhere.

    Parameters
    ----------
    total : (size, size) or (summed.size, summed.size) float
        Z'Z.
    unit : float, optional
        Mean diagonal of Z'Z over the columns of a free map; needed where those of the sums are reciprocal.
    """
    diagonal = np.diag(total)
    unit = float(diagonal[model.map].mean()) if unit is None else unit
    ridge = np.zeros(model.size)
    for columns in model.harmonics.values():
        ridge[columns] = _HARMONIC_RIDGE * unit
    for name in EFFECTS:
        columns = model.effect(name)
        ridge[columns] = np.maximum(_EFFECT_RIDGE * diagonal[columns], TINY)
    ridge[model.crossing] = max(_EFFECT_RIDGE * diagonal[model.crossing], TINY)
    for inverter in (model.drops, model.lags):
        ridge[inverter] = _DROP_RIDGE * float(diagonal[inverter].mean())
    in_map = sparse.eye_array(model.flux.parameters, model.size, k=model.map.start)
    rough = in_map.T @ (penalty * unit * model.flux.roughness) @ in_map
    return sparse.csr_array(rough + sparse.diags_array(ridge))
