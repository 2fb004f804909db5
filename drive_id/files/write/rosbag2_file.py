"""One MCAP file of a recording, as rosbag2 writes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

import yaml
from mcap.data_stream import RecordBuilder
from mcap.records import ChunkIndex
from mcap.writer import CompressionType, Writer

from drive_id.files.storage.mcap import RECORDER_LIBRARY, McapStorage
from drive_id.files.storage.mcap_stream import FileOpener, McapStream, open_unbuffered
from drive_id.files.storage.metadata import FileEntry, TopicEntry

LIBRARY = "drive_id"
CHUNK_SIZE = 64 * 1024
"""Bytes per chunk before compression; a killed recorder loses at most this and what was not flushed."""
_COMPRESSIONS = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}


@dataclass(frozen=True)
class FileOptions:
    """How files are written: chunks of so many bytes, their compression, whether by the recorder, on which disk."""

    chunk_size: int = CHUNK_SIZE
    compression: str = "zstd"
    live: bool = False
    opener: FileOpener = open_unbuffered


class RosbagFile:
    """One file, being written. All methods raise OSError when the disk refuses.

    Parameters
    ----------
    path : Path
        To create.
    options : FileOptions
    """

    def __init__(self, path: Path, options: FileOptions) -> None:
        self.path = path
        self.entry = FileEntry(path.name)
        self.finished = False
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._stream = McapStream(path, options.opener)
        self._writer = Writer(
            cast(IO[Any], self._stream),
            chunk_size=options.chunk_size,
            compression=_COMPRESSIONS[options.compression],
            enable_data_crcs=True,
        )
        _pack_chunk_indexes(self._writer)
        try:
            self._writer.start(profile="ros2", library=RECORDER_LIBRARY if options.live else LIBRARY)
        except OSError:
            self.release()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes in the file, what waits in its last chunk not counted."""
        return self._stream.position

    def add_topic(self, topic: TopicEntry) -> None:
        """Announce a topic."""
        if topic.type_name not in self._schemas:
            encoding = "ros2msg" if topic.definition else ""
            schema = self._writer.register_schema(topic.type_name, encoding, topic.definition.encode())
            self._schemas[topic.type_name] = schema
        offered = yaml.safe_dump(topic.offered_qos, sort_keys=False).strip()
        metadata = {"offered_qos_profiles": offered, "topic_type_hash": topic.hash}
        self._channels[topic.name] = self._writer.register_channel(
            topic.name, "cdr", self._schemas[topic.type_name], metadata
        )

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int, sequence: int) -> None:
        """Write one serialized message; times in ns."""
        self._writer.add_message(self._channels[topic], log_time, data, publish_time, sequence)
        self.entry.note(topic, log_time)

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Put a file beside the messages."""
        time = self.entry.first or 0
        self._writer.add_attachment(time, time, name, media_type, data)

    def flush(self, *, sync: bool = False) -> None:
        """Hand everything written so far to the operating system, and wait for the disk if ``sync``."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        if sync:
            self._stream.sync()

    def finish(self, metadata: dict[str, dict[str, str]]) -> None:
        """Complete the file, with metadata by name."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._stream.begin_end()
        for name, data in metadata.items():
            self._writer.add_metadata(name, data)
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.sync()
        self._stream.close()
        self.finished = True

    def end_early(self) -> None:
        """End the file behind what reached the disk, after an error of the disk: without an index, but readable."""
        self._stream.end_early()
        storage = McapStorage(self.path, self.path)
        try:
            counts = {topic.name: topic.count or 0 for topic in storage.topics}
            self.entry = FileEntry(self.path.name, storage.start if any(counts.values()) else None, storage.end, counts)
        finally:
            storage.close()

    def release(self) -> None:
        """Close the file, however it is."""
        with suppress(OSError):
            self._stream.close()


class _PackedIndexes:
    """A list of chunk indexes that keeps the bytes of their records, a fifth of what the objects take."""

    def __init__(self) -> None:
        self._records = bytearray()

    def append(self, index: ChunkIndex) -> None:
        builder = RecordBuilder()
        index.write(builder)
        self._records += cast(Callable[[], bytes], builder.end)()

    def __iter__(self) -> Iterator[_PackedIndexes]:
        yield self

    def write(self, builder: RecordBuilder) -> None:
        builder.write(self._records)


def _pack_chunk_indexes(writer: Writer) -> None:
    """Let a recording of hours need little memory; another version of mcap may keep its list elsewhere."""
    if getattr(writer, "_Writer__chunk_indices", None) == []:
        writer._Writer__chunk_indices = _PackedIndexes()  # type: ignore[attr-defined]  # noqa: SLF001
