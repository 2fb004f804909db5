"""Join currents, voltages, resolver and optional signals on one clock, and cut out whatever is not whole.

The stamps of the currents are the clock; comparisons are made on integer nanoseconds and on differences of neighbours,
so that neither the epoch nor the length of a recording costs precision. :class:`StreamJoin` joins signals as they
arrive, in bounded memory; :func:`join` gives it whole signals and no bound.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.core.signals.held_references import HeldReferences
from drive_id.core.signals.matching import Phase, partners
from drive_id.core.signals.period import check_agreement, measured_period, period_text
from drive_id.core.signals.scalar_track import ScalarTrack
from drive_id.core.signals.signal import LARGEST_CUT, Signal
from drive_id.core.signals.signal_track import MOST_HELD, SignalTrack
from drive_id.errors import DataError, NoOverlapError, SamplePeriodError
from drive_id.types import SCALARS, FloatArray, IntArray, Samples, fixed

SECTIONS = ("currents", "voltages", "resolver")
"""Signals that every recording has, in the order in which they are joined."""
SHORTEST_RUN = 4
"""Fewest samples of a gap-free run that is kept."""
ToPhases = Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]
"""Turns recorded values into phase quantities, see :class:`StreamJoin`."""
_LOCKING_PAIRS = 1000  # on which the offset between live signals is measured
_UNLIMITED = 1 << 62  # samples
_FEW_JOINED = 0.9
"""Share of the samples that found partners below which that is reported."""
_Rows = list[NDArray[Any]]
"""Samples with their partners: stamps (N,), currents and voltages (N, 3), angle and speed (N, 2) or angle (N, 1)."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Joined samples, of one run or of several."""

    samples: Samples
    continues: bool  # they begin with the last sample of the piece before


def joined(pieces: Sequence[Piece]) -> Samples:
    """Put consecutive pieces, at least one, together; the first begins a recording whatever it continues."""
    if len(pieces) == 1:
        return pieces[0].samples
    continues = [piece.continues and number > 0 for number, piece in enumerate(pieces)]
    return Samples.joined([piece.samples for piece in pieces], continues)


def join(
    currents: Signal,
    voltages: Signal,
    resolver: Signal,
    references: Signal | None = None,
    scalars: Mapping[str, Signal] | None = None,
    *,
    scaled_by: str = "",
    to_phases: tuple[ToPhases | None, ToPhases | None] = (None, None),
    turned: frozenset[str] | None = None,
) -> JoinedSamples:
    """Join the signals of one drive.

    Samples with repeated or backward stamps are cut out. A current sample is kept when voltages and resolver each have
    a sample within half a period of it (after the constant offset between the topics); whatever is cut leaves a gap,
    and a new run starts behind it.

    Parameters
    ----------
    currents, voltages : Signal
        (N, 3) values, A and V.
    resolver : Signal
        (N, 2) values, electrical angle in rad and speed in rad/s, or (N, 1): speed is then derived from the angle.
    references : Signal, optional
        (N, 2) values, current references d, q in A; held until the next one, for at most 1.5 of their periods.
    scalars : mapping of str to Signal, optional
        (N, 1) values, optional signals by their names in :class:`~drive_id.types.Samples`, of any rate; another name is
        that of a signal which only scales the voltages.
    scaled_by, to_phases, turned
        See :class:`StreamJoin`.

    Raises
    ------
    EmptyTopicError, NonFiniteError, SamplePeriodError, DataError
        See :meth:`StreamJoin.check`.
    """
    signals = (currents, voltages, resolver)
    reference = None
    if references is not None:
        held = HeldReferences(references.sample_period or measured_period(references))
        held.add(references)
        reference = held.at
    joining = StreamJoin(
        (currents.name, voltages.name, resolver.name),
        batch=_UNLIMITED,
        capacity=_UNLIMITED,
        recorded=True,
        reference=reference,
        scalars={name: signal.name for name, signal in (scalars or {}).items()},
        scaled_by=scaled_by,
        to_phases=to_phases,
        turned=turned,
    )
    for name, signal in (scalars or {}).items():
        joining.add_scalar(name, signal)
    for section, signal in enumerate(signals):
        joining.add(section, signal)
    end, pieces = joining.finished()
    end.check()
    return JoinedSamples(joined(pieces), end.report())


