"""The node ``commissioning``: the first start of a drive without load machine, as a service and as an action."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from drive_id_msgs.action import FirstStart as FirstStartGoal
from drive_id_msgs.srv import FirstStart
from rclpy.node import Node

from drive_id.common.settings import Checked, setting
from drive_id.errors import DriveIdError, OutputError
from drive_id.live.data_directory import new_recording
from drive_id.live.identification.identifier import Job, Reply, failed
from drive_id.live.identification.requests import Requests
from drive_id.nodes.support.clocks import STEADY
from drive_id.nodes.support.deferred_service import PacedServices, in_executor
from drive_id.nodes.support.parameters import declare_settings
from drive_id.nodes.support.request_server import RequestServer
from drive_id.nodes.support.runtime import run
from drive_id.ros.calls import Progress as Step
from drive_id.ros.conductor import Conductor
from drive_id.ros.first_start import Commissioned, commission
from drive_id.types import Progress

_REQUEST_PERIOD = 0.1  # s between looks at the request under way
_PATIENCE = 3.0
"""For a cancelled first start to bring the drive to rest and remove its empty folder, s."""


@dataclass(frozen=True)
class CommissioningSettings(Checked):
    """Folder of the files, and patience."""

    output_directory: str = setting(
        "first_starts", "Folder in which each first start makes a new one; relative to the working directory"
    )
    drive: str = setting(
        "", "Node that takes the angle by its parameters encoder_offset, ...; empty: the angle is only told"
    )
    timeout: float = setting(
        60.0, "For each step, and for all nodes to be ready", unit="s", minimum=1.0, maximum=3600.0
    )


@dataclass(frozen=True)
class _Outcome(Reply):
    """The reply of a first start."""

    commissioned: Commissioned | None = None


class Commissioning(Node):
    """Conducts the other nodes of its namespace through a first start, in a worker thread."""

    def __init__(self) -> None:
        super().__init__("commissioning")
        fields = CommissioningSettings.__dataclass_fields__
        self._settings = declare_settings(self, CommissioningSettings, read_only=fields)
        self._requests = Requests(0.0, partial(in_executor, self), patience=_PATIENCE)
        services, name = PacedServices(self), "~/first_start"
        server = RequestServer(self, services, FirstStart, FirstStartGoal, name, self._requests, self._job, self._said)
        self.create_timer(_REQUEST_PERIOD, server.look, clock=STEADY)
        self.get_logger().info(f"Ready: the files go to {self._settings.output_directory}.")

    def close(self) -> None:
        """Bring a first start under way to rest."""
        self._requests.stop(_PATIENCE)

    def _job(self, request: Any) -> Job:
        folder = _new_folder(Path(self._settings.output_directory), request.name)
        return partial(_first_start, self.get_namespace(), self._settings, folder, request.angle_known)

    def _said(self, response: Any, reply: Reply) -> Any:
        response.success, response.code, response.message = reply.success, reply.code, reply.message
        if isinstance(reply, _Outcome) and reply.commissioned is not None:
            start = reply.commissioned.start
            response.angle_offset, response.sigma_angle_offset = start.angle_offset, start.angle_sigma
            response.load_angle, response.current_offset = start.load_angle, start.current_offset
            response.shaft_acceleration = reply.commissioned.acceleration
            response.signals, response.parameters = map(
                str, (reply.commissioned.signals, reply.commissioned.parameters)
            )
        if reply.success:
            self.get_logger().info(reply.message)
        else:
            self.get_logger().warning(f"first_start: {reply.message}")
        return response


def _new_folder(directory: Path, name: str) -> Path:
    """Make and return the folder of a first start; refuse a name that leads elsewhere, or is taken."""
    folder = new_recording(directory, name, datetime.now())  # noqa: DTZ005  # names are in local time
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"{folder} cannot be made a folder ({error.strerror or error}).") from error
    return folder


def _first_start(
    namespace: str, settings: CommissioningSettings, folder: Path, angle_known: bool, tell: Progress
) -> Reply:
    """Run a first start; where it tells its progress, it can be cancelled, which stops the drive."""
    stage = ["Turning"]

    def say(word: str, _: str) -> None:
        stage[0] = word
        tell(word, 0.0)

    def step(now: Step) -> None:
        tell(stage[0], now.elapsed / now.duration if now.duration > 0 else 0.0)

    try:
        tell(stage[0], 0.0)
        with Conductor(namespace, drive=settings.drive, timeout=settings.timeout, tell=step) as bench:
            bench.wait_until_ready(settings.timeout)
            found = commission(bench, folder, folder.name, say, angle_known=angle_known)
        return _Outcome("ok", found.sentence(), commissioned=found)
    except DriveIdError as error:
        return failed(error)
    except Exception:  # whoever asked waits for an answer
        logging.getLogger(__name__).exception("A first start failed")
        return Reply("internal", "The first start failed by an error of drive_id itself: report it.")
    finally:
        if not any(folder.iterdir()):
            folder.rmdir()


def main() -> None:
    """Run the node until SIGINT or SIGTERM."""
    run(Commissioning)


if __name__ == "__main__":
    main()
