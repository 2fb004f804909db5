"""Calls to the nodes of one drive, each with a deadline, from a ROS context of their own."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from drive_id_msgs.srv import Command
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.publisher import Publisher
from std_msgs.msg import Empty

from drive_id.core.experiment.encoder import Encoder
from drive_id.core.experiment.permission import LIMIT
from drive_id.core.experiment.supervision import REFUSED_FOR
from drive_id.errors import ExperimentError
from drive_id.nodes.support.arguments import ros_arguments
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.middleware import fast_dds

PUBLISHER, RECORDER, IDENTIFICATION = NODES = ("trajectory_publisher", "recorder", "identification")
PARAMETERS = {"get_parameters": GetParameters, "set_parameters_atomically": SetParametersAtomically}
OF_PUBLISHER = {
    f"{PUBLISHER}/clear_fault": Command, **{f"{PUBLISHER}/{name}": kind for name, kind in PARAMETERS.items()}
}  # fmt: skip
_SPIN = 0.05
"""Longest pause between looks at a condition, s: short beside every step."""
_HEARTBEAT = 0.2
"""Time between signs of life to a node that stops without them, s: a tenth of that time."""
Own = TypeVar("Own", bound="Calls")


@dataclass(frozen=True)
class Progress:
    """Progress of the current step.

    Parameters
    ----------
    sentence : str
        What is waited for.
    waited : float
        Time since the step began, s.
    elapsed, duration : float
        Of the trajectory, s; 0 where none runs.
    coverage : float
        Share of the current disc that the identification node has data of, 0 to 1; NaN where the trajectory is not to
        cover it.
    phase : str
        What is under way, as in the action ``Experiment``; empty between goals.
    share : float
        Of the goal or of the present phase that is done, 0 to 1.
    resistance, sigma_resistance : float
        Of the last fit of the live samples, ohm; NaN before it.
    """

    sentence: str
    waited: float = 0.0
    elapsed: float = 0.0
    duration: float = 0.0
    coverage: float = math.nan
    phase: str = ""
    share: float = 0.0
    resistance: float = math.nan
    sigma_resistance: float = math.nan

    @property
    def of_disc(self) -> bool:
        """Whether the trajectory is to cover the disc; a first start is not."""
        return not math.isnan(self.coverage)


class Calls:
    """Calls nodes of one drive in sequence.

    It has a ROS context of its own: ``rclpy.init`` is neither needed nor disturbed. ``close`` and the end of a ``with``
    block leave the ROS graph, after :meth:`stop`.

    Parameters
    ----------
    name : str
        Of the node that calls.
    services : mapping of str to type
        Types of the services that are called, by name.
    nodes : sequence of str
        That must report before they are called: only then they know of this client, and their replies are not lost.
    namespace, drive, timeout, tell, arguments
        As of :class:`~drive_id.ros.bench.Bench`.
    """

    def __init__(
        self,
        name: str,
        services: Mapping[str, Any],
        nodes: Sequence[str],
        *,
        namespace: str,
        drive: str,
        timeout: float,
        tell: Callable[[Progress], None] | None,
        arguments: Sequence[str],
    ) -> None:
        self.timeout = timeout
        self.drive = drive
        self._tell = tell
        self._statuses: dict[str, DiagnosticStatus] = {}  # by node, as is what follows
        self._figures: dict[str, dict[str, str]] = {}
        self._context = Context()
        with fast_dds(), ros_arguments():
            self._context.init(args=list(arguments))
            self._node = Node(name, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._names = {self._node.resolve_service_name(node): node for node in nodes}
        of_drive = {f"{drive}/{each}": kind for each, kind in PARAMETERS.items()} if drive else {}
        kinds = {**OF_PUBLISHER, **services, **of_drive}
        self._services = {each: self._node.create_client(kind, each) for each, kind in kinds.items()}
        # After the clients: a node that is heard here knows of them, and its replies are not lost.
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._actions: list[ActionClient] = []

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the ROS graph, after :meth:`stop`."""
        try:
            self.stop()
        finally:
            for action in self._actions:
                action.destroy()
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()

    def stop(self) -> list[str]:
        """Bring to rest what was begun here; return what the nodes said."""
        return []

    def missing(self) -> list[str]:
        """Return the nodes that have not been heard of, or lack a service."""
        lacking = {name.rpartition("/")[0] for name, one in self._services.items() if not one.service_is_ready()}
        return sorted(lacking | (set(self._names.values()) - set(self._statuses)))

    def wait_until_ready(self, timeout: float = 300.0) -> None:
        """Wait until all nodes report and the drive publishes.

        Parameters
        ----------
        timeout : float
            For each of both, s. The first start after an installation compiles numerical kernels.

        Raises
        ------
        ExperimentError
            When a node is missing, or the drive is silent.
        """
        self._wait_for_nodes(timeout)
        self._wait_for_drive(timeout)

    def _wait_for_nodes(self, timeout: float) -> None:
        def lacking() -> str:
            names = " and ".join(self.missing())
            return f"waiting for {names} (the first start compiles the numerical kernels: about 30 s)"

        self._wait(lambda: not self.missing(), lambda: f"still {lacking()}", lacking, timeout)

    def _wait_for_drive(self, timeout: float) -> None:
        """Wait until the drive is in order; a limit that forbids a start does not change, and is told by the start."""

        def waiting() -> str:
            status, of_limit = self._statuses[PUBLISHER], self._figures[PUBLISHER].get(REFUSED_FOR) == LIMIT
            waits = status.level == DiagnosticStatus.WARN and not of_limit
            return f"waiting for the drive: {status.message}" if waits else ""

        self._wait(lambda: not waiting(), lambda: f"still {waiting()}", waiting, timeout, code="fault")

    def wait_for_publisher(self) -> None:
        """Wait until the trajectory publisher reports: only then its replies reach this client.

        Raises
        ------
        ExperimentError
            When it does not.
        """
        self._wait(lambda: PUBLISHER in self._statuses, lambda: f"nothing has been heard of {PUBLISHER}", lambda: "")

    def clear_fault(self) -> str:
        """Permit a start again after a trip or an emergency stop; return the publisher's sentence.

        Raises
        ------
        ExperimentError
            When the cause persists, or the publisher does not answer.
        """
        return str(self._required(f"{PUBLISHER}/clear_fault").message)

    def configure_publisher(self, **values: Any) -> None:
        """Set parameters of the trajectory publisher, all or none.

        Raises
        ------
        ExperimentError
            When the publisher refuses them.
        """
        self._configure(PUBLISHER, values)

    def publisher_value(self, name: str) -> float:
        """Return a parameter of the trajectory publisher that is a number, NaN where it is the default."""
        return self._parameter(PUBLISHER, name)

    def encoder(self) -> Encoder:
        """Return what the drive makes of its raw angle, by the parameters of its node.

        Raises
        ------
        ExperimentError
            When the node does not answer, or lacks them.
        """
        names = list(Encoder.__dataclass_fields__)
        values = [parameter_value_to_python(value) for value in self._values(self.drive, names)]
        if None in values or len(values) < len(names):
            raise ExperimentError(
                f"{self.drive} has no parameters {', '.join(names)}: enter the angle by hand, without --drive."
            )
        return Encoder(**dict(zip(names, values, strict=True)))

    def set_encoder(self, encoder: Encoder) -> None:
        """Set what the drive makes of its raw angle.

        Raises
        ------
        ExperimentError
            When the node refuses, as while current flows.
        """
        self._configure(self.drive, asdict(encoder))

    def _configure(self, node: str, values: Mapping[str, Any]) -> None:
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self._called(f"{node}/set_parameters_atomically", parameters=parameters).result
        if not result.successful:
            raise ExperimentError(f"{node}: {result.reason}")

    def _values(self, node: str, names: Sequence[str]) -> list[ParameterValue]:
        return list(self._called(f"{node}/get_parameters", names=names).values)

    def _parameter(self, node: str, name: str) -> float:
        """Return a parameter of a node that is a number or true, 0 if it is neither."""
        (value,) = map(parameter_value_to_python, self._values(node, [name]))
        return float(value) if isinstance(value, (bool, int, float)) else 0.0

    def _called(self, name: str, /, **fields: Any) -> Any:
        """Call a service and return its response, which itself tells of success."""
        node, client = name.rpartition("/")[0], self._services[name]
        future = client.call_async(client.srv_type.Request(**fields))
        self._wait(future.done, lambda: f"service {name} does not answer", lambda: f"{node}: {self._said(node)}")
        return future.result()

    def _required(self, name: str, /, **fields: Any) -> Any:
        response = self._called(name, **fields)
        self._succeeded(name, response)
        return response

    def _succeeded(self, name: str, response: Any) -> None:
        if not response.success:
            raise ExperimentError(f"{name}: {response.message}", response.code)

    def _action(self, kind: Any, name: str) -> ActionClient:
        """Return a client of an action, which :meth:`close` destroys."""
        client = ActionClient(self._node, kind, name)
        self._actions.append(client)
        return client

    def _heartbeats_to(self, node: str, due: Callable[[], bool] = lambda: True) -> Publisher:
        """Send signs of life to a node from now on, whenever they are due, and return their publisher."""
        heartbeats = self._node.create_publisher(Empty, f"{node}/heartbeat", 1)
        self._node.create_timer(_HEARTBEAT, lambda: due() and heartbeats.publish(Empty()), clock=STEADY)
        return heartbeats

    def _goal(
        self,
        client: ActionClient,
        goal: Any,
        heard: Callable[[Any], None],
        complaint: Callable[[], str],
        doing: Callable[[], str],
        timeout: float,
    ) -> Any:
        """Send a goal and return its result; whatever ends the wait, the goal does not go on."""
        sent = client.send_goal_async(goal, feedback_callback=lambda message: heard(message.feedback))
        result: Any = None

        def over() -> bool:
            if not result.done() and not client.server_is_ready():
                raise ExperimentError(f"{complaint()}: it is gone.", "no_answer")
            return bool(result.done())

        try:
            self._wait(sent.done, complaint, doing)
            result = sent.result().get_result_async()
            self._wait(over, complaint, doing, timeout, code="time_limit")
            return result.result().result
        finally:
            if sent.done() and not (result is not None and result.done()):
                sent.result().cancel_goal_async()
                self._executor.spin_once(timeout_sec=_SPIN)

    def _wait(
        self,
        condition: Callable[[], bool],
        complaint: Callable[[], str],
        doing: Callable[[], str],
        timeout: float | None = None,
        code: str = "no_answer",
    ) -> None:
        timeout = timeout or self.timeout
        begin = time.monotonic()
        while not condition():
            waited = time.monotonic() - begin
            if waited > timeout:
                raise ExperimentError(f"After {timeout:g} s, {complaint().removesuffix('.')}.", code)
            if self._tell is not None:
                self._tell(self._progress(doing(), waited))
            self._executor.spin_once(timeout_sec=_SPIN)

    def _progress(self, sentence: str, waited: float) -> Progress:
        return Progress(sentence, waited)

    def _value(self, node: str, key: str) -> float:
        """Return a number that a node reports, NaN if it reports none."""
        with contextlib.suppress(ValueError):
            return float(self._figures.get(node, {}).get(key, ""))
        return math.nan

    def _said(self, node: str) -> str:
        return str(self._statuses[node].message) if node in self._statuses else "nothing has been heard of it yet"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = self._names.get(status.name)
            if node is not None:
                self._statuses[node] = status
                self._figures[node] = {entry.key: entry.value for entry in status.values}
