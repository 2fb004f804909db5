"""State of a recording: samples received, written and lost, as figures and as sentences."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.files.storage.metadata import WRITTEN
from drive_id.types import NANOSECONDS


@dataclass(frozen=True)
class DriveChange:
    """A place in a recording from which on it is of another drive, or of the same one after its restart."""

    reason: Message
    log_time: int  # of the first message behind it, ns
    after: float  # time from the first message of the recording, s


@dataclass(frozen=True)
class TopicReport:
    """State of one topic."""

    topic: str
    messages: int = 0  # in the bag
    received: int = 0  # samples that arrived
    written: int = 0  # samples in the bag
    lost: int = 0  # samples that never arrived: gaps in first_sample
    losses: int = 0  # number of such gaps
    overflowed: int = 0  # samples that arrived when the queue was full
    discarded: int = 0  # samples in the queue when the disk refused and the recording ended
    restarts: int = 0  # places where first_sample ran backwards
    unreadable: int = 0  # messages that are no blocks of samples; they are recorded nevertheless
    uncounted: bool = False  # first_sample is always 0, so that samples that never arrived do not show
    first_stamp: int | None = None  # of the first sample in the bag, ns
    last_stamp: int | None = None  # of the last one, ns

    @property
    def dropped(self) -> int:
        """Samples that will never be in the bag; those in the queue are not counted, late ones no longer."""
        return self.lost + self.overflowed + self.discarded

    @property
    def queued(self) -> int:
        """Samples in the queue."""
        return self.received - self.written - self.overflowed - self.discarded

    @property
    def duration(self) -> float:
        """Time from the first to the last sample in the bag, s."""
        if self.first_stamp is None or self.last_stamp is None:
            return 0.0
        return (self.last_stamp - self.first_stamp) / NANOSECONDS


@dataclass(frozen=True)
class RecordingReport:
    """State of a recording, running or ended."""

    path: Path  # of the bag
    topics: tuple[TopicReport, ...]  # the first one, the phase currents, gives samples and duration
    files: int
    size: int  # on the disk, bytes
    waiting: int = 0  # in the queue, bytes
    error: str = ""  # why the recording ended by itself; empty when it did not
    remark: str = ""  # a sentence on what is wrong with the log times; empty if nothing is
    free: int | None = None  # on the disk at the last flush, bytes; None when that is unknown
    changes: tuple[DriveChange, ...] = ()  # each begins another recording in the bag

    @property
    def messages(self) -> int:
        """Messages of all topics in the bag."""
        return sum(topic.messages for topic in self.topics)

    @property
    def samples(self) -> int:
        """Samples of the first topic in the bag; where a write failed, the last block may lack other topics."""
        return self.topics[0].written

    @property
    def overflowed(self) -> int:
        """Samples of all topics that arrived when the queue was full."""
        return sum(topic.overflowed for topic in self.topics)

    @property
    def dropped(self) -> int:
        """Samples of all topics that will never be in the bag."""
        return sum(topic.dropped for topic in self.topics)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample of the first topic in the bag, s."""
        return self.topics[0].duration

    def sentence(self) -> str:
        """Return a sentence with the samples recorded and lost."""
        first = self.topics[0]
        text = f"{self.path} holds {counted(first.written, 'sample')} of {first.topic} ({first.duration:.3f} s)"
        missing = [f"{topic.dropped} of {topic.topic}" for topic in self.topics if topic.dropped]
        lost = f"these samples were lost: {', '.join(missing)}" if missing else "no sample was lost"
        uncounted = [topic.topic for topic in self.topics if topic.uncounted]
        if uncounted:
            unknown = f"losses on {', '.join(uncounted)} do not show, for first_sample is always 0 there"
            lost = f"{lost}; {unknown}" if missing else unknown
        empty = [topic.topic for topic in self.topics if not topic.messages]
        silent = f"; nothing came on {', '.join(empty)}" if empty else ""
        return f"{text}; {lost}{silent}."

    def outcome(self) -> str:
        """Return the error, if there was one, the sentence, the changes of the drive, and the remark."""
        return " ".join(filter(None, [self.error, self.sentence(), self.division(), self.remark]))

    def division(self) -> str:
        """Return a sentence or two on the recordings of several drives in the bag; empty if there is one only."""
        if not self.changes:
            return ""
        first, recordings = self.changes[0], counted(len(self.changes) + 1, "recording")
        return f"The bag holds {recordings}, the second from {first.after:.3f} s on: {first.reason}"

    def custom_data(self) -> dict[str, str]:
        """Return the figures for the metadata of the bag."""
        data = {}
        for topic in self.topics:
            data[f"samples_received:{topic.topic}"] = str(topic.received)
            data[f"{WRITTEN}{topic.topic}"] = str(topic.written)
            data[f"samples_lost:{topic.topic}"] = str(topic.dropped)
        if self.changes:
            data["recordings"] = str(len(self.changes) + 1)
        for number, change in enumerate(self.changes, 2):
            data[f"recording_{number}:begins"] = str(change.log_time)  # log time, ns, as in the files of the bag
            data[f"recording_{number}:because"] = str(change.reason)
        remarks = {"error": self.error, "remark": self.remark}
        return data | {name: said for name, said in remarks.items() if said}
