"""Data types that all rooms share: frozen dataclasses, validated once at construction.

SI units; amplitude-invariant (peak) currents, voltages and flux linkages; electrical radians and rad/s; phase order
a, b, c; d is the magnet axis and q leads it by 90 degrees electrical.
"""

from __future__ import annotations

import html
import math
import numbers
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drive_id.common.quantity import counted
from drive_id.errors import ConfigurationError, DataError, NonFiniteError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)

NANOSECONDS = 1_000_000_000
"""Of a second: stamps are whole numbers of them."""
TINY = float(np.finfo(np.float64).tiny)
"""Least divisor: keeps a ratio of nothing to nothing finite."""
_LARGEST = 1e39
"""Limit for samples, just beyond float32: powers and sums of larger values overflow."""
_LARGEST_SQUARE = 1e100
"""Upper bound of the sum of squares of any realistic number of samples below :data:`_LARGEST`."""


def ranges_table(caption: str, values: Mapping[str, NDArray[Any]]) -> str:
    """Return an HTML table of the least and largest known value of arrays, for notebooks."""
    known = {name: array[np.isfinite(array)] for name, array in values.items()}
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{array.min():.5g}</td><td>{array.max():.5g}</td></tr>"
        for name, array in known.items()
        if array.size
    )
    heading = "<tr><th></th><th>least</th><th>largest</th></tr>"
    return f"<table><caption>{html.escape(caption)}</caption>{heading}{rows}</table>"


