"""Parts of a bag in which the drive was restarted or exchanged: each is a recording of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drive_id.common.messages import Message
from drive_id.core.signals.drive_watch import LEAST_OF_ONE_DRIVE, DriveWatch
from drive_id.core.signals.join import SECTIONS
from drive_id.errors import DriveChangedError
from drive_id.files.messages.block_codec import read_head
from drive_id.files.messages.messages import BLOCK_FIELDS
from drive_id.files.messages.signals_file import SignalMap
from drive_id.files.read.reader import find_topics
from drive_id.files.storage.bag import open_bag
from drive_id.types import NANOSECONDS

_FEW = 3
"""Parts of a short recording that are read, however short: two restarts."""


@dataclass
class DrivePart:
    """Messages of one drive in a bag."""

    begin: int  # number of the first message, of those on the topics of currents, voltages and resolver
    reason: Message | None  # why it is of another drive than the part before; None for the first one
    end: int = 0  # number behind the last message
    samples: int = 0  # of the currents
    first_stamp: int = 0  # of the currents, ns
    last_stamp: int = 0

    @property
    def middle(self) -> float:
        """Time in its middle, s."""
        return 0.5 * (self.first_stamp + self.last_stamp) / NANOSECONDS


def drive_parts(path: Path, signals: SignalMap, namespace: str = "") -> list[DrivePart]:
    """Return the parts of a bag of our messages, in order, without those of a few samples only.

    Raises DriveChangedError when there are many and all are so short, and BagError, ConfigurationError as
    :func:`~drive_id.files.read.several.read_recording` does.
    """
    watch, parts = DriveWatch(), [DrivePart(0, None)]
    with open_bag(path) as bag:
        found = find_topics(bag, signals, namespace)
        topics = {found[section].name: section for section in SECTIONS}
        marks = list(bag.metadata.changes) if bag.metadata else []
        for number, message in enumerate(bag.messages(frozenset(topics))):
            if found[topics[message.topic]].type_name not in BLOCK_FIELDS:
                continue
            try:
                head = read_head(message.data)
            except ValueError:
                continue  # whoever decodes it tells
            reason = watch.block(
                message.topic, head.first_sample, head.samples, head.stamp, head.sample_period, head.frame
            )
            if marks and message.log_time >= marks[0].log_time:
                reason = reason or Message.told(marks[0].reason, "another_drive", {}, "warning")
                marks = marks[1:]
            if reason is not None:
                parts.append(DrivePart(number, reason))
            part = parts[-1]
            part.end = number + 1
            if topics[message.topic] == SECTIONS[0]:
                part.first_stamp = part.first_stamp if part.samples else head.stamp
                part.samples += head.samples
                part.last_stamp = head.stamp + round(head.samples * head.sample_period * NANOSECONDS)
    long = [part for part in parts if part.samples >= LEAST_OF_ONE_DRIVE]
    if not long and len(parts) <= _FEW:
        return parts
    if not long:
        raise DriveChangedError(Message("drive_changed.mixed", path=str(path), parts=len(parts)))
    return long
