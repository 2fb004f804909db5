"""Converts between the messages of a drive and its publisher, and what :mod:`drive_id.core.experiment` works with."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
from drive_id_msgs.msg import CurrentReference, DriveStatus, PhaseCurrents, PublisherState, Resolver

from drive_id.core.experiment import feedback
from drive_id.core.experiment.state_machine import ReferenceBlock
from drive_id.core.experiment.supervision import Report
from drive_id.nodes.support.signal_messages import headed
from drive_id.types import NANOSECONDS

_STATUS = tuple(name for name in feedback.DriveStatus.__dataclass_fields__ if name != "stamp")
_REPORTED = (
    "session", "dry_run", "elapsed", "duration", "coverage", "mean_speed", "mean_speed_reference", "bias", "completed",
)  # fmt: skip


_OF_RUN = ("trajectory", "i_max", "duration", "repeat")


def run_of(request: Any) -> dict[str, Any]:
    """Return the settings that a request has for its run alone: those that are neither 0 nor empty."""
    return {name: value for name in _OF_RUN if (value := getattr(request, name))}


def stamp_of(message: PhaseCurrents | Resolver | DriveStatus | CurrentReference) -> int:
    """Return the stamp of a message, ns; rclpy's Time refuses negative ones, which a node may send nevertheless."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def sample_block(message: PhaseCurrents | Resolver, *fields: str) -> feedback.SampleBlock:
    """Return a received block without copying its arrays."""
    values = tuple(np.frombuffer(getattr(message, field), np.float32) for field in fields)
    return feedback.SampleBlock(stamp_of(message), message.first_sample, message.sample_period, values)


def drive_status(message: DriveStatus) -> feedback.DriveStatus:
    """Return a received status."""
    return feedback.DriveStatus(stamp=stamp_of(message), **{name: getattr(message, name) for name in _STATUS})


def status_message(status: feedback.DriveStatus, frame_id: str) -> DriveStatus:
    """Return the message of a status."""
    return headed(DriveStatus(**{name: getattr(status, name) for name in _STATUS}), status.stamp, frame_id)


def reference_message(block: ReferenceBlock, frame_id: str) -> CurrentReference:
    """Return the message of a block of references."""
    message = CurrentReference(first_sample=block.first_sample, sample_period=block.sample_period)
    message.session, message.count, message.safe = block.session, block.count, block.safe
    message.stator_frame = block.stator_frame
    message.d, message.q = (array.array("f", column.tobytes()) for column in block.i_dq.T)
    return headed(message, block.stamp, frame_id)


def state_message(report: Report, reason: str, now: int, frame_id: str) -> PublisherState:
    """Return the message of the state at a time, ns."""
    message = PublisherState(state=report.state.value, reason=reason)
    message.i_d, message.i_q = report.i_dq.tolist()
    for name in _REPORTED:
        setattr(message, name, getattr(report, name))
    return headed(message, now, frame_id)
