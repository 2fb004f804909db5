"""The regression of method ``full``: its columns, the unknowns behind them, and the penalties.

    int u_s + delta [shifts] = R (1 + alpha dT) int i_s + u_0 dt + sum_j c_j int h_j(i)_s + t sum of crossings
                               + sum_j l_j int (h_j(i) - h_j(i'))_s + k dT [e^{j theta}]
                               + [e^{j theta} (f(i) + sum_h a_h(i) cos h theta + b_h(i) sin h theta)] at the ends

f is the flux map averaged over the rotor position; a_h, b_h are its harmonics, on a coarser grid; u_0 is a constant
voltage in the stator frame, which the offset of a current sensor causes through R. Harmonics 1 and 2 do not belong to
the machine: an offset o of the measured currents turns with -theta in the rotor frame and adds
``-f'(i) e^{-j theta} o``, a gain mismatch turns with -2 theta. i' is the current one sample earlier, turned with the
rotor: a drive that compensates its inverter from measured currents uses that one, so the difference remains.

Every variant of the model is a sparse matrix T from the unknowns to the columns: ``Z T x`` with one accumulated Z'Z.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from drive_id.core.full.windows import LAGS, SHIFTS, Windows
from drive_id.core.maps.coenergy import GradientSpline
from drive_id.core.maps.flux_models import ColumnArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes
from drive_id.core.numerics.compiled import compiled
from drive_id.types import BoolArray, FloatArray, IntArray

FLUX_CELLS, FLUX_DEGREE = 16, 4
HARMONIC_CELLS, HARMONIC_DEGREE = 4, 3
SENSOR_CELLS, SENSOR_DEGREE = 3, 3
SENSOR_ORDERS = (1, 2)

VOLTAGE, RESISTANCE = 0, 1
CONSTANT = slice(2, 4)
SHIFT = slice(4, 4 + len(SHIFTS))
MAGNET = SHIFT.stop
COPPER = 3.93e-3
"""Temperature coefficient of the winding's resistance at 20 degrees Celsius, 1/K."""

MOST_RUNS, MOST_RECORDINGS = 4, 8
"""Runs whose mechanical angle is followed, and recordings with a temperature of their own."""


def _layout(widths: dict[str, int]) -> dict[str, slice]:
    ends = np.cumsum(list(widths.values())).tolist()
    return {name: slice(end - width, end) for (name, width), end in zip(widths.items(), ends, strict=True)}


EFFECTS = _layout(
    {
        "iron_loss": 1,
        "hysteresis": 1,
        "current_latency": 1,
        "angle_latency": 1,
        "flux_lag": 1,
        **{f"flux_lag_{1e3 * lag:g}ms": 1 for lag in LAGS},
        "copper_heating": 1,
        "magnet_heating": 2,
        "copper_recordings": MOST_RECORDINGS - 1,
        "magnet_recordings": 2 * (MOST_RECORDINGS - 1),
        "eccentricity": 2 * MOST_RUNS,
        "eccentric_rotor": 2 * MOST_RUNS,
        "resolver_first": 2,
        "resolver_second": 2,
        "dc_link": 1,
        "phase_resistance": 2,
        "voltage_gains": 2,
    }
)
"""Effects beside the model that a fit tries, and their columns relative to the first one."""

EFFECT_COLUMNS = max(columns.stop for columns in EFFECTS.values())

PENALTIES = (1e-5, 1e-4, 1e-3, 1e-2)
"""Candidate weights of the map's roughness, relative to the mean diagonal of Z'Z over the map."""

_HARMONIC_RIDGE = 0.1
"""Relative to the mean diagonal of Z'Z over the map; over a harmonic it is many times larger. Where the trajectory
repeats in step with the rotor, so that harmonics and map cannot be separated, the map gets the flux."""

