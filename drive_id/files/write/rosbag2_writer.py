"""rosbag2 recordings, written message by message: a folder with MCAP files and ``metadata.yaml`` of version 9.

``mcap`` keeps the index of a file in memory until the file is complete: 0.7 kB per chunk, which is 18 MB per hour of a
drive at 10 kHz in chunks of 64 kB. :meth:`Rosbag2McapWriter.split` releases it.
"""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any, BinaryIO, cast

import yaml
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from drive_id.common.interrupts import held, note_complete
from drive_id.errors import OutputError
from drive_id.files.inputs.input_file import reason
from drive_id.files.messages.messages import DEFINITIONS, schema_text, type_hash
from drive_id.files.storage.container import MCAP_MAGIC
from drive_id.files.storage.durable import make_folder, sync_folder
from drive_id.files.storage.mcap import RECORDER_LIBRARY, McapStorage
from drive_id.files.storage.metadata import FileEntry, Qos, TopicEntry, bag_information, write_metadata

if TYPE_CHECKING:
    from typing_extensions import Self

LIBRARY = "drive_id"
CHUNK_SIZE = 64 * 1024
"""Bytes per chunk before compression; a killed recorder loses at most one chunk and what was not flushed."""
_COMPRESSIONS = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
_END_WITHOUT_SUMMARY = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0)
_RESERVE = "reserve.partial"
_RESERVE_SIZE = 64 * 1024  # bytes that are freed on a full disk, for the end of the bag and its metadata

FileOpener = Callable[[Path], BinaryIO]


def open_unbuffered(path: Path) -> BinaryIO:
    """Create a file whose writes reach the operating system at once."""
    return path.open("xb", buffering=0)


class McapStream:
    """The file below ``mcap.writer.Writer``, each of whose writes holds whole records.

    A write that fails is undone by :meth:`end_early`, which ends the file behind the last whole record. ``opener``
    creates the file; tests give a disk that fills up.
    """

    def __init__(self, path: Path, opener: FileOpener = open_unbuffered) -> None:
        self._stream = opener(path)
        self.position = 0
        self.data_end: int | None = None
        """Where the data ends, once only index and end mark follow."""

    def write(self, data: bytes) -> int:
        """Write all of ``data`` or raise OSError."""
        view = memoryview(data)
        while view:
            view = view[self._stream.write(view) :]
        self.position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self.position

    def flush(self) -> None:
        """Do nothing: every write has reached the operating system."""

    def sync(self) -> None:
        """Wait until everything written is on the disk and survives a power cut."""
        os.fsync(self._stream.fileno())

    def end_early(self) -> None:
        """Cut off an incomplete write and end the file without an index; OSError when the disk refuses that, too."""
        end = self.position if self.data_end is None else self.data_end
        self._stream.truncate(end)
        self._stream.seek(end)
        self.write(_END_WITHOUT_SUMMARY + MCAP_MAGIC)
        self.sync()

    def close(self) -> None:
        """Release the file."""
        self._stream.close()


