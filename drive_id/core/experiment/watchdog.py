"""Watches a drive: what arrives, when, by which clock, within which limits, and whether it follows the references.

``now`` is the time of the clock that stamps the references, ns; ``steady`` that of a monotonic clock, s, which alone
measures how long something has lasted. Nothing here commands anything: see :mod:`~.supervision`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from drive_id.core.experiment.feedback import DriveStatus, PublishedReferences, SampleBlock
from drive_id.core.experiment.permission import beyond_drive
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.signals.signal import SampleCount
from drive_id.types import NANOSECONDS, FloatArray

CURRENTS = "phase_currents"
RESOLVER = "resolver"
STATUS = "drive_status"
SIGNALS = (CURRENTS, RESOLVER, STATUS)
_STRAY = 1_000_000  # deviation of stamps from an even grid, ns, besides half a block, that is no step of the clock
_BRIEFLY = 0.1
"""Time for which an offset of the clock or another session may last, s: a stalled process catches up meanwhile."""

CURRENT_MARGIN = 1.1
"""Measured current that trips, by the drive's own current_limit: set-points may reach that limit, and overshoot of the
current control, noise and ripple come on top, 4 % with the simulated drives."""

Message = TypeVar("Message", SampleBlock, DriveStatus)


@dataclass(frozen=True)
class Fault:
    """Why the drive must not be driven."""

    reason: str  # a sentence
    immediate: bool = False  # set the reference to zero at once, without a ramp


@dataclass
class _Button:
    """One emergency stop: a topic, which nobody but its button publishes."""

    name: str
    heard: float | None = None
    pressed: bool = False
    latched: bool = False
    publishers: int = 1

    def note(self, steady: float, pressed: bool) -> None:
        """Note a message; two publishers cannot be told apart, so what one says does not release the other."""
        self.heard, self.latched = steady, self.latched or pressed
        if pressed or self.publishers <= 1:
            self.pressed = pressed

    def fault(self, steady: float, longest: float | None) -> Fault | None:
        if self.pressed:
            held = ""
            if self.publishers > 1:
                held = f", and a release by one of the {self.publishers} nodes that publish it does not count"
            return Fault(f"The emergency stop ({self.name}) is pressed{held}.", True)
        if self.latched:
            remedy = "clear it by characterize --clear-fault, or call ~/clear_fault"
            return Fault(f"The emergency stop ({self.name}) was pressed: {remedy}.", True)
        if longest is None:
            return None
        if self.heard is None or steady - self.heard > longest:
            return Fault(f"The emergency stop ({self.name}) is silent, longer than {longest:g} s.")
        if self.publishers > 1:
            return Fault(
                f"{self.publishers} nodes publish the emergency stop ({self.name}), so the silence of one would not be "
                "noticed: give each a topic of its own in emergency_stops."
            )
        return None


@dataclass
class _Since:
    """Since when a condition has held without a break, s."""

    begin: float | None = None

    def note(self, steady: float, holds: bool) -> None:
        self.begin = (steady if self.begin is None else self.begin) if holds else None

    def lasts(self, steady: float) -> bool:
        return self.begin is not None and steady - self.begin > _BRIEFLY


@dataclass
class _Stream(Generic[Message]):
    """One signal: its last message, and what was wrong with it."""

    name: str
    arrived: float | None = None
    last: Message | None = None
    fault: Fault | None = None
    count: SampleCount = field(default_factory=SampleCount)
    offset: float = 0.0
    away: _Since = field(default_factory=_Since)

    def silence(self, steady: float, longest: float) -> Fault | None:
        if self.arrived is None:
            return Fault(f"Nothing has arrived on {self.name}: start the drive, or remap the topic.")
        if steady - self.arrived <= longest:
            return None
        return Fault(
            f"Nothing has arrived on {self.name} for {steady - self.arrived:.2f} s, longer than watch_timeout, "
            f"{longest:g} s."
        )

    def note_clock(self, now: int, steady: float, stamp: int, largest: float) -> None:
        self.offset = (now - stamp) / NANOSECONDS
        self.away.note(steady, abs(self.offset) > largest)


class Watchdog:
    """Judges the messages of a drive, and what does not come.

    ``names`` are those of the topics ``phase_currents``, ``resolver``, ``drive_status`` and ``emergency_stops``, for
    messages.
    """

    def __init__(self, settings: ExperimentSettings, names: Mapping[str, str] | None = None) -> None:
        self.settings = settings
        self.published = PublishedReferences()
        self.publishers = 1
        """Nodes that publish references, this one included."""
        self.drives: tuple[str, ...] = ()
        """Nodes that publish the phase currents, as far as they are known."""
        names = names or {}
        self._currents: _Stream[SampleBlock] = _Stream(names.get(CURRENTS, CURRENTS))
        self._resolver: _Stream[SampleBlock] = _Stream(names.get(RESOLVER, RESOLVER))
        self._status: _Stream[DriveStatus] = _Stream(names.get(STATUS, STATUS))
        self._buttons = {name: _Button(names.get(name, name)) for name in settings.emergency_stops}
        self._distance = 0.0
        self._apart = ""
        self._foreign, self._unfollowed = _Since(), _Since()
        self._clock = (0, -math.inf)

    @property
    def lost(self) -> dict[str, int]:
        """Samples lost per signal, by the running count of the blocks."""
        return {stream.name: stream.count.lost for stream in (self._currents, self._resolver)}

    @property
    def clock_offset(self) -> float:
        """Time from the end of the last block to its arrival, s: latency, and what the drive's clock is behind."""
        return max((s.offset for s in (self._currents, self._resolver)), key=abs)

    # What arrives

    def currents(self, now: int, steady: float, block: SampleBlock) -> Fault | None:
        """Check a block of phase currents, three (N,) arrays, A, and return its fault."""
        fault = _malformed(self._currents.name, block)
        own = CURRENT_MARGIN * self.own_current_limit
        limit = min(self.settings.largest_phase_current, own)
        if fault is None and len(block):
            peaks = [float(np.max(np.abs(phase))) for phase in block.values]
            if max(peaks) > limit:
                phase = "abc"[int(np.argmax(peaks))]
                why = f", {CURRENT_MARGIN:g} times the current_limit of the drive: lower i_max" if limit == own else ""
                fault = Fault(f"The current of phase {phase} is {max(peaks):.4g} A, above {limit:.4g} A{why}.", True)
        return self._take(self._currents, now, steady, block, fault)

    def resolver(self, now: int, steady: float, block: SampleBlock) -> Fault | None:
        """Check a block of angle, rad, and electrical speed, rad/s, (N,) each, and return its fault."""
        fault = _malformed(self._resolver.name, block)
        low, high = self.speed_band
        if fault is None and len(block):
            slowest, fastest = float(np.min(block.values[1])), float(np.max(block.values[1]))
            planned = self.settings.planned_speed  # a free shaft: every further moment of torque drives it on
            if max(-slowest, fastest) > planned:
                fault = Fault(
                    f"The speed is {max(-slowest, fastest):.4g} rad/s, above 1.2 times shaft_speed_max, "
                    f"{planned:.4g} rad/s.",
                    True,
                )
            elif slowest < low:
                fault = Fault(f"The speed is {slowest:.4g} rad/s, below speed_min, {low:.4g} rad/s.")
            elif fastest > high:
                fault = Fault(f"The speed is {fastest:.4g} rad/s, above speed_max, {high:.4g} rad/s.")
        return self._take(self._resolver, now, steady, block, fault)

    def status(self, now: int, steady: float, status: DriveStatus) -> Fault | None:
        """Check what the drive says of itself, and return its fault."""
        stream, last = self._status, self._status.last
        fault = self._status_fault(status)
        if last is not None and status.count <= last.count:
            if status.stamp <= last.stamp:
                return None  # a straggler
            fault = fault or self._two_drives(stream.name) or _restarted(stream.name, last.count + 1, status.count)
        elif last is not None and status.stamp < last.stamp:
            fault = fault or _set_back(stream.name, last.stamp - status.stamp)
        stream.arrived, stream.last, stream.fault = steady, status, fault
        stream.note_clock(now, steady, status.stamp, self.settings.largest_clock_offset)
        _, due = self.published.at(np.array([status.stamp], np.int64))
        mine = self.published.session
        self._foreign.note(steady, status.session not in {0, mine})
        self._unfollowed.note(steady, due and self.published.hold and status.session == 0)
        return stream.fault

    def emergency_stop(self, steady: float, pressed: bool, button: str) -> Fault | None:
        """Note a message of an emergency stop; a press is kept until it is cleared."""
        self._buttons[button].note(steady, pressed)
        return self._estop(steady)

    def count_buttons(self, publishers: Mapping[str, int]) -> None:
        """Note how many nodes publish each emergency stop."""
        for name, number in publishers.items():
            self._buttons[name].publishers = number

    def release(self) -> None:
        """Forget earlier presses of the emergency stops."""
        for button in self._buttons.values():
            button.latched = button.pressed

    def _take(
        self, stream: _Stream[SampleBlock], now: int, steady: float, block: SampleBlock, fault: Fault | None
    ) -> Fault | None:
        if not len(block) and fault is None:
            return None
        if fault is None:
            fault, straggler = _order(stream, block)
            if straggler:
                return None
            fault = fault and (self._two_drives(stream.name) or fault)
            stream.last = block
        stream.arrived, stream.fault = steady, fault
        stream.count.add(block.first_sample, len(block), block.stamp, block.sample_period)
        if fault is None:
            stream.note_clock(now, steady, block.end, self.settings.largest_clock_offset)
            self._compare()
        return fault

    def _compare(self) -> None:
        """Average the distance between measured currents and references, where currents and angle overlap."""
        currents, resolver = self._currents.last, self._resolver.last
        if currents is None or resolver is None:
            return
        period = currents.sample_period * NANOSECONDS
        shift = round((resolver.stamp - currents.stamp) / period)
        first, last = max(0, shift), min(len(currents), shift + len(resolver))
        if first >= last:
            return
        a, b, c = (phase[first:last].astype(np.float64) for phase in currents.values)
        vector = (2 * a - b - c) / 3 + 1j * (b - c) / math.sqrt(3)
        if not self.published.stator_frame:
            vector = vector * np.exp(-1j * resolver.values[0][first - shift : last - shift])
        stamps = currents.stamp + np.round(np.arange(first, last) * period).astype(np.int64)
        measured = np.array([vector.real.mean(), vector.imag.mean()])
        wanted = self.published.at(stamps)[0].mean(axis=0)
        apart = math.hypot(*(measured - wanted))
        if not self.published.hold:
            apart = max(0.0, math.hypot(*measured) - math.hypot(*wanted))
        self._distance += (apart - self._distance) * -math.expm1(
            -(last - first) * currents.sample_period / self.settings.follow_time
        )
        self._apart = f"({_pair(measured)}) A measured, ({_pair(wanted)}) A commanded"

    # What is wrong

    @property
    def speed_band(self) -> tuple[float, float]:
        """Lowest and highest speed allowed, rad/s; infinite where nobody limits it."""
        low, high = self.settings.speed_min, self.settings.speed_max
        own = self.own_speed_limit
        high = own if high is None else min(high, own)
        return (-abs(high) if low is None else max(low, -own)), high

    @property
    def own_current_limit(self) -> float:
        """Largest amplitude that the drive says it follows, A; infinite if it does not say."""
        return math.inf if self._status.last is None else _limit(None, self._status.last.current_limit)

    @property
    def own_speed_limit(self) -> float:
        """Highest electrical speed that the drive permits, rad/s; infinite if it does not say."""
        return math.inf if self._status.last is None else _limit(None, self._status.last.speed_limit)

    @property
    def knows_drive(self) -> bool:
        """Whether the drive has said what its limits are, or must before anything starts."""
        return self.settings.require_status or self._status.last is not None

    def fault(self, now: int, steady: float) -> Fault | None:
        """Return the present fault, the most urgent one first."""
        return next((fault for fault in self._faults(now, steady) if fault is not None), None)

    def start_fault(self) -> Fault | None:
        """Return what only forbids a start: limits that are not known, or do not fit the drive."""
        reason = beyond_drive(self.settings, self.own_current_limit, self.own_speed_limit)
        return None if reason is None else Fault(reason)

    def flows(self) -> bool:
        """Whether a current flows that no reference commands."""
        return not self.published.hold and self._distance > self.settings.largest_distance

    def _faults(self, now: int, steady: float) -> Iterator[Fault | None]:
        settings = self.settings
        watched = (self._currents, self._resolver, self._status)
        yield self._estop(steady)
        yield self._clock_fault(now, steady)
        if self.publishers > 1:
            others = self.publishers - 1
            nodes = f"{others} other nodes publish" if others > 1 else "Another node publishes"
            yield Fault(f"{nodes} current_reference: stop them, a drive follows only one.", True)
        if settings.watch:
            needed = watched if settings.require_status or self._status.arrived is not None else watched[:2]
            for stream in needed:
                yield stream.silence(steady, settings.watch_timeout)
        for stream in watched:
            recent = stream.arrived is not None and steady - stream.arrived <= settings.watch_timeout
            yield stream.fault if recent else None
        if settings.watch:
            for stream in watched:
                yield self._offset_fault(stream, steady)
            yield self._following_fault(steady)

    def _two_drives(self, name: str) -> Fault | None:
        """Return why counts or stamps of a signal mix, if two drives are there; a killed one is seen for 20 s."""
        drives = list(dict.fromkeys(self.drives))
        if len(drives) < 2:
            return None
        return Fault(f"Two drives publish {name}, {' and '.join(drives)}, and their counts mix: stop one.", True)

    def _estop(self, steady: float) -> Fault | None:
        faults = [button.fault(steady, self.settings.emergency_stop_timeout) for button in self._buttons.values()]
        return max((fault for fault in faults if fault is not None), key=lambda fault: fault.immediate, default=None)

    def _clock_fault(self, now: int, steady: float) -> Fault | None:
        if now != self._clock[0]:
            self._clock = (now, steady)
        if steady - self._clock[1] <= self.settings.watch_timeout:
            return None
        return Fault(f"The clock of this node has stood still for {steady - self._clock[1]:.2f} s: /clock is paused.")

    def _offset_fault(self, stream: _Stream[SampleBlock] | _Stream[DriveStatus], steady: float) -> Fault | None:
        if not stream.away.lasts(steady):
            return None
        side = "behind" if stream.offset > 0 else "ahead of"
        return Fault(
            f"The stamps of {stream.name} are {abs(stream.offset):.3f} s {side} the clock of this node, more than "
            f"clock_offset, {self.settings.largest_clock_offset:g} s: synchronize the clocks.",
            True,
        )

    def _following_fault(self, steady: float) -> Fault | None:
        limit = self.settings.largest_distance
        if self._foreign.lasts(steady):
            return Fault("The drive follows the references of somebody else: stop whoever drives it.", True)
        if self._unfollowed.lasts(steady):
            return Fault("The drive does not follow the references: it reports no session.", True)
        if self._distance <= limit:
            return None
        return Fault(
            f"The current does not follow the reference: on average {self._distance:.4g} A apart, more than "
            f"follow_band, {limit:.4g} A (last: {self._apart}).",
            True,
        )

    def _status_fault(self, status: DriveStatus) -> Fault | None:
        settings = self.settings
        if status.fault:
            return Fault(f"The drive reports a fault: {status.fault.rstrip('.')}.", True)
        if not status.enabled:
            return Fault("The drive is not enabled.", True)
        highest = _limit(settings.temperature_max, status.winding_temperature_limit)
        for name in ("winding", "magnet"):
            temperature = getattr(status, f"{name}_temperature")
            limit = highest if name == "winding" or settings.temperature_max is not None else math.inf
            if temperature > limit:
                return Fault(f"The {name} has {temperature:.4g} degC, above temperature_max, {limit:.4g} degC.")
        low = -math.inf if settings.dc_link_voltage_min is None else settings.dc_link_voltage_min
        high = _limit(settings.dc_link_voltage_max, status.dc_link_voltage_limit)
        voltage = status.dc_link_voltage
        if voltage < low or voltage > high:
            return Fault(f"The DC link has {voltage:.4g} V, outside of {low:.4g} to {high:.4g} V.")
        return None


