"""Conducts the nodes of one drive through an experiment: trajectory, recording, identification."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from drive_id_msgs import srv
from drive_id_msgs.action import Identify
from drive_id_msgs.msg import PublisherState, Resolver
from drive_id_msgs.srv import Command, StartExperiment, StartRecording, StopRecording
from rcl_interfaces.srv import GetParameters
from std_msgs.msg import Empty

from drive_id.core.experiment.permission import permitted
from drive_id.core.experiment.settings import ExperimentSettings
from drive_id.core.experiment.supervision import CURRENT_LIMIT, SPEED_LIMIT
from drive_id.errors import DriveIdError, ExperimentError
from drive_id.nodes.support.parameters import settings_of
from drive_id.nodes.support.qos import LATCHED, STREAM_BEST_EFFORT
from drive_id.nodes.support.signal_messages import KINDS
from drive_id.ros.calls import IDENTIFICATION, NODES, PUBLISHER, RECORDER, Calls, Progress

SERVICES = {
    f"{RECORDER}/start": StartRecording,
    f"{RECORDER}/stop": StopRecording,
    f"{PUBLISHER}/start_experiment": StartExperiment,
    f"{PUBLISHER}/stop_experiment": Command,
    f"{IDENTIFICATION}/reset": Command,
    f"{IDENTIFICATION}/check": srv.Identify,
    **{f"{node}/get_parameters": GetParameters for node in NODES},
}
WAITING, TRAJECTORY, STOPPING, IDENTIFYING = ("waiting", "trajectory", "stopping", "identifying")
STOP_TIME = 15.0
"""Longest time to bring the drive to rest and complete the bag when a goal ends early, s."""
_STOPPING = 4.0
"""Longest wait for each answer then, s; and for the ramp to zero."""
_SILENCE = 5.0
"""Longest time without the state of a trajectory that is said to run, s: it comes ten times a second."""
_SPEED_BAND, _LEAST_BAND, _SPEED_TIME = 0.02, 2.0, 0.5
"""A speed is reached when it has been within this share, or so many rad/s, for so long, s."""
_LEAST_SHARE = 0.9
"""Share of the trajectory that a recording must hold: it begins before the trajectory, and ends behind it."""


@dataclass(frozen=True)
class Goal:
    """What an experiment is to be; values that are 0 or empty are as the nodes are configured."""

    name: str = ""  # of the recordings
    run: dict[str, Any] = field(default_factory=dict)  # fields of ``StartExperiment``
    speeds: Sequence[float] = ()  # electrical, rad/s, one for each recording; empty: one recording at any speed
    identify: dict[str, Any] | None = None  # fields of ``Identify`` besides ``bags``; None: record only

    @property
    def recordings(self) -> list[str]:
        """Their names; empty where they are named after the time."""
        count = max(len(self.speeds), 1)
        return [f"{self.name}_{number + 1}" if self.name and count > 1 else self.name for number in range(count)]


@dataclass(frozen=True)
class Recording:
    """A finished recording, or several of one experiment.

    Parameters
    ----------
    uris : tuple of str
        Paths of the bags on the recorder's machine.
    samples, dropped : int
        Samples of the phase currents in them, and samples lost.
    duration : float
        s.
    message : str
        The recorder's sentence.
    session : int
        Of the references of the last trajectory.
    """

    uris: tuple[str, ...] = ()
    samples: int = 0
    dropped: int = 0
    duration: float = 0.0
    message: str = ""
    session: int = 0

    @property
    def uri(self) -> str:
        """Path of the last bag."""
        return self.uris[-1]


class Conductor(Calls):
    """Runs experiments by calling trajectory_publisher, recorder and identification.

    While it waits for something, it sends heartbeats to the trajectory publisher, which ramps to zero current without
    them, and to the recorder while that records, which ends the recording: nothing keeps running when this process dies
    or hangs.

    Parameters
    ----------
    fit_time, speed_time : float
        Longest time for a fit, and for the shaft to reach a speed, s.
    namespace, drive, timeout, tell
        As of :class:`~drive_id.ros.bench.Bench`.
    """

    def __init__(
        self,
        namespace: str = "",
        *,
        drive: str = "",
        timeout: float = 60.0,
        fit_time: float = 600.0,
        speed_time: float = 300.0,
        tell: Callable[[Progress], None] | None = None,
    ) -> None:
        super().__init__(
            "conductor", SERVICES, NODES, namespace=namespace, drive=drive, timeout=timeout, tell=tell, arguments=()
        )
        self._fit_time, self._speed_time = fit_time, speed_time
        self.recorded = Recording()
        """What has been recorded for the goal under way."""
        self._records = self._drives = False  # a recording or trajectory may be under way that was started here
        self._recording = False  # one that was started here is under way
        self._state: PublisherState | None = None
        self._heard, self._speed = 0.0, math.nan
        self._phase, self._share = WAITING, 0.0  # of all recordings, then of the identification
        self._part = 1.0  # of one recording
        self._identify = self._action(Identify, f"{IDENTIFICATION}/identify")
        self._node.create_subscription(PublisherState, f"{PUBLISHER}/state", self._on_state, LATCHED)
        self._heartbeats = {
            PUBLISHER: self._heartbeats_to(PUBLISHER),
            RECORDER: self._heartbeats_to(RECORDER, lambda: self._recording),
        }

    def missing(self) -> list[str]:
        """Return the nodes that have not been heard of, or lack what is needed."""
        unheard = {node for node, beats in self._heartbeats.items() if not beats.get_subscription_count()}
        unheard |= set() if self._state is not None else {PUBLISHER}
        unready = set() if self._identify.server_is_ready() else {IDENTIFICATION}
        return sorted({*super().missing(), *unheard, *unready})

    def run(self, goal: Goal) -> Any:
        """Run an experiment; return the result of ``Identify``, None where it is only recorded.

        Raises
        ------
        ExperimentError
            With the code of what went wrong; :attr:`recorded` tells what there is nevertheless.
        """
        names = goal.recordings
        count = len(names)
        self.recorded, self._phase, self._share, self._part = Recording(), WAITING, 0.0, 1 / count
        self._wait_for_nodes(self.timeout)
        settings = self._check(goal)
        self._permit(settings, goal, math.inf, 0.0)
        self._wait_for_drive(self.timeout)
        self._permit(settings, goal, *(self._value(PUBLISHER, name) for name in (CURRENT_LIMIT, SPEED_LIMIT)))
        for number, speed in enumerate(goal.speeds or (None,)):
            self._phase, self._share = WAITING, number / count
            if speed is not None:
                self._wait_for_speed(speed)
            self._record(names[number], goal.run, first=number == 0)
        return None if goal.identify is None else self._identified(goal.identify)

    def run_experiment(self, name: str = "", **run: Any) -> Recording:
        """Record one trajectory.

        Raises
        ------
        ExperimentError
            When a node refuses, does not answer, or the trajectory is stopped before its end.
        """
        self.run(Goal(name, run))
        return self.recorded

    def stop(self) -> list[str]:
        """Bring the drive to zero current and close a recording that was begun here; return what the nodes said."""
        self._tell = None  # what shows progress may be what failed, or have been cancelled
        self.timeout = min(self.timeout, _STOPPING)
        said = []
        if self._drives:
            self._drives = False
            said += self._attempt(f"{PUBLISHER}/stop_experiment", self._stop_trajectory)
            said += self._attempt(PUBLISHER, self._rest)
        if self._records:
            said += self._attempt(f"{RECORDER}/stop", lambda: str(self._stop_recording().message))
        return said

    def _attempt(self, name: str, work: Callable[[], str]) -> list[str]:
        try:
            said = work()
        except ExperimentError as error:
            return [str(error)]
        return [f"{name}: {said}"] if said else []

    def _stop_trajectory(self) -> str:
        return str(self._called(f"{PUBLISHER}/stop_experiment").message)

    def _rest(self) -> str:
        """Wait for the ramp to zero, which shall be in the bag as well."""

        def rests() -> bool:
            return self._state is None or self._state.state in {PublisherState.IDLE, PublisherState.TRIPPED}

        self._wait(rests, lambda: f"{PUBLISHER} does not say that the current is at zero", lambda: "")
        return ""

    def _stop_recording(self) -> Any:
        """Complete the bag, and add it to what has been recorded."""
        self._records = self._recording = False
        stopped, before = self._called(f"{RECORDER}/stop"), self.recorded
        self.recorded = Recording(
            (*before.uris, *filter(None, [stopped.uri])),
            before.samples + stopped.samples,
            before.dropped + stopped.dropped,
            before.duration + stopped.duration,
            " ".join(filter(None, (before.message, stopped.message))),
            before.session,
        )
        return stopped

    def _record(self, name: str, run: dict[str, Any], *, first: bool) -> None:
        """Record one trajectory; the live samples of the identification node are those of the first one on."""
        self._heartbeats[PUBLISHER].publish(Empty())  # long before the start, which may require it
        self._records = True  # before there is an answer, which may come too late
        started = self._called(f"{RECORDER}/start", name=name)
        # Else the recorder may be busy for another client, who shall not be stopped.
        self._records = self._recording = started.success
        self._succeeded(f"{RECORDER}/start", started)
        self._heartbeats[RECORDER].publish(Empty())
        if first:
            self._required(f"{IDENTIFICATION}/reset")
        duration = self._run_trajectory(run)
        self._phase, self._share = STOPPING, self._share + self._part
        stopped = self._stop_recording()
        self._succeeded(f"{RECORDER}/stop", stopped)
        if stopped.uri != started.uri or stopped.duration < _LEAST_SHARE * duration:
            raise ExperimentError(
                f"{stopped.uri} holds {stopped.duration:.3f} s of a trajectory of {duration:.3f} s: look at the log of "
                f"{RECORDER}, and repeat the experiment.",
                "incomplete",
            )

    def _run_trajectory(self, run: dict[str, Any]) -> float:
        """Run a trajectory to its end, and return its duration, s."""
        self._phase = TRAJECTORY
        self._drives = True  # before there is an answer, which may come too late
        started = self._called(f"{PUBLISHER}/start_experiment", require_lease=True, **run)
        self._drives = started.success
        self._succeeded(f"{PUBLISHER}/start_experiment", started)
        self.recorded = replace(self.recorded, session=started.session)
        begun = time.monotonic()

        def mine() -> PublisherState | None:
            state = self._state
            return state if state is not None and state.session == started.session else None

        def ended() -> bool:
            state, silence = mine(), time.monotonic() - max(self._heard, begun)
            if silence > _SILENCE:
                raise ExperimentError(f"Nothing has been heard of {PUBLISHER} for {silence:.0f} s.", "no_answer")
            if state is None:
                raise ExperimentError(f"{PUBLISHER} was started again during the trajectory.", "no_answer")
            if state.state == state.TRIPPED:
                raise ExperimentError(f"The trajectory was stopped: {state.reason}", "tripped")
            if state.state == state.IDLE and not state.completed:
                raise ExperimentError(f"The trajectory did not reach its end: {state.reason}", "stopped")
            return bool(state.state == state.IDLE)

        def doing() -> str:
            state = mine()
            return "" if state is None else f"{state.state}: {state.elapsed:.1f} of {state.duration:g} s"

        self._wait(lambda: mine() is not None, lambda: f"{PUBLISHER} does not tell its state", lambda: "", _SILENCE)
        duration = float(self._state.duration) if self._state is not None else math.inf
        limit = self.timeout + duration
        self._wait(ended, lambda: "the trajectory does not end", doing, limit, "time_limit")
        self._drives = False
        return duration

    def _wait_for_speed(self, speed: float) -> None:
        """Wait until the shaft turns at a speed, rad/s."""
        subscription = self._node.create_subscription(Resolver, "resolver", self._on_resolver, STREAM_BEST_EFFORT)
        band = max(_SPEED_BAND * abs(speed), _LEAST_BAND)
        since = [math.inf]

        def reached() -> bool:
            within, now = abs(self._speed - speed) <= band, time.monotonic()
            since[0] = min(since[0], now) if within else math.inf
            return now >= since[0] + _SPEED_TIME

        def waiting() -> str:
            return f"waiting for {speed:.1f} rad/s (electrical): the shaft turns at {self._speed:.1f} rad/s"

        try:
            self._wait(reached, lambda: f"still {waiting()}", waiting, self._speed_time, "no_speed")
        finally:
            self._node.destroy_subscription(subscription)

    def _identified(self, fields: dict[str, Any]) -> Any:
        """Identify the drive from what was recorded."""
        self._phase, self._share, said = IDENTIFYING, 0.0, ["The fit begins."]

        def heard(feedback: Any) -> None:
            self._share, said[0] = feedback.progress, feedback.message

        goal = Identify.Goal(bags=list(self.recorded.uris), session=self.recorded.session, **fields)
        complaint = f"{IDENTIFICATION} has no result"
        result = self._goal(self._identify, goal, heard, lambda: complaint, lambda: said[0], self._fit_time)
        if not result.success:
            raise ExperimentError(f"{IDENTIFICATION}/identify: {result.message}", result.code)
        return result

    def _permit(self, settings: ExperimentSettings, goal: Goal, current_limit: float, speed_limit: float) -> None:
        """Refuse a goal that the publisher would refuse, before anything is recorded or forgotten for it."""
        try:
            permitted(settings, goal.run, current_limit, speed_limit)
        except DriveIdError as error:
            raise ExperimentError(f"{PUBLISHER}: {error}", error.code) from error

    def _check(self, goal: Goal) -> ExperimentSettings:
        """Return the publisher's settings.

        Refuse a goal that does not fit the nodes, nodes that do not fit each other, and several drives.
        """
        if self._state is not None and self._state.state == PublisherState.TRIPPED:
            raise ExperimentError(f"{PUBLISHER} has tripped: {self._state.reason}", "tripped")
        for topic in KINDS:
            count = self._node.count_publishers(topic)
            if count > 1:
                raise ExperimentError(
                    f"{count} nodes publish {self._node.resolve_topic_name(topic)}: leave one drive in each namespace."
                )
        settings = settings_of(ExperimentSettings, partial(self._values, PUBLISHER), PUBLISHER)
        if not goal.run.get("repeat") and settings.repeat == 0:
            endless = f"repeat of {PUBLISHER} is 0: give the goal a number of repetitions."
            raise ExperimentError(endless, "configuration")
        if not goal.run.get("i_max"):
            mapped = self._parameter(IDENTIFICATION, "i_max")
            if mapped and mapped < settings.i_max:
                raise ExperimentError(
                    f"{PUBLISHER} drives up to {settings.i_max:g} A and {IDENTIFICATION} maps up to {mapped:g} A: give "
                    "both the same i_max."
                )
        if goal.identify is not None:
            self._required(f"{IDENTIFICATION}/check", bags=goal.recordings, **goal.identify)
        clocks = {node: bool(self._parameter(node, "use_sim_time")) for node in NODES}
        if len(set(clocks.values())) > 1:
            simulated = " and ".join(node for node, own in clocks.items() if own)
            raise ExperimentError(f"Only {simulated} follows /clock: give all nodes the same use_sim_time.")
        return settings

    def _progress(self, sentence: str, waited: float) -> Progress:
        state, share = self._state, self._share
        elapsed, duration = (0.0, 0.0) if state is None else (state.elapsed, state.duration)
        if self._phase == TRAJECTORY and 0 < duration < math.inf:
            share += self._part * elapsed / duration
        of_disc = self._figures.get(PUBLISHER, {}).get("coverage") != ""
        return Progress(
            sentence,
            waited,
            elapsed,
            duration,
            self._value(IDENTIFICATION, "coverage") if of_disc else math.nan,
            self._phase,
            share,
            self._value(IDENTIFICATION, "fit: resistance [ohm]"),
            self._value(IDENTIFICATION, "fit: sigma of resistance [ohm]"),
        )

    def _on_state(self, message: PublisherState) -> None:
        self._state, self._heard = message, time.monotonic()

    def _on_resolver(self, message: Resolver) -> None:
        if len(message.speed):
            self._speed = float(message.speed[-1])
