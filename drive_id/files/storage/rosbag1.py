"""Storage files of ROS 1 (``.bag``), read by rosbags."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path

from rosbags.rosbag1 import Reader, ReaderError

from drive_id.errors import TruncatedBagError
from drive_id.files.storage.container import RawMessage, Storage, TopicInfo, merged_topics

_ERRORS = (ReaderError, ValueError, KeyError, IndexError, AssertionError, OSError, EOFError, RuntimeError, struct.error)


class Rosbag1Storage(Storage):
    """One ROS 1 bag, named ``shown`` in errors; raises TruncatedBagError when it was not completed, or is damaged."""

    kind = "rosbag1"

    def __init__(self, path: Path, shown: Path) -> None:
        self._shown = shown
        with self._one_sentence():
            self._reader = Reader(path)
            self._reader.open()
        self.topics = tuple(
            merged_topics(
                TopicInfo(found.topic, found.msgtype, found.msgcount, "ros1", "ros1msg", found.msgdef.data)
                for found in self._reader.connections
            ).values()
        )
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
        wanted = [connection for connection in self._reader.connections if connection.topic in topics]
        if not wanted:
            return
        self._count, self._done = sum(connection.msgcount for connection in wanted), 0
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
