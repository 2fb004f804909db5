"""One recording from start to stop, without ROS: messages are enqueued by one thread and written by another."""

from __future__ import annotations

import math
import shutil
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from drive_id.common.messages import Message
from drive_id.core.signals.drive_watch import DriveWatch
from drive_id.core.signals.signal import SampleCount
from drive_id.errors import DriveIdError
from drive_id.files.messages.block_codec import BlockHead, read_head
from drive_id.files.messages.messages import PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER
from drive_id.files.storage.mcap import McapStorage
from drive_id.files.storage.metadata import Qos
from drive_id.files.write.rosbag2_writer import FileOpener, Rosbag2McapWriter, open_unbuffered
from drive_id.live.publishers import Publisher
from drive_id.live.recording.recording_report import DriveChange, RecordingReport, TopicReport
from drive_id.live.recording.recording_settings import RecordingSettings
from drive_id.types import NANOSECONDS

_HELD_UP = 1.0
"""Longest time between looks that counts as silence, s: a process that was held up finds heartbeats waiting."""
_POLL = 0.05  # s; the writer looks for messages so often, so that callbacks need not wake it
_OVERHEAD = 250  # bytes a message costs in the queue beyond its data
_FEEDBACK = (PHASE_CURRENTS, PHASE_VOLTAGES, RESOLVER)
"""Types of the topics whose counts are those of the drive; references have that of their publisher."""
_BURST = 1.0
"""Time within which one change of the drive is told of, s: two drives that publish at once mix block by block."""


@dataclass(frozen=True)
class RecordedTopic:
    """A topic to record."""

    name: str  # absolute
    type_name: str  # package/msg/Name
    qos: Qos | None = None  # that it is offered with
    optional: bool = False  # it is in the bag and in the report from its first message on, and not before
    blocks: bool = True  # its messages are blocks of samples; otherwise, each counts as one sample
    definition: str = ""  # complete ros2msg definition of a type that is not ours
    hash_: str = ""  # its RIHS01 hash


class _Waiting(NamedTuple):
    topic: str
    data: bytes
    log_time: int
    head: BlockHead | None


_COMPLETE = "The recording has ended, and is complete up to then."
_SPLIT = _Waiting("", b"", 0, None)
"""Stands in the queue where a new file begins."""


@dataclass
class _Received:
    """Counters of a topic that the receiving thread keeps."""

    count: SampleCount = field(default_factory=SampleCount)
    unreadable: int = 0
    overflowed: int = 0


@dataclass
class _Written:
    """Counters of a topic that the writing thread keeps."""

    messages: int = 0
    samples: int = 0
    first_stamp: int | None = None
    last_stamp: int | None = None

    def add(self, head: BlockHead | None) -> None:
        self.messages += 1
        if head is None or head.samples == 0:
            return
        self.samples += head.samples
        last = head.stamp + round((head.samples - 1) * head.sample_period * NANOSECONDS)
        self.first_stamp = head.stamp if self.first_stamp is None else min(self.first_stamp, head.stamp)
        self.last_stamp = last if self.last_stamp is None else max(self.last_stamp, last)


