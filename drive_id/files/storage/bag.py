"""A recording as a whole: one storage file, or a folder of them with or without ``metadata.yaml``."""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.errors import BagError, MessageCountError, MessageTypeError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import open_input, reason
from drive_id.files.storage.container import (
    MCAP_MAGIC,
    ROSBAG1_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    RawMessage,
    Storage,
    UnpackBudget,
    decompress,
    file_size,
    has_checksum,
    merged_topics,
    read_magic,
    readable,
    unpack_file,
)
from drive_id.files.storage.mcap import McapStorage
from drive_id.files.storage.metadata import BagMetadata, read_metadata
from drive_id.files.storage.sqlite import SqliteStorage

_ENDINGS = tuple(kind + packed for kind in (".mcap", ".db3") for packed in ("", ".zstd", ".lz4", ".zst"))


@dataclass(eq=False)
class Bag:
    """An open recording; made by :func:`open_bag`."""

    path: Path
    files: tuple[Path, ...]  # the storage files in order
    storages: tuple[Storage, ...]  # the same, open
    metadata: BagMetadata | None
    compression: str  # of the files as a whole, or within them; empty for none
    packed_with_checksum: bool  # all files are compressed as a whole, with a checksum of their content

    def __post_init__(self) -> None:
        self.topics = merged_topics(topic for storage in self.storages for topic in storage.topics)
        self._check_types()
        self._budget = UnpackBudget(sum(file_size(file) for file in self.files))

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics``, file by file in order of arrival.

        Raises BagError when a file is damaged, or holds more or fewer messages than declared.
        """
        found: Counter[str] = Counter()
        self._budget.restart()
        for storage in self.storages:
            for message in storage.messages(topics):
                found[message.topic] += 1
                yield self.decompressed(message)
        declared = self.metadata.counts if self.metadata else {}
        for topic in topics:
            if topic in declared and declared[topic] != found[topic]:
                raise MessageCountError(
                    f"metadata.yaml of {self.path} declares {counted(declared[topic], 'message')} on {topic} but its "
                    f"files hold {found[topic]}: complete the folder, or rewrite metadata.yaml with 'ros2 bag reindex'."
                )

    @property
    def checked(self) -> bool:
        """Whether checksums covered all that has been read so far."""
        return self.packed_with_checksum or all(storage.checked for storage in self.storages)

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Sentences about files that were not completed but can be read."""
        return tuple(storage.warning for storage in self.storages if storage.warning is not None)

    def decompressed(self, message: RawMessage) -> RawMessage:
        """Decompress a message, if it is compressed by itself; CDR never begins like zstd."""
        if message.data[:4] != ZSTD_MAGIC:
            return message
        try:
            plain = decompress(bytes(message.data), "zstd")
            self._budget.take(len(plain))
            return message._replace(data=plain)
        except ValueError as error:
            raise TruncatedBagError(
                f"The message on {message.topic} logged at {message.log_time} ns in {self.path} cannot be decompressed "
                f"({error}): copy the recording again from its origin."
            ) from error

    def attachment(self, name: str) -> bytes | None:
        """Return the first attachment of that name in any file."""
        found = (storage.attachment(name) for storage in self.storages)
        return next((data for data in found if data is not None), None)

    def _check_types(self) -> None:
        for topic in (topic for storage in self.storages for topic in storage.topics):
            if topic.type_name != (merged := self.topics[topic.name].type_name):
                raise MessageTypeError(
                    f"{topic.name} has type {merged} in different files of {self.path}: give the files one by one."
                )
        for name, type_name in self.metadata.types.items() if self.metadata else ():
            if name in self.topics and self.topics[name].type_name not in (type_name, ""):
                raise MessageTypeError(
                    f"metadata.yaml of {self.path} gives {name} the type {type_name} but its files say "
                    f"{self.topics[name].type_name}: rewrite metadata.yaml with 'ros2 bag reindex'."
                )


