"""Storage files of ROS 1 (``.bag``), read by rosbags."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rosbags.rosbag1 import Reader, ReaderError

from drive_id.errors import MessageTypeError, TruncatedBagError
from drive_id.files.storage.container import RawMessage, Storage, TopicInfo

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_ERRORS = (ReaderError, ValueError, KeyError, IndexError, AssertionError, OSError, EOFError, RuntimeError, struct.error)


class Rosbag1Storage(Storage):
    """One ROS 1 bag, named ``shown`` in errors; raises TruncatedBagError when it was not completed, or is damaged."""

    kind = "rosbag1"

    def __init__(self, path: Path, shown: Path) -> None:
        self._shown = shown
        with self._one_sentence():
            self._reader = Reader(path)
            self._reader.open()
        connections: dict[str, list[Connection]] = defaultdict(list)
        for connection in self._reader.connections:
            connections[connection.topic].append(connection)
        for topic, members in connections.items():
            if len({member.msgtype for member in members}) > 1:
                self.close()
                raise MessageTypeError(f"{topic} has several types in {shown}: divide the bag.")
        self.topics = tuple(
            TopicInfo(
                topic,
                members[0].msgtype,
                sum(member.msgcount for member in members),
                "ros1",
                "ros1msg",
                members[0].msgdef.data,
            )
            for topic, members in connections.items()
        )
        self._connections = connections
        count = self._reader.message_count
        self.start = self._reader.start_time if count else 0
        self.end = self._reader.end_time if count else 0
        self._done, self._count = 0, count

    @property
    def progress(self) -> float:
        """Part of the messages that has been read, 0 to 1."""
        return min(self._done / self._count, 1.0) if self._count else 0.0

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in order of arrival."""
        wanted = [member for topic in topics for member in self._connections.get(topic, ())]
        if not wanted:
            return
        self._count, self._done = sum(member.msgcount for member in wanted), 0
        with self._one_sentence():
            for connection, stamp, data in self._reader.messages(wanted):
                self._done += 1
                yield RawMessage(connection.topic, stamp, data)

    def close(self) -> None:
        """Release the file."""
        if self._reader.bio is not None:
            self._reader.close()

    @contextmanager
    def _one_sentence(self) -> Iterator[None]:
        try:
            yield
        except _ERRORS as error:
            said = " ".join(str(error).split())[:160]
            raise TruncatedBagError(
                f"{self._shown} is no readable ROS 1 bag ({said}): repair it with 'rosbag reindex', or record it again."
            ) from error
