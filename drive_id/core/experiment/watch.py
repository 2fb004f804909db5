"""Watching a drive while it is driven: what it measures must arrive, be finite and stay within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.signals.signal import SampleCount


@dataclass(frozen=True)
class Fault:
    """Why a drive must not be driven.

    Parameters
    ----------
    reason : str
        A sentence.
    immediate : bool
        Whether the reference must go to zero without a ramp.
    """

    reason: str
    immediate: bool


@dataclass
class _Stream:
    name: str
    arrived: float | None = None
    fault: Fault | None = None
    count: SampleCount = field(default_factory=SampleCount)


class Watch:
    """The watched signals of one drive. Times are seconds of a steady clock.

    Parameters
    ----------
    settings : ExperimentSettings
    currents, resolver : str, optional
        Names of the topics, for messages.
    """

    def __init__(
        self, settings: ExperimentSettings, currents: str = "phase_currents", resolver: str = "resolver"
    ) -> None:
        self.settings = settings
        self._currents = _Stream(currents)
        self._resolver = _Stream(resolver)

    @property
    def lost(self) -> dict[str, int]:
        """Samples that did not arrive, by the blocks' own count, per signal."""
        return {stream.name: stream.count.lost for stream in (self._currents, self._resolver)}

    def currents(self, now: float, first_sample: int, i_abc: Sequence[NDArray[np.float32]]) -> Fault | None:
        """Look at a block of phase currents, three arrays, A; return what is wrong with it."""
        fault = _malformed(self._currents.name, i_abc)
        limit = self.settings.largest_phase_current
        if fault is None and len(i_abc[0]):
            peaks = [float(np.max(np.abs(phase))) for phase in i_abc]
            if max(peaks) > limit:
                phase = "abc"[int(np.argmax(peaks))]
                fault = Fault(
                    f"The current of phase {phase} is {max(peaks):.4g} A, above {limit:.4g} A.", immediate=True
                )
        return _note(self._currents, now, first_sample, len(i_abc[0]), fault)

    def resolver(self, now: float, first_sample: int, signals: Sequence[NDArray[np.float32]]) -> Fault | None:
        """Look at a block of angle, rad, and electrical speed, rad/s; return what is wrong with it."""
        fault = _malformed(self._resolver.name, signals)
        speed = signals[1]
        low, high = self.settings.speed_min, self.settings.speed_max
        if fault is None and len(speed):
            slowest, fastest = float(np.min(speed)), float(np.max(speed))
            if low is not None and slowest < low:
                fault = Fault(f"The speed is {slowest:.4g} rad/s, below speed_min, {low:.4g} rad/s.", immediate=False)
            elif high is not None and fastest > high:
                fault = Fault(f"The speed is {fastest:.4g} rad/s, above speed_max, {high:.4g} rad/s.", immediate=False)
        return _note(self._resolver, now, first_sample, len(speed), fault)

    def fault(self, now: float) -> Fault | None:
        """Return why the drive must not be driven now, or None."""
        for stream in (self._currents, self._resolver) if self.settings.watch else ():
            silence = self._silence(stream, now)
            if silence is not None:
                return silence
        timeout = self.settings.watch_timeout
        recent = [
            s.fault for s in (self._currents, self._resolver) if s.arrived is not None and now - s.arrived <= timeout
        ]
        return next((fault for fault in recent if fault), None)

    def _silence(self, stream: _Stream, now: float) -> Fault | None:
        if stream.arrived is None:
            return Fault(f"Nothing has arrived on {stream.name}: start the drive, or remap the topic.", immediate=False)
        silence = now - stream.arrived
        if silence <= self.settings.watch_timeout:
            return None
        return Fault(
            f"Nothing has arrived on {stream.name} for {silence:.2f} s, longer than watch_timeout, "
            f"{self.settings.watch_timeout:g} s.",
            immediate=False,
        )


def _malformed(name: str, arrays: Sequence[NDArray[np.float32]]) -> Fault | None:
    if len({len(array) for array in arrays}) > 1:
        return Fault(f"A block of {name} has arrays of different lengths.", immediate=True)
    if not all(np.isfinite(array).all() for array in arrays):
        return Fault(f"Samples of {name} are NaN or infinite.", immediate=True)
    return None


def _note(stream: _Stream, now: float, first_sample: int, samples: int, fault: Fault | None) -> Fault | None:
    if samples or fault:
        stream.arrived = now
        stream.fault = fault
        stream.count.add(first_sample, samples)
    return fault
