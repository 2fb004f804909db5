"""Gains of current controllers over the current, and the phase margin that they leave between the points of a table.

Each axis has a PI controller, ``k_p = a l(i)`` and ``k_i = a R``, which cancels the pole of ``1 / (R + s L)`` where the
table's inductance l, read by linear interpolation, is the machine's L. With a delay T_d, the open loop is
``(k_p s + k_i) e^{-s T_d} / (s (R + s L))``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from drive_id.analysis.machine import halved
from drive_id.common.quantity import counted
from drive_id.core.numerics.bisection import largest_possible
from drive_id.exchange.exports.axes import clean
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import BoolArray, FloatArray, IntArray

TOLERANCE = 0.2
"""Share by which inductances may differ from those of the map: that much between machines of a series is common."""
_DELAY = 1.5
"""Samples from the measured current to the mean of the voltage that answers it: one of computation, half a sample of
the modulator."""
_SUM = 320  # places along an axis at which the margin is computed: of a table with 21 points, 16 in each cell
_FEWEST = 6  # in each cell
_LEAST_SHARE = 0.7  # of the map's inductance at a point that its gain may be lowered to; else the table is refined
_EXCESS = 1.02  # of a gain between points over that of the map's inductance, from which on it is lowered
_MOST_POINTS = 81  # of an axis that is refined: tables of two fluxes and two gains then take 105 kB
_TOLD = 0.9  # of the same: lowered by less is not told
_WORST = 4000  # places from which the bandwidth follows
_SPARE = math.radians(0.1)  # of the phase margin, as the worst current may lie between the places
_ROUNDS = 4  # of these two
_BISECTIONS = 30


@dataclass(frozen=True, eq=False)
class CurrentControl:
    """Current controllers of both axes; build them by :func:`designed`."""

    table: MapTable
    bandwidth: float  # a, rad/s
    inductances: dict[str, FloatArray]  # by axis, (D, Q), H: gains over the bandwidth
    margin: float  # least phase margin with inductances 20 % off, rad; NaN without a delay
    nominal: float  # the same with those of the map
    delay: float  # s
    lowered: int  # points with data at which a gain is more than a tenth lower than that of the map's inductance
    asked: tuple[int, int]  # points of the axes that were asked for

    def __str__(self) -> str:
        """Return the sentence that the header and the command print."""
        hertz = f"The bandwidth is {self.bandwidth / (2 * math.pi):.4g} Hz"
        if not math.isfinite(self.margin):
            return f"{hertz}; no delay is considered."
        least, nominal = (math.floor(math.degrees(x) * 10) / 10 for x in (self.margin, self.nominal))
        return (
            f"{hertz}; at {self.delay:.4g} s of delay, the phase margin of each axis is at least {least:.1f} degrees "
            f"with L {100 * TOLERANCE:.0f} % more or less, {nominal:.1f} with the map's, at and between the points."
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what was done to the table."""
        now, out = (len(self.table.i_d), len(self.table.i_q)), [str(self)]
        if now != self.asked:
            out.append(
                f"The table has {now[0]} x {now[1]} points instead of {self.asked[0]} x {self.asked[1]}, for between "
                "those the inductances change too much for gains that are interpolated."
            )
        if self.lowered:
            out.append(
                f"At {counted(self.lowered, 'point')} the gain is more than {100 * (1 - _TOLD):.0f} % lower than that "
                "of the inductance there, so that it is not too high between the points."
            )
        return tuple(out)


def designed(table: MapTable, options: ExportOptions) -> CurrentControl:
    """Choose table, gains and bandwidth so that the phase margin holds between the points, with L 20 % off as well."""
    asked = len(table.i_d), len(table.i_q)
    places = _Places(table)
    while any(marks.any() for marks in places.coarse):
        i_d, i_q = (
            clean(halved(axis, marks))
            for axis, marks in zip((places.table.i_d, places.table.i_q), places.coarse, strict=True)
        )
        if max(len(i_d), len(i_q)) > _MOST_POINTS:
            break
        places = _Places(table.on(i_d, i_q))
    rate, margin, nominal, delay = options.rate, math.nan, math.nan, 0.0
    if options.sample_period is not None:
        delay = _DELAY * options.sample_period
        wanted = math.radians(options.phase_margin) + _SPARE
        rate, *found = places.limited(rate, wanted, delay)
        margin, nominal = (x - _SPARE for x in found)
    lowered = int(np.count_nonzero((places.shares < _TOLD).any(axis=0) & places.table.inside))
    gains = dict(zip("dq", places.gains, strict=True))
    return CurrentControl(places.table, rate, gains, margin, nominal, delay, lowered, asked)