_DROP_RIDGE = 1e-7
_FEW = 64
"""Windows whose products are formed at once: fewer windows touch fewer columns."""
_EFFECT_RIDGE = 1e-9
_TINY = float(np.finfo(np.float64).tiny)


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
    """

    low: FloatArray
    high: FloatArray
    i_max: float
    orders: tuple[int, ...]

    @cached_property
    def shapes(self) -> CapacitiveShapes:
        """Shapes of the inverter's drop."""
        return CapacitiveShapes.up_to(self.i_max)

    @cached_property
    def flux(self) -> GradientSpline:
        """Space of the flux map."""
        return GradientSpline.within(self.low, self.high, FLUX_CELLS, FLUX_DEGREE)

    @cached_property
    def harmonic(self) -> GradientSpline:
        """Space of the amplitudes of a rotor-position harmonic."""
        return GradientSpline.within(self.low, self.high, HARMONIC_CELLS, HARMONIC_DEGREE)

    @cached_property
    def sensor(self) -> GradientSpline:
        """Space of the amplitudes of a harmonic caused by the current sensors."""
        return GradientSpline.within(self.low, self.high, SENSOR_CELLS, SENSOR_DEGREE)

    @property
    def drops(self) -> slice:
        """Columns of the inverter's shapes, [shape, phase] row-major."""
        return slice(MAGNET + 1, MAGNET + 1 + 3 * len(self.shapes.scales))

    @property
    def lags(self) -> slice:
        """Columns of what a compensation by the currents one sample earlier leaves of the drop."""
        return slice(self.drops.stop, self.drops.stop + len(self.shapes.coarse.scales))

    @property
    def crossing(self) -> int:
        """Column of the time by which the drop's step comes early."""
        return int(self.lags.stop)

    @property
    def effects(self) -> slice:
        """Columns of the effects that depend on the map, see :mod:`drive_id.core.full.effects`."""
        return slice(self.crossing + 1, self.crossing + 1 + EFFECT_COLUMNS)

    def effect(self, name: str) -> slice:
        """Columns of one effect."""
        own = EFFECTS[name]
        return slice(self.effects.start + own.start, self.effects.start + own.stop)

    @property
    def map(self) -> slice:
        """Columns of the flux map."""
        return slice(self.effects.stop, self.effects.stop + self.flux.parameters)

    @property
    def all_orders(self) -> tuple[int, ...]:
        """All harmonics, in the order of their columns."""
        return (*SENSOR_ORDERS, *self.orders)

    def space(self, order: int) -> GradientSpline:
        """Return the space of a harmonic's amplitudes."""
        return self.sensor if order in SENSOR_ORDERS else self.harmonic

    @cached_property
    def harmonics(self) -> dict[int, slice]:
        """Columns of each harmonic, those of a_h before those of b_h."""
        columns, start = {}, self.map.stop
        for order in self.all_orders:
            columns[order] = slice(start, start + 2 * self.space(order).parameters)
            start = columns[order].stop
        return columns

    @property
    def size(self) -> int:
        """Number of columns."""
        return int(self.harmonics[self.all_orders[-1]].stop)

    def phase_columns(self) -> IntArray:
        """Return the columns of the inverter's shapes as (S, 3)."""
        return np.arange(self.drops.start, self.drops.stop).reshape(-1, 3)

    def contains(self, windows: Windows) -> BoolArray:
        """Tell (N,) which windows start and end within the range of the map."""
        inside = self.flux.contains(windows.i_dq.reshape(-1, 2)).reshape(-1, 2)
        return np.asarray(inside.all(axis=1))

    def design(self, windows: Windows) -> FloatArray:
        """Return the rows Z of N windows, (N, 2, size): real parts in [:, 0], imaginary parts in [:, 1]."""
        out = np.zeros((len(windows), 2, self.size))
        out[:, :, : self.map.start] = self._beside_flux(windows)
        for turn, column, value, start, factor in self._ends(windows, self.all_orders):
            add_end(column, value, turn, start, factor, out)
        return _weighted(windows, out)

    def effect_products(self, windows: Windows) -> FloatArray:
        """Return Z'z (size, EFFECT_COLUMNS), z being the columns of the effects."""
        out = np.zeros((self.size, EFFECT_COLUMNS))
        for start in range(0, len(windows), _FEW):
            rows = self.design(windows.part(slice(start, start + _FEW))).reshape(-1, self.size)
            met = np.flatnonzero(rows.any(axis=0))
            out[met] += rows[:, met].T @ rows[:, self.effects]
        return out

    def design_times(self, windows: Windows, t: sparse.csr_array, orders: Sequence[int]) -> FloatArray:
        """Return Z T (N, 2, M) for T (size, M) without forming Z; the rows of T of other ``orders`` are empty."""
        before = self.map.start
        out = np.zeros((len(windows), 2, t.shape[1]))
        beside = t[:before].toarray()
        used = np.flatnonzero(beside.any(axis=0))
        out[:, :, used] = self._beside_flux(windows) @ beside[:, used]
        for turn, column, value, start, factor in self._ends(windows, orders):
            add_end_through(column, value, turn, start, factor, t.indptr, t.indices, t.data, out)
        return _weighted(windows, out)

    def _beside_flux(self, windows: Windows) -> FloatArray:
        """Return the columns before those of the flux, (N, 2, map.start)."""
        count, drops = len(windows), self.drops
        out = np.zeros((count, 2, self.map.start))
        known = np.concatenate(
            [windows.voltage[:, None], (windows.current * (1 + COPPER * windows.heating))[:, None]], axis=1
        )
        out[:, 0, :2], out[:, 1, :2] = known.real, known.imag
        out[:, 0, CONSTANT.start] = out[:, 1, CONSTANT.start + 1] = windows.duration
        out[:, 0, SHIFT], out[:, 1, SHIFT] = windows.shifted.real, windows.shifted.imag
        magnet = windows.magnet_heating * np.diff(np.exp(1j * windows.angle), axis=1)[:, 0]
        out[:, 0, MAGNET], out[:, 1, MAGNET] = magnet.real, magnet.imag
        a, b, c = np.moveaxis(windows.shape * windows.drop_scale[:, None, None], -1, 0)
        zero = np.zeros_like(a)
        out[:, 0, drops] = np.stack([2 * a, -b, -c], axis=-1).reshape(count, -1) / 3
        out[:, 1, drops] = np.stack([zero, b, -c], axis=-1).reshape(count, -1) / np.sqrt(3)
        lag = windows.lag * windows.drop_scale[:, None]
        out[:, 0, self.lags], out[:, 1, self.lags] = lag.real, lag.imag
        out[:, 0, self.crossing], out[:, 1, self.crossing] = windows.crossing.real, windows.crossing.imag
        if windows.effects is not None:
            out[:, 0, self.effects], out[:, 1, self.effects] = windows.effects.real, windows.effects.imag
        return out

    def _ends(
        self, windows: Windows, orders: Sequence[int]
    ) -> Iterator[tuple[FloatArray, ColumnArray, FloatArray, IntArray, FloatArray]]:
        """Yield the flux at both ends of all windows, space by space, as arguments of the kernels."""
        for end, sign in ((0, -1.0), (1, 1.0)):
            angle = windows.angle[:, end]
            turn = sign * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            for space, maps in self._maps(angle, orders).items():
                rows = space.rows(windows.i_dq[:, end])
                start, factor = np.array([start for start, _ in maps]), np.array([factor for _, factor in maps])
                yield turn, rows.column, rows.value, start, factor

    def _maps(self, angle: FloatArray, orders: Sequence[int]) -> dict[GradientSpline, list[tuple[int, FloatArray]]]:
        """Return for each space the first columns of the maps in it and their factors (N,)."""
        maps: dict[GradientSpline, list[tuple[int, FloatArray]]] = {self.flux: [(self.map.start, np.ones(len(angle)))]}
        for order in orders:
            space, start = self.space(order), self.harmonics[order].start
            maps.setdefault(space, []).append((start, np.cos(order * angle)))
            maps[space].append((start + space.parameters, np.sin(order * angle)))
        return maps


