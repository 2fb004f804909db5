"""Experiments under supervision: a watchdog over the drive permits a start and demands a stop."""

from __future__ import annotations

import itertools
import math
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from drive_id.common.health import Health, Level
from drive_id.core.experiment.feedback import DriveStatus, SampleBlock
from drive_id.core.experiment.permission import LIMIT, permitted
from drive_id.core.experiment.settings import ExperimentSettings, make_trajectory, total_duration
from drive_id.core.experiment.state_machine import Experiment, ExperimentState, ReferenceBlock
from drive_id.core.experiment.watchdog import Fault, Watchdog
from drive_id.errors import DriveIdError
from drive_id.types import NANOSECONDS, FloatArray

_SESSIONS = itertools.count((secrets.randbits(47) << 16) + 1)
"""Sessions of this process: its runs are counted in the lowest 16 bits, the others tell whose they are."""
CURRENT_LIMIT, SPEED_LIMIT = "current limit of the drive [A]", "speed limit of the drive [rad/s]"
"""Values of the health: what the drive says of itself, infinite if it does not."""
REFUSED_FOR = "refused for"
"""Value of the health: ``limit`` where the drive is in order, and a run within its limits would start."""
_CLEAR = "When the cause is gone, clear it by characterize --clear-fault, or by the service ~/clear_fault."


@dataclass(frozen=True)
class Answer:
    """Answer to a request."""

    code: str  # a constant of the services ``StartExperiment`` and ``Command``
    message: str  # a sentence

    @property
    def success(self) -> bool:
        """Whether the request was fulfilled."""
        return self.code == "ok"


