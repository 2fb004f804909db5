"""A client of one drive's nodes: runs experiments by the action of the node ``experiment``."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drive_id_msgs.action import Experiment
from drive_id_msgs.srv import Identify

from drive_id.errors import ExperimentError
from drive_id.fitting.result import Identification, load
from drive_id.nodes.support.replies import NAMES
from drive_id.ros.calls import IDENTIFICATION, NODES, Calls, Progress
from drive_id.ros.conductor import STOP_TIME, Recording

EXPERIMENT = "experiment"
SERVICES = {f"{IDENTIFICATION}/identify": Identify}
_TOLD = 1.0
"""Time between reports of progress, s: nobody reads faster."""
_LEASE = 2.0
"""Time after which the node cancels a goal without signs of life, s."""


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


class Bench(Calls):
    """Runs experiments with the nodes of one drive; each step has a deadline.

    While a goal is under way, it sends heartbeats to the node ``experiment``, which brings the drive to zero current
    without them: nothing keeps running when this process dies or hangs.

    It has a ROS context of its own: ``rclpy.init`` is neither needed nor disturbed. At the end of a ``with`` block, and
    by :meth:`close`, it cancels a goal that has not ended.

    Parameters
    ----------
    namespace : str
        Of the drive's nodes.
    drive : str
        Node of the drive with the parameters of :class:`~drive_id.core.experiment.encoder.Encoder`, where it has them.
    timeout : float
        For each answer of a node, s; a goal of an experiment takes as long as the node ``experiment`` permits.
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
        super().__init__(
            "bench_client", SERVICES, (*NODES, EXPERIMENT), namespace=namespace, drive=drive, timeout=timeout,
            tell=None if tell is None else _paced(tell), arguments=arguments,
        )  # fmt: skip
        self._last = Progress("")
        self._under_way: Any = None  # future of the goal's handle
        self._experiments = self._action(Experiment, f"{EXPERIMENT}/{EXPERIMENT}")
        self._heartbeats_to(EXPERIMENT)

    def missing(self) -> list[str]:
        """Return the nodes that have not been heard of, or lack what is needed."""
        return sorted({*super().missing(), *([] if self._experiments.server_is_ready() else [EXPERIMENT])})

    def run_experiment(self, name: str = "", **goal: Any) -> Recording:
        """Record one trajectory, or one for each of ``speeds``, and do not identify the drive.

        Parameters
        ----------
        name : str
            Of the recording; default: date and time.
        **goal : Any
            Fields of the action ``Experiment``.

        Raises
        ------
        ExperimentError
            When a node refuses, does not answer, or the trajectory is stopped before its end; ``code`` is the result's.
        """
        return _recording(self._run(name=name, **{"method": Experiment.Goal.METHOD_NONE, **goal}))

    def characterize(self, name: str = "", **goal: Any) -> tuple[Recording, Identified]:
        """Run a whole experiment: record as :meth:`run_experiment` does, and identify the drive.

        Parameters
        ----------
        name, **goal
            As of :meth:`run_experiment`.

        Raises
        ------
        ExperimentError
            As of :meth:`run_experiment`, and when the fit fails.
        """
        result = self._run(name=name, **goal)
        return _recording(result), Identified(result.flux_map, result.report, result.output, result.message)

    def identify(self, bags: Sequence[str] = (), method: str = "", signals: str = "", **fields: Any) -> Identified:
        """Identify the drive.

        Parameters
        ----------
        bags : sequence of str
            Recordings, on the machine of the identification node; none: its live samples.
        method : str
            ``psm``, ``joint`` or ``full``; default: as the node is configured.
        signals : str
            Signals file for the recordings, on the machine of the node; default: as the node is configured.
        **fields : Any
            Further fields of ``Identify``, such as ``i_max`` or ``part``; ``operator`` is ``operator_name`` there.

        Raises
        ------
        ExperimentError
            When the node refuses or does not answer; its sentence tells why.
        """
        wanted = {"bags": list(bags), "method": method, "signals": signals, **_named(fields)}
        reply = self._required(f"{IDENTIFICATION}/identify", **wanted)
        return Identified(reply.flux_map, reply.report, reply.output, reply.message)

    def stop(self) -> list[str]:
        """Cancel a goal under way, and wait until the drive is at zero current; return what the node said."""
        if self._under_way is None:
            return []
        sent, self._under_way = self._under_way, None
        self._tell = None  # what shows progress may be what failed
        self.timeout = STOP_TIME + 1.0
        try:
            self._wait(sent.done, lambda: f"{EXPERIMENT} does not answer", lambda: "")
            sent.result().cancel_goal_async()
            over = sent.result().get_result_async()
            self._wait(over.done, lambda: f"{EXPERIMENT} does not say that the current is at zero", lambda: "")
        except ExperimentError as error:
            return [str(error)]
        return [f"{EXPERIMENT}: {over.result().result.message}"]

    def _run(self, **goal: Any) -> Any:
        """Run an experiment and return its result."""
        self._last = Progress("The goal is sent.")
        wanted = Experiment.Goal(lease_time=_LEASE, **_named(goal))
        sent = self._under_way = self._experiments.send_goal_async(wanted, feedback_callback=self._on_feedback)

        def doing() -> str:
            return self._last.sentence

        self._wait(sent.done, lambda: f"{EXPERIMENT} does not answer", doing)
        over = sent.result().get_result_async()
        while not over.done():
            begun = self._last
            self._wait(
                lambda begun=begun: over.done() or self._last is not begun,  # type: ignore[misc]
                lambda: f"nothing has been heard of {EXPERIMENT}", doing,
            )  # fmt: skip
        self._under_way = None
        result = over.result().result
        if not result.success:
            raise ExperimentError(result.message, result.code)
        return result

    def _progress(self, sentence: str, waited: float) -> Progress:
        return self._last if self._under_way is not None else Progress(sentence, waited)

    def _on_feedback(self, message: Any) -> None:
        said = message.feedback
        self._last = Progress(
            said.waits_for, 0.0, said.elapsed, said.duration, said.coverage, said.phase, said.share,
            said.resistance, said.sigma_resistance,
        )  # fmt: skip


def _recording(result: Any) -> Recording:
    return Recording(
        tuple(result.bags), result.samples, result.dropped, result.duration, result.message, result.session
    )


def _named(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a request, whose names for machine, operator and so on need not be those of the message."""
    return {NAMES.get(name, name): value for name, value in fields.items()}


def _paced(tell: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Return a function that hands progress on at most once a second."""
    told = [time.monotonic()]

    def paced(now: Progress) -> None:
        if time.monotonic() > told[0] + _TOLD:
            told[0] = time.monotonic()
            tell(now)

    return paced
