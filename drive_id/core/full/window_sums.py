"""Cross products Z'Z of all windows, per fold of time, and a sample of the windows themselves."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg.blas import dsyrk

from drive_id.core.frames import ComplexArray
from drive_id.core.full.model import EFFECT_COLUMNS, FullModel
from drive_id.core.full.windows import MEASURED, WindowCutter, Windows
from drive_id.core.numerics.compiled import compiled
from drive_id.core.numerics.running_sums import SavedSums
from drive_id.core.numerics.threads import in_threads, one_blas_thread
from drive_id.types import BoolArray, FloatArray, IntArray, Samples

FOLDS = 5
SEGMENT = 0.25
"""Duration of data that go to the same fold, s."""
MOST_KEPT = 24_000
"""Windows that are kept, in whole segments evenly over time, to examine the residuals."""

_TILE = 256
_CHUNK = 64
"""Windows whose products are formed at once: fewer windows touch fewer columns."""


class WindowSums:
    """Z'Z over windows, per fold, in memory that does not grow with the recording.

    Parameters
    ----------
    model : FullModel

    Notes
    -----
    Segments of time go to the folds in turn: a fit without one fold is tested on data that it has not seen.
    """

    def __init__(self, model: FullModel) -> None:
        self.model = model
        self.windows = 0
        self.outside = 0
        self._cutter = WindowCutter(model.shapes, short=True)
        self._folds: list[FloatArray] = []
        self._shared: set[int] = set()  # folds that a copy holds, too
        self._counts = np.zeros(FOLDS)
        self._pending: list[Windows] = []
        self._segment = 0  # of the pending windows
        self._last = -1  # last segment with windows
        self._kept: dict[int, Windows] = {}
        self._every = 1
        self._recording = 0

    def next_recording(self, heating: float = 0.0, drop_scale: float = 1.0) -> None:
        """Begin another recording, under its own conditions, see :class:`Windows`."""
        for windows in self._cutter.finish():
            self._take(windows)
        self._flush()
        self._recording += self.windows > 0
        self._cutter.restart(SEGMENT * self._next_start(), self._recording)
        self._cutter.set_conditions(heating, drop_scale)

    def add(self, samples: Samples, idle: BoolArray | None = None, *, continues: bool = False) -> None:
        """Accumulate further samples, see :meth:`WindowCutter.cut`."""
        for windows in self._cutter.cut(samples, idle, continues=continues):
            self._take(windows)

    def finished(self) -> WindowSums:
        """Return a copy that includes the samples still waiting for more; this one goes on without them."""
        other = self.copy()
        for windows in other._cutter.finish():  # noqa: SLF001  # of its own class
            other._take(windows)  # noqa: SLF001
        other._flush()  # noqa: SLF001
        return other

    def copy(self) -> WindowSums:
        """Return an independent copy; folds are shared until one of the two changes them."""
        other = copy.copy(self)
        other._cutter = self._cutter.copy()  # noqa: SLF001  # of its own class
        other._folds, other._shared = list(self._folds), set(range(len(self._folds)))  # noqa: SLF001
        self._shared = set(other._shared)  # noqa: SLF001  # copied before the first change
        other._counts = self._counts.copy()  # noqa: SLF001
        other._pending, other._kept = list(self._pending), dict(self._kept)  # noqa: SLF001
        return other

    def with_orders(self, orders: tuple[int, ...]) -> WindowSums:
        """Return the sums over the kept windows for a model with other harmonics."""
        model = self.model
        return self._over(FullModel(model.low, model.high, model.i_max, orders), self._kept)

    def between_crossings(self, weights: Callable[[Windows], FloatArray]) -> WindowSums:
        """Return the sums over the kept short windows instead, with weights (N,) on their squared residuals."""
        short = {number: windows.part(windows.short) for number, windows in self._kept.items()}
        return self._over(
            self.model,
            {
                number: replace(windows, short=np.zeros(len(windows), np.bool_), weight=weights(windows))
                for number, windows in short.items()
            },
        )

    def _over(self, model: FullModel, kept: Mapping[int, Windows]) -> WindowSums:
        other = WindowSums(model)
        for number in sorted(kept):
            other._segment, other._pending = number, [kept[number]]  # of its own class
            other._flush()
        other.outside = self.outside
        return other

    def with_effects(self, columns: Callable[[Windows], ComplexArray]) -> WindowSums:
        """Return sums that include the effects' columns of the kept windows.

        Parameters
        ----------
        columns : callable
            Returns (N, EFFECT_COLUMNS) of windows.

        Notes
        -----
        Where not all windows are kept, the products of the effects with all columns are extrapolated from the kept
        ones by regression, ``z = Z b + r``: only the part of the effects that no other column explains is extrapolated.
        """
        other = self.copy()
        model, effects = self.model, self.model.effects
        kept = {number: windows.part(~windows.short) for number, windows in self._kept.items()}
        kept = {number: replace(windows, effects=columns(windows)) for number, windows in kept.items()}
        other._kept = kept  # noqa: SLF001  # of its own class
        rows = in_threads(model.effect_products, [kept[number] for number in sorted(kept)])
        products = np.zeros((FOLDS, model.size, EFFECT_COLUMNS))
        for number, product in zip(sorted(kept), rows, strict=True):
            products[number % FOLDS] += product
        if sum(len(windows) for windows in kept.values()) < self.windows:
            products = self._extrapolated(products)
        for fold, product in enumerate(products):
            matrix = other._own(fold)  # noqa: SLF001
            matrix[effects, :] = product.T
            matrix[:, effects] = product
        return other

    def _extrapolated(self, products: FloatArray) -> FloatArray:
        """Return the products (F, size, E) of all windows, see :meth:`with_effects`."""
        effects = self.model.effects
        some = self.with_orders(self.model.orders)
        kept_folds, folds = some.folds, self.folds
        total = kept_folds.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(total), np.finfo(np.float64).tiny))
        scaled = total / scale[:, None] / scale
        scaled[np.diag_indices_from(scaled)] += 1e-8
        outer = products.sum(axis=0) / scale[:, None]
        outer[effects] = 0.0
        b = linalg.cho_solve(linalg.cho_factor(scaled, lower=True), outer) / scale[:, None]
        out = np.empty_like(products)
        for fold, product in enumerate(products):
            share = self._counts[fold] / max(float(some._counts[fold]), 1.0)  # noqa: SLF001
            left = share * (product - kept_folds[fold] @ b)
            out[fold] = folds[fold] @ b + left
            inner = share * (product[effects] - b.T @ (kept_folds[fold] @ b)) + b.T @ (folds[fold] @ b)
            out[fold][effects] = 0.5 * (inner + inner.T)
        return out

    def merge(self, other: WindowSums) -> None:
        """Add the sums over other recordings, of an equal model; ``other`` stays unchanged."""
        theirs = other.finished()
        for windows in self._cutter.finish():
            self._take(windows)
        self._flush()
        self._every = max(self._every, theirs._every)  # noqa: SLF001  # of its own class
        offset = self._next_start()
        for number, matrix in enumerate(theirs._matrices()):  # noqa: SLF001
            self._own((number + offset) % FOLDS)[...] += matrix
        self._counts = self._counts + np.roll(theirs._counts, offset)  # noqa: SLF001
        known = self._recording + 1 if self.windows else 0
        runs = 1 + max((int(windows.run.max()) for windows in self._kept.values()), default=-1)
        self._kept |= {
            offset + number: replace(windows, recording=windows.recording + known, run=windows.run + runs)
            for number, windows in theirs._kept.items()  # noqa: SLF001
        }
        self._recording = known + theirs._recording  # noqa: SLF001
        if theirs.windows:
            self._last = offset + theirs._last  # noqa: SLF001
        self._cutter.restart(SEGMENT * self._next_start(), self._recording)
        self.windows += theirs.windows
        self.outside += theirs.outside
        self._thin()

    def state(self) -> SavedSums:
        """Return the state as arrays: only the windows, as long as all of them are kept."""
        done = self.finished()
        out: SavedSums = {"outside": np.array(done.outside), "every": np.array(done._every)}  # noqa: SLF001  # of its own class
        out["segment"] = np.array(sorted(done._kept), np.int64)  # noqa: SLF001
        kept = [done._kept[number] for number in sorted(done._kept)]  # noqa: SLF001
        out["length"] = np.array([len(windows) for windows in kept], np.int64)
        if kept:
            together = Windows.joined(kept)
            out |= {f"windows.{name}": getattr(together, name) for name in MEASURED}
        if done.windows > sum(len(windows) for windows in done.kept()):
            rows, columns = np.tril_indices(self.model.size)
            out["folds"] = np.array([fold[rows, columns] for fold in done._matrices()])  # noqa: SLF001
            out["counts"], out["last"] = done._counts, np.array(done._last)  # noqa: SLF001
        return out

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        self.__dict__.update(WindowSums(self.model).__dict__)
        ends = np.cumsum(state["length"])
        together = Windows(**{name: state[f"windows.{name}"] for name in MEASURED}) if len(ends) else None
        for number, start, end in zip(state["segment"], ends - state["length"], ends, strict=True):
            if together is not None:
                self._segment, self._pending = int(number), [together.part(slice(int(start), int(end)))]
                self._flush()
        self.outside, self._every = int(state["outside"]), int(state["every"])
        if "folds" in state:
            rows, columns = np.tril_indices(self.model.size)
            for fold, packed in zip(self._matrices(), state["folds"], strict=True):
                fold[rows, columns] = packed
            self._counts, self._last = np.array(state["counts"]), int(state["last"])
            self.windows = int(self._counts.sum())
        if together is not None:
            self._recording = int(together.recording.max())
        self._cutter.restart(SEGMENT * self._next_start(), self._recording)

    @property
    def folds(self) -> FloatArray:
        """Z'Z of each fold, (FOLDS, size, size), symmetric."""
        out, matrices = np.empty((FOLDS, self.model.size, self.model.size)), self._matrices()

        def fill(number: int) -> None:
            out[number] = matrices[number].T  # C rows are Fortran columns: the upper triangle
            mirror_upper(out[number])

        in_threads(fill, range(FOLDS))
        return out

    @property
    def total(self) -> FloatArray:
        """Z'Z of all windows, (size, size), symmetric."""
        out = np.zeros((self.model.size, self.model.size))
        for matrix in self._matrices():
            out += matrix.T
        mirror_upper(out)
        return out

    @property
    def counts(self) -> FloatArray:
        """Rows of each fold, (FOLDS,)."""
        return np.asarray(2.0 * self._counts)

    def kept(self) -> list[Windows]:
        """Return the kept segments in order of time."""
        return [windows.part(~windows.short) for _, windows in sorted(self._kept.items())]

    def kept_short(self) -> list[Windows]:
        """Return the short windows of the kept segments in order of time."""
        return [windows.part(windows.short) for _, windows in sorted(self._kept.items())]

    def _next_start(self) -> int:
        """Return the segment in which the next recording begins, the same for merging and adding."""
        return -(-(self._last + 1) // self._every) * self._every

    def _matrices(self) -> list[FloatArray]:
        if not self._folds:
            self._folds = [np.zeros((self.model.size, self.model.size), order="F") for _ in range(FOLDS)]
        return self._folds

    def _own(self, fold: int) -> FloatArray:
        """Return a fold that no copy shares."""
        matrices = self._matrices()
        if fold in self._shared:
            matrices[fold] = matrices[fold].copy(order="F")
            self._shared.discard(fold)
        return matrices[fold]

    def _take(self, windows: Windows) -> None:
        """Collect windows until a segment is complete."""
        usable = self.model.contains(windows)
        self.outside += int((~usable & ~windows.short).sum())
        segment = windows.interval(SEGMENT)
        for number in np.unique(segment):
            if number != self._segment:
                self._flush()
                self._segment = int(number)
            self._pending.append(windows.part(np.flatnonzero((segment == number) & usable)))

    def _flush(self) -> None:
        """Accumulate the windows of a segment."""
        windows = Windows.joined(self._pending) if self._pending else None
        self._pending = []
        if windows is None or windows.short.all():
            return
        fold, whole = self._segment % FOLDS, windows.part(~windows.short)
        matrix = self._own(fold)
        with one_blas_thread(with_scipy=True):
            for start in range(0, len(whole), _CHUNK):
                few = whole.part(slice(start, start + _CHUNK))
                add_products(self.model.design(few).reshape(-1, self.model.size), matrix)
        self._counts[fold] += len(whole) if whole.weight is None else whole.weight.sum()
        self.windows += len(whole)
        self._last = self._segment
        if self._segment % self._every == 0:
            earlier = self._kept.get(self._segment)
            self._kept[self._segment] = windows if earlier is None else Windows.joined([earlier, windows])
            self._thin()

    def _thin(self) -> None:
        while len(self._kept) > 1 and sum(int((~windows.short).sum()) for windows in self._kept.values()) > MOST_KEPT:
            self._every *= 2
            self._kept = {number: windows for number, windows in self._kept.items() if number % self._every == 0}


def mirror_upper(matrix: FloatArray) -> None:
    """Copy the upper triangle of a matrix to the lower one, tile by tile to stay in the cache."""
    edges = [*range(0, len(matrix), _TILE), len(matrix)]
    for k, (start, end) in enumerate(pairwise(edges)):
        corner = matrix[start:end, start:end]
        corner[...] = np.triu(corner) + np.triu(corner, 1).T
        for left, right in pairwise(edges[: k + 1]):
            matrix[start:end, left:right] = matrix[left:right, start:end].T


@compiled("f8[::1, :], i8[::1], f8[::1, :]")
def add_lower(block: FloatArray, columns: IntArray, total: FloatArray) -> None:
    """Add the lower triangle of a matrix (K, K) to the rows and columns ``columns`` (K,), increasing, of ``total``."""
    for column in range(len(columns)):
        for row in range(column, len(columns)):
            total[columns[row], columns[column]] += block[row, column]


def add_products(rows: FloatArray, total: FloatArray) -> None:
    """Add the lower triangle of rows' rows to ``total``, skipping columns that are zero.

    Parameters
    ----------
    rows : (N, size) float
        Neighbours in time, whose currents meet few of the basis functions.
    total : (size, size) float, in Fortran order
    """
    columns = np.flatnonzero(rows.any(axis=0))
    add_lower(dsyrk(1.0, rows[:, columns].T, lower=1), columns, total)