@dataclass(frozen=True)
class Report:
    """State of a supervised experiment; what only a free shaft has is NaN for other trajectories."""

    state: ExperimentState
    reason: str  # why it tripped, was stopped, or would not start; empty otherwise
    session: int
    elapsed: float  # s
    duration: float  # s
    i_dq: FloatArray  # (2,), reference that is due now, A
    coverage: float  # 0 to 1
    dry_run: bool  # nothing is published
    mean_speed: float = math.nan  # of a free shaft, electrical, rad/s
    mean_speed_reference: float = math.nan
    bias: float = math.nan  # mean of i_q relative to its amplitude
    completed: bool = False  # the last run reached its end: nothing stopped or tripped it


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

    The names of topics are for messages, see :class:`~.watchdog.Watchdog`.
    """

    def __init__(self, settings: ExperimentSettings, names: Mapping[str, str] | None = None) -> None:
        rehearse(settings)
        self._experiment = Experiment(settings)
        self._watchdog = Watchdog(settings, names)
        self._settings, self._changed = settings, False
        self._duration = total_duration(settings, make_trajectory(settings))
        self._heartbeat = -math.inf
        self._leased = self._rest = False
        self._dry_run = settings.dry_run
        self._unpublished = 0

    @property
    def trip_reason(self) -> str:
        """Why the last experiment tripped; empty if it did not."""
        return self._experiment.trip_reason

    @property
    def session(self) -> int:
        """Session of the last experiment, 0 before the first one."""
        return self._experiment.session

    def plan(self) -> str:
        """Describe the experiment that a start runs, or that has been started."""
        settings, seconds = self._experiment.settings, self._duration
        how_long = "until it is stopped" if math.isinf(seconds) else f"for {seconds:.4g} s"
        dry = ", published to nobody (dry_run)" if self._dry_run else ""
        return f"{settings.trajectory} within {settings.i_max:g} A {how_long}{dry}"

    def start(
        self,
        now: int,
        steady: float,
        publishers: int = 1,
        *,
        dry_run: bool = False,
        require_lease: bool = False,
        run: Mapping[str, Any] = MappingProxyType({}),
    ) -> Answer:
        """Start, or return why not.

        ``publishers`` counts those of references, this one included; the options cannot loosen the settings. ``run``
        holds settings of this run alone, instead of those of the same names.
        """
        self._watchdog.publishers = publishers
        leased = steady - self._heartbeat <= self._settings.lease_time
        refused = self._refused(now, steady)
        if refused is None and (require_lease or self._settings.require_lease) and not leased:
            refused = "no_heartbeat", "Not started: require_lease is set, and nobody sends heartbeats on ~/heartbeat."
        refused = refused or self._configured(run)
        if refused is not None:
            return Answer(*refused)
        self._leased, self._dry_run = leased, dry_run or self._settings.dry_run
        self._experiment.start(now, next(_SESSIONS))
        return Answer("ok", f"Started: {self.plan()}.")

    def _configured(self, run: Mapping[str, Any]) -> tuple[str, str] | None:
        """Configure a run; return code and sentence of why it is not possible, if so, and stay as before."""
        watchdog = self._watchdog
        try:
            settings = permitted(self._settings, run, watchdog.own_current_limit, watchdog.own_speed_limit)
        except DriveIdError as error:
            return error.code, f"Not started: {error}"
        if settings != self._experiment.settings:
            self._take(settings)
        return None

    def _refused(self, now: int, steady: float) -> tuple[str, str] | None:
        """Return code and sentence of what forbids any start."""
        if self._experiment.active:
            state = self._experiment.state(now).value
            return "busy", f"An experiment is under way ({state}): stop it, or wait for its end."
        if now <= 0:
            return "no_clock", "The time is 0: use_sim_time is set, but nobody publishes /clock."
        if self.trip_reason:
            return "tripped", f"Not started: it tripped before. {self.trip_reason} {_CLEAR}"
        if (fault := self._watchdog.fault(now, steady)) is not None:
            return "fault", f"Not started: {fault.reason}"
        return None

    def stop(self, now: int) -> Answer:
        """Ramp down to zero; when nothing is running, bring a drive to zero that somebody else drives."""
        self._rest = not self._experiment.active
        self._experiment.stop(now, "Stopped on request.")
        if self._watchdog.flows():
            flows = f"{self._doing()} But the drive does not go to zero current: use the emergency stop."
            return Answer("current_flows", flows)
        return Answer("ok", self._doing())

    def clear_fault(self, now: int, steady: float) -> Answer:
        """Permit a start again after a trip or an emergency stop whose cause is gone."""
        if self._experiment.active:
            return Answer("busy", f"Not cleared: {self._doing()}")
        self._watchdog.release()
        fault = self._watchdog.fault(now, steady)
        if fault is not None:
            return Answer("fault", f"Not cleared: {fault.reason}")
        was, self._experiment.trip_reason = self.trip_reason, ""
        return Answer("ok", f"Cleared: {was}" if was else "There was no fault.")

    def _doing(self) -> str:
        """Return a sentence on what stop and clear_fault find."""
        ends = "Stopping: the current ramps down to zero." if self._experiment.active else "Nothing is running."
        return f"{ends} It tripped: {self.trip_reason} {_CLEAR}" if self.trip_reason else ends

    def change(self, now: int, settings: ExperimentSettings) -> None:
        """Change the settings; a running experiment is stopped first."""
        self._settings, self._changed = settings, True
        self._experiment.stop(now, "Stopped, because parameters were changed.")
        self._take_settings()

    def currents(self, now: int, steady: float, block: SampleBlock) -> bool:
        """Check a block of phase currents (three (N,) arrays, A); return whether it trips the experiment."""
        return self._judge(now, self._watchdog.currents(now, steady, block))

    def resolver(self, now: int, steady: float, block: SampleBlock) -> bool:
        """Check a block of angle, rad, and speed, rad/s, (N,) each; return whether it trips the experiment."""
        fault = self._watchdog.resolver(now, steady, block)
        feedback = self._experiment.feedback
        if feedback is not None and fault is None and len(block):
            active = self._experiment.state(now) is ExperimentState.RUNNING
            feedback.add(block.first_sample, block.sample_period, block.values[0], active=active)
            if feedback.stands_still(self._settings.watch_timeout):
                fault = Fault(
                    f"The angle has not changed for {self._settings.watch_timeout:g} s, though the torque reverses: "
                    "the shaft is locked, or the drive repeats old samples.",
                    True,
                )
        return self._judge(now, fault)

    def status(self, now: int, steady: float, status: DriveStatus) -> bool:
        """Check what the drive says of itself; return whether it trips the experiment."""
        return self._judge(now, self._watchdog.status(now, steady, status))

    def emergency_stop(self, now: int, steady: float, pressed: bool, button: str = "emergency_stop") -> bool:
        """Note a message of one of the ``emergency_stops``; return whether it trips the experiment."""
        return self._judge(now, self._watchdog.emergency_stop(steady, pressed, button))

    def count_buttons(self, publishers: Mapping[str, int]) -> None:
        """Note how many nodes publish each of the ``emergency_stops``."""
        self._watchdog.count_buttons(publishers)

    def count_drives(self, nodes: Sequence[str]) -> None:
        """Note which nodes publish the phase currents."""
        self._watchdog.drives = tuple(nodes)

    def heartbeat(self, steady: float) -> None:
        """Note a sign of life of the client that starts experiments, or has just started one."""
        self._heartbeat = steady
        self._leased |= self._experiment.active

    def advance(self, now: int, steady: float, publishers: int = 1) -> list[ReferenceBlock]:
        """Return the blocks to publish now; ``publishers`` as in :meth:`start`."""
        self._watchdog.publishers = publishers
        fault = self._watchdog.fault(now, steady)  # also while nothing runs: it measures how long something has lasted
        silence = steady - self._heartbeat
        if self._leased and silence > self._settings.lease_time:
            fault = fault or Fault(
                f"The client that started has sent no heartbeat for {silence:.2f} s, longer than lease_time, "
                f"{self._settings.lease_time:g} s."
            )
        self._judge(now, fault)
        blocks = self._told(self._experiment.advance(now), now)
        if not self._experiment.active:
            self._dry_run = self._settings.dry_run
            # After a trip, nobody else drives before it is cleared.
            rival = bool(self.trip_reason) and (publishers > 1 or self._watchdog.flows())
            if self._rest or rival:
                blocks += self._told([self._experiment.rest(now)], now)
        self._rest = False
        self._take_settings()
        return blocks

    def withhold(self, now: int, block: ReferenceBlock) -> bool:
        """Return whether a block must not be published: the process was held up since it was made, which trips."""
        return self._experiment.withhold(now, block)

    def finish(self, now: int, reason: str = "Stopped, because the node ends.") -> list[ReferenceBlock]:
        """Stop, and return all blocks down to the last zero: before nothing more can be published."""
        return self._told(self._experiment.finish(now, reason), now)

    def _told(self, blocks: list[ReferenceBlock], now: int) -> list[ReferenceBlock]:
        """Return the blocks that are published, and have the watchdog expect the drive to follow them."""
        if self._dry_run:
            self._unpublished += sum(len(block.i_dq) for block in blocks)
            return []
        self._watchdog.published.add(blocks, now)
        return [replace(block, first_sample=block.first_sample - self._unpublished) for block in blocks]

    def report(self, now: int, steady: float) -> Report:
        """Return the present state."""
        experiment = self._experiment
        reason = experiment.trip_reason or experiment.stop_reason
        if not experiment.active and not reason:
            fault = self._watchdog.fault(now, steady) or self._watchdog.start_fault()
            reason = "" if fault is None else f"A start would be refused: {fault.reason}"
        i_dq, state = experiment.current(now), experiment.state(now)
        elapsed = experiment.elapsed(now)
        feedback = experiment.feedback
        shaft = (math.nan,) * 3 if feedback is None else (feedback.mean.value, feedback.reference, feedback.bias)
        completed = state is ExperimentState.IDLE and experiment.session > 0 and not experiment.stop_reason
        return Report(
            state, reason, experiment.session, elapsed, self._duration, i_dq, experiment.coverage, self._dry_run,
            *shaft, completed,
        )  # fmt: skip

    def health(self, now: int, steady: float) -> Health:
        """Return state, time, set-point and coverage."""
        settings, report = self._experiment.settings, self.report(now, steady)
        values = {
            "state": report.state.value,
            "trajectory": settings.trajectory,
            "elapsed [s]": f"{report.elapsed:.3f}",
            "duration [s]": f"{report.duration:.3f}",
            "i_max [A]": f"{settings.i_max:g}",
            "i_d [A]": f"{report.i_dq[0]:.4g}",
            "i_q [A]": f"{report.i_dq[1]:.4g}",
            "coverage": f"{report.coverage:.3f}" if settings.covers_disc else "",
            "clock offset [s]": f"{self._watchdog.clock_offset:.3f}",
            CURRENT_LIMIT: f"{self._watchdog.own_current_limit:.9g}",
            SPEED_LIMIT: f"{self._watchdog.own_speed_limit:.9g}",
        }
        if not math.isnan(report.bias):
            values["mean speed [rad/s]"] = f"{report.mean_speed:.4g} of {report.mean_speed_reference:.4g}"
            values["bias of i_q"] = f"{report.bias:.3f}"
        values |= {f"lost samples of {name}": str(lost) for name, lost in self._watchdog.lost.items()}
        if report.state is ExperimentState.TRIPPED:
            flows = " The drive does not go to zero current: use the emergency stop." if self._watchdog.flows() else ""
            return Health(Level.ERROR, f"{report.reason}{flows} {_CLEAR}", values)
        if self._experiment.active:
            return Health(Level.OK, f"{report.state.value}: {self._progress(report)}.", values)
        fault, of_limit = self._watchdog.fault(now, steady), self._watchdog.start_fault()
        if fault is None and of_limit is not None and self._watchdog.knows_drive:
            values[REFUSED_FOR] = LIMIT
        if (fault := fault or of_limit) is not None:
            return Health(Level.WARN, f"A start would be refused: {fault.reason}", values)
        return Health(Level.OK, self._experiment.stop_reason or "Waiting for a start.", values)

    def _progress(self, report: Report) -> str:
        """Return how far a running experiment is."""
        if not self._experiment.settings.covers_disc:
            return f"{report.elapsed:.1f} of {report.duration:.1f} s"
        return f"{100 * report.coverage:.0f} % of the disc visited"

    def _judge(self, now: int, fault: Fault | None) -> bool:
        if fault is None or not self._experiment.active:
            return False
        self._experiment.trip(now, fault.reason, immediate=fault.immediate)
        return True

    def _take_settings(self) -> None:
        if not self._experiment.active and self._changed:
            self._take(self._settings)

    def _take(self, settings: ExperimentSettings) -> None:
        self._changed = False
        self._experiment.configure(settings)
        self._watchdog.settings = settings
        self._duration = total_duration(settings, make_trajectory(settings))
