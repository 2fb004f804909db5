"""The drive's buffer of current references: sessions, due times, and zero current whenever something is wrong.

It keeps the rules of the message ``CurrentReference``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.limits import approach
from drive_id.core.signals.signal import block_stamps, finite_rows
from drive_id.types import NANOSECONDS, BoolArray, FloatArray, IntArray

_LARGEST = 5_000_000  # set-points in the buffer
_EARLY = 0.1  # sample periods by which a set-point may come due after the sample that takes it
_HOLD = 1.5  # periods for which the last set-point is held before the current goes to zero
_QUIET = 1.0  # time at rest without a message after which the drive is free again, and a fault forgotten, s
_RUN_BITS = 16  # lowest bits of a session, which count the runs of one publisher


@dataclass
class ReferenceCounts:
    """Set-points that arrived too late, were malformed, were beyond the limit, or belonged to no session in force."""

    late: int = 0
    unusable: int = 0
    beyond: int = 0
    foreign: int = 0


class ReferenceBuffer:
    """Set-points until they come due.

    Parameters
    ----------
    i_max : float
        Largest amplitude that the drive follows, A.
    slew_rate : float
        |di/dt| to zero current when set-points run out or are dropped, A/s.
    """

    def __init__(self, i_max: float, slew_rate: float) -> None:
        self.counts = ReferenceCounts()
        self.fault = ""
        self.session: int | None = None
        """Session that is followed."""
        self.applied = 0
        """Count of the last set-point applied."""
        self.last = np.zeros(2)
        """Reference in force, A."""
        self.stator_frame = False
        """Whether the references of this session are alpha and beta."""
        self._i_max = i_max
        self._slew_rate = slew_rate
        self._owner = 0  # its last session; 0: the drive is free
        self._silence = 0.0
        self._expected = 0
        self._taken: int | None = None
        self._due: IntArray
        self._hold: IntArray
        self._count: IntArray
        self._values: FloatArray
        self._drop()

    def __len__(self) -> int:
        return len(self._due)

    @property
    def dry(self) -> bool:
        """Whether no session is followed."""
        return self.session is None

    def add(
        self,
        stamp: int,
        sample_period: float,
        d: NDArray[np.float32],
        q: NDArray[np.float32],
        *,
        session: int = 1,
        count: int = 0,
        safe: bool = False,
        stator_frame: bool = False,
    ) -> None:
        """Add a block of set-points, which replaces all due at or after its stamp.

        Parameters
        ----------
        stamp : int
            Due time of the first, ns.
        sample_period : float
            s.
        d, q : (N,) float32
            A. Malformed blocks are counted and ignored.
        session, count, safe, stator_frame
            As in the message.
        """
        self._silence = 0.0
        if safe:
            self._drop()
            return
        if len(d) != len(q) or not 1e-9 <= sample_period <= 1e3 or len(d) + len(self) > _LARGEST:
            self.counts.unusable += max(len(d), len(q), 1)
            return
        values = np.stack((d, q), axis=-1).astype(np.float64)
        if not finite_rows(values).all():
            self.counts.unusable += len(values)
            return
        due = block_stamps(stamp, len(values), sample_period)
        if self._taken is not None:
            self.counts.late += int(np.searchsorted(due, self._taken, side="right"))
        if self._is_foreign(session, count):
            self.counts.foreign += len(values)
            return
        amplitude = np.hypot(values[:, 0], values[:, 1]).max(initial=0.0)
        if amplitude > self._i_max * (1 + 1e-6):
            self.counts.beyond += len(values)
            self.fail(f"Set-points of {amplitude:.4g} A exceed the limit of {self._i_max:.4g} A.")
            return
        self.session = self._owner = session
        self._expected, self.stator_frame = count + len(values), stator_frame
        kept = int(np.searchsorted(self._due, stamp))
        hold = np.full(len(due), round(_HOLD * sample_period * NANOSECONDS), np.int64)
        self._due = np.concatenate((self._due[:kept], due))
        self._hold = np.concatenate((self._hold[:kept], hold))
        self._count = np.concatenate((self._count[:kept], count + np.arange(len(values), dtype=np.int64)))
        self._values = np.concatenate((self._values[:kept], values))

    def _is_foreign(self, session: int, count: int) -> bool:
        """Return whether a block is to be ignored; one of another publisher than the drive belongs to is a fault."""
        if self.fault:
            return True
        if session == self.session:
            return count < self._expected
        if self._owner and session >> _RUN_BITS != self._owner >> _RUN_BITS:
            self.fail("Two publishers send references.")
            return True
        return count != 0 or session <= self._owner  # without its beginning, or of a run that is over

    def fail(self, reason: str) -> None:
        """End the session with a fault."""
        self.fault = reason
        self._drop()

    def _drop(self) -> None:
        """End the session: the current goes to zero."""
        self.session, self._silence = None, 0.0
        self._due = self._hold = self._count = np.zeros(0, np.int64)
        self._values = np.zeros((0, 2))

    def take(self, stamps: IntArray, sample_period: float) -> FloatArray:
        """Return the references (N, 2), A, at the next samples (N,), ns, ``sample_period``, s, apart."""
        out = np.zeros((len(stamps), 2))
        step = self._slew_rate * sample_period
        index = np.searchsorted(self._due, stamps + round(_EARLY * sample_period * NANOSECONDS), side="right") - 1
        begun = index >= 0
        known = begun.copy()
        known[begun] = stamps[begun] - self._due[index[begun]] <= self._hold[index[begun]]
        over = begun & ~known
        if over.any():  # what follows a gap is not taken up again
            known[int(np.argmax(over)) :] = False
        for start, end in _runs(known):
            if known[start]:
                out[start:end] = self._values[index[start:end]]
                self.applied = int(self._count[index[end - 1]])
            else:
                ramp = approach(self.last, np.zeros(2), step, end - start)
                out[start : start + len(ramp)] = ramp
            self.last = out[end - 1].copy()
        self._taken = int(stamps[-1])
        if over.any():
            self._drop()
        done = max(int(index[-1]), 0)
        self._due, self._hold, self._values = self._due[done:], self._hold[done:], self._values[done:]
        self._count = self._count[done:]
        self._silence += len(stamps) * sample_period  # by its own samples, whatever becomes of the clock
        if self.session is None and self._silence > _QUIET:
            self.fault, self._owner = "", 0
        return out


def _runs(known: BoolArray) -> list[tuple[int, int]]:
    """Return begin and end of each run of equal values."""
    edges = np.flatnonzero(np.diff(known)) + 1
    return list(zip([0, *edges.tolist()], [*edges.tolist(), len(known)], strict=True))
