"""Cross products Z'Z of all windows, per fold of time, and a sample of the windows themselves."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from functools import reduce
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from drive_id.core.frames import ComplexArray
from drive_id.core.full.model import EFFECT_COLUMNS, FullModel
from drive_id.core.full.windows import MEASURED, Terms, WindowCutter, Windows, interval, kept_of
from drive_id.core.numerics.normal_equations import add_triangle, congruent, triangle_of, unpacked
from drive_id.core.numerics.running_sums import SavedSums, exactly
from drive_id.core.numerics.threads import MOST_THREADS, begun, in_threads, one_blas_thread
from drive_id.types import TINY, BoolArray, FloatArray, Samples, either_turned

FOLDS = 5
"""Parts of the data, each of which is left out once: the usual number; time grows with it."""
SEGMENT = 0.25
"""Duration of data that go to the same fold, s."""
MOST_KEPT = 24_000
"""Number of stored windows, in whole segments all over the time, for the analysis of residuals."""

_DUE = 16 * FOLDS
"""Segments collected before their products are formed: with more windows, neighbours are closer, and folds are formed
in parallel threads."""
_UNSEEN, _STEPS = 0.1, 4
"""Share of all windows' products below which those of the kept ones count as unseen, and steps of the iterated
regularization: what the kept windows hold in full is regressed to 0.1^4 = 1e-4."""
_ROUNDING = 1e-10
"""Added to the unit diagonal: products are exact to 1e-13, and columns without data must not end the factorization."""


class WindowSums:
    """Z'Z over windows, per fold, in memory that does not grow with the recording.

    Notes
    -----
    Segments of time go to the folds in turn: a fit without one fold is tested on data that it has not seen.

    The columns are ``model.summed``. Sums over reciprocal columns take 41 % of the memory of those over free ones;
    :meth:`freed` forms the latter from the kept windows.
    """

    def __init__(self, model: FullModel) -> None:
        self.model = model
        self.windows = 0
        self.outside = 0
        self.turned: frozenset[str] | None = frozenset()
        """Which signals a log held in d and q, see :class:`~drive_id.types.Samples`."""
        self._link = np.zeros(2)  # integral of the DC-link voltage, V s, over the time in which it was recorded, s
        self._cutter = WindowCutter(model.shapes, SEGMENT)
        self._folds: list[FloatArray] = []
        self._shared: set[int] = set()  # folds shared with a copy
        self._squares = np.zeros(FOLDS)  # of the columns of a free map, where those of the sums are reciprocal
        self._due: list[tuple[int, Terms]] = []  # folds and windows whose products are still to be formed
        self._forming: Future[None] | None = None  # those under way in another thread
        self.effects: FloatArray | None = None
        """Z'z (FOLDS, size, EFFECT_COLUMNS), z being the columns of the effects; see :meth:`with_effects`."""
        self.known: dict[Any, Any] = {}  # to solvers of these folds, with any effects
        self._some: list[FloatArray] = []  # triangles of the folds over the kept windows, where these are not all
        self._counts = np.zeros(FOLDS)
        self._pending: list[Terms] = []
        self._segment = 0  # of the pending windows
        self._last = -1  # last segment with windows
        self._kept: dict[int, Windows] = {}  # by segment
        self._short: dict[int, Windows] = {}  # those that are short, likewise
        self._every = 1
        self._recording = 0

    def next_recording(self, heating: float = 0.0, drop_scale: float = 1.0) -> None:
        """Begin another recording, under its own conditions, see :class:`Windows`."""
        self._finish()
        self._recording += self.windows > 0
        self._restart()
        self._cutter.set_conditions(heating, drop_scale)

    def add(
        self, samples: Samples, idle: BoolArray | None = None, *, continues: bool = False, prompt: bool = False
    ) -> None:
        """Accumulate further samples, see :meth:`WindowCutter.cut`.

        With ``prompt``, all products are formed immediately, so that :meth:`finished` is quick even after many samples.
        """
        self.turned = either_turned(self.turned, samples.turned)
        if samples.dc_link_voltage is not None:
            known = samples.dc_link_voltage[np.isfinite(samples.dc_link_voltage)]
            self._link = self._link + samples.sample_period * np.array([known.sum(), len(known)])
        for windows in self._cutter.cut(samples, idle, continues=continues):
            self._take(windows)
        if prompt:
            self._form_products(threads=1)  # there are few: waiting for other threads takes longer on a busy computer

    def finished(self) -> WindowSums:
        """Return a copy that includes the samples not yet in a window; the original can still be extended."""
        other = self.copy()
        other._finish()  # noqa: SLF001  # of its own class
        other._form_products()  # noqa: SLF001
        return other

    def copy(self) -> WindowSums:
        """Return an independent copy; folds are shared until one of the two changes them."""
        other = copy.copy(self)
        other._cutter = self._cutter.copy()  # noqa: SLF001  # of its own class
        other.known = {}
        other._folds, other._shared = list(self._folds), set(range(len(self._folds)))  # noqa: SLF001
        self._shared = set(other._shared)  # noqa: SLF001  # copied before the first change
        other._due = list(self._due)  # noqa: SLF001
        other._counts, other._squares = self._counts.copy(), self._squares.copy()  # noqa: SLF001
        other._pending = list(self._pending)  # noqa: SLF001
        other._kept, other._short = dict(self._kept), dict(self._short)  # noqa: SLF001
        return other

    def over(self, model: FullModel, kept: Mapping[int, Windows] | None = None) -> WindowSums:
        """Return the sums over the kept windows, or over others of the same segments, for another model."""
        kept, other = self._kept if kept is None else kept, WindowSums(model)
        for number in sorted(kept):
            other._segment, other._pending = number, [kept[number]]  # of its own class
            other._flush()
        other._form_products()
        other._short = dict(self._short)
        other.outside, other.turned, other._link = self.outside, self.turned, self._link
        return other

    def freed(self, orders: tuple[int, ...]) -> WindowSums:
        """Return the sums over the kept windows for a model of free maps with these harmonics only, or these sums."""
        if not self.model.reciprocal:
            return self
        return self.over(replace(self.model, orders=orders, reciprocal=False))

    def changed(self, change: Callable[[Windows], Windows], *, short: bool = False) -> WindowSums:
        """Return the sums over the kept windows, or over their short ones, after a change, without effects."""
        kept = self._short if short else self._kept
        return self.over(self.model, {number: change(windows) for number, windows in kept.items()})

    def sampled(self, most: int) -> WindowSums:
        """Return the sums over about so many of the kept windows, evenly over them, without effects, or these sums."""
        every = sum(map(len, self.kept())) // most
        if every < 2:
            return self
        return self.changed(lambda windows: windows.part(kept_of(np.arange(len(windows)), every)))

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
        Any b gives the right sums on average. It must not be large where the kept windows hold little of Z, at the rim
        of what they cover, and is therefore found by iterated Tikhonov regularization.
        """
        other, model = self.copy(), self.model
        other.known = self.known
        numbers, kept = sorted(self._kept), self.kept()
        products = np.zeros((FOLDS, model.summed.size, EFFECT_COLUMNS))
        some = WindowSums(model).triangles() if self.thinned and not self._some else []

        def of_fold(fold: int) -> list[tuple[int, Windows]]:
            own = [(number, windows) for number, windows in zip(numbers, kept, strict=True) if number % FOLDS == fold]
            if not own:
                return []
            together = Windows.joined([windows for _, windows in own])
            together = replace(together, effects=columns(together))
            for rows, indices in model.nonzero_columns(together):
                first, last = np.searchsorted(indices, (model.effects.start, model.effects.stop))
                chosen = indices[first:last] - model.effects.start
                block = rows.T @ (rows if some else rows[:, first:last])
                if some:  # where the effects do not count
                    add_triangle(block, indices, some[fold])
                    block = block[:, first:last]
                products[fold, indices[:, None], chosen] += block
            edges = np.cumsum([0, *(len(windows) for _, windows in own)]).tolist()
            return [
                (number, together.part(slice(*edge))) for (number, _), edge in zip(own, pairwise(edges), strict=True)
            ]

        for done in in_threads(of_fold, range(FOLDS)):
            other._kept |= dict(done)  # noqa: SLF001  # of its own class
        self._some = some or self._some
        other.effects = self._extrapolated(products) if self.thinned else products
        return other

    def _extrapolated(self, products: FloatArray) -> FloatArray:
        """Return the products (F, size, E) of all windows, see :meth:`with_effects`."""
        some, folds, rows = self._some, self.triangles(), np.zeros(FOLDS)
        for number, windows in self._kept.items():
            rows[number % FOLDS] += 2.0 * windows.weights.sum()
        effects, size = self.model.effects, self.model.summed.size
        total = unpacked(reduce(np.add, some), size)
        every = unpacked(reduce(np.add, folds), size) * rows.sum() / max(float(self.counts.sum()), 1.0)
        total[effects] = total[:, effects] = every[effects] = every[:, effects] = 0.0
        scale = np.sqrt(np.maximum(np.diag(every), TINY))
        shrunk = (total + _UNSEEN * every) / scale[:, None] / scale
        shrunk[np.diag_indices_from(shrunk)] += _ROUNDING
        outer = products.sum(axis=0)
        outer[effects] = 0.0
        used = np.flatnonzero(outer.any(axis=0))  # many an effect has no data
        factor, outer = linalg.cho_factor(shrunk, lower=True, overwrite_a=True), outer[:, used]
        b = np.zeros_like(outer)
        for _ in range(_STEPS):
            b += linalg.cho_solve(factor, (outer - total @ b) / scale[:, None]) / scale[:, None]
        out = np.zeros_like(products)
        square = np.ix_(used + effects.start, np.arange(len(used)))
        for fold, product in enumerate(products[:, :, used]):
            share = self.counts[fold] / max(float(rows[fold]), 1.0)
            own, explained = (unpacked(each[fold], size) @ b for each in (some, folds))
            found = explained + share * (product - own)
            inner = share * (product[square] - b.T @ own) + b.T @ explained
            found[effects] = 0.0
            found[square] = 0.5 * (inner + inner.T)
            out[fold][:, used] = found
        return out

    def merge(self, other: WindowSums) -> None:
        """Add the sums over other recordings, of an equal model; ``other`` stays unchanged."""
        theirs = other.finished()
        self._finish()
        self._form_products()
        self._some = []
        if self.model.reciprocal != theirs.model.reciprocal:
            self._reduce()
            theirs._reduce()  # noqa: SLF001  # of its own class
        self._every = max(self._every, theirs._every)  # noqa: SLF001  # of its own class
        offset = self._next_start()
        for number, triangle in enumerate(theirs.triangles()):
            self._own((number + offset) % FOLDS)[...] += triangle
        self._counts = self._counts + np.roll(theirs._counts, offset)  # noqa: SLF001
        self._squares = self._squares + np.roll(theirs._squares, offset)  # noqa: SLF001
        known = self._recording + 1 if self.windows else 0
        run, section = self._lasts()
        for own, more in ((self._kept, theirs._kept), (self._short, theirs._short)):  # noqa: SLF001
            for number, windows in more.items():
                recordings, runs = windows.recording + known, windows.run + run + 1
                numbered = replace(windows, recording=recordings, run=runs, section=windows.section + section + 1)
                own[offset + number] = numbered
        self._recording = known + theirs._recording  # noqa: SLF001
        if theirs.windows:
            self._last = offset + theirs._last  # noqa: SLF001
        self._restart()
        self.windows += theirs.windows
        self.outside += theirs.outside
        self.turned = either_turned(self.turned, theirs.turned)
        self._link = self._link + theirs._link  # noqa: SLF001
        self._thin()

    def state(self) -> SavedSums:
        """Return the state as arrays: only the windows, as long as all of them are kept."""
        self._form_products()  # not again in each copy
        done = self.finished()
        out: SavedSums = {"outside": np.array(done.outside), "every": np.array(done._every)}  # noqa: SLF001  # of its own class
        out["link"] = done._link  # noqa: SLF001
        if done.turned is not None:
            out["turned"] = np.array(sorted(done.turned), np.str_)
        out["segment"] = np.array(sorted(done._kept), np.int64)  # noqa: SLF001
        kept = [Windows.joined(list(both)) for both in zip(done.kept(), done.kept_short(), strict=True)]
        out["length"] = np.array([len(windows) for windows in kept], np.int64)
        if kept:
            together = Windows.joined(kept)
            out |= {f"windows.{name}": getattr(together, name) for name in MEASURED}
        if done.windows > sum(len(windows) for windows in done.kept()):
            out["folds"] = np.array(done.triangles())
            out["counts"], out["last"] = done._counts, np.array(done._last)  # noqa: SLF001
            out["squares"] = done._squares  # noqa: SLF001
            out["reciprocal"] = np.array(self.model.reciprocal)
        return out

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a state, see :class:`~drive_id.core.numerics.running_sums.Accumulator`."""
        reciprocal = bool(state.get("reciprocal", self.model.reciprocal))
        self.__dict__.update(WindowSums(replace(self.model, reciprocal=reciprocal)).__dict__)
        ends = np.cumsum(state["length"])
        if len(ends):
            together = Windows(**{name: state[f"windows.{name}"] for name in MEASURED})
            for number, start, end in zip(state["segment"], ends - state["length"], ends, strict=True):
                self._segment, self._pending = int(number), [together.part(slice(int(start), int(end)))]
                self._flush(form="folds" not in state)
            self._recording = int(together.recording.max())
        self._form_products()
        self.outside, self._every, self._link = int(state["outside"]), int(state["every"]), np.array(state["link"])
        self.turned = frozenset(map(str, state["turned"])) if "turned" in state else None
        if "folds" in state:
            self._folds = list(exactly(state["folds"], np.array(self.triangles())))
            self._squares = exactly(state["squares"], self._squares)
            self._counts, self._last = np.array(state["counts"]), int(state["last"])
            self.windows = int(self._counts.sum())
        self._restart()

    @property
    def folds(self) -> FloatArray:
        """Z'Z of each fold, (FOLDS, summed.size, summed.size), symmetric, with the effects."""
        effects = [None] * FOLDS if self.effects is None else list(self.effects)
        matrices = [unpacked(triangle, self.model.summed.size) for triangle in self.triangles()]
        return np.array([with_products(*both, self.model) for both in zip(matrices, effects, strict=True)])

    def triangles(self) -> list[FloatArray]:
        """Return the lower triangle of Z'Z of each fold, row by row, without the effects; not to be changed."""
        self._settle()
        if not self._folds:
            size = self.model.summed.size
            self._folds = [np.zeros(size * (size + 1) // 2) for _ in range(FOLDS)]
        return self._folds

    @property
    def unit(self) -> float:
        """Mean diagonal of Z'Z over the columns of a free map."""
        if self.model.reciprocal:
            self._settle()
            return float(self._squares.sum() / self.model.flux.parameters)
        return float(self._map_diagonals().sum() / self.model.flux.parameters)

    def _map_diagonals(self) -> FloatArray:
        """Return the sums (FOLDS,) of the diagonal over the map."""
        rows = np.arange(self.model.summed.map.start, self.model.summed.map.stop)
        return np.array([triangle[rows * (rows + 3) // 2].sum() for triangle in self.triangles()])

    @property
    def counts(self) -> FloatArray:
        """Rows of each fold, (FOLDS,)."""
        return np.asarray(2.0 * self._counts)

    @property
    def mean_link(self) -> float:
        """Mean DC-link voltage over time, V; NaN where it was not recorded.

        The windows do not tell it: which are kept, and how large the voltages in them are, repeats with the trajectory,
        as a variation of the link may.
        """
        integral, time = self._link
        return float(integral / time) if time > 0 else np.nan

    @property
    def thinned(self) -> bool:
        """Whether not all windows are kept."""
        return sum(map(len, self.kept())) < self.windows

    def kept(self) -> list[Windows]:
        """Return the kept segments in order of time."""
        return [self._kept[number] for number in sorted(self._kept)]

    def kept_folds(self) -> list[int]:
        """Return the fold of each kept segment in order of time."""
        return [number % FOLDS for number in sorted(self._kept)]

    def kept_short(self) -> list[Windows]:
        """Return the short windows of the kept segments in order of time."""
        return [self._short[number] for number in sorted(self._kept)]

    def _next_start(self) -> int:
        """Return the segment in which the next recording begins, the same for merging and adding."""
        return self._last + 1

    def _own(self, fold: int) -> FloatArray:
        """Return the triangle of a fold that no copy shares."""
        triangles = self.triangles()
        if fold in self._shared:
            triangles[fold] = triangles[fold].copy()
            self._shared.discard(fold)
        return triangles[fold]

    def _take(self, windows: Terms) -> None:
        """Collect windows until a segment is complete."""
        usable = self.model.contains(windows)
        self.outside += int((~usable & ~windows.short).sum())
        segment = interval(windows.time, SEGMENT)
        for number in np.unique(segment):
            if number != self._segment:
                self._flush()
                self._segment = int(number)
            self._pending.append(windows.part(np.flatnonzero((segment == number) & usable)))

    def _finish(self) -> None:
        """Take the last windows of a run, and complete their segment."""
        for windows in self._cutter.finish():
            self._take(windows)
        self._flush()

    def _flush(self, *, form: bool = True) -> None:
        """Complete a segment; its products are formed later, see :meth:`_form_products`."""
        parts, self._pending = self._pending, []
        kept = kept_of(np.array(self._segment), self._every)
        windows = (Windows if kept else Terms).joined(parts) if parts else None
        if windows is None or windows.short.all():
            return
        if isinstance(windows, Windows) and windows.acceleration is None:
            windows = windows.accelerated()
        fold, whole = self._segment % FOLDS, windows.part(~windows.short) if windows.short.any() else windows
        if form:
            self._due.append((fold, whole))
        self._some = []
        self._counts[fold] += whole.weights.sum()
        self.windows += len(whole)
        self._last = self._segment
        if isinstance(windows, Windows):
            short = windows.part(windows.short)
            for known, new in ((self._kept, whole), (self._short, short)):
                known[self._segment] = Windows.joined([known[self._segment], new] if self._segment in known else [new])
            self._thin()
        if len(self._due) >= _DUE:
            self._settle()  # no more than one batch waits
            self._forming = begun(self._products_due())

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy, also in another process, begins with."""
        self._settle()
        return self.__dict__

    def _settle(self) -> None:
        """Wait for the products under way."""
        forming, self._forming = self._forming, None
        if forming is not None:
            forming.result()

    def _form_products(self, threads: int = MOST_THREADS) -> None:
        """Add the products of the segments that are due to their folds."""
        self._products_due(threads)()

    def _products_due(self, threads: int = MOST_THREADS) -> Callable[[], None]:
        """Return what adds the products of the segments that are due to their folds."""
        by_fold: dict[int, list[Terms]] = {}
        for number, windows in self._due:
            by_fold.setdefault(number, []).append(windows)
        self._due = []
        triangles = {number: self._own(number) for number in by_fold}
        model = self.model

        def add(number: int) -> None:
            windows = Terms.joined(by_fold.pop(number))
            for rows, columns in model.nonzero_columns(windows):
                add_triangle(rows.T @ rows, columns, triangles[number])
            if model.reciprocal:
                self._squares[number] += model.map_squares(windows)

        def form() -> None:
            with one_blas_thread():
                in_threads(add, sorted(by_fold), threads)

        return form

    def _restart(self) -> None:
        self._cutter.restart(SEGMENT * self._next_start(), self._recording, self._lasts())

    def _lasts(self) -> tuple[int, int]:
        """Return the numbers of the last run and of the last section; -1 before there is one."""
        run, section = (
            max((int(getattr(windows, name).max()) for windows in self._kept.values()), default=-1)
            for name in ("run", "section")
        )
        return run, section

    def _reduce(self) -> None:
        """Sum over the columns of reciprocal maps from now on."""
        if self.model.reciprocal:
            return
        model, size = replace(self.model, reciprocal=True), self.model.summed.size
        self._squares = self._map_diagonals()
        self._folds = [triangle_of(congruent(model.expansion, unpacked(one, size))) for one in self.triangles()]
        self.model, self._shared = model, set()

    def _thin(self) -> None:
        while len(self._kept) > 1 and sum(map(len, self._kept.values())) > MOST_KEPT:
            self._every *= 2
            numbers = np.array(sorted(self._kept))  # those of a merged recording were kept by other numbers
            for number in numbers[~kept_of(np.arange(len(numbers)), 2)].tolist():
                del self._kept[number], self._short[number]
        self._cutter.every = self._every  # those of other segments would be dropped


def with_products(matrix: FloatArray, products: FloatArray | None, model: FullModel) -> FloatArray:
    """Put the products (size, EFFECT_COLUMNS) of the effects with all columns into Z'Z, if there are any."""
    if products is not None:
        matrix[model.effects, :] = products.T
        matrix[:, model.effects] = products
    return matrix