@dataclass(frozen=True, eq=False, repr=False)
class Samples:
    """Equally sampled signals of one drive, the paper's ``eq:experiment``, without the gaps.

    All sources (live topics, our bags, bags with other messages) end in this type. Its arrays are checked once, so they
    are read-only: arrays that can be written to are copied.

    Parameters
    ----------
    stamp : (N,) int64
        Time of each sample in ns since an arbitrary epoch, strictly increasing.
    i_abc : (N, 3) float
        Measured phase currents at ``stamp``, A.
    u_abc : (N, 3) float
        Commanded phase voltages, held in the stator frame from ``stamp`` to ``stamp + sample_period``, V.
    angle : (N,) float
        Electrical angle at ``stamp``, rad, wrapped or not.
    speed : (N,) float
        Electrical speed at ``stamp``, rad/s.
    sample_period : float
        s.
    run_starts : (S,) int64, optional
        Index of the first sample of each gap-free run; the first is 0. Nothing is differenced or integrated across the
        start of a run. Default: one run.
    i_dq_reference : (N, 2) float, optional
        Current references valid at ``stamp``, A, NaN where none is known.
    truth : GroundTruth, optional
        Of a simulation. A fit never uses it, but is scored against it.
    dc_link_voltage, winding_temperature, magnet_temperature, shaft_torque : (N,) float, optional
        Optional signals interpolated at ``stamp``, V, degrees Celsius (twice) and Nm, NaN where unknown.
    angle_error : float
        Standard error of an angle that was interpolated, rad; 0 for an angle recorded with each sample.
    turned : frozenset of str, optional
        Which of "currents" and "voltages" a log held in d and q, so that the angle of that transformation counts.
        Default: not known.

    Raises
    ------
    DataError
        When shapes disagree, the period is not positive, stamps do not increase or runs are not in order.
    NonFiniteError
        When a sample is NaN or infinite; optional signals and references may be NaN.
    """

    stamp: IntArray
    i_abc: FloatArray
    u_abc: FloatArray
    angle: FloatArray
    speed: FloatArray
    sample_period: float
    run_starts: IntArray = field(default_factory=lambda: np.zeros(1, np.int64))
    i_dq_reference: FloatArray | None = None
    truth: GroundTruth | None = None
    dc_link_voltage: FloatArray | None = None
    winding_temperature: FloatArray | None = None
    magnet_temperature: FloatArray | None = None
    shaft_torque: FloatArray | None = None
    angle_error: float = 0.0
    turned: frozenset[str] | None = None

    def __post_init__(self) -> None:
        if np.ndim(self.stamp) != 1:
            raise DataError(f"stamp has shape {np.shape(self.stamp)}: give a stamp for each sample.")
        n = len(self.stamp)
        shapes: dict[str, tuple[int, ...]] = {"i_abc": (n, 3), "u_abc": (n, 3), "angle": (n,), "speed": (n,)}
        if self.i_dq_reference is not None:
            shapes["i_dq_reference"] = (n, 2)
        shapes |= dict.fromkeys(self.scalars(), (n,))
        for name, shape in shapes.items():
            values = np.asarray(getattr(self, name))
            if values.dtype.kind not in "biuf":
                raise DataError(f"{name} holds values of type {values.dtype}: pass real numbers.")
            if values.shape != shape:
                said = f"{name} has shape {values.shape} where {n} stamps need {shape}"
                raise DataError(f"{said}: pass arrays of equal length.")
            object.__setattr__(self, name, _read_only(values, np.float64))
        for name in ("stamp", "run_starts"):
            object.__setattr__(self, name, _read_only(np.asarray(getattr(self, name)), np.int64))
        if not (isinstance(self.sample_period, numbers.Real) and 0 < self.sample_period < math.inf):
            raise DataError(f"The sample period is {self.sample_period} s: it must be a positive number of seconds.")
        if n == 0:
            raise DataError("There are no samples: check that the three signals overlap in time.")
        if np.any(np.diff(self.stamp) <= 0):
            raise DataError("The stamps do not increase strictly: cut repeated and backward stamps first.")
        starts = self.run_starts
        if len(starts) == 0 or starts[0] != 0 or np.any(np.diff(starts) <= 0) or starts[-1] >= n:
            raise DataError("run_starts must begin with 0 and increase strictly within the samples.")
        self._check_values()

    def _check_values(self) -> None:
        n = len(self)
        for name, values in self.scalars().items():
            if (np.abs(values) > _LARGEST).any():
                raise NonFiniteError(f"{name} holds infinite values: use NaN where it is unknown.")
        for name in ("i_abc", "u_abc", "angle", "speed"):
            values = getattr(self, name)
            with np.errstate(over="ignore", invalid="ignore"):
                square = np.vdot(values, values)
            if not square < _LARGEST_SQUARE:
                usable = (np.abs(values) < _LARGEST).reshape(n, -1).all(axis=1)
                k = int(np.argmin(usable))
                what = "NaN or infinite" if not np.isfinite(values).all() else f"larger than {_LARGEST:g}"
                raise NonFiniteError(
                    f"{name} holds {counted(n - int(usable.sum()), 'sample')} {what}, the first at "
                    f"{(self.stamp[k] - self.stamp[0]) * 1e-9:.6f} s: repair or cut the recording there."
                )

    def __len__(self) -> int:
        return len(self.stamp)

    def __repr__(self) -> str:
        parts = [f"{len(self)} at {1e-3 / self.sample_period:.6g} kHz", f"{self.duration:.4g} s"]
        parts += [counted(len(self.run_starts), "run")] if len(self.run_starts) > 1 else []
        known = ["references"] if self.i_dq_reference is not None else []
        known += [name.replace("_", " ") for name in self.scalars()]
        parts += [f"with {' and '.join(known)}"] if known else []
        parts += [f"truth of {self.truth.machine}"] if self.truth else []
        return f"<Samples: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Return the ranges of the signals as a small table, for notebooks."""
        ranges = {"i_abc, A": self.i_abc, "u_abc, V": self.u_abc, "speed, rad/s electrical": self.speed}
        return ranges_table(repr(self)[1:-1], ranges | self.scalars())

    @property
    def duration(self) -> float:
        """Time covered by data, gaps excluded, s."""
        return len(self) * self.sample_period

    def scalars(self) -> dict[str, FloatArray]:
        """Return the optional signals that are there, (N,) each, by name."""
        found = {name: getattr(self, name) for name in SCALARS}
        return {name: values for name, values in found.items() if values is not None}

    def or_unknown(self, name: str) -> FloatArray:
        """Return references or an optional signal by name, NaN where there are none."""
        values: FloatArray | None = getattr(self, name)
        shape = (len(self), 2) if name == "i_dq_reference" else (len(self),)
        return np.broadcast_to(np.nan, shape) if values is None else values

    def runs(self) -> Iterator[slice]:
        """Yield the gap-free runs as slices, in order of time."""
        ends = np.append(self.run_starts[1:], len(self))
        for start, end in zip(self.run_starts, ends, strict=True):
            yield slice(int(start), int(end))

    def part(self, start: int, stop: int, *, copy: bool = False) -> Samples:
        """Return samples ``start`` to ``stop`` (not included) with their runs, references and optional signals.

        Parameters
        ----------
        start, stop : int
            Indices, ``0 <= start < stop <= len(self)``.
        copy : bool
            Own arrays instead of views, so that these samples can be freed.
        """
        inner = self.run_starts[(self.run_starts > start) & (self.run_starts < stop)] - start
        starts = np.append(np.zeros(1, np.int64), inner)
        return self._cut(lambda x: fixed(x[start:stop].copy()) if copy else x[start:stop], starts)

    def chosen(self, kept: BoolArray, begins: BoolArray) -> Samples:
        """Return some of the samples, at least one.

        Parameters
        ----------
        kept : (N,) bool
            Which ones.
        begins : (N,) bool
            Which of them begin a run; the first one must.
        """
        return self._cut(lambda x: fixed(x[kept]), np.flatnonzero(begins[kept]))

    def _cut(self, cut: Callable[[NDArray[Any]], NDArray[Any]], run_starts: IntArray) -> Samples:
        """Return samples whose arrays are all cut alike."""
        arrays = {name: getattr(self, name) for name in (*_SIGNALS, *_OPTIONAL)}
        own: dict[str, Any] = {name: None if array is None else cut(array) for name, array in arrays.items()}
        return replace(self, **own, run_starts=run_starts)

    @classmethod
    def joined(cls, parts: Sequence[Samples], continues: Sequence[bool] | None = None) -> Samples:
        """Put samples of one period together, in the order given.

        Parameters
        ----------
        parts : sequence of Samples
            At least one, each later than the ones before.
        continues : sequence of bool, optional
            Which parts begin with the last sample of the part before, which is then taken once and no new run begins.
            Default: none does.

        Returns
        -------
        Samples
            References and optional signals are NaN in parts without; None where no part has any. The truth is kept
            when all have the same.

        Raises
        ------
        DataError
            When the stamps do not increase from part to part.
        """
        skips = [int(goes_on) for goes_on in continues or [False] * len(parts)]
        sizes = [len(part) - skip for part, skip in zip(parts, skips, strict=True)]
        offsets = np.cumsum([0, *sizes[:-1]])

        def together(arrays: Iterable[NDArray[Any]]) -> NDArray[Any]:
            return fixed(np.concatenate([array[skip:] for array, skip in zip(arrays, skips, strict=True)]))

        known = [name for name in _OPTIONAL if any(getattr(part, name) is not None for part in parts)]
        arrays: dict[str, Any] = {name: together(getattr(part, name) for part in parts) for name in _SIGNALS}
        arrays |= {name: together(part.or_unknown(name) for part in parts) for name in known}
        return replace(
            parts[0],
            **arrays,
            run_starts=np.concatenate(
                [part.run_starts[skip:] - skip + at for part, skip, at in zip(parts, skips, offsets, strict=True)]
            ),
            truth=parts[0].truth if all(part.truth is parts[0].truth for part in parts) else None,
            angle_error=math.sqrt(float(np.average([part.angle_error**2 for part in parts], weights=sizes))),
            turned=reduce(either_turned, (part.turned for part in parts)),
        )


