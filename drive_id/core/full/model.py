"""Everything that method ``full`` fits at once, as columns of one linear regression over windows.

    int u_s + delta [shifts] = R (1 + alpha dT) int i_s + u_0 dt + sum_j c_j int h_j(i)_s
                               + sum_j l_j int (h_j(i) - h_j(i'))_s + k dT [e^{j theta}]
                               + [e^{j theta} (f(i) + sum_h a_h(i) cos h theta + b_h(i) sin h theta)] at the ends

f is the flux map averaged over the rotor position; a_h, b_h are its harmonics, on a coarser grid; u_0 is a constant
voltage in the stator frame, which the offset of a current sensor causes in R int i_s. Harmonics 1 and 2 are no property
of a machine: an offset o of the measured currents turns with -theta in the rotor frame and adds
``-f'(i) e^{-j theta} o``, a mismatch of their gains turns with -2 theta. i' is the current of one sample before, turned
with the rotor: a drive that compensates its inverter's drop by measured currents, which are old when the voltage acts,
leaves just the difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from drive_id.core.full.kernels import add_end, add_end_through
from drive_id.core.full.windows import SHIFTS, Windows
from drive_id.core.maps.coenergy import GradientSpline
from drive_id.core.maps.flux_models import ColumnArray
from drive_id.core.maps.inverter_curve import CapacitiveShapes
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


@dataclass(frozen=True, eq=False)
class FullModel:
    """The spaces of the unknowns and the columns where they stand.

    Parameters
    ----------
    low, high : (2,) float
        Range of the map in i_d and i_q, A.
    i_max : float
        Radius of the current disc, A.
    orders : tuple of int
        Candidate harmonics of the rotor position, electrical.
    """

    low: FloatArray
    high: FloatArray
    i_max: float
    orders: tuple[int, ...]

    @cached_property
    def shapes(self) -> CapacitiveShapes:
        """Of the inverter's drop."""
        return CapacitiveShapes.up_to(self.i_max)

    @cached_property
    def flux(self) -> GradientSpline:
        """Space of the flux map."""
        return GradientSpline.within(self.low, self.high, FLUX_CELLS, FLUX_DEGREE)

    @cached_property
    def harmonic(self) -> GradientSpline:
        """Space of each harmonic's amplitudes."""
        return GradientSpline.within(self.low, self.high, HARMONIC_CELLS, HARMONIC_DEGREE)

    @cached_property
    def sensor(self) -> GradientSpline:
        """Space of each harmonic that a current sensor causes."""
        return GradientSpline.within(self.low, self.high, SENSOR_CELLS, SENSOR_DEGREE)

    @property
    def drops(self) -> slice:
        """Columns of the inverter's shapes, [shape, phase] row-major."""
        return slice(MAGNET + 1, MAGNET + 1 + 3 * len(self.shapes.scales))

    @property
    def lags(self) -> slice:
        """Columns of what a drive that compensates the drop with earlier currents leaves of it."""
        return slice(self.drops.stop, self.drops.stop + len(self.shapes.coarse.scales))

    @property
    def map(self) -> slice:
        """Columns of the flux map."""
        return slice(self.lags.stop, self.lags.stop + self.flux.parameters)

    @property
    def all_orders(self) -> tuple[int, ...]:
        """Harmonics in the order of their columns."""
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

    def contains(self, windows: Windows) -> BoolArray:
        """Tell (N,) which windows begin and end within the range of the map."""
        inside = self.flux.contains(windows.i_dq.reshape(-1, 2)).reshape(-1, 2)
        return np.asarray(inside.all(axis=1))

    def design(self, windows: Windows) -> FloatArray:
        """Return the rows of the regression.

        Parameters
        ----------
        windows : Windows

        Returns
        -------
        (N, 2, size) float
            Real parts in [:, 0], imaginary parts in [:, 1].
        """
        out = np.zeros((len(windows), 2, self.size))
        out[:, :, : self.map.start] = self._beside_flux(windows)
        for turn, column, value, start, factor in self._ends(windows, self.all_orders):
            add_end(column, value, turn, start, factor, out)
        return out

    def forms(self, windows: Windows, t: sparse.csr_array, orders: Sequence[int]) -> FloatArray:
        """Return the rows of the regression times T (size, M), without making them: (N, 2, M).

        ``orders`` are the harmonics in use: the rows of T of all others are empty.
        """
        before = self.map.start
        out = np.zeros((len(windows), 2, t.shape[1]))
        beside = t[:before].toarray()
        used = np.flatnonzero(beside.any(axis=0))
        out[:, :, used] = self._beside_flux(windows) @ beside[:, used]
        for turn, column, value, start, factor in self._ends(windows, orders):
            add_end_through(column, value, turn, start, factor, t.indptr, t.indices, t.data, out)
        return out

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
        magnet = windows.heating * np.diff(np.exp(1j * windows.angle), axis=1)[:, 0]
        out[:, 0, MAGNET], out[:, 1, MAGNET] = magnet.real, magnet.imag
        a, b, c = np.moveaxis(windows.shape * windows.drop_scale[:, None, None], -1, 0)
        zero = np.zeros_like(a)
        out[:, 0, drops] = np.stack([2 * a, -b, -c], axis=-1).reshape(count, -1) / 3
        out[:, 1, drops] = np.stack([zero, b, -c], axis=-1).reshape(count, -1) / np.sqrt(3)
        lag = windows.lag * windows.drop_scale[:, None]
        out[:, 0, self.lags], out[:, 1, self.lags] = lag.real, lag.imag
        return out

    def _ends(
        self, windows: Windows, orders: Sequence[int]
    ) -> Iterator[tuple[FloatArray, ColumnArray, FloatArray, IntArray, FloatArray]]:
        """Yield the flux at each end of all windows, space by space, as the kernels take it."""
        for end, sign in ((0, -1.0), (1, 1.0)):
            angle = windows.angle[:, end]
            turn = sign * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            for space, parts in self._parts(angle, orders).items():
                rows = space.rows(windows.i_dq[:, end])
                start, factor = np.array([start for start, _ in parts]), np.array([factor for _, factor in parts])
                yield turn, rows.column, rows.value, start, factor

    def _parts(self, angle: FloatArray, orders: Sequence[int]) -> dict[GradientSpline, list[tuple[int, FloatArray]]]:
        """Return for each space the first columns of the maps in it and their factors (N,)."""
        parts: dict[GradientSpline, list[tuple[int, FloatArray]]] = {self.flux: [(self.map.start, np.ones(len(angle)))]}
        for order in orders:
            space, start = self.space(order), self.harmonics[order].start
            parts.setdefault(space, []).append((start, np.cos(order * angle)))
            parts[space].append((start + space.parameters, np.sin(order * angle)))
        return parts

    def phase_columns(self) -> IntArray:
        """Return the columns of the inverter's shapes as (S, 3)."""
        return np.arange(self.drops.start, self.drops.stop).reshape(-1, 3)
