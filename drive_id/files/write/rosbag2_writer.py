"""Recordings as rosbag2 writes them: a folder with MCAP files and ``metadata.yaml`` of version 9."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import yaml

from drive_id.errors import OutputError
from drive_id.files.messages.messages import DEFINITIONS, schema_text, type_hash
from drive_id.files.storage.container import reason
from drive_id.files.storage.mcap_stream import FileOpener, open_unbuffered
from drive_id.files.storage.metadata import FileEntry, Qos, TopicEntry, bag_information, write_metadata
from drive_id.files.write.rosbag2_file import CHUNK_SIZE, FileOptions, RosbagFile

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["CHUNK_SIZE", "Qos", "Rosbag2McapWriter"]

_RESERVE = "reserve.partial"
_RESERVE_SIZE = 64 * 1024


class Rosbag2McapWriter:
    """Write one recording, message by message, already serialized.

    What was flushed can be recovered when the process dies; ``close`` makes the recording complete. After an error of
    the disk, ``end_early`` ends it behind what was written.

    Parameters
    ----------
    path : Path
        Folder to create.
    name : str, optional
        Of the recording, from which its files are named ``<name>_<N>.mcap``; default: the folder's.
    chunk_size : int
        Bytes.
    compression : str
        Of the chunks: ``zstd``, ``lz4`` or empty.
    ros_distro : str
        For the record.
    live : bool
        Mark the files as written live, and keep some space of the disk for ending them when it is full.
    opener : callable
        Creates the files.

    Raises
    ------
    OutputError
        When the folder exists or cannot be written; from every method.
    """

    def __init__(
        self,
        path: Path,
        *,
        name: str = "",
        chunk_size: int = CHUNK_SIZE,
        compression: str = "zstd",
        ros_distro: str = "jazzy",
        live: bool = False,
        opener: FileOpener = open_unbuffered,
    ) -> None:
        self.path = path
        self._name = name or path.name
        self._options = FileOptions(chunk_size, compression, live, opener)
        self._distro = ros_distro
        self._topics: dict[str, TopicEntry] = {}
        self._sequence: Counter[str] = Counter()
        self._earlier: list[RosbagFile] = []
        self._closed = False
        try:
            path.mkdir(parents=True)
        except FileExistsError as error:
            raise OutputError(f"{path} exists already: choose another name, or remove it.") from error
        except OSError as error:
            raise _refused(path, error) from error
        try:
            if live:
                (path / _RESERVE).write_bytes(bytes(_RESERVE_SIZE))
            self._file = self._open_file(0)
        except OSError as error:
            self._free_reserve()
            with suppress(OSError):
                path.rmdir()
            raise _refused(path, error) from error

    @property
    def _files(self) -> list[RosbagFile]:
        return [*self._earlier, self._file]

    @property
    def message_count(self) -> int:
        """Messages written so far."""
        return sum(file.entry.count for file in self._files)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files so far, the last one being written."""
        return tuple(file.path for file in self._files)

    @property
    def file_size(self) -> int:
        """Bytes in the file being written, what waits in its last chunk not counted."""
        return self._file.size

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return sum(file.size for file in self._files)

    def add_topic(
        self, topic: str, type_name: str, *, qos: Qos | None = None, definition: str = "", hash_: str = ""
    ) -> None:
        """Announce a topic.

        Parameters
        ----------
        topic : str
            Absolute name.
        type_name : str
            ``package/msg/Name``.
        qos : Qos, optional
        definition, hash_ : str
            Complete ``ros2msg`` definition and RIHS01 hash; known for our own sample messages.
        """
        if topic in self._topics:
            raise OutputError(f"Topic {topic} is recorded already: record each topic once.")
        if not definition and type_name in DEFINITIONS:
            definition, hash_ = schema_text(type_name), type_hash(type_name)
        self._topics[topic] = TopicEntry(topic, type_name, hash_, [(qos or Qos()).profile()], definition)
        self._file.add_topic(self._topics[topic])

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int | None = None) -> None:
        """Write one serialized message.

        Parameters
        ----------
        topic : str
        data : bytes
            CDR.
        log_time, publish_time : int
            ns; when it was received and published.
        """
        published = log_time if publish_time is None else publish_time
        try:
            self._file.write(topic, data, log_time, published, self._sequence[topic] & 0xFFFFFFFF)
        except OSError as error:
            raise _refused(self.path, error) from error
        self._sequence[topic] += 1

    def attach(self, name: str, data: bytes, media_type: str = "application/octet-stream") -> None:
        """Put a file beside the messages."""
        with self._refusal():
            self._file.attach(name, data, media_type)

    def flush(self, *, sync: bool = False) -> None:
        """Hand everything written so far to the operating system, so that it survives the end of this process.

        Parameters
        ----------
        sync : bool
            Wait until it is on the disk, so that it survives a power cut too.
        """
        with self._refusal():
            self._file.flush(sync=sync)

    def split(self) -> None:
        """Complete the file being written and go on in a new one."""
        with self._refusal():
            self._finish_file(None)
            file = self._open_file(len(self._earlier) + 1)
        self._earlier.append(self._file)
        self._file = file

    def close(self, custom: Mapping[str, str] | None = None) -> None:
        """Complete the recording: index, end mark and ``metadata.yaml``.

        Parameters
        ----------
        custom : mapping of str to str, optional
            Kept as ``custom_data`` in ``metadata.yaml`` and as metadata ``drive_id`` in the last file.
        """
        if self._closed:
            return
        self._free_reserve()
        with self._refusal():
            self._finish_file(custom)
        self.describe(custom)
        self._closed = True

    def end_early(self) -> None:
        """End the file behind what reached the disk, after an error of the disk: without an index, but readable.

        Raises
        ------
        OutputError
            When not even that goes; then the file breaks off, as if the process had been killed.
        """
        self._closed = True
        self._free_reserve()
        try:
            with self._refusal():
                if not self._file.finished:
                    self._file.end_early()
        finally:
            self._file.release()

    def describe(self, custom: Mapping[str, str] | None = None) -> None:
        """Write ``metadata.yaml`` about the files, when they are complete.

        Parameters
        ----------
        custom : mapping of str to str, optional
            Its ``custom_data``.
        """
        with self._refusal():
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

    def _open_file(self, number: int) -> RosbagFile:
        file = RosbagFile(self.path / f"{self._name}_{number}.mcap", self._options)
        for topic in self._topics.values():
            file.add_topic(topic)
        return file

    def _finish_file(self, custom: Mapping[str, str] | None) -> None:
        if self._file.finished:
            return
        dumped = yaml.safe_dump(self._information([self._file.entry], custom), sort_keys=False)
        own = {"drive_id": dict(custom)} if custom else {}
        self._file.finish({**own, "rosbag2": {"serialized_metadata": dumped}})

    def _information(self, files: list[FileEntry], custom: Mapping[str, str] | None) -> dict[str, Any]:
        return bag_information(list(self._topics.values()), files, self._distro, custom)

    def _free_reserve(self) -> None:
        with suppress(OSError):
            (self.path / _RESERVE).unlink(missing_ok=True)

    @contextmanager
    def _refusal(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise _refused(self.path, error) from error


def _refused(path: Path, error: OSError) -> OutputError:
    return OutputError(f"{path} cannot be written ({reason(error)}): check its folder, permissions and free space.")
