"""Requests for fits, without ROS: one is under way, one may wait, and each can be cancelled or takes too long."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drive_id.common.health import Level, Observation
from drive_id.common.quantity import counted
from drive_id.errors import DriveIdError
from drive_id.live.identification.identifier import BUSY, Job, Reply, failed
from drive_id.live.worker import Worker, step_of

PATIENCE = 1.0
"""s that a cancelled fit has for ending by itself; then the node is free, whatever the fit is waiting for."""
MOST_ABANDONED = 4
"""Cancelled fits that may still be running; with more, requests are refused."""
_PERIOD = 1.0  # s between feedbacks that say nothing new
_STAGES: Final = {
    "Reading": (0.0, 0.05), "Accumulating": (0.05, 0.6), "Solving": (0.6, 0.95), "Writing": (0.95, 1.0),
    "Turning": (0.0, 0.8), "Shaking": (0.8, 1.0),  # a first start
    **dict.fromkeys(("waiting", "trajectory", "stopping"), (0.0, 0.65)), "identifying": (0.65, 1.0),  # an experiment
}  # fmt: skip
_USUAL_STEPS = 60.0  # of a solution by method full


@dataclass(frozen=True)
class Stage:
    """How far a request is: a word, the estimated share of the whole that is done, 0 to 1, and both in a sentence."""

    name: str
    share: float
    sentence: str


@dataclass(eq=False)
class Request:
    """A request for a fit."""

    make: Callable[[], Job]  # returns the job when its turn comes; may raise DriveIdError
    finish: Callable[[Reply], None]  # called once, with the reply
    tell: Callable[[Stage], None] | None = None  # called with the stage, some ten times a second while it changes


class _Running:
    """A request under way, and why it is to end, if so."""

    def __init__(self, request: Request, worker: Worker[Reply], now: float, patience: float) -> None:
        self.request = request
        self.patience = patience
        self.worker = worker
        self.begun = now
        self.ending: Reply | None = None
        self.patient_until = 0.0
        self.stage = Stage("Reading", 0.0, "Reading.")
        self.told = 0.0  # when a stage was told last; 0: none has begun

    def end(self, reply: Reply, now: float) -> None:
        """Have the job end, and reply so when it has, or when patience is over."""
        if self.ending is None:
            self.ending, self.patient_until = reply, now + self.patience
            self.worker.cancel()

    def ended(self) -> Reply | None:
        """Return the reply of a job that was told to end, once it has: its own, if it has one."""
        return None if self.worker.busy else self.worker.left or self.ending

    def look(self, what: str, share: float | None) -> Stage:
        """Return how far the request is by a progress of its worker; the share never decreases."""
        name = step_of(what)
        low, high = _STAGES.get(name, (0.0, 0.0))
        if share is None and name == "Solving":
            steps = self.worker.steps
            share = steps / (steps + _USUAL_STEPS)
        done = max(self.stage.share, low + (high - low) * (share or 0.0))
        self.stage = Stage(name or self.stage.name, done, f"{name or self.stage.name}, {100 * done:.0f} % done.")
        return self.stage


class Requests:
    """Runs requests one after another. Not for several threads: workers hand their replies over by ``call``.

    Parameters
    ----------
    time_limit : float
        Longest time for one request, s; 0: unlimited.
    call : callable
        Has the thread of this object make a call.
    patience : float, optional
        For a cancelled job to end by itself, s.
    pace : float, optional
        Time between reports of how far a request is, s, besides one of each stage that begins; default: whenever that
        has changed.
    """

    def __init__(
        self,
        time_limit: float,
        call: Callable[[Callable[[], None]], None],
        *,
        patience: float | None = None,
        pace: float | None = None,
    ) -> None:
        self._limit = time_limit
        self._call = call
        self._patience, self._pace = PATIENCE if patience is None else patience, pace
        self._running: _Running | None = None
        self._waiting: Request | None = None
        self._waiting_told = 0.0
        self._abandoned: list[Worker[Reply]] = []

    @property
    def busy(self) -> bool:
        """Whether a request is under way or waiting."""
        return self._running is not None or self._waiting is not None

    @property
    def doing(self) -> str:
        """A sentence on the step under way."""
        if self._running is None:
            return "Waiting for requests."
        what, share = self._running.worker.progress
        return f"{what or self._running.stage.name}." if share is None else f"{what}, {100 * share:.0f} %."

    def submit(self, request: Request, *, may_wait: bool) -> None:
        """Begin a request, or refuse it as busy; ``may_wait``: let it wait for the one under way if no other does."""
        self._forget_ended()
        if not self.busy and len(self._abandoned) < MOST_ABANDONED:
            self._begin(request)
        elif may_wait and self._waiting is None and self._running is not None:
            self._waiting = request
        else:
            request.finish(BUSY)

    def cancel(self, request: Request, reply: Reply) -> None:
        """End a request with a reply, if it is not over."""
        if request is self._waiting:
            self._waiting = None
            request.finish(reply)
        elif self._running is not None and request is self._running.request:
            self._running.end(reply, time.monotonic())

    def look(self) -> None:
        """End what was cancelled or takes too long, and tell how far the request is; call it ten times a second."""
        self._forget_ended()
        running, now = self._running, time.monotonic()
        if running is None:
            return
        if self._limit and now - running.begun > self._limit:
            said = f"The fit took longer than time_limit, {self._limit:g} s: give fewer recordings, or raise the limit."
            running.end(Reply("time_limit", said), now)
        if running.ending is not None:
            reply = running.ended() or (running.ending if now > running.patient_until else None)
            if reply is not None:
                self._end(running, reply)
            return
        self._feed_back(running, now)

    def findings(self) -> list[Observation]:
        """Return how many cancelled fits are still running."""
        self._forget_ended()
        count = len(self._abandoned)
        sentence = f"A disk or compiled code still holds {counted(count, 'cancelled request')}."
        return [(Level.WARN, sentence)] if count else []

    def end_all(self, reply: Reply) -> None:
        """End all requests with a reply."""
        if self._waiting is not None:
            self.cancel(self._waiting, reply)
        if self._running is not None:
            self.cancel(self._running.request, reply)

    def stop(self, patience: float) -> None:
        """End the request under way within ``patience``, s, without a reply."""
        if self._running is not None:
            self._running.worker.stop(patience)

    def _begin(self, request: Request) -> None:
        try:
            job = request.make()
        except DriveIdError as error:
            request.finish(failed(error))
            return
        running = self._running = _Running(request, Worker(), time.monotonic(), self._patience)
        running.worker.start(job, lambda reply: self._call(lambda: self._end(running, reply)))

    def _end(self, running: _Running, reply: Reply) -> None:
        if running is not self._running:
            return  # given up before
        self._tell_begun(running)
        if running.ending is not None and running.worker.busy and reply is running.ending:
            self._abandoned.append(running.worker)
        self._running = None
        running.request.finish(reply)
        if self._waiting is not None:
            request, self._waiting = self._waiting, None
            self._begin(request)

    def _feed_back(self, running: _Running, now: float) -> None:
        self._tell_begun(running)
        before, (what, share) = running.stage, running.worker.progress
        if running.told and step_of(what) == before.name:  # else another has just begun
            stage = running.look(what, share)
            news, since = self._pace is None and stage != before, now - running.told
            if news or since >= (self._pace or _PERIOD):
                self._tell(running, stage)
        waiting = self._waiting
        if waiting is not None and waiting.tell is not None and now - self._waiting_told > _PERIOD:
            self._waiting_told = now
            waiting.tell(Stage("Waiting", 0.0, "Waiting for the request under way."))

    def _tell_begun(self, running: _Running) -> None:
        """Tell each stage that has begun, also those that are over."""
        begun = running.worker.begun
        while begun:
            self._tell(running, running.look(*begun.popleft()))

    def _tell(self, running: _Running, stage: Stage) -> None:
        running.told = time.monotonic()
        if running.request.tell is not None:
            running.request.tell(stage)

    def _forget_ended(self) -> None:
        self._abandoned = [worker for worker in self._abandoned if worker.busy]