@dataclass(frozen=True)
class JoinReport:
    """What became of the signals of one recording."""

    samples: int  # in the result
    gaps: int  # breaks found, also around stretches that were too short to keep
    warnings: tuple[Message, ...]  # what is missing, cut out or shifted


@dataclass(frozen=True, eq=False)
class JoinedSamples:
    """Joined samples, and what was done to get them."""

    samples: Samples
    report: JoinReport


class StreamJoin:
    """Joins currents, voltages, resolver and optional signals as they arrive.

    Joined samples wait for the optional signals that are expected or have arrived before, for a few seconds at most.

    Parameters
    ----------
    names : tuple of str
        Topics of currents, voltages and resolver, for messages.
    batch : int
        Samples to wait for before joining them: fewer cost more, more come later.
    wait : float
        Duration of data to collect before joining, s, if more than ``batch`` samples; at most half of ``capacity``.
    capacity : int
        Most samples of a signal to keep while others lag behind; what is older goes without partners. No more joined
        samples wait for optional signals, either.
    locking : int
        Pairs of samples on which to measure the constant offset between the signals.
    recorded : bool
        The signals are read from a recording, see :class:`~drive_id.core.signals.signal_track.SignalTrack`. Given
        whole, they need neither a declared period nor, in the resolver, the speed.
    sort : bool
        Wait behind a gap for samples that arrive late, see :class:`~drive_id.core.signals.signal_track.SignalTrack`.
    reference : callable, optional
        Returns the current references (N, 2), A, at increasing stamps (N,), ns, for samples of a period, s.
    scalars : mapping of str to str, optional
        Optional signals that are known to come, by their names in :class:`~drive_id.types.Samples`, and their topics.
    scaled_by : str
        Of the ``scalars``, that by which the voltages are multiplied: ``dc_link_voltage`` for duty cycles. Samples for
        which it is unknown are cut out.
    to_phases : tuple of callable or None
        Of currents and voltages that are no phase quantities: returns these (N, 3) for the recorded values, the angle
        (N,), rad, the speed (N,), rad/s, and the sample period, s.
    turned : frozenset of str, optional
        See :class:`~drive_id.types.Samples`.

    Notes
    -----
    Nothing is raised while signals arrive: :meth:`check` says what is wrong with them.
    """

    def __init__(
        self,
        names: tuple[str, str, str] = SECTIONS,
        *,
        batch: int = 1000,
        wait: float = 0.0,
        capacity: int = 50_000,
        locking: int = _LOCKING_PAIRS,
        recorded: bool = False,
        sort: bool = True,
        reference: Callable[[IntArray, float], FloatArray | None] | None = None,
        scalars: Mapping[str, str] | None = None,
        scaled_by: str = "",
        to_phases: tuple[ToPhases | None, ToPhases | None] = (None, None),
        turned: frozenset[str] | None = None,
    ) -> None:
        held = min(MOST_HELD, capacity // 2) if sort else 0
        self.tracks = tuple(SignalTrack(name, recorded=recorded, held=held) for name in names)
        self.batch = batch
        self.wait = wait
        self.locking = locking
        self._reference = reference
        self._recorded = recorded
        self.capacity = capacity
        self.samples = 0
        self.runs = 0
        self.gaps = 0
        self.time_lost = 0.0
        self._scalars = {name: ScalarTrack(topic, capacity) for name, topic in (scalars or {}).items()}
        self._scaled_by = scaled_by
        self._to_phases = to_phases
        self._turned = turned
        self._waiting: list[Piece] = []  # for the optional signals
        self._cut = 0  # samples without a DC-link voltage
        self._offsets: tuple[int, ...] = ()  # of voltages and resolver, ns; empty until they are known
        self._phases: tuple[Phase, ...] = (Phase(), Phase())
        self._late = False
        self._given_up_to: int | None = None  # largest stamp of such partners
        self._fault: DataError | None = None
        self._taken: tuple[int | None, ...] = (None, None)  # stamps of the last partners
        self._carry: _Rows = []
        self._continues = False  # the carry is the last sample handed on
        self._joined = 0
        self._early = 0
        self._first_early = 0
        self.last_stamp: int | None = None
        """Stamp of the last sample handed on, ns."""

    def add(self, section: int, piece: Signal) -> list[Piece]:
        """Take a further part of a signal and return what can be joined by now.

        The section is 0 for currents, 1 for voltages, 2 for the resolver with angle and speed. The part has its
        declared period, unless it is a whole recorded signal; its losses are those since the part before.
        """
        track = self.tracks[section]
        if self._given_up_to is not None and len(piece.stamp):
            self._late |= int(piece.stamp.min()) <= self._given_up_to + self._step
        track.add(piece)
        return self.advance() if track.fresh >= self._enough(track) else []

    def _enough(self, track: SignalTrack) -> int:
        """Return the number of fresh samples of a signal at which to join."""
        if not self.wait or not track.period:
            return self.batch
        return max(self.batch, int(min(self.wait / track.period, self.capacity / 2)))

    def add_scalar(self, name: str, piece: Signal) -> None:
        """Take a further part, (N, 1) values, of an optional signal by its name in :class:`~drive_id.types.Samples`."""
        if name not in self._scalars:
            self._scalars[name] = ScalarTrack(piece.name, self.capacity)
        self._scalars[name].add(piece)

    @property
    def late(self) -> bool:
        """Whether samples arrived whose partners had been given up."""
        return self._late or any(track.late for track in self._scalars.values())

    @property
    def failing(self) -> bool:
        """Whether nothing will be joined any more: :meth:`check` says why."""
        return self._fault is not None or any(track.fault for track in self.tracks)

    def finished(self) -> tuple[StreamJoin, list[Piece]]:
        """Join the rest as if nothing were to follow, without touching this stream.

        Returns the stream after its end, for :meth:`check` and :meth:`report`, and the pieces that were still waiting.
        """
        other = copy.copy(self)
        other.tracks = tuple(track.copy() for track in self.tracks)
        other._scalars = {name: track.copy() for name, track in self._scalars.items()}  # noqa: SLF001  # of its own class
        other._waiting = list(self._waiting)  # noqa: SLF001
        return other, other.advance(final=True)

    def check(self) -> None:
        """Raise what is wrong with the signals; call it on a finished stream.

        Raises
        ------
        EmptyTopicError
            When a signal has no sample.
        NonFiniteError
            When a value is NaN or infinite.
        StampOrderError
            When more than 1 % of a signal would have to be cut out.
        SamplePeriodError
            When the periods of the signals, or the declared and the stamped one, differ by more than 1 %.
        NoOverlapError
            When nothing, or no run of a few samples, is common to the three.
        DataError
            When the stamps of two signals are not locked to each other, or lie half a period apart.
        """
        claims = [(f"{track.name} declares", track.period) for track in self.tracks if track.period]
        if len(claims) == len(self.tracks) and not any(track.fault for track in self.tracks):
            check_agreement(claims)  # first, for a wrong period shows as stamps out of order, too
        for track in self.tracks:
            track.check()
        measured = [(f"the stamps of {track.name} show", track.measured_period) for track in self.tracks]
        claims += [(said, period) for said, period in measured if period is not None]
        if not claims:
            raise SamplePeriodError(
                f"The sample period is unknown, for {self.tracks[0].name} declares none and holds too few messages to "
                "measure it: give sample_period in a signals file."
            )
        check_agreement(claims)
        if self._fault is not None:
            raise self._fault
        clock = self.tracks[0].name
        for track, phase in zip(self.tracks[1:], self._phases, strict=True):
            phase.offset(self._step, track.name, clock)
        if not self._joined:
            raise _overlap_error([(track.name, *track.range) for track in self.tracks])
        if self._early > LARGEST_CUT * self._joined:
            raise SamplePeriodError(
                f"On {clock}, {counted(self._early, 'sample')} came within half of the sample period "
                f"{period_text(self._step * 1e-9)}, the first {self._first_early * 1e-9:.6f} s after its start: "
                "correct sample_period or the stamp source in a signals file."
            )
        if not self.samples and self._cut:
            raise NoOverlapError(
                f"The voltages of {self.tracks[1].name} are duty cycles, and the DC-link voltage is unknown during all "
                "of them: record it, or give a constant scale in the signals file."
            )
        if not self.samples:
            raise NoOverlapError(
                f"No {SHORTEST_RUN} consecutive samples of {clock} have simultaneous voltages and angles: "
                "record the signals without losses."
            )

    def report(self) -> JoinReport:
        """Return what became of the signals."""
        return JoinReport(self.samples, self.gaps, tuple(self._warnings()))

    def _warnings(self) -> Iterator[Message]:
        for track, offset in zip(self.tracks, (0, *(self._offsets or (0, 0))), strict=True):
            yield from track.warnings(offset * 1e-9, self._period)
        currents = self.tracks[0]
        finite = currents.read - sum(track.not_finite for track in self.tracks)
        if self.samples < _FEW_JOINED * finite:
            yield Message("samples_unused", samples=self.samples, read=currents.read, topic=currents.name)
        if self.gaps:
            yield Message("gaps.join", gaps=self.gaps, runs=self.runs, time_lost=self.time_lost * 1e-9)
        for track in self.tracks:
            if track.given_up and not self._recorded:
                yield Message("samples_late", samples=track.given_up, topic=track.name)
        for scalar in self._scalars.values():
            if scalar.unknown:
                yield Message("signal_unknown", seconds=scalar.unknown * self._period, topic=scalar.name)
        if self._cut:
            yield Message("duty_cycles_cut", samples=self._cut)

    @property
    def _step(self) -> float:
        """Sample period, ns; 0 as long as it is unknown."""
        return self._period * 1e9

    @property
    def _period(self) -> float:
        """Sample period, s: the first that a signal declares; of a recording that declares none, what stamps show."""
        known = [track.period for track in self.tracks if track.period]
        if not known and self._recorded:
            known = [period for track in self.tracks if (period := track.measured_period)]
        return known[0] if known else 0.0

    def advance(self, *, final: bool = False) -> list[Piece]:
        """Return what can be joined by now, however little it is, and what must be for want of room.

        ``final``: nothing is to follow.
        """
        for track in self.tracks:
            track.fold(final=final)
        pieces: list[Piece] = []
        if not self._fault and not any(track.fault for track in self.tracks) and self._lock(final=final):
            pieces = self._hand_on(self._match(final=final))
        for track in self.tracks:
            excess = len(track.stamp) - self.capacity
            if excess > 0:
                self._note_given_up(int(track.stamp[excess - 1]))
                track.given_up += excess
                track.drop(excess)
        return self._with_scalars(pieces, final=final)

    def _with_scalars(self, pieces: list[Piece], *, final: bool) -> list[Piece]:
        """Return the waiting pieces for which the optional signals are decided, with these signals."""
        if not self._scalars and not self._scaled_by:
            return pieces
        self._waiting += pieces
        newest = int(self._waiting[-1].samples.stamp[-1]) if self._waiting else 0
        decided = min((track.decided(newest) for track in self._scalars.values()), default=newest)
        excess = sum(len(piece.samples) for piece in self._waiting) - self.capacity
        complete: list[Piece] = []
        while self._waiting and (final or excess > 0 or int(self._waiting[0].samples.stamp[-1]) <= decided):
            piece = self._waiting.pop(0)
            excess -= len(piece.samples)
            scalars: dict[str, Any] = {name: track.at(piece.samples.stamp) for name, track in self._scalars.items()}
            scale = scalars.get(self._scaled_by)
            for name, track in self._scalars.items():
                track.unknown += int(np.isnan(scalars[name][int(piece.continues) :]).sum())
                if np.isnan(scalars[name]).all() or name not in SCALARS:
                    del scalars[name]
            complete += self._in_volts(replace(piece, samples=replace(piece.samples, **scalars)), scale)
        return complete

    def _in_volts(self, piece: Piece, u_dc: FloatArray | None) -> list[Piece]:
        """Multiply duty cycles by what scales them (N,), and cut out the samples for which that is unknown."""
        samples = piece.samples
        if not self._scaled_by:
            return [piece]
        known = np.zeros(len(samples), np.bool_) if u_dc is None else np.isfinite(u_dc)
        cut = int((~known).sum()) - (piece.continues and not known[0])
        self._cut += cut
        self.samples -= cut
        begins = np.zeros(len(samples), np.bool_)
        begins[samples.run_starts] = True
        begins[1:] |= known[1:] & ~known[:-1]
        if u_dc is None or not known.any():
            return []
        begins[int(np.argmax(known))] = True
        volts = replace(samples.chosen(known, begins), u_abc=samples.u_abc[known] * u_dc[known, None])
        return [Piece(volts, bool(piece.continues and known[0]))]

    def _lock(self, *, final: bool) -> bool:
        """Measure the offsets once there are enough pairs; afterwards, or when they cannot be had, say which."""
        if self._offsets:
            return True
        if not self._step:
            return False
        clock, others = self.tracks[0], self.tracks[1:]
        phases = [Phase.of(clock.stamp, other.stamp, self._step) for other in others]
        if not final and min(phase.count for phase in phases) < self.locking:
            return False
        try:
            self._offsets = tuple(
                phase.offset(self._step, other.name, clock.name) for phase, other in zip(phases, others, strict=True)
            )
        except DataError as error:
            self._fault = error
            return False
        return True

    def _match(self, *, final: bool) -> _Rows:
        """Return the samples whose partners are decided, and forget whatever is past."""
        clock, others, offsets = self.tracks[0], self.tracks[1:], self._offsets
        decided = len(clock.stamp)
        if not final:
            for other, offset in zip(others, offsets, strict=True):
                latest = int(other.stamp[-1]) - offset if len(other.stamp) else np.iinfo(np.int64).min
                decided = min(decided, int(np.searchsorted(clock.stamp, latest, side="right")))
            overdue = len(clock.stamp) - self.capacity
            if overdue > decided:
                self._note_given_up(int(clock.stamp[overdue - 1]))
                clock.given_up += overdue - decided
                decided = overdue
        stamp = clock.stamp[:decided]
        self._phases = tuple(
            phase + Phase.of(stamp, other.stamp, self._step) for phase, other in zip(self._phases, others, strict=True)
        )
        rows = self._matched(stamp)
        if decided:
            for other, offset in zip(others, offsets, strict=True):
                past = int(np.searchsorted(other.stamp, int(stamp[-1]) + offset, side="right")) - 1
                other.drop(max(past, 0))
            clock.drop(decided)
        return rows

    def _note_given_up(self, stamp: int) -> None:
        self._given_up_to = max(stamp, self._given_up_to or stamp)

    def _matched(self, stamp: IntArray) -> _Rows:
        """Return the samples at the clock's ``stamp`` (N,) for which each signal has a partner; nothing for none."""
        others = self.tracks[1:]
        found = np.ones(len(stamp), np.bool_)
        indices, taken = [], list(self._taken)
        for k, (other, offset) in enumerate(zip(others, self._offsets, strict=True)):
            index, there = partners(stamp, other.stamp, offset, self._step, taken[k])
            if there.any():
                taken[k] = int(other.stamp[index[np.flatnonzero(there)[-1]]])
            indices.append(index)
            found &= there
        self._taken = tuple(taken)
        if not found.any():
            return []
        rows = [_rows(other.values, index[found]) for other, index in zip(others, indices, strict=True)]
        own = np.flatnonzero(found)
        return [_rows(stamp, own), _rows(self.tracks[0].values, own), *rows]

    def _hand_on(self, new: _Rows) -> list[Piece]:
        """Divide the joined samples into gap-free runs, leave out the shortest, and hand on the others."""
        if not new:
            return []
        rows = [np.concatenate(both) for both in zip(self._carry, new, strict=True)] if self._carry else new
        stamp = rows[0]
        step = np.diff(stamp)
        early = step < 0.5 * self._step
        if early.any() and not self._early:
            self._first_early = int(stamp[np.argmax(early)]) - self.tracks[0].range[0]
        self._early += int(early.sum())
        self._joined += len(new[0])
        starts = [0, *(np.flatnonzero((step > 1.5 * self._step) | early) + 1).tolist()]
        runs = [slice(start, end) for start, end in pairwise([*starts, len(stamp)])]
        self.gaps += len(runs) - 1
        least = [2 if self._continues and run.start == 0 else SHORTEST_RUN for run in runs]
        chosen = [run for run, length in zip(runs, least, strict=True) if run.stop - run.start >= length]
        pieces = [self._piece(rows, chosen)] if chosen else []
        self._continues = runs[-1] in chosen or (self._continues and len(runs) == 1)
        carried = slice(-1, None) if self._continues else runs[-1]
        self._carry = [values[carried] for values in rows]
        return pieces

    def _piece(self, rows: _Rows, runs: list[slice]) -> Piece:
        """Put runs, at least one, into one piece, and count them."""
        continues = self._continues and runs[0].start == 0
        lengths = np.array([run.stop - run.start for run in runs])
        starts = np.concatenate(([0], np.cumsum(lengths)[:-1])).astype(np.int64)
        part: slice | IntArray = slice(runs[0].start, runs[-1].stop)
        if len(starts) > 1 and int(lengths.sum()) < len(rows[0]):
            part = np.concatenate([np.arange(run.start, run.stop) for run in runs])
        stamp, currents, voltages, position = (values[part] for values in rows)
        angle, period = position[:, 0].copy(), self._period
        before = np.concatenate(([self.last_stamp if self.last_stamp is not None else stamp[0]], stamp[:-1]))
        begun = starts[1:] if continues or self.last_stamp is None else starts
        self.time_lost += float(np.sum(stamp[begun] - before[begun]) - self._step * len(begun))
        self.samples += len(stamp) - continues
        self.runs += len(runs) - continues
        self.last_stamp = int(stamp[-1])
        speed = position[:, 1].copy() if position.shape[1] > 1 else _derived_speed(angle, starts, period)
        i_abc, u_abc = (
            values if convert is None else convert(values, angle, speed, period)
            for values, convert in zip((currents, voltages), self._to_phases, strict=True)
        )
        samples = Samples(
            stamp=fixed(stamp),
            i_abc=fixed(i_abc),
            u_abc=fixed(u_abc),
            angle=fixed(angle),
            speed=fixed(speed),
            sample_period=period,
            run_starts=starts,
            i_dq_reference=self._reference(stamp, period) if self._reference else None,
            turned=self._turned,
        )
        return Piece(samples, continues)


def _rows(values: NDArray[Any], index: IntArray) -> NDArray[Any]:
    """Return rows at increasing indices, at least one: without a copy where none is left out in between."""
    first, last = int(index[0]), int(index[-1])
    return values[first : last + 1] if last - first == len(index) - 1 else values[index]


def _derived_speed(angle: FloatArray, starts: IntArray, period: float) -> FloatArray:
    """Differentiate the angle (N,) within each run by central differences, rad/s."""
    speed = np.empty_like(angle)
    with np.errstate(over="ignore", invalid="ignore"):  # absurd angles give infinite speeds, which Samples refuses
        for start, end in zip(starts, np.append(starts[1:], len(angle)), strict=True):
            speed[start:end] = np.gradient(np.unwrap(angle[start:end]), period)
    return speed


def _overlap_error(ranges: Sequence[tuple[str, int, int]]) -> NoOverlapError:
    """Return the error for signals, given by name, first and last stamp, ns, that share no sample."""
    start = min(first for _, first, _ in ranges)
    text = ", ".join(
        f"{name} from {(first - start) * 1e-9:.3f} to {(last - start) * 1e-9:.3f} s" for name, first, last in ranges
    )
    return NoOverlapError(
        f"The signals share no sample ({text}, counted from stamp {start} ns): record them at the same time, or take "
        "another stamp source in a signals file."
    )
