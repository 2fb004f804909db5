"""The node ``identification``: fits recordings or the live samples on request."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from drive_id_msgs.action import Identify as IdentifyGoal
from drive_id_msgs.msg import FitReport, FluxMap, OperatingPoint
from drive_id_msgs.srv import Command, GetResult, Identify, ListResults
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import PointCloud2

from drive_id.common.health import Health, Level
from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.core.accumulation.evidence import check_live
from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError, InactiveError
from drive_id.live.identification.identification_settings import IdentificationSettings
from drive_id.live.identification.identifier import DEACTIVATED, Identifier, Job, Reply, again
from drive_id.live.identification.inbox import Inbox
from drive_id.live.identification.refits import Refit
from drive_id.live.identification.requests import Requests
from drive_id.live.identification.result_folders import ResultFolders
from drive_id.live.identification.warm_up import warm_up
from drive_id.live.worker import Worker, return_free_memory, share_arenas
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.deferred_service import MOST_LISTED, Lookups, in_executor
from drive_id.nodes.support.diagnostics import publish_health
from drive_id.nodes.support.managed import ManagedNode
from drive_id.nodes.support.parameters import declare_settings, on_change
from drive_id.nodes.support.qos import LATCHED, STREAM, overridable
from drive_id.nodes.support.replies import (
    NAMES,
    fill,
    fit_report_message,
    flux_map_message,
    flux_map_points,
    operating_point_message,
    result_info,
)
from drive_id.nodes.support.request_server import RequestServer
from drive_id.nodes.support.runtime import run
from drive_id.nodes.support.signal_messages import KINDS
from drive_id.nodes.support.topics.live import LiveTopics
from drive_id.types import SCALARS, Progress

Asked = TypeVar("Asked")
_REQUEST_PERIOD = 0.1  # s between looks at the request under way, and at whether a background fit is due
_OPERATING_PERIOD = 0.05  # s between looks at the operating points that have arrived
_PATIENCE = 2.0  # s for a running fit to stop at the end of the process
_SWITCH_INTERVAL = 5e-4  # s after which a fit yields the interpreter to the executor


class IdentificationNode(ManagedNode):
    """Accumulates live samples while it is active; fits run in a worker thread."""

    def __init__(self) -> None:
        super().__init__("identification")
        settings = declare_settings(self, IdentificationSettings, read_only=IdentificationSettings.__dataclass_fields__)
        fit = declare_settings(self, FitSettings)
        self.get_logger().info("Loading the numerical kernels; the first start compiles them.")
        warm_up(fit)
        return_free_memory()
        topics: Any = tuple(self.resolve_topic_name(name) for name in KINDS)
        scalar_topics = {name: self.resolve_topic_name(name) for name in SCALARS}
        self._identifier = Identifier(settings, fit, topics, scalar_topics, self.get_fully_qualified_name())
        self._frame_id = settings.frame_id
        self._inbox = Inbox(partial(in_executor, self))
        self._requests = Requests(settings.time_limit, partial(in_executor, self))
        self._refitter: Worker[Refit | None] = Worker()
        self._flux_map = self.create_publisher(FluxMap, "flux_map", **overridable(LATCHED))
        self._fit_report = self.create_publisher(FitReport, "fit_report", **overridable(LATCHED))
        self._points = self.create_publisher(PointCloud2, "flux_map_points", **overridable(LATCHED))
        self._operating_point = self.create_publisher(OperatingPoint, "operating_point", **overridable(STREAM))
        # A method that live samples cannot serve is refused.
        on_change(self, FitSettings, lambda settings: check_live(settings.method), self._on_settings)
        self._topics = LiveTopics(self, self._identifier, self._inbox, settings.signals)
        self.paced.create(Command, "~/reset", self._on_reset)
        self.paced.create(Identify, "~/check", self._on_check)
        folders = self._identifier.folders
        looks = Lookups(self, self.paced)
        looks.serve(ListResults, "~/list_results", partial(_list_results, folders))
        looks.serve(GetResult, "~/get_result", partial(_get_result, folders, self._frame_id))
        self._server = RequestServer(
            self, self.paced, Identify, IdentifyGoal, "~/identify", self._requests, self._job, self._said
        )
        self.create_timer(_REQUEST_PERIOD, self._look_after_requests, clock=STEADY)
        if settings.operating_point_rate > 0:
            self.create_timer(_OPERATING_PERIOD, self._publish_operating_points, clock=STEADY)
        publish_health(self, self._health)
        self.bring_up(f"Ready: recordings from {settings.data_directory}, live samples of {topics[0]}.")

    def connect(self) -> None:
        """Subscribe to the topics of the drive."""
        self._topics.open()

    def disconnect(self) -> None:
        """End the subscriptions and forget the live samples."""
        self._topics.close()
        self._forget()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take messages and requests, and publish the last map of the process before this one."""
        last = self._identifier.folders.last()
        if last is not None:
            reply = again(last)
            self._publish(flux_map_message(reply, self._frame_id), fit_report_message(reply))
            self.get_logger().info(f"Published again: {reply.message}")
        return super().on_activate(state)

    def rest(self) -> bool:
        """End the fits under way; whoever asked for one hears of it within a second."""
        self._refitter.cancel()
        self._requests.end_all(DEACTIVATED)
        return True

    def close(self) -> None:
        """Stop a running fit; one inside compiled code ends with the process."""
        self._refitter.cancel()
        self._requests.stop(_PATIENCE)
        self._refitter.stop(_PATIENCE)

    def _look_after_requests(self) -> None:
        self._inbox.look()
        self._server.look()
        self._refit()

    def _refit(self) -> None:
        """Fit the live samples in the background if that is due and nobody is waiting for another fit."""
        if not self.active or self._requests.busy or self._refitter.busy:
            return
        job = self._identifier.refit()
        if job is not None:
            life = self._identifier.life
            self._refitter.start(job, lambda refit: in_executor(self, lambda: self._refitted(refit, life)))

    def _refitted(self, refit: Refit | None, life: int) -> None:
        if refit is None or life != self._identifier.life or not self.active:
            return
        self._identifier.take(refit)
        if self._identifier.refits.publishes and not self._requests.busy:
            reply = self._identifier.provisional(refit)
            self._publish(flux_map_message(reply, self._frame_id), fit_report_message(reply))

    def _on_settings(self, settings: FitSettings) -> None:
        self._inbox.empty()
        if self._identifier.configure(settings):
            self.get_logger().info("The live samples were discarded because the settings of the fit changed.")

    def _job(self, request: Any) -> Job:
        """Return the job of a request whose turn has come."""
        if not self.active:
            raise InactiveError(self.inactive())
        dropped: list[Message] = []
        if not request.bags:
            self._inbox.empty()
            dropped = self._inbox.warnings()
        job = self._asked(self._identifier.job, request)
        life = self._identifier.life
        self._refitter.cancel()

        def run(tell: Progress) -> Reply:
            reply = job(tell)
            warnings = (*reply.warnings, *dropped)
            return replace(reply, warnings=warnings, refit=reply.refit if life == self._identifier.life else None)

        return run

    def _asked(self, what: Callable[..., Asked], request: Any) -> Asked:
        """Return what the identifier makes of the fields of a request."""
        names = {name: getattr(request, field) for name, field in NAMES.items()}
        further = {name: getattr(request, name) for name in ("i_max", "temperatures", "u_dc", "session")}
        return what(request.bags, request.method, request.signals, names, request.part, **further)

    def _on_check(self, request: Any, response: Any) -> Any:
        """Tell what a request would be refused for, before its bags exist."""
        try:
            if not self.active:
                raise InactiveError(self.inactive())
            self._asked(self._identifier.check, request)
        except DriveIdError as error:
            return self.answer("check", response, error.code, str(error))
        return self.answer("check", response, response.CODE_OK, "Such bags can be identified.")

    def _said(self, response: Any, reply: Reply) -> Any:
        """Fill the response or result of a request that is over, and publish its map."""
        if reply.refit is not None:
            self._identifier.take(reply.refit)
        try:
            fill(response, reply, self._frame_id)
        except Exception:  # noqa: BLE001  # whoever asked waits for an answer
            self.get_logger().error(f"A reply could not be made: {traceback.format_exc()}")
            return type(response)(code="internal", message="The reply could not be made: report this as a bug.")
        if response.success:
            self._publish(response.flux_map, response.report)
            self.get_logger().info(f"{reply.message} The results are in {reply.output}.")
        else:
            self.get_logger().warning(f"identify: {reply.message}")
        return response

    def _publish(self, flux_map: FluxMap, report: FitReport) -> None:
        self._fit_report.publish(report)
        self._flux_map.publish(flux_map)
        self._points.publish(flux_map_points(flux_map))

    def _publish_operating_points(self) -> None:
        points = self._identifier.operating_points
        if not self._operating_point.get_subscription_count():
            points.clear()
            return
        for point in points.take():
            self._operating_point.publish(operating_point_message(point, self._frame_id))

    def _on_reset(self, _: Any, response: Any) -> Any:
        self._forget()
        return self.answer("reset", response, response.CODE_OK, "The live samples were discarded.")

    def _forget(self) -> None:
        self._inbox.reset()
        self._identifier.reset()

    def _health(self) -> Health:
        if not self.active:
            return self.inactive_health()
        dropped = [(Level.WARN, warning) for warning in self._inbox.warnings()]
        findings = [*dropped, *self._requests.findings(), *self._topics.findings()]
        return self._identifier.health(self._requests.doing, self._topics.publishers(), findings)


def _list_results(folders: ResultFolders, request: Any, response: Any) -> Any:
    found, response.total = folders.find(request.machine, request.serial, request.most or MOST_LISTED)
    response.results = [result_info(each) for each in found]
    response.message = f"{len(found)} of {counted(response.total, 'result')}."
    return response


def _get_result(folders: ResultFolders, frame_id: str, request: Any, response: Any) -> Any:
    reply = again(folders.get(request.folder, request.machine, request.serial))
    return fill(response, reply, frame_id)


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    sys.setswitchinterval(_SWITCH_INTERVAL)
    share_arenas()
    run(IdentificationNode)


if __name__ == "__main__":
    main()
