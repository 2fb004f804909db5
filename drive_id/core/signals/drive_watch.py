"""Tells where the messages of another drive begin: one that was restarted, exchanged, or publishes beside the first."""

from __future__ import annotations

from collections.abc import Mapping

from drive_id.common.messages import Message
from drive_id.core.signals.signal import SampleCount

LEAST_OF_ONE_DRIVE = 2000
"""Samples of a part that is kept, 0.2 s at 10 kHz: two drives that publish at once give parts of a block each."""


class DriveWatch:
    """Watches the messages of the signals of one drive, and who publishes them.

    A drive that was restarted may be another one: nothing but its running count tells. What belongs to a message is
    compared with the messages of the same topic since the last change, so that one change is told once.
    """

    def __init__(self) -> None:
        self._counts: dict[str, SampleCount] = {}
        self._frames: dict[str, str] = {}
        self._publishers: dict[str, Mapping[str, str]] = {}

    def block(
        self, topic: str, first_sample: int, samples: int, stamp: int, period: float, frame: str
    ) -> Message | None:
        """Take a block, and return why it is of another drive than those before; None if it is not.

        Parameters
        ----------
        first_sample, samples : int
            Running count of the first sample, and number of samples.
        stamp : int
            Of the first sample, ns.
        period : float
            Of the samples, s.
        frame : str
            ``frame_id`` of the message.
        """
        count = self._counts.setdefault(topic, SampleCount())
        due, known = count.due, self._frames.setdefault(topic, frame)
        another = count.add(first_sample, samples, stamp, period)
        if not another and frame == known:
            return None
        self._counts, self._frames = {}, {}
        self.block(topic, first_sample, samples, stamp, period, frame)
        if frame != known:
            return Message("another_drive.frame", topic=topic, before=known, after=frame)
        return Message("another_drive.count", topic=topic, before=due or 0, after=first_sample)

    def interrupt(self) -> None:
        """Have the next blocks begin anew: what is missing before them was left out on purpose."""
        for count in self._counts.values():
            count.interrupt()

    def publishers(self, topic: str, found: Mapping[str, str]) -> Message | None:
        """Take the nodes that publish a topic, by the identity of the publisher; return that there is a new one."""
        known = self._publishers.get(topic, {})
        self._publishers[topic] = {**known, **found}
        new = [node for identity, node in found.items() if identity not in known]
        if not known or not new:
            return None
        self._counts, self._frames = {}, {}
        others = [node for identity, node in found.items() if identity in known]
        wording = "another_drive.second" if others else "another_drive.publisher"
        return Message(wording, topic=topic, node=new[0], other=others[0] if others else None)