def _weighted(windows: Windows, rows: FloatArray) -> FloatArray:
    """Multiply rows (N, 2, M) by the roots of the windows' weights."""
    if windows.weight is not None:
        rows *= np.sqrt(windows.weight)[:, None, None]
    return rows


@compiled("const i4[:, :, ::1], const f8[:, :, ::1], const f8[:, ::1], const i8[::1], const f8[:, ::1], f8[:, :, ::1]")
def add_end(
    column: ColumnArray, value: FloatArray, turn: FloatArray, start: IntArray, factor: FloatArray, out: FloatArray
) -> None:
    """Add the flux at one end of the windows to the rows of the regression, for all maps in one space.

    Parameters
    ----------
    column, value : (N, 2, K)
        Basis functions, see :class:`~drive_id.core.maps.flux_models.BasisRows`; no column twice in a row.
    turn : (N, 2) float
        Cosine and sine of the angle, times the sign of the end.
    start : (P,) int
        First column of each map.
    factor : (P, N) float
        Factor on each map.
    out : (N, 2, size) float
    """
    for n in range(column.shape[0]):
        for p in range(len(start)):
            cosine, sine = turn[n, 0] * factor[p, n], turn[n, 1] * factor[p, n]
            for k in range(column.shape[2]):
                d, q = start[p] + column[n, 0, k], start[p] + column[n, 1, k]
                out[n, 0, d] += cosine * value[n, 0, k]
                out[n, 1, d] += sine * value[n, 0, k]
                out[n, 0, q] -= sine * value[n, 1, k]
                out[n, 1, q] += cosine * value[n, 1, k]