def _order(stream: _Stream[SampleBlock], block: SampleBlock) -> tuple[Fault | None, bool]:
    """Return the fault of a block by its count and stamp, and whether it is a straggler, overtaken by later blocks."""
    due, last = stream.count.due, stream.last
    if due is None or last is None:
        return None, False
    width = len(block) * block.sample_period * NANOSECONDS
    late, behind = block.stamp - last.end, block.first_sample - due
    if behind < 0 and not (block.first_sample == 0 and stream.count.zeros == stream.count.blocks):
        if abs(late - behind * block.sample_period * NANOSECONDS) <= 0.5 * width + _STRAY:
            return None, True
        return _restarted(stream.name, due, block.first_sample), False
    if late < -0.5 * width - _STRAY:
        return _set_back(stream.name, -late), False
    return None, False


def _restarted(name: str, due: int, count: int) -> Fault:
    return Fault(f"The count of {name} fell from {due} to {count}: the drive was restarted.", True)


def _set_back(name: str, by: int) -> Fault:
    return Fault(f"The stamps of {name} do not advance: {by / NANOSECONDS:.3f} s behind those before.", True)


def _limit(wanted: float | None, own: float) -> float:
    """Return the tighter one of the limit wanted and that of the drive; infinite without either."""
    return min(math.inf if wanted is None else wanted, math.inf if math.isnan(own) else own)


def _pair(vector: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" for value in vector)


def _malformed(name: str, block: SampleBlock) -> Fault | None:
    if len({len(array) for array in block.values}) > 1:
        return Fault(f"A block of {name} has arrays of different lengths.", True)
    if not all(np.isfinite(array).all() for array in block.values):
        return Fault(f"Samples of {name} are NaN or infinite.", True)
    if not 1e-9 <= block.sample_period <= 1e3:
        return Fault(f"A block of {name} declares a sample period of {block.sample_period:g} s.", True)
    return None
