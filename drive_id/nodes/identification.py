"""The node ``identification``: fits recordings or the live samples on request."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

from drive_id_msgs.msg import FluxMap, PhaseCurrents, PhaseVoltages, Resolver, ScalarSamples
from drive_id_msgs.srv import Identify
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from drive_id.core.fit_settings import FitSettings
from drive_id.errors import DriveIdError
from drive_id.health import Health
from drive_id.live.identification_settings import IdentificationSettings
from drive_id.live.identifier import BUSY, Identifier, Reply, failed
from drive_id.live.warm_up import warm_up
from drive_id.live.worker import Worker
from drive_id.nodes.deferred_service import DeferredService
from drive_id.nodes.deferred_service import Reply as Answer
from drive_id.nodes.diagnostics import Diagnostics
from drive_id.nodes.matched_subscription import MatchedSubscription
from drive_id.nodes.parameters import declare_settings, on_change
from drive_id.nodes.qos import LATCHED
from drive_id.nodes.replies import fill
from drive_id.nodes.runtime import run
from drive_id.types import SCALARS

TOPICS = {"phase_currents": PhaseCurrents, "phase_voltages": PhaseVoltages, "resolver": Resolver}
_MATCH_PERIOD = 0.25  # s between checks of who publishes
_PATIENCE = 2.0  # s for a running fit to stop at the end of the process
_SWITCH_INTERVAL = 5e-4  # s after which a fit yields the interpreter to the executor


class Identification(Node):
    """Accumulates live samples from its start on; fits run in a worker thread."""

    def __init__(self) -> None:
        super().__init__("identification")
        settings = declare_settings(self, IdentificationSettings, read_only=IdentificationSettings.__dataclass_fields__)
        fit = declare_settings(self, FitSettings)
        self.get_logger().info("Loading the numerical kernels; the first start compiles them: about 30 s.")
        warm_up(fit)
        topics: Any = tuple(self.resolve_topic_name(name) for name in TOPICS)
        scalar_topics = {name: self.resolve_topic_name(name) for name in SCALARS}
        self._identifier = Identifier(settings, fit, topics, scalar_topics)
        self._frame_id = settings.frame_id
        self._worker: Worker[Reply] = Worker()
        self._fitting = False  # not worker.busy: its thread may outlive the reply
        self._flux_map = self.create_publisher(FluxMap, "flux_map", LATCHED)
        on_change(self, FitSettings, lambda _: None, self._on_settings)
        self._topics = [
            MatchedSubscription(self, kind, name, partial(self._identifier.receive, section), raw=True)
            for section, (name, kind) in enumerate(TOPICS.items())
        ]
        self._scalar_topics = [
            MatchedSubscription(self, ScalarSamples, name, partial(self._identifier.receive_scalar, name), raw=True)
            for name in SCALARS
        ]
        self._timer = self.create_timer(
            _MATCH_PERIOD, self._match_topics, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._services_kept = [
            DeferredService(self, Identify, "~/identify", self._on_identify),
            self.create_service(Trigger, "~/reset", self._on_reset),
        ]
        self._diagnostics = Diagnostics(self, self._health)
        self.get_logger().info(f"Ready: recordings from {settings.data_directory}, live samples of {topics[0]}.")

    def close(self) -> None:
        """Stop a running fit; one inside compiled code ends with the process."""
        self._worker.stop(_PATIENCE)

    def _match_topics(self) -> None:
        for topic in (*self._topics, *self._scalar_topics):
            topic.match()

    def _on_settings(self, settings: FitSettings) -> None:
        if self._identifier.configure(settings):
            self.get_logger().info("The live samples were discarded because the settings of the fit changed.")

    def _on_identify(self, request: Identify.Request, answer: Answer) -> None:
        if self._fitting:
            answer(self._response(BUSY))
            return
        try:
            job = self._identifier.job(request.bags, request.method)
        except DriveIdError as error:
            answer(self._response(failed(error)))
            return
        self._fitting = True
        self._worker.start(job, lambda reply: answer.from_thread(lambda: self._fitted(reply)))

    def _fitted(self, reply: Reply) -> Identify.Response:
        self._fitting = False
        return self._response(reply)

    def _response(self, reply: Reply) -> Identify.Response:
        response = fill(Identify.Response(), reply, self._frame_id)
        if reply.success:
            self._flux_map.publish(response.flux_map)
            self.get_logger().info(f"{reply.message} The results are in {reply.output}.")
        else:
            self.get_logger().warning(f"identify: {reply.message}")
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._identifier.reset()
        response.success, response.message = True, "The live samples were discarded."
        return response

    def _health(self) -> Health:
        what, share = self._worker.progress
        doing = f"{what}." if share is None else f"{what}, {100 * share:.0f} %."
        doing = doing if self._fitting else "Waiting for requests."
        return self._identifier.health(doing, [topic.publishers for topic in self._topics])


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    sys.setswitchinterval(_SWITCH_INTERVAL)
    run(Identification)


if __name__ == "__main__":
    main()