def either_turned(one: frozenset[str] | None, other: frozenset[str] | None) -> frozenset[str] | None:
    """Return which signals of two logs were held in d and q in either; None if one of them does not tell."""
    return None if one is None or other is None else one | other


def fixed(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Forbid writing to an array that nobody else writes to: :class:`Samples` take it without a copy."""
    values.flags.writeable = False
    return values


def _read_only(values: NDArray[Any], kind: type[Scalar]) -> NDArray[Scalar]:
    """Return values as a contiguous array that nobody can write to, as kernels want it."""
    return fixed(np.array(values, kind, order="C", copy=True if values.flags.writeable else None))


_SIGNALS = ("stamp", "i_abc", "u_abc", "angle", "speed")
"""Arrays with one entry per sample that are always there."""

SCALARS = ("dc_link_voltage", "winding_temperature", "magnet_temperature", "shaft_torque")
"""Optional signals: fields of :class:`Samples` and relative topics of the same names."""

_OPTIONAL = ("i_dq_reference", *SCALARS)
"""Arrays with one entry per sample that may be missing."""


@dataclass(frozen=True, eq=False)
class MachineMap:
    """A machine file in memory: flux linkages on a grid of currents, possibly over the rotor position, and ratings.

    Parameters
    ----------
    name : str
        For tables and titles.
    i_d, i_q : (D,), (Q,) float
        Axes, A, strictly increasing.
    psi_d, psi_q : (D, Q) float
        Flux linkages averaged over the rotor position, Wb.
    resistance : float
        Of the stator winding, ohm.
    pole_pairs : int
    i_max : float
        Largest current amplitude to be commanded, A.
    u_dc : float
        DC-link voltage, V.
    theta : (H,) float, optional
        Electrical angles, rad, equally spaced over one period of the harmonics without its end point.
    psi_d_theta, psi_q_theta : (D, Q, H) float, optional
        Flux linkages over the rotor position, Wb.

    Raises
    ------
    ConfigurationError
        When shapes disagree, axes do not increase, or a value is not finite or not positive where it must be.
    """

    name: str
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    resistance: float
    pole_pairs: int
    i_max: float
    u_dc: float
    theta: FloatArray | None = None
    psi_d_theta: FloatArray | None = None
    psi_q_theta: FloatArray | None = None

    def __post_init__(self) -> None:
        shape = (len(self.i_d), len(self.i_q))
        if min(shape) < 4:
            raise ConfigurationError(f"Machine '{self.name}' has a {shape} grid: at least 4 x 4 points are needed.")
        for axis in ("i_d", "i_q"):
            if np.any(np.diff(getattr(self, axis)) <= 0):
                raise ConfigurationError(f"Axis {axis} of machine '{self.name}' does not increase strictly: sort it.")
        maps: dict[str, tuple[int, ...]] = {"psi_d": shape, "psi_q": shape}
        if self.theta is not None:
            maps |= {"psi_d_theta": (*shape, len(self.theta)), "psi_q_theta": (*shape, len(self.theta))}
        for name, expected in maps.items():
            values = getattr(self, name)
            if values is None or values.shape != expected:
                found = None if values is None else values.shape
                raise ConfigurationError(f"{name} of machine '{self.name}' is {found} where its axes need {expected}.")
            if not np.isfinite(values).all():
                raise ConfigurationError(f"{name} of machine '{self.name}' holds NaN or infinite values: fill the map.")
        if not (np.isfinite(self.resistance) and self.resistance >= 0):
            raise ConfigurationError(f"The resistance of machine '{self.name}' is {self.resistance}: give ohms >= 0.")
        for name in ("pole_pairs", "i_max", "u_dc"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigurationError(f"{name} of machine '{self.name}' is {value}: it must be positive.")


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """What a simulation knows and an experiment does not; attached to the bag, never in its topics.

    Parameters
    ----------
    machine : str
    i_d, i_q : (D,), (Q,) float
        Axes, A.
    psi_d, psi_q : (D, Q) float
        True flux linkages, averaged over the rotor position, Wb.
    resistance : float
        Of the stator, without the linear part of the inverter's drop, ohm.
    inverter_current, inverter_voltage : (C,) float
        True voltage drop of one phase (positive for positive current, V) over the phase current (A).
    i_max : float
        Radius of the current disc of the experiment, A.
    pole_pairs : int
    details : dict of str to str, float or int
        Settings of the simulation.

    Raises
    ------
    ConfigurationError
        When shapes disagree, axes do not increase, or a value is not finite.
    """

    machine: str
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    resistance: float
    inverter_current: FloatArray
    inverter_voltage: FloatArray
    i_max: float
    pole_pairs: int
    details: dict[str, str | float | int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = (len(self.i_d), len(self.i_q))
        curve = len(self.inverter_current)
        if min(shape) < 4 or self.psi_d.shape != shape or self.psi_q.shape != shape:
            raise ConfigurationError(f"The true map of '{self.machine}' does not match its axes of {shape} points.")
        if curve < 2 or len(self.inverter_voltage) != curve:
            raise ConfigurationError(f"The true inverter curve of '{self.machine}' does not fit its {curve} currents.")
        if any(np.any(np.diff(axis) <= 0) for axis in (self.i_d, self.i_q, self.inverter_current)):
            raise ConfigurationError(f"The axes of the truth of '{self.machine}' do not increase strictly: sort them.")
        arrays = (self.psi_d, self.psi_q, self.inverter_voltage)
        if not all(np.isfinite(values).all() for values in arrays) or not self.i_max > 0:
            raise ConfigurationError(f"The truth of '{self.machine}' is not finite or its disc empty: simulate again.")


Progress = Callable[[str, float | None], None]
"""Called with the name of the step and its completed share, 0 to 1; None for a step of unknown length."""


def silent(what: str, share: float | None) -> None:  # a Progress
    """Report no progress."""


def on_bar(bar: Any) -> Progress:
    """Return what shows progress on a bar: ``drive_id.fit(bag, tell=drive_id.on_bar(tqdm()))``.

    Parameters
    ----------
    bar : tqdm.tqdm
        Or any object with ``total``, ``n``, ``set_description`` and ``refresh``.
    """

    def tell(what: str, share: float | None) -> None:
        bar.total, bar.n = 1.0, share or 0.0
        bar.set_description(what)
        bar.refresh()

    return tell