@contextmanager
def open_bag(path: Path, *, salvage: bool = False) -> Iterator[Bag]:
    """Open a recording for reading: a storage file or a folder, plain or compressed.

    With ``salvage``, damaged MCAP files are opened as far as they can be read: to describe them, not to fit them.

    Raises BagError when it is not a recording, is damaged or cannot be read.
    """
    files, metadata = storage_files(path)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drive_id_")))
        storages, kinds, sealed = [], set(), True
        for number, file in enumerate(files):
            target = folder / str(number)
            target.mkdir()
            plain, kind = unpack_file(file, target)
            storages.append(open_storage(plain, file, stack, salvage=salvage))
            kinds.add(kind and f"{kind} (file)")
            sealed = sealed and has_checksum(read_magic(file, file), kind)
        if metadata and metadata.message_compression:
            kinds.add(f"{metadata.message_compression} (message)")
        compressions = (*sorted({storage.compression for storage in storages}), *sorted(kinds))
        yield Bag(path, files, tuple(storages), metadata, "+".join(filter(None, compressions)), sealed)


def open_storage(path: Path, shown: Path, stack: ExitStack, *, salvage: bool = False) -> Storage:
    """Open one storage file, already decompressed as a whole and closed by ``stack``; its content decides how.

    Raises NotABagError or TruncatedBagError, which name it ``shown``.
    """
    magic = read_magic(path, shown)
    storage: Storage
    if magic.startswith(MCAP_MAGIC):
        storage = McapStorage(path, shown, salvage=salvage)
    elif magic.startswith(SQLITE_MAGIC):
        storage = SqliteStorage(path, shown)
    elif magic.startswith(ROSBAG1_MAGIC):
        from drive_id.files.storage.rosbag1 import Rosbag1Storage  # noqa: PLC0415  # loads rosbags

        storage = Rosbag1Storage(path, shown)
    elif not magic:
        raise NotABagError(
            f"{shown} is empty: record it again, or recover the other files of its folder with 'drive-id recover'."
        )
    else:
        raise NotABagError(
            f"{shown} is neither an MCAP nor a sqlite3 recording, nor another log that is read: give a "
            "rosbag2 file or folder, or export the log as CSV or Parquet."
        )
    stack.callback(storage.close)
    return storage


def storage_files(path: Path) -> tuple[tuple[Path, ...], BagMetadata | None]:
    """Return the storage files of a recording in order, and its metadata if there are any.

    Raises NotABagError when there is none, or ``metadata.yaml`` is unreadable or names other files than those that are
    there.
    """
    present = _present(path)
    with readable(path):
        described = path.is_dir() and (path / "metadata.yaml").exists()
    if not described:
        return present_files(path), None
    metadata = read_metadata(path / "metadata.yaml")
    files = tuple(path / name for name in metadata.files)
    for file in files:
        if not os.path.isfile(file):  # noqa: PTH113  # Path.is_file raises for names that the system refuses
            raise NotABagError(
                f"metadata.yaml of {path} names {file.name[:80]}, which is not there: copy it from its origin, or fit "
                "what is left after 'drive-id recover'."
            )
    named = set(files)
    left = [entry.name for entry in present if entry not in named]
    if left:
        raise NotABagError(
            f"{path} holds {left[0]}, which its metadata.yaml does not name: rewrite metadata.yaml with "
            "'ros2 bag reindex', or move the file away."
        )
    return files, metadata


def present_files(path: Path) -> tuple[Path, ...]:
    """Return the storage files of a recording in order of their names, ignoring ``metadata.yaml``.

    Raises NotABagError when there is none.
    """
    files = _present(path)
    if not files:
        if (path / "identification.json").exists():
            raise NotABagError(f"{path} is a result folder, not a recording: see it by drive-id info or report.")
        raise NotABagError(
            f"{path} is a folder without an .mcap or .db3 file: give a rosbag2 folder, or the files of other logs."
        )
    return tuple(files)


def _present(path: Path) -> list[Path]:
    """Return the storage files of a folder in order, or the file itself; NotABagError when it cannot be read."""
    with readable(path):
        if not path.exists():
            raise NotABagError(f"There is no {path}{'' if path.is_absolute() else ' here'}: check its name and folder.")
        if not path.is_dir():
            return [path]
        files = (entry for entry in path.iterdir() if entry.name.endswith(_ENDINGS) and entry.is_file())
        return sorted(files, key=_natural)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts ``bag_10`` behind ``bag_9``."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"([0-9]+)", path.name)]


def file_digest(path: Path) -> str:
    """Return the sha256 of a file, hexadecimal; raises BagError when it cannot be read."""
    digest = hashlib.sha256()
    try:
        with open_input(path) as stream:
            while piece := stream.read(1 << 20):
                digest.update(piece)
    except OSError as error:
        raise BagError(f"{path} cannot be read ({reason(error)}): check the disk or the network.") from error
    return digest.hexdigest()
