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
from drive_id.live.memory import return_free_memory, share_arenas
from drive_id.live.refits import Refit
from drive_id.live.warm_up import warm_up
from drive_id.live.worker import Worker
from drive_id.nodes.deferred_service import DeferredService, in_executor
from drive_id.nodes.deferred_service import Reply as Answer
from drive_id.nodes.diagnostics import Diagnostics
from drive_id.nodes.matched_subscription import MatchedSubscription
from drive_id.nodes.parameters import declare_settings, on_change
from drive_id.nodes.qos import LATCHED
from drive_id.nodes.replies import fill, flux_map_message
from drive_id.nodes.runtime import run
from drive_id.types import SCALARS

TOPICS = {"phase_currents": PhaseCurrents, "phase_voltages": PhaseVoltages, "resolver": Resolver}
_MATCH_PERIOD = 0.25  # s between checks of who publishes
_REFIT_PERIOD = 0.1  # s between checks of whether a fit in the background is due
_PATIENCE = 2.0  # s for a running fit to stop at the end of the process
_SWITCH_INTERVAL = 5e-4  # s after which a fit yields the interpreter to the executor


class Identification(Node):
    """Accumulates live samples from its start on; fits run in a worker thread."""

    def __init__(self) -> None:
        super().__init__("identification")
        settings = declare_settings(self, IdentificationSettings, read_only=IdentificationSettings.__dataclass_fields__)
        fit = declare_settings(self, FitSettings)
        self.get_logger().info("Loading the numerical kernels; the first start compiles them.")
        warm_up(fit)
        return_free_memory()
        topics: Any = tuple(self.resolve_topic_name(name) for name in TOPICS)
        scalar_topics = {name: self.resolve_topic_name(name) for name in SCALARS}
        self._identifier = Identifier(settings, fit, topics, scalar_topics)
        self._frame_id = settings.frame_id
        self._worker: Worker[Reply] = Worker()
        self._refitter: Worker[Refit | None] = Worker()
        self._life = 0  # of the live samples; a fit of forgotten ones is of no use
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
        self._refit_timer = self.create_timer(_REFIT_PERIOD, self._refit, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = Diagnostics(self, self._health)
        self.get_logger().info(f"Ready: recordings from {settings.data_directory}, live samples of {topics[0]}.")

    def close(self) -> None:
        """Stop a running fit; one inside compiled code ends with the process."""
        self._refitter.cancel()
        self._worker.stop(_PATIENCE)
        self._refitter.stop(_PATIENCE)

    def _match_topics(self) -> None:
        for topic in (*self._topics, *self._scalar_topics):
            topic.match()

    def _refit(self) -> None:
        """Fit the live samples in the background if that is due and nobody is waiting for another fit."""
        if self._fitting or self._refitter.busy:
            return
        job = self._identifier.refit()
        if job is not None:
            life = self._life
            self._refitter.start(job, lambda refit: in_executor(self, lambda: self._refitted(refit, life)))

    def _refitted(self, refit: Refit | None, life: int) -> None:
        if refit is None or life != self._life:
            return
        self._identifier.take(refit)
        if self._identifier.refits.publishes and not self._fitting:
            self._flux_map.publish(flux_map_message(self._identifier.provisional(refit), self._frame_id))

    def _on_settings(self, settings: FitSettings) -> None:
        if self._identifier.configure(settings):
            self._life += 1
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
        self._fitting, life = True, self._life
        self._refitter.cancel()
        self._worker.start(job, lambda reply: answer.from_thread(lambda: self._fitted(reply, life)))

    def _fitted(self, reply: Reply, life: int) -> Identify.Response:
        self._fitting = False
        if reply.refit is not None and life == self._life:
            self._identifier.take(reply.refit)
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
        self._life += 1
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
    share_arenas()
    run(Identification)


if __name__ == "__main__":
    main()
