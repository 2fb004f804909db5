"""State machine of an experiment: ramp in, run, ramp out, and safe ends from every state.

Set-points are published ahead of time on a fixed time grid. The drive must obey two rules: a safe block brings the
current to zero on receipt (a stop takes effect at once, whatever was published ahead and whatever its clock says), and
when set-points run out, the current goes to zero (a dead publisher leaves no current behind).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.free_shaft import FreeShaft
from drive_id.core.experiment.limits import approach, follow, inside_disc
from drive_id.core.experiment.settings import ExperimentSettings, make_trajectory, speed_feedback, total_duration
from drive_id.core.maps.coverage import Visits, disc_points
from drive_id.core.signals.signal import block_stamps
from drive_id.types import NANOSECONDS, FloatArray, IntArray

LARGEST_BLOCK = 1000  # set-points
_COVERAGE_NODES = 21  # along each axis of the grid on which visited places are counted
_COVERAGE_STEP = 10  # set-points, of which one is counted


class ExperimentState(Enum):
    """State of an experiment."""

    IDLE = "idle"
    RAMP_IN = "ramp_in"
    RUNNING = "running"
    RAMP_OUT = "ramp_out"
    TRIPPED = "tripped"


@dataclass(frozen=True, eq=False)
class ReferenceBlock:
    """A block of set-points."""

    stamp: int  # due time of the first set-point, ns
    first_sample: int  # running count of the set-points published
    sample_period: float  # s
    i_dq: NDArray[np.float32]  # (N, 2), A
    session: int
    count: int  # of the first set-point in the session
    safe: bool  # the drive goes to zero current on receipt
    stator_frame: bool = False  # the set-points are alpha and beta

    @property
    def due(self) -> IntArray:
        """Due times of the set-points (N,), ns."""
        return block_stamps(self.stamp, len(self.i_dq), self.sample_period)


class Experiment:
    """Runs one experiment after the other; without a clock, threads or ROS.

    Times are integer nanoseconds of the clock that stamps the blocks. All set-points lie in the disc of ``i_max``, and
    consecutive ones differ by at most ``slew_rate`` times the sample period, except for an immediate trip.
    """

    def __init__(self, settings: ExperimentSettings) -> None:
        self._first_sample = 0
        self._active = False
        self._state = ExperimentState.IDLE
        self._rest = 0
        self._forget_last(0, 0)
        self.configure(settings)

    def _forget_last(self, now: int, session: int) -> None:
        self.trip_reason = self.stop_reason = ""
        self.session, self._session_start = session, self._first_sample
        self._safe = False
        self._pending = False  # the next set-points are due at once, not ahead
        self._cut = False  # the reference went to zero without a ramp
        self._epoch = self._last_now = now
        self._next = 0
        self._marks: list[tuple[int, ExperimentState]] = []
        self._point = np.zeros(2)
        self._run_start = -1  # not yet
        self._ahead: FloatArray = np.zeros((0, 2))

    def configure(self, settings: ExperimentSettings) -> None:
        """Change the settings for the next start; only while no experiment is active."""
        assert not self._active
        self.settings = settings
        self._trajectory = make_trajectory(settings)
        self.feedback = speed_feedback(settings, self._trajectory)
        self._turned = np.exp(-1j * (0.0 if settings.stator_frame else settings.angle_offset))
        self._step = settings.slew_rate * settings.sample_period
        total = total_duration(settings, self._trajectory) / settings.sample_period
        self._total = None if math.isinf(total) else round(total)
        axis = np.linspace(-settings.i_max, settings.i_max, _COVERAGE_NODES)
        self._visits = Visits(axis, axis)
        self._disc = disc_points(axis, axis, settings.i_max)

    @property
    def active(self) -> bool:
        """Whether set-points are being published, ramps and final zeros included."""
        return self._active

    @property
    def coverage(self) -> float:
        """Share (0 to 1) of the disc close to the set-points of the last experiment that have come due."""
        near, total = self._disc
        return float(near[self._visits.count > 0].sum() / total)

    def state(self, now: int) -> ExperimentState:
        """Return the state of the set-point that is due now."""
        if self.trip_reason:
            return ExperimentState.TRIPPED
        if not self._active:
            return ExperimentState.IDLE
        return self._due_state(now)

    def elapsed(self, now: int) -> float:
        """Return the time since the trajectory began, s; 0 before."""
        if not self._active or self._run_start < 0:
            return 0.0
        return max(0.0, (self._index(now) - self._run_start) * self.settings.sample_period)

    def current(self, now: int) -> FloatArray:
        """Return the set-point (2,) that is due now, A."""
        position = self._index(now) - (self._next - len(self._ahead))
        return self._ahead[position].copy() if 0 <= position < len(self._ahead) else np.zeros(2)

    def start(self, now: int, session: int = 1) -> None:
        """Start an experiment in a session of its own and clear an earlier trip; only while none is active."""
        assert not self._active
        self._forget_last(now, session)
        self._active = self._pending = True
        self._epoch += self._nanoseconds(self.settings.lead_time) // 2
        self._visits.count[:] = 0
        self.feedback = speed_feedback(self.settings, self._trajectory)
        self._enter(ExperimentState.RAMP_IN)

    def stop(self, now: int, reason: str) -> None:
        """Ramp down from the set-point that is due now, replacing what was published ahead."""
        if self._active and self._due_state(now) in {ExperimentState.RAMP_IN, ExperimentState.RUNNING}:
            self.stop_reason = reason
            self._override(now, immediate=False)

    def trip(self, now: int, reason: str, *, immediate: bool) -> None:
        """Stop because of a fault, whose sentence is kept if it is the first one; ``immediate``: without a ramp."""
        if not self._active:
            return
        self.trip_reason = self.trip_reason or reason
        if (immediate and not self._cut) or self._due_state(now) in {ExperimentState.RAMP_IN, ExperimentState.RUNNING}:
            self._override(now, immediate=immediate)

    def advance(self, now: int) -> list[ReferenceBlock]:
        """Return the blocks to publish now, so that set-points reach ``lead_time`` ahead."""
        if not self._active:
            return []
        self._check_clock(now)
        horizon = self._index(now + self._nanoseconds(self.settings.lead_time)) + 1
        blocks = self._blocks(max(0, horizon - self._next))
        if self._state is ExperimentState.IDLE and self._index(now) >= self._next:
            self._active = False
        self._forget(now)
        return blocks

    def finish(self, now: int, reason: str) -> list[ReferenceBlock]:
        """Stop, and return all blocks down to the last zero at once: before the process ends."""
        if not self._active:
            return []
        self._check_clock(now)
        self.stop(now, reason)
        blocks = []
        while self._state is not ExperimentState.IDLE:
            blocks += self._blocks(LARGEST_BLOCK)
        self._active = False
        return blocks

    def withhold(self, now: int, block: ReferenceBlock) -> bool:
        """Return whether a block must not be published: it became late since it was made, which trips."""
        if block.safe or now < block.stamp:
            return False
        self._trip_late(now, now - block.stamp)
        return True

    def rest(self, now: int) -> ReferenceBlock:
        """Return a block that brings the drive to zero current, whoever drives it; only while none is active."""
        assert not self._active
        self._safe = True
        return self._block(now, np.zeros((1, 2), np.float32))

    # Time grid

    def _nanoseconds(self, seconds: float) -> int:
        return round(seconds * NANOSECONDS)

    def _index(self, now: int) -> int:
        """Return the index of the last set-point due at or before ``now``."""
        return math.floor((now - self._epoch) / (self.settings.sample_period * NANOSECONDS) + 1e-3)

    def _stamp(self, index: int) -> int:
        return self._epoch + round(index * self.settings.sample_period * NANOSECONDS)

    def _check_clock(self, now: int) -> None:
        """Trip when the set-points ran out before this call, or the clock was set back."""
        last, self._last_now = self._last_now, now
        late = now - self._stamp(self._next)
        if now < last - self._nanoseconds(self.settings.lead_time):
            self._epoch, self._next, self._ahead = now, 0, np.zeros((0, 2))
            self._marks = [(0, self._state)]
            self.trip(now, f"The clock was set back by {(last - now) / NANOSECONDS:.3f} s.", immediate=True)
        elif late <= 0 or (self._pending and self._safe) or self._state is ExperimentState.IDLE:
            return
        elif self._cut:
            self._state = ExperimentState.IDLE  # the drive is at zero without further set-points
        else:
            self._trip_late(now, late)

    def _trip_late(self, now: int, late: int) -> None:
        self.trip(
            now,
            f"The publisher came {late / NANOSECONDS:.3f} s too late to publish ahead: its process was held up, or the "
            "clock jumped; raise lead_time.",
            immediate=True,
        )

    # Set-points

    def _due_state(self, now: int) -> ExperimentState:
        """Return the state of the set-point that is due now, regardless of trips."""
        due = [state for first, state in self._marks if first <= self._index(now)]
        return due[-1] if due else self._marks[0][1]

    def _enter(self, state: ExperimentState) -> None:
        self._state = state
        self._marks.append((self._next, state))
        if state is ExperimentState.RUNNING:
            self._run_start = self._next

    def _override(self, now: int, *, immediate: bool) -> None:
        """Withdraw all set-points due from now on, and go to zero from the present one."""
        self._cut, self._safe = immediate, True
        self._point = np.zeros(2) if immediate else self.current(now)
        first = max(self._index(now) + 1, 0)
        kept = len(self._ahead) - (self._next - first)
        self._ahead = self._ahead[: max(kept, 0)] if first <= self._next else self._ahead[:0]
        self._next = first
        self._marks = [(first, state) for first, state in self._marks if first < self._next]
        self._enter(ExperimentState.RAMP_OUT)
        self._rest = self._resting()
        self._pending = True

    def _resting(self) -> int:
        """Return the number of zeros at the end of an experiment."""
        return math.ceil(self.settings.lead_time / self.settings.sample_period)

    def _blocks(self, count: int) -> list[ReferenceBlock]:
        self._pending = False
        first = self._next
        pieces = []
        while count > 0 and self._state is not ExperimentState.IDLE:
            piece = self._piece(count)
            if len(piece):
                self._point = piece[-1]
                self._next += len(piece)
                count -= len(piece)
                pieces.append(piece)
        if not pieces:
            return []
        values = inside_disc(np.concatenate(pieces), self.settings.i_max)
        self._ahead = np.concatenate((self._ahead, values))
        return [
            self._block(self._stamp(first + start), values[start : start + LARGEST_BLOCK])
            for start in range(0, len(values), LARGEST_BLOCK)
        ]

    def _block(self, stamp: int, values: NDArray[np.float32]) -> ReferenceBlock:
        first, period = self._first_sample, self.settings.sample_period
        self._first_sample += len(values)
        count, frame = first - self._session_start, self.settings.stator_frame
        if self._turned != 1.0:  # into the frame of the drive
            vector = (values[:, 0] + 1j * values[:, 1].astype(np.float64)) * self._turned
            values = inside_disc(np.stack([vector.real, vector.imag], axis=-1), self.settings.i_max)
        return ReferenceBlock(stamp, first, period, values, self.session, count, self._safe, frame)

    def _piece(self, count: int) -> FloatArray:
        """Return up to ``count`` further set-points of the present state; none when it is over."""
        if self._state is ExperimentState.RAMP_IN:
            target = inside_disc(self._trajectory(np.zeros(1)), self.settings.i_max)[0].astype(np.float64)
            points = approach(self._point, target, self._step, count)
            if not len(points):
                self._enter(ExperimentState.RUNNING)
            return points
        if self._state is ExperimentState.RUNNING:
            return self._running(count)
        points = approach(self._point, np.zeros(2), self._step, count)
        if not len(points):
            points = np.zeros((min(count, self._rest), 2))
            self._rest -= len(points)
            if self._rest == 0:
                self._state = ExperimentState.IDLE
        return points

    def _running(self, count: int) -> FloatArray:
        passed = self._next - self._run_start
        left = count if self._total is None else min(count, self._total - passed)
        if left <= 0:
            self._enter(ExperimentState.RAMP_OUT)
            self._rest = self._resting()
            return np.zeros((0, 2))
        times = (passed + np.arange(left, dtype=np.float64)) * self.settings.sample_period
        if self.feedback is not None and isinstance(self._trajectory, FreeShaft):
            targets = self._trajectory(times, self.feedback.biases(left))
        else:
            targets = self._trajectory(times)
        return follow(self._point, targets, self._step)

    def _forget(self, now: int) -> None:
        """Drop the set-points before the one that is due now, and count where they were."""
        begin = self._next - len(self._ahead)
        old = min(max(self._index(now) - begin, 0), len(self._ahead))
        self._visits.add(self._ahead[:old:_COVERAGE_STEP].astype(np.float64))
        self._ahead = self._ahead[old:]
        due = [k for k, (first, _) in enumerate(self._marks) if first <= self._index(now)]
        self._marks = self._marks[due[-1] :] if due else self._marks
