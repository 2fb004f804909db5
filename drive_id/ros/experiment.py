"""The node ``experiment``: a whole experiment as one action."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from functools import partial
from typing import Any

from drive_id_msgs.action import Experiment
from rclpy.node import Node
from std_msgs.msg import Empty

from drive_id.common.health import Health
from drive_id.common.settings import Checked, setting
from drive_id.errors import DriveIdError, ExperimentError
from drive_id.live.data_directory import check_name
from drive_id.live.identification.identifier import Job, Reply, check_fields, failed
from drive_id.live.identification.requests import Requests, Stage
from drive_id.live.worker import Cancelled
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.deferred_service import PacedServices, in_executor
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.experiment_messages import run_of
from drive_id.nodes.support.parameters import declare_settings
from drive_id.nodes.support.qos import STREAM_BEST_EFFORT
from drive_id.nodes.support.replies import NAMES
from drive_id.nodes.support.request_server import RequestServer
from drive_id.nodes.support.runtime import run
from drive_id.ros.calls import Progress as Step
from drive_id.ros.conductor import STOP_TIME, Conductor, Goal, Recording
from drive_id.types import Progress

_REQUEST_PERIOD = 0.1  # s between looks at the goal under way
_FEEDBACK_PERIOD = 0.5  # s
_OF_ALL_FITS = ("method", "i_max", "temperatures", "u_dc")
_OF_FIT = (*_OF_ALL_FITS, "signals", *NAMES.values())
"""Fields of a goal that the fit gets as they are."""


@dataclass(frozen=True)
class ConductingSettings(Checked):
    """Patience with the other nodes, which together is the longest time that a goal takes."""

    timeout: float = setting(
        60.0, "For the nodes and the drive to be ready, for each answer of a node, and for a trajectory beyond its "
        "duration", unit="s", minimum=1.0, maximum=3600.0,
    )  # fmt: skip
    fit_time: float = setting(600.0, "For the identification", unit="s", minimum=1.0, maximum=1e5)
    speed_time: float = setting(
        300.0, "For the shaft to reach each speed of a goal", unit="s", minimum=1.0, maximum=1e5
    )


@dataclass(frozen=True)
class GoalSettings(Checked):
    """What a goal says to this node itself; all else is checked by the settings of the nodes that it is for."""

    speeds: tuple[float, ...] = setting((), "Of each recording, electrical", unit="rad/s", minimum=-1e6, maximum=1e6)
    lease_time: float = setting(0.0, "Longest time without a heartbeat; 0: none", unit="s", minimum=0.0, maximum=1e6)


@dataclass(frozen=True, eq=False)
class _Conducted(Reply):
    """The reply to a goal: what was recorded, and the result of ``Identify`` if there is one."""

    recording: Recording | None = None
    identified: Any = None


class ExperimentNode(Node):
    """Conducts the other nodes of its namespace, in a worker thread."""

    def __init__(self) -> None:
        super().__init__("experiment")
        self._settings = declare_settings(self, ConductingSettings, read_only=ConductingSettings.__dataclass_fields__)
        self._step = Step("")
        self._beat = 0.0
        self._requests = Requests(0.0, partial(in_executor, self), patience=STOP_TIME, pace=_FEEDBACK_PERIOD)
        server = RequestServer(
            self, PacedServices(self), None, Experiment, "~/experiment", self._requests, self._job, self._said,
            feedback=self._feedback, may_wait=False,
        )  # fmt: skip
        self.create_subscription(Empty, "~/heartbeat", self._on_heartbeat, STREAM_BEST_EFFORT)
        self.create_timer(_REQUEST_PERIOD, server.look, clock=STEADY)
        publish_health(self, self._health)
        self.get_logger().info("Ready.")

    def close(self) -> None:
        """Bring an experiment under way to rest."""
        self._requests.stop(STOP_TIME)

    def _job(self, request: Any) -> Job:
        own = GoalSettings(tuple(request.speeds), request.lease_time)
        fit = {name: getattr(request, name) for name in _OF_FIT} if request.method != request.METHOD_NONE else None
        goal = Goal(request.name, run_of(request), own.speeds, fit)
        for name in filter(None, goal.recordings):
            check_name(name)
        if fit is not None:  # by the node's own settings, before anything moves: see the conductor
            check_fields(len(goal.recordings), **{name: fit[name] for name in _OF_ALL_FITS})
        self._step, self._beat = Step("The goal begins."), time.monotonic()
        return partial(self._experiment, goal, request.lease_time)

    def _experiment(self, goal: Goal, lease_time: float, tell: Progress) -> Reply:
        """Run an experiment; where it tells its progress, it can be cancelled, which stops the drive."""

        def step(now: Step) -> None:
            self._step = now
            tell(now.phase, now.share)
            if lease_time and time.monotonic() > self._beat + lease_time:
                raise ExperimentError(f"The client has sent no heartbeat for {lease_time:g} s.", "no_heartbeat")

        settings = self._settings
        tell("waiting", 0.0)
        with Conductor(
            self.get_namespace(), timeout=settings.timeout, fit_time=settings.fit_time,
            speed_time=settings.speed_time, tell=step,
        ) as conductor:  # fmt: skip
            found = None
            try:
                found = conductor.run(goal)
                fitted = "" if found is None else f" {found.message}"
                reply = Reply("ok", f"{conductor.recorded.message}{fitted}")
            except DriveIdError as error:
                reply = failed(error)
            except Cancelled:
                reply = Reply("cancelled", "The goal was cancelled, or its client is gone.")
            except Exception:  # whoever asked waits for an answer
                logging.getLogger(__name__).exception("An experiment failed")
                reply = Reply("internal", "The experiment failed by an error of drive_id itself: report it.")
            said = conductor.stop()
            message = " ".join(filter(None, (reply.message, *said)))
            return _Conducted(reply.code, message, recording=conductor.recorded, identified=found)

    def _feedback(self, stage: Stage) -> Any:
        step = self._step
        return Experiment.Feedback(
            phase=stage.name,
            share=stage.share,
            waits_for=step.sentence,
            **{name: getattr(step, name) for name in ("elapsed", "duration", "coverage", "resistance")},
            sigma_resistance=step.sigma_resistance,
        )

    def _said(self, response: Any, reply: Reply) -> Any:
        response.success, response.code, response.message = reply.success, reply.code, reply.message
        if isinstance(reply, _Conducted) and reply.recording is not None:
            response.bags = list(reply.recording.uris)
            for name in ("samples", "dropped", "duration", "session"):
                setattr(response, name, getattr(reply.recording, name))
            if reply.identified is not None:
                for name in ("output", "flux_map", "report"):
                    setattr(response, name, getattr(reply.identified, name))
        if reply.success:
            self.get_logger().info(reply.message)
        else:
            self.get_logger().warning(f"experiment: {reply.message}")
        return response

    def _on_heartbeat(self, _: Empty) -> None:
        self._beat = time.monotonic()

    def _health(self) -> Health:
        doing = self._step.sentence if self._requests.busy else "Waiting for a goal."
        return Health.of(doing, self._requests.findings(), {})


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    run(ExperimentNode)


if __name__ == "__main__":
    main()