class McapOutput:
    """A file being written, or complete. All methods raise OSError when the disk refuses."""

    def __init__(
        self, path: Path, opener: FileOpener, *, chunk_size: int, compression: str, library: str, profile: str = "ros2"
    ) -> None:
        self.path = path
        self.entry = FileEntry(path.name)
        self.finished = False
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._stream = McapStream(path, opener)
        self.writer = Writer(
            cast(IO[Any], self._stream),
            chunk_size=chunk_size,
            compression=_COMPRESSIONS[compression],
            enable_data_crcs=True,
        )
        try:
            self.writer.start(profile=profile, library=library)
        except OSError:
            self.release()
            path.unlink()
            raise

    @property
    def size(self) -> int:
        """Bytes written, without the chunk in memory."""
        return self._stream.position

    def add_topic(self, topic: TopicEntry) -> None:
        """Announce a topic."""
        if topic.type_name not in self._schemas:
            encoding = "ros2msg" if topic.definition else ""
            schema = self.writer.register_schema(topic.type_name, encoding, topic.definition.encode())
            self._schemas[topic.type_name] = schema
        offered = yaml.safe_dump(topic.offered_qos, sort_keys=False).strip()
        metadata = {"offered_qos_profiles": offered, "topic_type_hash": topic.hash}
        self._channels[topic.name] = self.writer.register_channel(
            topic.name, "cdr", self._schemas[topic.type_name], metadata
        )

    def write(self, topic: str, data: bytes, log_time: int, sequence: int) -> None:
        """Write one serialized message, logged and published at ``log_time``, ns."""
        self.writer.add_message(self._channels[topic], log_time, data, log_time, sequence)
        self.entry.note(topic, log_time)

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Add an attachment."""
        time = self.entry.first or 0
        self.writer.add_attachment(time, time, name, media_type, data)

    def flush(self) -> None:
        """Write what is in memory and wait until all is on the disk."""
        self.writer.flush()  # type: ignore[no-untyped-call]
        self._stream.sync()

    def finish(self, information: Mapping[str, Any], custom: Mapping[str, str] | None = None) -> None:
        """Complete the file, with the content of a ``metadata.yaml`` about it, and metadata ``drive_id``."""
        self.writer.flush()  # type: ignore[no-untyped-call]
        self._stream.data_end = self._stream.position
        if custom:
            self.writer.add_metadata("drive_id", dict(custom))
        self.writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)})
        self.writer.finish()  # type: ignore[no-untyped-call]
        self._stream.sync()
        self._stream.close()
        del self.writer  # and the index that it holds
        self.finished = True

    def end_early(self) -> None:
        """End the file behind what reached the disk: without an index, but readable."""
        self._stream.end_early()
        storage = McapStorage(self.path, self.path)
        try:
            counts = {topic.name: topic.count or 0 for topic in storage.topics}
            self.entry = FileEntry(self.path.name, storage.start if any(counts.values()) else None, storage.end, counts)
        finally:
            storage.close()

    def release(self) -> None:
        """Close the file, complete or not."""
        with suppress(OSError):
            self._stream.close()


class Rosbag2McapWriter:
    """Write one recording, message by message, already serialized.

    :meth:`close` completes the recording; what was flushed before the process died can be recovered. After an error of
    the disk, :meth:`end_early` ends it behind what was written. Every method raises OutputError when the folder exists
    or cannot be written.

    Parameters
    ----------
    path : Path
        Folder to create; its files are named ``<folder>_<N>.mcap``.
    chunk_size : int
        Bytes.
    compression : str
        Of the chunks: ``zstd``, ``lz4`` or empty.
    live : bool
        Mark the files as written live, and reserve disk space for ending them when the disk is full.
    """

    def __init__(
        self,
        path: Path,
        *,
        chunk_size: int = CHUNK_SIZE,
        compression: str = "zstd",
        ros_distro: str = "jazzy",
        live: bool = False,
        opener: FileOpener = open_unbuffered,
    ) -> None:
        self.path = path
        library = RECORDER_LIBRARY if live else LIBRARY
        self._new_file = partial(
            McapOutput, opener=opener, chunk_size=chunk_size, compression=compression, library=library
        )
        self._distro = ros_distro
        self._topics: dict[str, TopicEntry] = {}
        self._sequence: Counter[str] = Counter()
        self._files: list[McapOutput] = []
        self._closed = False
        with _refusal(path):
            try:
                self._unsynced = make_folder(path) | {path}
            except FileExistsError as error:
                raise _taken(path) from error
            try:
                if live:
                    (path / _RESERVE).write_bytes(bytes(_RESERVE_SIZE))
                self._open_file()
            except OSError:
                self._free_reserve()
                with suppress(OSError):
                    path.rmdir()
                raise

    @property
    def _file(self) -> McapOutput:
        return self._files[-1]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files so far, the last one being written."""
        return tuple(file.path for file in self._files)

    @property
    def file_size(self) -> int:
        """Bytes in the file being written, without the chunk in memory."""
        return self._file.size

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return sum(file.size for file in self._files)

    def add_topic(
        self, topic: str, type_name: str, *, qos: Qos | None = None, definition: str = "", hash_: str = ""
    ) -> None:
        """Announce a topic by its absolute name and its type, ``package/msg/Name``.

        Its complete ``ros2msg`` definition and RIHS01 hash are known for our own sample messages.
        """
        if topic in self._topics:
            raise OutputError(f"Topic {topic} is recorded already: record each topic once.")
        if not definition and type_name in DEFINITIONS:
            definition, hash_ = schema_text(type_name), type_hash(type_name)
        self._topics[topic] = TopicEntry(topic, type_name, hash_, [(qos or Qos()).profile()], definition)
        self._file.add_topic(self._topics[topic])

    def write(self, topic: str, data: bytes, log_time: int) -> None:
        """Write one message in CDR, received at ``log_time``, ns."""
        try:  # for each message, so without a context manager
            self._file.write(topic, data, log_time, self._sequence[topic] & 0xFFFFFFFF)
        except OSError as error:
            raise _refused(self.path, error) from error
        self._sequence[topic] += 1

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Add an attachment."""
        with _refusal(self.path):
            self._file.attach(name, data, media_type)

    def flush(self) -> None:
        """Wait until everything written so far is on the disk, so that it survives a power cut."""
        with _refusal(self.path):
            self._file.flush()
            self._sync_names()

    def split(self) -> None:
        """Complete the file being written and continue in a new one."""
        with _refusal(self.path):
            self._finish_file(None)
            self._open_file()
        self._unsynced.add(self.path)

    def close(self, custom: Mapping[str, str] | None = None) -> None:
        """Complete the recording: index, end mark and ``metadata.yaml``.

        ``custom`` becomes ``custom_data`` in ``metadata.yaml``, and the metadata ``drive_id`` in the last file.
        """
        if self._closed:
            return
        self._free_reserve()
        with _refusal(self.path):
            self._finish_file(custom)
            self._sync_names()
        self.describe(custom)
        self._closed = True

    def end_early(self) -> None:
        """End the file behind what reached the disk, after an error of the disk: without an index, but readable.

        Raises OutputError when the disk refuses that, too; then the file breaks off, as if the process had been killed.
        """
        self._closed = True
        self._free_reserve()
        try:
            with _refusal(self.path):
                if not self._file.finished:
                    self._file.end_early()
                self._sync_names()
        finally:
            self._file.release()

    def describe(self, custom: Mapping[str, str] | None = None) -> None:
        """Write ``metadata.yaml`` about the files, when they are complete, with ``custom`` as its ``custom_data``."""
        with _refusal(self.path):
            write_metadata(self.path, self._information([file.entry for file in self._files], custom))

    def abandon(self) -> None:
        """Close the file without completing the recording."""
        self._closed = True
        self._free_reserve()
        self._file.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.close()
        finally:
            if not self._closed:
                self.abandon()

    def _open_file(self) -> None:
        file = self._new_file(self.path / f"{self.path.name}_{len(self._files)}.mcap")
        for topic in self._topics.values():
            file.add_topic(topic)
        self._files.append(file)

    def _finish_file(self, custom: Mapping[str, str] | None) -> None:
        if not self._file.finished:
            self._file.finish(self._information([self._file.entry], custom), custom)

    def _sync_names(self) -> None:
        """Wait until the names of folder and files are on the disk: syncing a file keeps its content only."""
        for folder in tuple(self._unsynced):
            sync_folder(folder)
            self._unsynced.discard(folder)

    def _information(self, files: list[FileEntry], custom: Mapping[str, str] | None) -> dict[str, Any]:
        return bag_information(list(self._topics.values()), files, self._distro, custom)

    def _free_reserve(self) -> None:
        with suppress(OSError):
            (self.path / _RESERVE).unlink(missing_ok=True)


@contextmanager
def whole_or_nothing(path: Path) -> Iterator[Path]:
    """Yield the path of a folder to make, which becomes ``path`` when the block ends without an error.

    A writer has synced what is in the folder by then, so that ``path`` is also whole after a power cut.

    Raises OutputError when ``path`` exists or cannot be written.
    """
    with _refusal(path):
        if path.exists() or path.is_symlink():
            raise _taken(path)
        unsynced = make_folder(path.parent, exist_ok=True) | {path.parent}
        around: Path | None = None
        try:
            with held():
                around = Path(tempfile.mkdtemp(prefix=f".{path.name}.partial-", dir=path.parent))
            yield around / path.name
            with held():
                (around / path.name).rename(path)
                note_complete(path)
            for folder in unsynced:
                sync_folder(folder)
        finally:
            if around is not None:
                with held():
                    shutil.rmtree(around, ignore_errors=True)


@contextmanager
def _refusal(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _refused(path, error) from error


def _taken(path: Path) -> OutputError:
    return OutputError(f"{path} exists already: choose another name, or remove it.")


def _refused(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path} cannot be written ({reason(error)}): check its folder, permissions and free space.")
