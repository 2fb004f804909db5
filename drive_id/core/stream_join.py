"""The join of :mod:`drive_id.core.join` for signals that are still arriving: the same samples, in bounded memory.

Blocks come in any interleaving and wait until the other signals have passed their time. What joins is handed on in
pieces; each continues the one before it, or begins behind a gap.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from drive_id.core.join import SHORTEST_RUN, early_error, no_run_error, overlap_error
from drive_id.core.join_report import JoinReport, join_warnings
from drive_id.core.matching import Phase, partners
from drive_id.core.sample_period import check_agreement
from drive_id.core.signal import LARGEST_CUT, Signal
from drive_id.core.signal_track import SignalTrack
from drive_id.errors import DataError
from drive_id.types import FloatArray, IntArray, Samples

SECTIONS = ("currents", "voltages", "resolver")
_LOCKING_PAIRS = 1000


@dataclass(frozen=True, eq=False)
class Piece:
    """Joined samples.

    Parameters
    ----------
    samples : Samples
        Of one run or of several.
    continues : bool
        They begin with the last sample of the piece before.
    """

    samples: Samples
    continues: bool


@dataclass(frozen=True, eq=False)
class _Rows:
    """Joined samples that are not handed on yet: stamps (N,) and a, b, c currents, voltages, angle, speed (N, 8)."""

    stamp: IntArray
    values: FloatArray

    def __len__(self) -> int:
        return len(self.stamp)

    def __getitem__(self, part: slice) -> _Rows:
        return _Rows(self.stamp[part], self.values[part])


class StreamJoin:
    """Joins currents, voltages and resolver as they arrive.

    Parameters
    ----------
    names : tuple of str
        Topics of currents, voltages and resolver, for messages.
    batch : int
        Samples to wait for before joining them: fewer cost more, more come later.
    capacity : int
        Most samples of a signal to keep while others lag behind; what is older goes without partners.

    Notes
    -----
    The sample period is the declared one of the currents. The constant offset between the signals is measured on the
    first thousand samples. Faults that :func:`~drive_id.core.join.join` would raise are kept for :meth:`check`.
    """

    def __init__(self, names: tuple[str, str, str] = SECTIONS, *, batch: int = 1000, capacity: int = 50_000) -> None:
        self.tracks = tuple(SignalTrack(name) for name in names)
        self.batch = batch
        self.capacity = capacity
        self.samples = 0
        self.runs = 0
        self.gaps = 0
        self.time_lost = 0.0
        self._offsets: tuple[int, int] | None = None
        self._phases = (Phase(), Phase())
        self._fault: DataError | None = None
        self._taken: list[int | None] = [None, None]
        self._carry = _Rows(np.zeros(0, np.int64), np.zeros((0, 8)))
        self._continues = False  # the carry is the last sample handed on
        self._joined = 0
        self._early = 0
        self._first_early = 0
        self._last_stamp: int | None = None  # handed on

    @property
    def last_stamp(self) -> int | None:
        """Stamp of the last sample handed on, ns."""
        return self._last_stamp

    def add(self, section: int, piece: Signal) -> list[Piece]:
        """Take a further part of a signal and return what can be joined by now.

        Parameters
        ----------
        section : int
            0 for currents, 1 for voltages, 2 for the resolver with angle and speed.
        piece : Signal
            With its declared period; its losses are those since the part before.
        """
        track = self.tracks[section]
        track.add(piece)
        return self._advance(final=False) if track.fresh >= self.batch else []

    def finished(self) -> tuple[StreamJoin, list[Piece]]:
        """Join the rest as if nothing were to follow, without touching this stream.

        Returns
        -------
        join : StreamJoin
            The stream after its end, for :meth:`check` and :meth:`report`.
        pieces : list of Piece
            What was still waiting.
        """
        other = copy.copy(self)
        other.tracks = tuple(track.copy() for track in self.tracks)
        other._taken = list(self._taken)  # noqa: SLF001  # of its own class
        return other, other._advance(final=True)  # noqa: SLF001  # of its own class

    def check(self) -> None:
        """Raise what :func:`~drive_id.core.join.join` would raise; call it on a finished stream.

        Raises
        ------
        EmptyTopicError, NonFiniteError, StampOrderError, SamplePeriodError, NoOverlapError, DataError
        """
        for track in self.tracks:
            track.check()
        claims = [(f"{track.name} declares", track.period or 0.0) for track in self.tracks]
        measured = [(f"the stamps of {track.name} show", track.measured_period) for track in self.tracks]
        check_agreement([*claims, *((said, period) for said, period in measured if period is not None)])
        if self._fault is not None:
            raise self._fault
        clock = self.tracks[0].name
        for track, phase in zip(self.tracks[1:], self._phases, strict=True):
            phase.offset(self._step, track.name, clock)
        if not self._joined:
            raise overlap_error([(track.name, *track.range) for track in self.tracks])
        if self._early > LARGEST_CUT * self._joined:
            raise early_error(clock, self._early, self._first_early, self._step * 1e-9)
        if not self.samples:
            raise no_run_error(clock)

    def report(self) -> JoinReport:
        """Return what became of the signals."""
        offsets = (0, *(self._offsets or (0, 0)))
        signals = tuple(track.report(self.samples, offset) for track, offset in zip(self.tracks, offsets, strict=True))
        report = JoinReport(
            signals, self.tracks[0].period or 0.0, self.samples, self.runs, self.time_lost * 1e-9, self.gaps
        )
        given_up = [
            f"{track.given_up} samples of {track.name} waited too long for the other signals and were left out."
            for track in self.tracks
            if track.given_up
        ]
        return report.with_warnings((*join_warnings(report), *given_up))

    @property
    def _step(self) -> float:
        """Sample period, ns."""
        return (self.tracks[0].period or 0.0) * 1e9

    def _advance(self, *, final: bool) -> list[Piece]:
        """Join what can be joined, and what must be for want of room."""
        for track in self.tracks:
            track.fold()
        pieces: list[Piece] = []
        if not self._fault and not any(track.fault for track in self.tracks) and self._lock(final=final):
            pieces = self._hand_on(self._match(final=final))
        for track in self.tracks:
            excess = len(track.stamp) - self.capacity
            if excess > 0:
                track.given_up += excess
                track.drop(excess)
        return pieces

    def _lock(self, *, final: bool) -> bool:
        """Measure the offsets once there are enough pairs; afterwards, or when they cannot be had, say which."""
        if self._offsets is not None:
            return True
        clock = self.tracks[0]
        phases = tuple(Phase.of(clock.stamp, other.stamp, self._step) for other in self.tracks[1:])
        if not final and min(phase.count for phase in phases) < _LOCKING_PAIRS:
            return False
        try:
            self._offsets = (
                phases[0].offset(self._step, self.tracks[1].name, clock.name),
                phases[1].offset(self._step, self.tracks[2].name, clock.name),
            )
        except DataError as error:
            self._fault = error
            return False
        return True

    def _match(self, *, final: bool) -> _Rows:
        """Return the samples whose partners are decided, and forget whatever is past."""
        clock, others, offsets = self.tracks[0], self.tracks[1:], self._offsets or (0, 0)
        decided = len(clock.stamp)
        if not final:
            for other, offset in zip(others, offsets, strict=True):
                latest = int(other.stamp[-1]) - offset if len(other.stamp) else np.iinfo(np.int64).min
                decided = min(decided, int(np.searchsorted(clock.stamp, latest, side="right")))
            overdue = len(clock.stamp) - self.capacity
            if overdue > decided:
                clock.given_up += overdue - decided
                decided = overdue
        stamp = clock.stamp[:decided]
        found = np.ones(decided, np.bool_)
        indices = []
        for k, (other, offset) in enumerate(zip(others, offsets, strict=True)):
            index, there = partners(stamp, other.stamp, offset, self._step, self._taken[k])
            if there.any():
                self._taken[k] = int(other.stamp[index[np.flatnonzero(there)[-1]]])
            indices.append(index)
            found &= there
        self._measure_drift(stamp)
        columns = [clock.values[:decided][found]]
        columns += [other.values[index[found]] for other, index in zip(others, indices, strict=True) if found.any()]
        rows = _Rows(stamp[found], np.hstack(columns) if found.any() else np.zeros((0, 8)))
        if decided:
            for other, offset in zip(others, offsets, strict=True):
                past = int(np.searchsorted(other.stamp, int(stamp[-1]) + offset, side="right")) - 1
                other.drop(max(past, 0))
            clock.drop(decided)
        return rows

    def _measure_drift(self, stamp: IntArray) -> None:
        first, second = (
            phase + Phase.of(stamp, other.stamp, self._step)
            for phase, other in zip(self._phases, self.tracks[1:], strict=True)
        )
        self._phases = first, second

    def _hand_on(self, new: _Rows) -> list[Piece]:
        """Divide the joined samples into gap-free runs, leave out the shortest, and hand on the others."""
        if not len(new):
            return []
        rows = _Rows(np.concatenate([self._carry.stamp, new.stamp]), np.concatenate([self._carry.values, new.values]))
        step = np.diff(rows.stamp)
        early = step < 0.5 * self._step
        if early.any() and not self._early:
            self._first_early = int(rows.stamp[np.argmax(early)]) - self.tracks[0].range[0]
        self._early += int(early.sum())
        self._joined += len(new)
        starts = [0, *(np.flatnonzero((step > 1.5 * self._step) | early) + 1).tolist()]
        ends = [*starts[1:], len(rows)]
        self.gaps += len(starts) - 1
        chosen: list[slice] = []
        for start, end in zip(starts, ends, strict=True):
            goes_on = self._continues and start == 0
            if (goes_on and end - start > 1) or (not goes_on and end - start >= SHORTEST_RUN):
                chosen.append(slice(start, end))
        last = slice(starts[-1], ends[-1])
        piece = self._piece(rows, chosen)
        last_is_out = (bool(chosen) and chosen[-1] == last) or (self._continues and last.start == 0)
        self._carry = rows[len(rows) - 1 :] if last_is_out else rows[last]
        self._continues = last_is_out
        return [piece] if piece else []

    def _piece(self, rows: _Rows, runs: list[slice]) -> Piece | None:
        """Put runs into one piece, and count them."""
        if not runs:
            return None
        continues = self._continues and runs[0].start == 0
        index = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        lengths = np.array([run.stop - run.start for run in runs])
        starts = np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64)
        stamp, values = rows.stamp[index], rows.values[index]
        before = np.concatenate(([self._last_stamp if self._last_stamp is not None else stamp[0]], stamp[:-1]))
        begun = starts[1:] if continues or self._last_stamp is None else starts
        self.time_lost += float(np.sum(stamp[begun] - before[begun]) - self._step * len(begun))
        self.samples += len(stamp) - continues
        self.runs += len(runs) - continues
        self._last_stamp = int(stamp[-1])
        samples = Samples(
            stamp=stamp,
            i_abc=np.ascontiguousarray(values[:, :3]),
            u_abc=np.ascontiguousarray(values[:, 3:6]),
            angle=values[:, 6].copy(),
            speed=values[:, 7].copy(),
            sample_period=self.tracks[0].period or 0.0,
            run_starts=starts,
        )
        return Piece(samples, continues)
