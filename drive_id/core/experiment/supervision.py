"""Experiments under supervision: a watchdog over the signals of the drive permits a start and demands a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drive_id.core.experiment.settings import ExperimentSettings, make_trajectory, total_duration
from drive_id.core.experiment.state_machine import NANOSECONDS, Experiment, ExperimentState, ReferenceBlock
from drive_id.core.signals.signal import SampleCount
from drive_id.health import Health, Level


@dataclass(frozen=True)
class Fault:
    """Why the drive must not be driven.

    Parameters
    ----------
    reason : str
        A sentence.
    immediate : bool
        Set the reference to zero at once, without a ramp.
    """

    reason: str
    immediate: bool


@dataclass
class _Stream:
    name: str
    arrived: float | None = None
    fault: Fault | None = None
    count: SampleCount = field(default_factory=SampleCount)


class Watchdog:
    """Checks that phase currents and resolver keep arriving, are finite and stay within their limits.

    Times are seconds of a monotonic clock.

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
        """Samples lost per signal, by the running count of the blocks."""
        return {stream.name: stream.count.lost for stream in (self._currents, self._resolver)}

    def currents(self, now: float, first_sample: int, i_abc: Sequence[NDArray[np.float32]]) -> Fault | None:
        """Check a block of phase currents, three (N,) arrays, A, and return its fault."""
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
        """Check a block of angle, rad, and electrical speed, rad/s, (N,) each, and return its fault."""
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
        """Return the present fault: a signal that is silent, or the fault of its last block."""
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


def rehearse(settings: ExperimentSettings) -> None:
    """Run the beginning of an experiment without output, so that lazy loading in numpy does not delay a start."""
    experiment = Experiment(settings)
    experiment.start(0)
    for now in (0, NANOSECONDS // 10, NANOSECONDS // 5):
        experiment.advance(now)
    experiment.finish(NANOSECONDS // 5, "")


class SupervisedExperiment:
    """An experiment that starts only without a fault of the drive, and is stopped by one.

    ``now`` is the time of the clock that stamps the blocks, ns; ``steady`` that of a monotonic clock, s.

    Parameters
    ----------
    settings : ExperimentSettings
    currents, resolver : str, optional
        Names of the topics, for messages.
    """

    def __init__(
        self, settings: ExperimentSettings, currents: str = "phase_currents", resolver: str = "resolver"
    ) -> None:
        rehearse(settings)
        self._experiment = Experiment(settings)
        self._watchdog = Watchdog(settings, currents, resolver)
        self._settings = settings
        self._duration = total_duration(settings, make_trajectory(settings))

    @property
    def trip_reason(self) -> str:
        """Why the last experiment tripped; empty if it did not."""
        return self._experiment.trip_reason

    def plan(self) -> str:
        """Describe the experiment that a start runs."""
        settings = self._settings
        seconds = total_duration(settings, make_trajectory(settings))
        how_long = "until it is stopped" if math.isinf(seconds) else f"for {seconds:.4g} s"
        return f"{settings.trajectory} within {settings.i_max:g} A {how_long}"

    def start(self, now: int, steady: float, publishers: int = 1) -> tuple[bool, str]:
        """Start, or return why not; ``publishers`` is the number of publishers of references, this one included."""
        if self._experiment.active:
            state = self._experiment.state(now).value
            return False, f"An experiment is under way ({state}): stop it, or wait for its end."
        if now <= 0:
            return False, "The time is 0: use_sim_time is set, but nobody publishes /clock."
        if publishers > 1:
            return (
                False,
                f"{publishers - 1} other nodes publish current_reference: stop them, a drive follows only one.",
            )
        fault = self._watchdog.fault(steady)
        if fault is not None:
            return False, f"{self._tripped()}Not started: {fault.reason}"
        self._experiment.start(now)
        return True, f"Started: {self.plan()}."

    def stop(self, now: int) -> tuple[bool, str]:
        """Ramp down to zero; succeeds, too, when nothing is running."""
        if not self._experiment.active:
            return True, "Nothing is running."
        self._experiment.stop(now, "Stopped on request.")
        return True, "Stopping: the current ramps down to zero."

    def change(self, now: int, settings: ExperimentSettings) -> None:
        """Change the settings; a running experiment is stopped first."""
        self._settings = settings
        self._duration = total_duration(settings, make_trajectory(settings))
        self._experiment.stop(now, "Stopped, because parameters were changed.")
        self._take_settings()

    def currents(self, now: int, steady: float, first_sample: int, i_abc: Sequence[NDArray[np.float32]]) -> bool:
        """Check a block of phase currents (three (N,) arrays, A); return whether it trips the experiment."""
        return self._judge(now, self._watchdog.currents(steady, first_sample, i_abc))

    def resolver(self, now: int, steady: float, first_sample: int, signals: Sequence[NDArray[np.float32]]) -> bool:
        """Check a block of angle, rad, and speed, rad/s, (N,) each; return whether it trips the experiment."""
        return self._judge(now, self._watchdog.resolver(steady, first_sample, signals))

    def advance(self, now: int, steady: float) -> list[ReferenceBlock]:
        """Return the blocks to publish now."""
        if self._experiment.active:
            self._judge(now, self._watchdog.fault(steady))
        blocks = self._experiment.advance(now)
        self._take_settings()
        return blocks

    def finish(self, now: int, reason: str = "Stopped, because the node ends.") -> list[ReferenceBlock]:
        """Stop, and return all blocks down to the last zero: before nothing more can be published."""
        return self._experiment.finish(now, reason)

    def health(self, now: int, steady: float) -> Health:
        """Return state, time, set-point and coverage."""
        experiment, settings = self._experiment, self._settings
        state = experiment.state(now)
        i_d, i_q = experiment.current(now)
        coverage = experiment.coverage
        values = {
            "state": state.value,
            "trajectory": settings.trajectory,
            "elapsed [s]": f"{experiment.elapsed(now):.3f}",
            "duration [s]": f"{self._duration:.3f}",
            "i_max [A]": f"{settings.i_max:g}",
            "i_d [A]": f"{i_d:.4g}",
            "i_q [A]": f"{i_q:.4g}",
            "coverage": f"{coverage:.3f}",
        }
        values |= {f"lost samples of {name}": str(lost) for name, lost in self._watchdog.lost.items()}
        if state is ExperimentState.TRIPPED:
            return Health(Level.ERROR, experiment.trip_reason, values)
        if experiment.active:
            return Health(Level.OK, f"{state.value}: {100 * coverage:.0f} % of the disc visited.", values)
        fault = self._watchdog.fault(steady)
        if fault is not None:
            return Health(Level.WARN, f"A start would be refused: {fault.reason}", values)
        return Health(Level.OK, experiment.stop_reason or "Waiting for a start.", values)

    def _judge(self, now: int, fault: Fault | None) -> bool:
        if fault is None or not self._experiment.active:
            return False
        self._experiment.trip(now, fault.reason, immediate=fault.immediate)
        return True

    def _take_settings(self) -> None:
        if not self._experiment.active and self._experiment.settings is not self._settings:
            self._experiment.configure(self._settings)
            self._watchdog.settings = self._settings

    def _tripped(self) -> str:
        return f"Tripped before: {self._experiment.trip_reason} " if self._experiment.trip_reason else ""
