"""A client of one drive's nodes: waits for them, checks them and calls their services."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from drive_id_msgs.srv import Command, Identify, StartExperiment, StartRecording, StopRecording
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from std_msgs.msg import Empty

from drive_id.core.experiment.encoder import Encoder
from drive_id.errors import ExperimentError
from drive_id.fitting.result import Identification, load
from drive_id.nodes.support.arguments import ros_arguments
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.middleware import fast_dds
from drive_id.nodes.support.replies import NAMES
from drive_id.nodes.support.signal_messages import KINDS

PUBLISHER, RECORDER, IDENTIFICATION = NODES = ("trajectory_publisher", "recorder", "identification")
PARAMETERS = {"get_parameters": GetParameters, "set_parameters_atomically": SetParametersAtomically}
SERVICES = {
    f"{RECORDER}/start": StartRecording,
    f"{RECORDER}/stop": StopRecording,
    f"{PUBLISHER}/start_experiment": StartExperiment,
    f"{PUBLISHER}/stop_experiment": Command,
    f"{PUBLISHER}/clear_fault": Command,
    f"{PUBLISHER}/set_parameters_atomically": SetParametersAtomically,
    f"{IDENTIFICATION}/reset": Command,
    f"{IDENTIFICATION}/identify": Identify,
    **{f"{node}/get_parameters": GetParameters for node in NODES},
}
_IDLE = "idle"
_TRIPPED = "tripped"
_LATEST_START = 5.0
"""Time after the start within which the publisher reports a trajectory, s."""
_STOPPING = 5.0
"""Longest wait for each node when a bench is brought to rest, s."""
_HEARTBEAT = 0.2
"""Time between signs of life to the publisher, s: a tenth of the time after which it stops without them."""
_SPIN = 0.05
"""Longest pause between looks at a condition, s: short beside every step."""
_TOLD = 1.0
"""Time between reports of progress, s: nobody reads faster."""


@dataclass(frozen=True)
class Progress:
    """Progress of the current step.

    Parameters
    ----------
    sentence : str
        As a node reports it.
    waited : float
        Time since the step began, s.
    elapsed, duration : float
        Of the trajectory, s; 0 where none runs.
    coverage : float
        Share of the current disc that the identification node has data of, 0 to 1.
    of_disc : bool
        The trajectory is to cover the disc; a first start is not.
    """

    sentence: str
    waited: float
    elapsed: float = 0.0
    duration: float = 0.0
    coverage: float = 0.0
    of_disc: bool = True


@dataclass(frozen=True)
class Recording:
    """A finished recording.

    Parameters
    ----------
    uri : str
        Path of the bag on the recorder's machine.
    samples, dropped : int
        Samples of the phase currents in the bag, and samples lost.
    duration : float
        s.
    message : str
        The recorder's sentence.
    """

    uri: str
    samples: int
    dropped: int
    duration: float
    message: str


@dataclass(frozen=True)
class Identified:
    """The reply of the identification node.

    Parameters
    ----------
    flux_map : drive_id_msgs.msg.FluxMap
    report : drive_id_msgs.msg.FitReport
    output : str
        Result folder on the machine of the node.
    message : str
        The node's sentence.
    """

    flux_map: Any
    report: Any
    output: str
    message: str

    def load(self) -> Identification:
        """Load the result folder, which must be reachable from here.

        Raises
        ------
        ResultError
            If it is not.
        """
        return load(Path(self.output))


class Bench:
    """Calls the nodes of one drive in sequence, each call with a deadline.

    While it waits for something, it sends heartbeats to the trajectory publisher, which ramps to zero current without
    them: nothing keeps running when this process dies or hangs.

    It has a ROS context of its own: ``rclpy.init`` is neither needed nor disturbed. At the end of a ``with`` block, and
    by :meth:`close`, it stops a trajectory and a recording that it began and that have not ended.

    Parameters
    ----------
    namespace : str
        Of the drive's nodes.
    drive : str
        Node of the drive with the parameters of :class:`~drive_id.core.experiment.encoder.Encoder`, where it has them.
    timeout : float
        For each step, s; for a trajectory, in addition to its duration.
    tell : callable, optional
        Called with :class:`Progress` about once a second while something is waited for.
    arguments : sequence of str
        ROS arguments, such as ``["--ros-args", "-r", "__ns:=/drive_1"]``.

    Raises
    ------
    ConfigurationError
        When the namespace or a ROS argument is invalid.
    """

    def __init__(
        self,
        namespace: str = "",
        *,
        drive: str = "",
        timeout: float = 60.0,
        tell: Callable[[Progress], None] | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        self.timeout = timeout
        self._tell = tell
        self._begun = False
        self._statuses: dict[str, DiagnosticStatus] = {}  # by node, as is what follows
        self._figures: dict[str, dict[str, str]] = {}
        self._states: list[str] = []
        self._context = Context()
        with fast_dds(), ros_arguments():
            self._context.init(args=list(arguments))
            self._node = Node("bench_client", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._names = {self._node.resolve_service_name(node): node for node in NODES}
        self.drive = drive
        of_drive = {f"{drive}/{name}": kind for name, kind in PARAMETERS.items()} if drive else {}
        kinds = SERVICES | of_drive
        self._services = {name: self._node.create_client(kind, name) for name, kind in kinds.items()}
        self._heartbeats = self._node.create_publisher(Empty, f"{PUBLISHER}/heartbeat", 1)
        self._node.create_timer(_HEARTBEAT, lambda: self._heartbeats.publish(Empty()), clock=STEADY)
        # After the clients: a node that is heard here knows of them, and its replies are not lost.
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def __enter__(self) -> Bench:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the ROS graph, after :meth:`stop`."""
        try:
            self.stop()
        finally:
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()

    def wait_until_ready(self, timeout: float = 300.0) -> None:
        """Wait until all nodes report and the drive publishes; then check that they fit together.

        Parameters
        ----------
        timeout : float
            s. The first start after an installation compiles numerical kernels.

        Raises
        ------
        ExperimentError
            When a node is missing, the drive is silent, several drives publish, or the nodes disagree on ``i_max`` or
            on ``use_sim_time``.
        """

        def waiting() -> str:
            missing = {name.rpartition("/")[0] for name, one in self._services.items() if not one.service_is_ready()}
            missing |= set(NODES) - set(self._statuses)
            missing |= set() if self._heartbeats.get_subscription_count() else {PUBLISHER}
            if missing:
                names = " and ".join(sorted(missing))
                return f"waiting for {names} (the first start compiles the numerical kernels: about 30 s)"
            status = self._statuses[PUBLISHER]
            return f"waiting for the drive: {status.message}" if status.level == DiagnosticStatus.WARN else ""

        self._wait(lambda: not waiting(), lambda: f"still {waiting()}", waiting, timeout)
        self._check()

    def wait_for_publisher(self) -> None:
        """Wait until the trajectory publisher reports: only then its replies reach this client.

        Raises
        ------
        ExperimentError
            When it does not.
        """
        self._wait(lambda: PUBLISHER in self._statuses, lambda: f"nothing has been heard of {PUBLISHER}", lambda: "")

    def run_experiment(self, name: str = "") -> Recording:
        """Record one trajectory: start the recorder, run the trajectory to its end, stop the recorder.

        The live samples of the identification node are those of this trajectory, too.

        Parameters
        ----------
        name : str
            Of the recording; default: date and time.

        Raises
        ------
        ExperimentError
            When a node refuses, does not answer, or the trajectory is stopped before its end.
        """
        self._heartbeats.publish(Empty())  # long before the start, which may require it
        self._begun = True  # before there is an answer, which may come too late
        started = self._called(f"{RECORDER}/start", name=name)
        self._begun = started.success  # else the recorder may be busy for another client, who shall not be stopped
        self._succeeded(f"{RECORDER}/start", started)
        self._required(f"{IDENTIFICATION}/reset")
        self._run_trajectory()
        stopped = self._required(f"{RECORDER}/stop")
        self._begun = False
        return Recording(started.uri, stopped.samples, stopped.dropped, stopped.duration, stopped.message)

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

    def identify(
        self, bags: Sequence[str] = (), method: str = "", signals: str = "", *, part: str = "", **names: str
    ) -> Identified:
        """Identify the drive.

        Parameters
        ----------
        bags : sequence of str
            Recordings, on the machine of the identification node; none: its live samples.
        method : str
            ``psm``, ``joint`` or ``full``; default: as the node is configured.
        signals : str
            Signals file for the recordings, on the machine of the node; default: as the node is configured.
        part : {"", "before", "after"}
            Of live samples, where the drive was restarted or exchanged meanwhile.
        **names : str
            ``machine``, ``serial``, ``bench``, ``operator``, ``notes``; default: as the node is configured.

        Raises
        ------
        ExperimentError
            When the node refuses or does not answer; its sentence tells why.
        """
        wanted = {"bags": list(bags), "method": method, "signals": signals, "part": part}
        wanted |= {NAMES[name]: text for name, text in names.items()}
        reply = self._required(f"{IDENTIFICATION}/identify", **wanted)
        return Identified(reply.flux_map, reply.report, reply.output, reply.message)

    def stop(self) -> list[str]:
        """Bring the drive to zero current and close a recording that this client began; return what the nodes said."""
        if not self._begun:
            return []
        self._begun = False
        self._tell = None  # what shows progress may be what failed
        self.timeout = min(self.timeout, _STOPPING)
        return [self._stopped(name) for name in (f"{PUBLISHER}/stop_experiment", f"{RECORDER}/stop")]

    def clear_fault(self) -> str:
        """Permit a start again after a trip or an emergency stop; return the publisher's sentence.

        Raises
        ------
        ExperimentError
            When the cause persists, or the publisher does not answer.
        """
        return str(self._required(f"{PUBLISHER}/clear_fault").message)

    def _stopped(self, name: str) -> str:
        try:
            return f"{name}: {self._called(name).message}"
        except ExperimentError as error:
            return str(error)

    def _run_trajectory(self) -> None:
        self._states.clear()
        self._required(f"{PUBLISHER}/start_experiment", require_lease=True)
        started = time.monotonic()

        def ended() -> bool:
            if _TRIPPED in self._states:
                raise ExperimentError(f"The trajectory was stopped: {self._said(PUBLISHER)}")
            was_active = any(state != _IDLE for state in self._states) or time.monotonic() > started + _LATEST_START
            return bool(was_active and self._states and self._states[-1] == _IDLE)

        remaining = max(self._value(PUBLISHER, "duration [s]"), 0.0)
        timeout = self.timeout + remaining
        self._wait(ended, lambda: "the trajectory does not end", lambda: self._said(PUBLISHER), timeout)

    def _check(self) -> None:
        """Compare parameters of the nodes, and count who publishes the drive's signals."""
        for topic in KINDS:
            count = self._node.count_publishers(topic)
            if count > 1:
                raise ExperimentError(
                    f"{count} nodes publish {self._node.resolve_topic_name(topic)}: leave one drive in each namespace."
                )
        i_max = {node: self._parameter(node, "i_max") for node in (PUBLISHER, IDENTIFICATION)}
        if i_max[IDENTIFICATION] and i_max[IDENTIFICATION] < i_max[PUBLISHER]:
            raise ExperimentError(
                f"{PUBLISHER} drives up to {i_max[PUBLISHER]:g} A and {IDENTIFICATION} maps up to "
                f"{i_max[IDENTIFICATION]:g} A: give both the same i_max."
            )
        clocks = {node: bool(self._parameter(node, "use_sim_time")) for node in NODES}
        if len(set(clocks.values())) > 1:
            simulated = " and ".join(node for node, own in clocks.items() if own)
            raise ExperimentError(f"Only {simulated} follows /clock: give all nodes the same use_sim_time.")

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
        return float(value) if isinstance(value, (bool, float)) else 0.0

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
            raise ExperimentError(f"{name}: {response.message}")

    def _wait(
        self,
        condition: Callable[[], bool],
        complaint: Callable[[], str],
        doing: Callable[[], str],
        timeout: float | None = None,
    ) -> None:
        timeout = timeout or self.timeout
        begin = told = time.monotonic()
        while not condition():
            now = time.monotonic()
            if now > begin + timeout:
                raise ExperimentError(f"After {timeout:g} s, {complaint()}.")
            if self._tell is not None and now > told + _TOLD:
                told = now
                self._tell(self._progress(doing(), now - begin))
            self._executor.spin_once(timeout_sec=_SPIN)

    def _progress(self, sentence: str, waited: float) -> Progress:
        elapsed, duration = (self._value(PUBLISHER, f"{key} [s]") for key in ("elapsed", "duration"))
        of_disc = self._figures.get(PUBLISHER, {}).get("coverage") != ""
        return Progress(sentence, waited, elapsed, duration, self._value(IDENTIFICATION, "coverage"), of_disc)

    def _value(self, node: str, key: str) -> float:
        """Return a number that a node reports, 0 if it reports none."""
        with contextlib.suppress(ValueError):
            return float(self._figures.get(node, {}).get(key, ""))
        return 0.0

    def _said(self, node: str) -> str:
        return str(self._statuses[node].message) if node in self._statuses else "nothing has been heard of it yet"

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            node = self._names.get(status.name)
            if node is None:
                continue
            self._statuses[node] = status
            self._figures[node] = {entry.key: entry.value for entry in status.values}
            if node == PUBLISHER:
                self._states.append(self._figures[node].get("state", ""))