class RecordingSession:
    """Record serialized messages into a bag until :meth:`stop`, or until the disk refuses.

    Parameters
    ----------
    path : Path
        Bag to create.
    topics : sequence of RecordedTopic
        The first is the one whose samples are reported.
    ros_distro : str
        For the record.
    opener : callable
        Creates the files.

    Raises
    ------
    OutputError
        When the bag exists or cannot be created.
    """

    def __init__(
        self,
        path: Path,
        topics: Sequence[RecordedTopic],
        settings: RecordingSettings,
        *,
        ros_distro: str = "jazzy",
        opener: FileOpener = open_unbuffered,
    ) -> None:
        self.path = path
        self._settings = settings
        self._limit = int(settings.queue_size * 1e6)
        self._queue: deque[_Waiting] = deque()
        self._bytes_in, self._bytes_out = 0, 0
        self._received = {topic.name: _Received() for topic in topics}
        self._written = {topic.name: _Written() for topic in topics}
        self._before = self._snapshot()
        self._file_begin: int | None = None
        self._split_due = False
        self.error = ""
        """Why the recording ended before it was stopped; empty if it did not."""
        self._free: int | None = None
        self._silence = -math.inf  # time without a heartbeat, s, from the first one on
        self.remark = ""
        """A sentence on the log times for report and metadata, by the receiving thread."""
        self.paused = False
        """Whether messages are left out at present."""
        self._watch = DriveWatch()
        self._changes: list[DriveChange] = []
        self._begun: int | None = None  # log time of the first message of the drive, ns
        self._open, self._failed = True, False
        self._stopping = threading.Event()
        self._writer = Rosbag2McapWriter(
            path,
            chunk_size=settings.chunk_size,
            compression="" if settings.compression == "none" else settings.compression,
            ros_distro=ros_distro,
            live=True,
            opener=opener,
        )
        self._place = self._found()
        self._topics = {topic.name: topic for topic in topics}
        self._absent = {topic.name for topic in topics if topic.optional}  # not in the bag yet
        for topic in topics:
            if not topic.optional:
                self._writer.add_topic(topic.name, topic.type_name, qos=topic.qos)
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._thread.start()

    def add_topic(self, topic: RecordedTopic) -> None:
        """Record an optional topic that has come up; to be called by the receiving thread."""
        if topic.name in self._received:
            return
        self._written[topic.name], self._before[topic.name] = _Written(), _Written()
        self._topics[topic.name] = topic
        self._absent.add(topic.name)
        self._received[topic.name] = _Received()

    def pause(self) -> None:
        """Leave out what comes until :meth:`resume`, without counting it as lost."""
        self.paused = True

    def resume(self) -> None:
        """Record again."""
        self.paused = False
        self._watch.interrupt()
        for received in self._received.values():
            received.count.interrupt()

    def heartbeat(self) -> None:
        """Note a sign of life of whoever records: without further ones for ``lease_time``, the recording ends."""
        self._silence = 0.0

    def split(self) -> None:
        """Continue in a new file, behind all that was received."""
        if self._open:
            self._queue.append(_SPLIT)

    def publishers(self, topic: str, found: Sequence[Publisher], log_time: int) -> None:
        """Take who publishes a topic; to be called by the receiving thread, several times a second."""
        if topic in self._topics and self._topics[topic].type_name in _FEEDBACK:
            self._divide(self._watch.publishers(topic, {each.identity: each.node for each in found}), log_time)

    def receive(self, topic: str, data: bytes, log_time: int) -> None:
        """Count a message and enqueue it; to be called by one thread.

        Parameters
        ----------
        data : bytes
            CDR.
        log_time : int
            When it was received, ns.
        """
        if not self._open or self.paused:
            return
        received = self._received[topic]
        head = self._head(topic, data, log_time)
        if head is None:
            received.unreadable += 1
        elif not self._topics[topic].blocks:
            received.count.samples += 1
            received.count.blocks += 1
        else:
            block = (head.first_sample, head.samples, head.stamp, head.sample_period)
            if self._topics[topic].type_name in _FEEDBACK:
                self._divide(self._watch.block(topic, *block, head.frame), log_time)
                self._begun = log_time if self._begun is None else self._begun
            received.count.add(*block)
        size = len(data) + _OVERHEAD
        if self._bytes_in - self._bytes_out + size > self._limit:
            received.overflowed += head.samples if head else 0
            return
        self._queue.append(_Waiting(topic, data, log_time, head))
        self._bytes_in += size

    def _divide(self, reason: Message | None, log_time: int) -> None:
        """Begin another recording in the bag, in a file of its own, unless it is empty so far."""
        if reason is None or self._begun is None:
            return
        if not self._changes or log_time - self._changes[-1].log_time > _BURST * NANOSECONDS:
            self._changes.append(DriveChange(reason, log_time, (log_time - self._begun) / NANOSECONDS))
            self.split()

    def stop(self, patience: float | None = None) -> bool:
        """Write the queue to the disk and complete the bag; may be called again.

        Parameters
        ----------
        patience : float, optional
            Time to wait for the disk, s; default: as long as it takes.

        Returns
        -------
        bool
            Whether the recording has ended.
        """
        self._open = False
        self._stopping.set()
        self._thread.join(patience)
        return not self._thread.is_alive()

    def report(self) -> RecordingReport:
        """Return the state of the recording."""
        topics = []
        for name, received in list(self._received.items()):
            count, written = received.count, self._written[name]
            if self._topics[name].optional and not (count.blocks or received.unreadable):
                continue
            discarded = count.samples - written.samples - received.overflowed if self._failed else 0
            topics.append(
                TopicReport(
                    name, written.messages, count.samples, written.samples, count.lost, count.losses,
                    received.overflowed, discarded, count.restarts, received.unreadable, count.counts_nothing,
                    written.first_stamp, written.last_stamp,
                )
            )  # fmt: skip
        files = self._writer.files
        waiting = self._bytes_in - self._bytes_out
        return RecordingReport(
            self.path, tuple(topics), len(files), self._writer.size, waiting, self.error, self.remark, self._free,
            tuple(self._changes),
        )  # fmt: skip

    # -- the writing thread ----------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._write_until_stopped()
            if self._is_gone():
                self._give_up()
            else:
                self._open = False
                self._write_queue()
                self._writer.close(self.report().custom_data())
        except (DriveIdError, OSError) as error:
            if self._is_gone():
                self._give_up()
            else:
                self._fail(str(error))
        except Exception as error:  # noqa: BLE001  # a writer that dies without a word would lose everything
            self._fail(f"The writer of {self.path} failed ({type(error).__name__}: {error}): report this as a bug.")

    def _write_until_stopped(self) -> None:
        flushed = time.monotonic()
        stopping, looked = False, flushed
        while not stopping:
            stopping = self._stopping.wait(_POLL)
            self._write_queue()
            before, looked = looked, time.monotonic()
            self._silence += min(looked - before, _HELD_UP)
            if self._is_left():
                return
            if time.monotonic() - flushed >= self._settings.flush_period - _POLL:
                flushed = time.monotonic()  # what comes while the disk works waits for the next one
                self._writer.flush()
                if self._is_gone() or self._is_short():
                    return

    def _write_queue(self) -> None:
        for _ in range(len(self._queue)):
            self._write(self._queue.popleft())

    def _is_left(self) -> bool:
        """Tell whether the client that began the recording is gone."""
        left = self._silence > self._settings.lease_time
        if left:
            silent = f"The client that records has sent no heartbeat for {self._silence:.1f} s, longer than lease_time."
            self.error = f"{silent} {_COMPLETE}"
        return left

    def _is_short(self) -> bool:
        """Tell whether the recording must end before the disk is full."""
        self._free = free_space(self.path)
        short = shortage(self._free, self._settings, self.path)
        if short:
            self.error = f"{short} {_COMPLETE}"
        return bool(short)

    def _write(self, message: _Waiting) -> None:
        if message is _SPLIT:
            self._split_due = True  # with the next message, so that no file is empty
            return
        if self._file_begin is None:
            self._file_begin = message.log_time
        elif self._split_due or self._is_full(message.log_time):
            self._writer.split()
            self._place = self._found()
            self._file_begin = message.log_time
            self._before = self._snapshot()
        self._split_due = False
        if message.topic in self._absent:
            self._absent.remove(message.topic)
            topic = self._topics[message.topic]
            self._writer.add_topic(
                topic.name, topic.type_name, qos=topic.qos, definition=topic.definition, hash_=topic.hash_
            )
        self._writer.write(message.topic, message.data, message.log_time)
        self._written[message.topic].add(message.head)
        self._bytes_out += len(message.data) + _OVERHEAD

    def _head(self, topic: str, data: bytes | memoryview, log_time: int) -> BlockHead | None:
        """Return the head of a message; None if it should be a block and is not."""
        if not self._topics[topic].blocks:
            return BlockHead(log_time, 0, 0.0, 1)
        try:
            return read_head(data)
        except ValueError:
            return None

    def _snapshot(self) -> dict[str, _Written]:
        return {name: replace(written) for name, written in list(self._written.items())}

    def _is_full(self, log_time: int) -> bool:
        size, duration = self._settings.max_file_size, self._settings.max_file_duration
        begin = self._file_begin or 0
        return (0 < size <= self._writer.file_size / 1e6) or (0 < duration <= (log_time - begin) / NANOSECONDS)

    def _found(self) -> tuple[tuple[int, int], ...] | None:
        """Return the identities of the folder and of the file being written; None if one of them is not there."""
        try:
            found = [path.stat() for path in (self.path, self._writer.files[-1])]
        except OSError:
            return None
        return tuple((entry.st_dev, entry.st_ino) for entry in found)

    def _is_gone(self) -> bool:
        """Tell whether the bag was removed or renamed: writing to such a file succeeds, only its name tells."""
        return self._place is None or self._found() != self._place

    def _give_up(self) -> None:
        """End a bag that is gone: none of its samples counts as written, and nothing is put in its place."""
        self._open = False
        self._queue.clear()
        self._bytes_out = self._bytes_in
        with suppress(DriveIdError):
            self._writer.end_early()  # for a folder that was only renamed
        self._written = {name: _Written() for name in self._written}
        self._failed = True
        self.error = (
            f"{self.path} was removed or renamed while it was being recorded, so the recording has ended: if the "
            "folder is elsewhere, complete it with 'drive-id recover'."
        )

    def _fail(self, reason: str) -> None:
        """End the bag behind the last record that was written, and count its messages again."""
        self._open = False
        self._queue.clear()
        self._bytes_out = self._bytes_in
        advice = "what was written until then is complete and readable."
        try:
            self._writer.end_early()
            self._count_written()
            self._failed = True
            self._writer.describe(self.report().custom_data() | {"error": reason})
        except DriveIdError:
            advice = "what was written until then breaks off: complete it with 'drive-id recover'."
            with suppress(DriveIdError):
                self._count_written()
        self._failed = True
        self.error = f"{reason} The recording has ended; {advice}"

    def _count_written(self) -> None:
        """Count the messages in the last file again: some of those handed to the writer never reached the disk."""
        written = self._before
        file = self._writer.files[-1]
        with closing(McapStorage(file, file)) as storage:
            for message in storage.messages(frozenset(written)):
                written[message.topic].add(self._head(message.topic, message.data, message.log_time))
        self._written = written


def free_space(path: Path) -> int | None:
    """Return the free bytes of the disk that holds a path, there or yet to be made; None if it does not tell."""
    folder = next(each for each in (path, *path.parents) if each.exists())
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


def shortage(free: int | None, settings: RecordingSettings, path: Path) -> str:
    """Return a sentence if the disk of a path has too little space for a recording, else an empty one."""
    if free is None or free >= 1e6 * settings.least_free_space:
        return ""
    return (
        f"The disk of {path} has {free / 1e6:.0f} MB left, less than least_free_space "
        f"({settings.least_free_space:g} MB): free some space, or lower it."
    )
