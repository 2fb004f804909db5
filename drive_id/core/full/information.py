"""What windows say about the unknowns of method ``full``: cross products per fold of time, and some of the windows."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.full.kernels import add_products
from drive_id.core.full.model import FullModel
from drive_id.core.full.windows import WindowCutter, Windows
from drive_id.core.numerics.running_sums import State
from drive_id.core.numerics.threads import in_threads
from drive_id.types import BoolArray, FloatArray, Samples

FOLDS = 5
SEGMENT = 0.25
"""s of data in a row that go to the same fold."""
MOST_KEPT = 24_000
"""Windows that are kept themselves, in whole segments evenly over time, to study the residuals."""

_BLOCK = 256
_CHUNK = 64
"""Windows whose products are formed at a time: the fewer, the fewer columns they touch."""


class WindowInformation:
    """Z'Z over windows, per fold; its size does not grow with the recording.

    Parameters
    ----------
    model : FullModel

    Notes
    -----
    Segments of time take turns in the folds: leaving one out tests a fit on data that it has not seen.
    """

    def __init__(self, model: FullModel) -> None:
        self.model = model
        self.windows = 0
        self.outside = 0
        self._cutter = WindowCutter(model.shapes)
        self._folds: list[FloatArray] = []
        self._shared: set[int] = set()  # folds that another one holds, too
        self._counts = np.zeros(FOLDS, np.int64)
        self._pending: list[Windows] = []
        self._segment = 0  # of the windows that are pending
        self._last = -1  # segment that has windows
        self._kept: dict[int, Windows] = {}
        self._every = 1

    def next_recording(self, heating: float = 0.0, drop_scale: float = 1.0) -> None:
        """Tell that another recording begins, and under which conditions, see :class:`Windows`."""
        for windows in self._cutter.finish():
            self._take(windows)
        self._flush()
        self._cutter.restart(SEGMENT * self._next_start())
        self._cutter.set_conditions(heating, drop_scale)

    def add(self, samples: Samples, idle: BoolArray | None = None, *, continues: bool = False) -> None:
        """Accumulate further samples, see :meth:`WindowCutter.cut`."""
        for windows in self._cutter.cut(samples, idle, continues=continues):
            self._take(windows)

    def finished(self) -> WindowInformation:
        """Return the information with the samples that still wait for more; this one goes on without it."""
        other = self.copy()
        for windows in other._cutter.finish():  # noqa: SLF001  # of its own class
            other._take(windows)  # noqa: SLF001
        other._flush()  # noqa: SLF001
        return other

    def copy(self) -> WindowInformation:
        """Return information that goes its own way from here."""
        other = copy.copy(self)
        other._cutter = self._cutter.copy()  # noqa: SLF001  # of its own class
        other._folds, other._shared = list(self._folds), set(range(len(self._folds)))  # noqa: SLF001
        self._shared = set(other._shared)  # noqa: SLF001  # whoever adds to a fold first copies it
        other._counts = self._counts.copy()  # noqa: SLF001
        other._pending, other._kept = list(self._pending), dict(self._kept)  # noqa: SLF001
        return other

    def with_orders(self, orders: tuple[int, ...]) -> WindowInformation:
        """Return the information of the windows that were kept about a model with other harmonics."""
        model = self.model
        other = WindowInformation(FullModel(model.low, model.high, model.i_max, orders))
        for number in sorted(self._kept):
            other._segment, other._pending = number, [self._kept[number]]  # of its own class
            other._flush()
        other.outside = self.outside
        return other

    def merge(self, other: WindowInformation) -> None:
        """Add what another one of equal model has gathered of other recordings; that one stays as it is."""
        theirs = other.finished()
        for windows in self._cutter.finish():
            self._take(windows)
        self._flush()
        self._every = max(self._every, theirs._every)  # noqa: SLF001  # of its own class
        offset = self._next_start()
        for number, matrix in enumerate(theirs._matrices()):  # noqa: SLF001
            self._own((number + offset) % FOLDS)[...] += matrix
        self._counts = self._counts + np.roll(theirs._counts, offset)  # noqa: SLF001
        self._kept |= {offset + number: windows for number, windows in theirs._kept.items()}  # noqa: SLF001
        if theirs.windows:
            self._last = offset + theirs._last  # noqa: SLF001
        self._cutter.restart(SEGMENT * self._next_start())
        self.windows += theirs.windows
        self.outside += theirs.outside
        self._thin()

    def state(self) -> State:
        """Return all that was gathered: the windows alone, while they are few enough to be kept all."""
        done = self.finished()
        out: State = {"outside": np.array(done.outside), "every": np.array(done._every)}  # noqa: SLF001  # of its own class
        out["segment"] = np.array(sorted(done._kept), np.int64)  # noqa: SLF001
        kept = done.kept()
        out["length"] = np.array([len(windows) for windows in kept], np.int64)
        if kept:
            together = Windows.joined(kept)
            out |= {f"windows.{field.name}": getattr(together, field.name) for field in fields(Windows)}
        if done.windows > int(out["length"].sum()):
            rows, columns = np.tril_indices(self.model.size)
            out["folds"] = np.array([fold[rows, columns] for fold in done._matrices()])  # noqa: SLF001
            out["counts"], out["last"] = done._counts, np.array(done._last)  # noqa: SLF001
        return out

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take over a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        self.__dict__.update(WindowInformation(self.model).__dict__)
        ends = np.cumsum(state["length"])
        together = Windows(*(state[f"windows.{field.name}"] for field in fields(Windows))) if len(ends) else None
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
        self._cutter.restart(SEGMENT * self._next_start())

    @property
    def folds(self) -> FloatArray:
        """Z'Z of each fold, (FOLDS, size, size), symmetric."""
        out, matrices = np.empty((FOLDS, self.model.size, self.model.size)), self._matrices()

        def fill(number: int) -> None:
            out[number] = matrices[number].T  # rows of C's order are columns of Fortran's: the upper triangle
            mirror_upper(out[number])

        in_threads(fill, range(FOLDS))
        return out

    @property
    def counts(self) -> FloatArray:
        """Rows of each fold, (FOLDS,)."""
        return np.asarray(2.0 * self._counts)

    def kept(self) -> list[Windows]:
        """Return the segments that were kept, in order of time."""
        return [self._kept[number] for number in sorted(self._kept)]

    def _next_start(self) -> int:
        """Return the segment in which another recording begins: whether it is merged or added makes no difference."""
        return -(-(self._last + 1) // self._every) * self._every

    def _matrices(self) -> list[FloatArray]:
        if not self._folds:
            self._folds = [np.zeros((self.model.size, self.model.size), order="F") for _ in range(FOLDS)]
        return self._folds

    def _own(self, fold: int) -> FloatArray:
        """Return a fold that may be written to."""
        matrices = self._matrices()
        if fold in self._shared:
            matrices[fold] = matrices[fold].copy(order="F")
            self._shared.discard(fold)
        return matrices[fold]

    def _take(self, windows: Windows) -> None:
        """Collect windows until a segment is complete."""
        usable = self.model.contains(windows)
        self.outside += int((~usable).sum())
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
        if windows is None or not len(windows):
            return
        fold = self._segment % FOLDS
        matrix = self._own(fold)
        for start in range(0, len(windows), _CHUNK):
            part = windows.part(slice(start, start + _CHUNK))
            add_products(self.model.design(part).reshape(-1, self.model.size), matrix)
        self._counts[fold] += len(windows)
        self.windows += len(windows)
        self._last = self._segment
        if self._segment % self._every == 0:
            earlier = self._kept.get(self._segment)
            self._kept[self._segment] = windows if earlier is None else Windows.joined([earlier, windows])
            self._thin()

    def _thin(self) -> None:
        while len(self._kept) > 1 and sum(len(windows) for windows in self._kept.values()) > MOST_KEPT:
            self._every *= 2
            self._kept = {number: windows for number, windows in self._kept.items() if number % self._every == 0}


def mirror_upper(matrix: FloatArray) -> None:
    """Make a matrix symmetric by its upper triangle; by blocks, as a transposed copy would miss the cache."""
    edges = [*range(0, len(matrix), _BLOCK), len(matrix)]
    for k, (start, end) in enumerate(pairwise(edges)):
        corner = matrix[start:end, start:end]
        corner[...] = np.triu(corner) + np.triu(corner, 1).T
        for left, right in pairwise(edges[: k + 1]):
            matrix[start:end, left:right] = matrix[left:right, start:end].T