@dataclass(frozen=True, eq=False)
class _Places:
    """Currents at and between the points of a table, (S, T) of them, and the inductances of both axes there."""

    table: MapTable

    @cached_property
    def parts(self) -> tuple[int, int]:
        """In how many equal parts each cell is divided along both axes."""
        d, q = (max(_FEWEST, _SUM // (len(axis) - 1)) for axis in (self.table.i_d, self.table.i_q))
        return d, q

    @cached_property
    def axes(self) -> tuple[FloatArray, FloatArray]:
        d, q = (divided(axis, n) for axis, n in zip((self.table.i_d, self.table.i_q), self.parts, strict=True))
        return d, q

    @cached_property
    def _currents(self) -> tuple[FloatArray, FloatArray]:
        i_d, i_q = np.meshgrid(*self.axes, indexing="ij")
        return i_d, i_q

    @cached_property
    def coarse(self) -> list[BoolArray]:
        """Intervals of both axes in which a gain must be much lower than that of the inductance, with data near.

        An inductance is compared along its own current; along the other one, only what is lost between points counts.
        """
        out = []
        for axis, parts in enumerate(self.parts):
            known = np.moveaxis(self.table.inside, axis, 0)
            marks = np.zeros(len(known) - 1, np.bool_)
            for own, ratio in enumerate(self.least / self._read(self._nodes)):
                lines = np.moveaxis(ratio, axis, 0)[:, :: self.parts[1 - axis]]  # through points of the other axis
                ends = np.minimum(lines[:-1:parts], lines[parts::parts])
                low = np.stack([ends, *(lines[k::parts] for k in range(1, parts))]).min(axis=0)
                enough = _LEAST_SHARE * (1.0 if own == axis else np.minimum(ends, 1.0))
                marks |= ((low < enough) & (known[1:] | known[:-1])).any(axis=1)
            out.append(marks)
        return out

    @cached_property
    def true(self) -> FloatArray:
        """Inductances (4, 2, S, T), H: of the map, of bicubic interpolation, and of the bilinear one to both sides."""
        i_d, i_q = self._currents
        psi_d, psi_q = self.table.machine.psi_dq(*self.table.grid)
        slopes = self.table.machine.inductances(i_d, i_q)
        (d, q), (x, y) = (self.table.i_d, self.table.i_q), self.axes
        l_d = cubic(q, cubic(d, psi_d, x, 1).T, y).T
        l_q = cubic(q, cubic(d, psi_q, x).T, y, 1).T
        bilinear = [
            (_linear(q, secant_d.T, y).T, _linear(d, secant_q.T, x))
            for secant_d, secant_q in zip(_secants(d, psi_d, x), _secants(q, psi_q.T, y), strict=True)
        ]
        return np.array([[slopes[..., 0, 0], slopes[..., 1, 1]], [l_d, l_q], *bilinear])

    @cached_property
    def least(self) -> FloatArray:
        """The smallest of these inductances that is positive, (2, S, T), H."""
        return np.asarray(np.where(self.true > 0, self.true, np.inf).min(axis=0))

    @cached_property
    def _nodes(self) -> FloatArray:
        """Inductances at the points of the table, (2, D, Q), H: of the map where it has data, else not above those."""
        slopes = self.table.machine.inductances(*self.table.grid)
        found = np.stack([slopes[..., 0, 0], slopes[..., 1, 1]])
        return np.where(self.table.inside, found, found * self._shares(found))

    @cached_property
    def shares(self) -> FloatArray:
        """Factors (2, D, Q) on the inductances at the points."""
        return self._shares(self._nodes)

    def _shares(self, nodes: FloatArray) -> FloatArray:
        """Return factors (2, D, Q) on inductances at the points so that linear interpolation exceeds none between them.

        A point gets the least ratio of the inductances at the places of its cells to the interpolation there.
        """
        ratio = self.least / self._read(nodes)
        ratio = np.where(ratio < 1 / _EXCESS, ratio, 1.0)
        for axis, parts in zip((-2, -1), self.parts, strict=True):
            ratio = np.moveaxis(_around(np.moveaxis(ratio, axis, -1), parts), -1, axis)
        return ratio

    @cached_property
    def gains(self) -> FloatArray:
        """Inductances (2, D, Q), H, that the gains of the table rest on."""
        return self._nodes * self.shares

    def _read(self, nodes: FloatArray) -> FloatArray:
        (d, q), (x, y) = (self.table.i_d, self.table.i_q), self.axes
        return np.stack([_linear(q, _linear(d, values, x).T, y).T for values in nodes])

    def limited(self, rate: float, wanted: float, delay: float) -> tuple[float, float, float]:
        """Return the largest bandwidth up to ``rate``, rad/s, with a phase margin, and the least with L off and right.

        The margin is that of the worst place, for whichever of the inductances there.
        """
        resistance = self.table.machine.resistance if math.isfinite(self.table.machine.resistance) else 0.0
        gains = np.broadcast_to(self._read(self.gains), self.true.shape).ravel()
        known = self.true.ravel() > 0
        true, gains = self.true.ravel()[known], gains[known]
        off = [(1 - TOLERANCE) * true, (1 + TOLERANCE) * true]
        kept = np.zeros(0, np.int64)
        for _ in range(_ROUNDS):
            margins = np.minimum(*(phase_margin(rate * gains, rate * resistance, resistance, x, delay) for x in off))
            if margins.min() >= wanted:
                break
            kept = np.union1d(kept, np.argpartition(margins, min(_WORST, len(margins) - 1))[:_WORST])
            rate = _largest(gains[kept], [x[kept] for x in off], resistance, delay, wanted, rate)
        nominal = phase_margin(rate * gains, rate * resistance, resistance, true, delay)
        margins = np.minimum(*(phase_margin(rate * gains, rate * resistance, resistance, x, delay) for x in off))
        return rate, float(min(margins.min(), nominal.min())), float(nominal.min())


def phase_margin(
    kp: FloatArray, ki: FloatArray | float, resistance: float, inductance: FloatArray, delay: float
) -> FloatArray:
    """Return the phase margin (...), rad, of a PI controller, a delay, s, and a winding."""
    excess = kp**2 - resistance**2
    root = np.sqrt(excess**2 + (2 * inductance * ki) ** 2)
    omega = np.sqrt((excess + root) / 2) / inductance  # where the open loop has amplitude 1
    lead, lag = np.arctan2(omega * kp, ki), np.arctan2(omega * inductance, resistance)
    return np.asarray(np.pi / 2 + lead - lag - omega * delay)


def _largest(
    gains: FloatArray, inductances: list[FloatArray], resistance: float, delay: float, wanted: float, high: float
) -> float:
    def enough(rate: float) -> bool:
        margins = [phase_margin(rate * gains, rate * resistance, resistance, x, delay).min() for x in inductances]
        return bool(min(margins) >= wanted)

    return largest_possible(enough, high, _BISECTIONS)


def divided(axis: FloatArray, parts: int) -> FloatArray:
    """Return an axis with each of its cells in equal parts."""
    inner = axis[:-1, None] + np.diff(axis)[:, None] * np.arange(parts) / parts
    return np.append(inner.ravel(), axis[-1])


def _around(values: FloatArray, parts: int) -> FloatArray:
    """Return the least of values at the places (..., S) of the cells that meet at each point, (..., D)."""
    cells = (values.shape[-1] - 1) // parts
    within = np.stack([values[..., k : k + parts * cells : parts] for k in range(parts)]).min(axis=0)
    within = np.minimum(within, values[..., parts::parts])
    edge = np.full((*values.shape[:-1], 1), np.inf)
    return np.asarray(np.minimum(np.concatenate([within, edge], axis=-1), np.concatenate([edge, within], axis=-1)))


def cubic(axis: FloatArray, values: FloatArray, x: FloatArray, order: int = 0) -> FloatArray:
    """Interpolate along the first axis as the header's bicubic functions do, with the slopes of parabolas."""
    return np.asarray(CubicHermiteSpline(axis, values, np.gradient(values, axis, axis=0, edge_order=2))(x, order))


def _linear(axis: FloatArray, values: FloatArray, x: FloatArray) -> FloatArray:
    k = _cell(axis, x)
    share = ((x - axis[k]) / (axis[k + 1] - axis[k]))[:, None]
    return np.asarray((1 - share) * values[k] + share * values[k + 1])


def _cell(axis: FloatArray, x: FloatArray) -> IntArray:
    return np.asarray(np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2))


def _secants(axis: FloatArray, values: FloatArray, x: FloatArray) -> list[FloatArray]:
    """Return the slopes (S, ...) of linear interpolation along the first axis, below and above places x (S,)."""
    slopes = np.diff(values, axis=0) / np.diff(axis)[:, None]
    below = np.clip(np.searchsorted(axis, x, side="left") - 1, 0, len(axis) - 2)
    return [slopes[below], slopes[_cell(axis, x)]]