@compiled(
    "const i4[:, :, ::1], const f8[:, :, ::1], const f8[:, ::1], const i8[::1], const f8[:, ::1], "
    "const i4[::1], const i4[::1], const f8[::1], f8[:, :, ::1]"
)
def add_end_through(
    column: ColumnArray,
    value: FloatArray,
    turn: FloatArray,
    start: IntArray,
    factor: FloatArray,
    first: IntArray,
    unknown: IntArray,
    share: FloatArray,
    out: FloatArray,
) -> None:
    """Add the flux at one end of the windows to the rows of the regression times a sparse matrix T.

    Parameters
    ----------
    column, value, turn, start, factor
        As in :func:`add_end`.
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
    """One variant of the model.

    Parameters
    ----------
    reciprocal : bool
        The maps are gradients of a co-energy.
    orders : tuple of int
        Harmonics, including those of the sensors.
    per_phase : bool
        One inverter curve per phase.
    inverter : bool
        With an inverter curve at all.
    constant : bool
        With a constant voltage in the stator frame.
    penalty : float
        On the map's roughness.
    delay : float
        Time by which the voltages act later than recorded, samples.
    magnet : bool
        With a magnet flux that changes with temperature.
    lag : bool
        With the remainder of a compensation by the currents one sample earlier.
    crossing : bool
        With a time by which the drop's steps come early; none beside a latency of the currents, which moves them, too.
    effects : tuple of str
        Names in ``EFFECTS`` that are fitted.
    """

    reciprocal: bool
    orders: tuple[int, ...]
    per_phase: bool = False
    inverter: bool = True
    constant: bool = True
    penalty: float = PENALTIES[0]
    delay: float = 0.0
    magnet: bool = False
    lag: bool = False
    crossing: bool = False
    effects: tuple[str, ...] = ()


def delay_shares(delay: float) -> FloatArray:
    """Return the weights (len(SHIFTS),) of the shift columns for a delay in samples, -4 to 4.

    The commanded voltage is held, so a fractional delay takes exactly that fraction of the previous sample.
    """
    shares = []
    for shift in SHIFTS:
        if shift < 0:
            shares.append(np.clip(delay + shift + 1, 0.0, 1.0))
        else:
            shares.append(-np.clip(-delay - shift, 0.0, 1.0))
    return np.array(shares)


def basis(model: FullModel, spec: ModelSpec) -> sparse.csr_array:
    """Return T (size, M), from the unknowns of a variant to the columns of the regression."""
    size, blocks = model.size, []

    def place(block: sparse.sparray | FloatArray, first: int) -> None:
        block = sparse.coo_array(block)
        coordinates = (block.coords[0] + first, block.coords[1])
        blocks.append(sparse.coo_array((block.data, coordinates), (size, block.shape[1])))

    place(np.ones((1, 1)), RESISTANCE)
    if spec.constant:
        place(np.eye(2), CONSTANT.start)
    if spec.magnet:
        place(np.ones((1, 1)), MAGNET)
    if spec.inverter:
        shapes = len(model.shapes.scales)
        drops = np.eye(3 * shapes) if spec.per_phase else np.kron(np.eye(shapes), np.ones((3, 1)))
        place(drops, model.drops.start)
        if spec.crossing and "current_latency" not in spec.effects:
            place(np.ones((1, 1)), model.crossing)
    if spec.lag:
        place(np.eye(len(model.shapes.coarse.scales)), model.lags.start)
    for name in spec.effects:
        columns = model.effect(name)
        place(np.eye(columns.stop - columns.start), columns.start)
    gradient = model.flux.gradient
    place(gradient[:, 1:] if spec.reciprocal else sparse.eye_array(model.flux.parameters), model.map.start)
    for order in spec.orders:
        space = model.space(order)
        free = order in SENSOR_ORDERS or not spec.reciprocal
        one = sparse.eye_array(space.parameters) if free else space.gradient[:, 1:]
        place(sparse.block_diag([one, one]), model.harmonics[order].start)
    return sparse.csr_array(sparse.hstack(blocks))


def roughness(model: FullModel, total: FloatArray, penalty: float) -> sparse.csr_array:
    """Return the penalty on the columns (size, size): second differences of the map, slight ridges elsewhere."""
    diagonal = np.diag(total)
    unit = float(diagonal[model.map].mean())
    ridge = np.zeros(model.size)
    for columns in model.harmonics.values():
        ridge[columns] = _HARMONIC_RIDGE * unit
    for name in EFFECTS:
        columns = model.effect(name)
        ridge[columns] = np.maximum(_EFFECT_RIDGE * diagonal[columns], _TINY)
    ridge[model.crossing] = max(_EFFECT_RIDGE * diagonal[model.crossing], _TINY)
    for inverter in (model.drops, model.lags):
        ridge[inverter] = _DROP_RIDGE * float(diagonal[inverter].mean())
    before, after = model.map.start, model.size - model.map.stop
    rough = sparse.block_diag(
        [sparse.csr_array((before, before)), penalty * unit * model.flux.roughness, sparse.csr_array((after, after))]
    )
    return sparse.csr_array(rough + sparse.diags_array(ridge))
