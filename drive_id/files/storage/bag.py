"""A recording as a whole: one storage file, or a folder of them with or without ``metadata.yaml``."""

from __future__ import annotations

import hashlib
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from drive_id.errors import BagError, MessageCountError, MessageTypeError, NotABagError, TruncatedBagError
from drive_id.files.storage.container import (
    MCAP_MAGIC,
    ROSBAG1_MAGIC,
    SQLITE_MAGIC,
    ZSTD_MAGIC,
    RawMessage,
    Storage,
    TopicInfo,
    decompress,
    read_magic,
    reason,
    unpack_file,
)
from drive_id.files.storage.folder import BagMetadata, storage_files
from drive_id.files.storage.mcap import McapStorage
from drive_id.files.storage.sqlite import SqliteStorage


class Bag:
    """An open recording; made by :func:`open_bag`.

    Parameters
    ----------
    path : Path
    files : tuple of Path
        The storage files in order.
    storages : tuple of Storage
        The same, open.
    metadata : BagMetadata or None
    compression : str
        Of the files as a whole, or within them; empty for none.
    """

    def __init__(
        self,
        path: Path,
        files: tuple[Path, ...],
        storages: tuple[Storage, ...],
        metadata: BagMetadata | None,
        compression: str,
    ) -> None:
        self.path = path
        self.files = files
        self.storages = storages
        self.metadata = metadata
        self.compression = compression
        self.topics = self._merged_topics()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics``, file by file in order of arrival.

        Raises
        ------
        BagError
            When a file is damaged, or holds other than the declared number of messages.
        """
        found: Counter[str] = Counter()
        for storage in self.storages:
            for message in storage.messages(topics):
                found[message.topic] += 1
                yield self.decompressed(message)
        self.check_counts(topics, found)

    def check_counts(self, topics: Collection[str], found: Mapping[str, int]) -> None:
        """Compare the messages found on topics with ``metadata.yaml``.

        Raises
        ------
        MessageCountError
            When it declares more, or fewer.
        """
        declared = self.metadata.counts if self.metadata else {}
        for topic in topics:
            if topic in declared and declared[topic] != found.get(topic, 0):
                raise MessageCountError(
                    f"metadata.yaml of {self.path} declares {declared[topic]} messages on {topic} but its files hold "
                    f"{found.get(topic, 0)}: complete the folder, or rewrite metadata.yaml with 'ros2 bag reindex'."
                )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences about files that were not completed but can be read."""
        return tuple(text for storage in self.storages if (text := getattr(storage, "warning", "")))

    def decompressed(self, message: RawMessage) -> RawMessage:
        """Undo the compression of single messages; serialized data never begin like zstd."""
        if message.data[:4] != ZSTD_MAGIC:
            return message
        try:
            return message._replace(data=decompress(bytes(message.data), "zstd"))
        except ValueError as error:
            raise TruncatedBagError(
                f"The message on {message.topic} logged at {message.log_time} ns in {self.path} cannot be decompressed "
                f"({error}): copy the recording again from its origin."
            ) from error

    def attachment(self, name: str) -> bytes | None:
        """Return the first attachment of that name in any file."""
        for storage in self.storages:
            data = storage.attachment(name)
            if data is not None:
                return data
        return None

    def _merged_topics(self) -> dict[str, TopicInfo]:
        merged: dict[str, TopicInfo] = {}
        for storage in self.storages:
            for topic in storage.topics:
                before = merged.get(topic.name)
                if before is None:
                    merged[topic.name] = topic
                    continue
                if before.type_name != topic.type_name:
                    raise MessageTypeError(
                        f"{topic.name} has type {before.type_name} in one file of {self.path} and {topic.type_name} in "
                        "another: give the files one by one."
                    )
                known = before.count is not None and topic.count is not None
                count = (before.count or 0) + (topic.count or 0) if known else None
                merged[topic.name] = replace(before, count=count, definition=before.definition or topic.definition)
        for name, type_name in self.metadata.types.items() if self.metadata else ():
            if name in merged and merged[name].type_name not in (type_name, ""):
                raise MessageTypeError(
                    f"metadata.yaml of {self.path} gives {name} the type {type_name} but its files say "
                    f"{merged[name].type_name}: rewrite metadata.yaml with 'ros2 bag reindex'."
                )
        return merged


@contextmanager
def open_bag(path: Path, *, salvage: bool = False) -> Iterator[Bag]:
    """Open a recording for reading: a storage file or a folder, plain or compressed.

    Parameters
    ----------
    path : Path
    salvage : bool
        Open truncated MCAP files too, as far as they go; to describe them, not to fit them.

    Raises
    ------
    BagError
        When it is not a recording, damaged or cannot be read.
    """
    files, metadata = storage_files(path)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drive_id_")))
        storages, kinds = [], {f"{metadata.message_compression} (message)"} if metadata else set()
        for number, file in enumerate(files):
            target = folder / str(number)
            target.mkdir()
            plain, kind = unpack_file(file, target)
            storages.append(open_storage(plain, file, stack, salvage=salvage))
            kinds.add(f"{kind} (file)")
        within = sorted({storage.compression for storage in storages})
        around = sorted(kind for kind in kinds if not kind.startswith(" "))
        yield Bag(path, files, tuple(storages), metadata, "+".join(filter(None, (*within, *around))))


def open_storage(path: Path, shown: Path, stack: ExitStack, *, salvage: bool = False) -> Storage:
    """Open one storage file with the back-end that its content, not its name, asks for.

    Parameters
    ----------
    path : Path
        Of the file, already decompressed as a whole.
    shown : Path
        What to call it in messages.
    stack : ExitStack
        Closes the file.
    salvage : bool
        Describe what can be read of a truncated MCAP file, instead of refusing it.

    Raises
    ------
    NotABagError, TruncatedBagError
    """
    magic = read_magic(path, shown)
    storage: Storage
    if magic.startswith(MCAP_MAGIC):
        storage = McapStorage(path, shown, salvage=salvage)
    elif magic.startswith(SQLITE_MAGIC):
        storage = SqliteStorage(path, shown)
    elif magic.startswith(ROSBAG1_MAGIC):
        raise NotABagError(f"{shown} is a ROS 1 bag: convert it first, for instance with 'rosbags-convert'.")
    elif not magic:
        raise NotABagError(f"{shown} is empty: record it again.")
    else:
        raise NotABagError(f"{shown} is neither an MCAP nor a sqlite3 recording: give a rosbag2 file or folder.")
    stack.callback(storage.close)
    return storage


def file_digest(path: Path, going_on: Callable[[], bool] = lambda: True) -> str:
    """Return the sha256 of a file, hexadecimal.

    Parameters
    ----------
    path : Path
    going_on : callable
        Asked after each piece; when it says no, the digest is that of what was read by then.

    Raises
    ------
    BagError
        When it cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while going_on() and (piece := stream.read(1 << 20)):
                digest.update(piece)
    except OSError as error:
        raise BagError(f"{path} cannot be read ({reason(error)}): check the disk or the network.") from error
    return digest.hexdigest()
