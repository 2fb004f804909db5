"""What storage files (MCAP, sqlite3, ROS 1) share: their base class, magic numbers and decompression."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from drive_id.common.messages import Message
from drive_id.errors import BagError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import NotAFileError, check_input, open_input, reason, shown_size

MCAP_MAGIC = b"\x89MCAP0\r\n"
SQLITE_MAGIC = b"SQLite format 3\0"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
LZ4_MAGIC = b"\x04\x22\x4d\x18"
ROSBAG1_MAGIC = b"#ROSBAG"
TRUTH_ATTACHMENT = "ground_truth.npz"
"""Name of the attachment that holds the truth of a simulation."""

LARGEST_CHUNK = 1 << 27
"""Largest chunk, message or record that is unpacked or read at once, bytes."""
_UNPACKED = 1 << 28
"""Bytes that a recording of any size may unpack to."""
_RATIO = 100
"""Further bytes for each of its own: constant samples are packed well."""
_LZ4_FLAGS = 4
_PIECE = 1 << 20  # bytes unpacked at once, after which the budget is asked
_AT_ONCE = 1 << 24
"""Bytes of memory that are taken on a declared size alone."""
_DECOMPRESSION_ERRORS = (zstandard.ZstdError, RuntimeError, EOFError, ValueError)


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a storage file."""

    name: str
    type_name: str  # in the form package/msg/Name
    count: int | None  # messages that the file declares, if it does
    encoding: str  # of the messages: cdr, ros1 and json can be read
    definition_format: str = ""  # such as ros2msg or ros2idl
    definition: str = ""  # complete message definition, or empty


def merged_topics(topics: Iterable[TopicInfo]) -> dict[str, TopicInfo]:
    """Return topics by name: counts of the same name are added, and different types joined by ``and``."""
    found: dict[str, TopicInfo] = {}
    for topic in topics:
        before = found.setdefault(topic.name, topic)
        if before is topic:
            continue
        same = before.type_name == topic.type_name
        found[topic.name] = replace(
            before,
            type_name=before.type_name if same else f"{before.type_name} and {topic.type_name}",
            count=None if before.count is None or topic.count is None else before.count + topic.count,
            definition=before.definition or topic.definition,
        )
    return found


class RawMessage(NamedTuple):
    """One serialized message, with its topic and log time (ns)."""

    topic: str
    log_time: int
    data: bytes | memoryview


class Storage(ABC):
    """One storage file, open for reading. All errors are :class:`~drive_id.errors.BagError`."""

    kind: str
    """``mcap``, ``sqlite3`` or ``rosbag1``."""
    topics: tuple[TopicInfo, ...] = ()
    start = 0
    """Earliest log time, ns; ``start`` and ``end`` are 0 when there is no message."""
    end = 0
    compression = ""
    """Of the chunks; empty for none."""
    damage = ""
    """What is wrong with the file; empty if it is complete."""
    warning: Message | None = None
    """About a file that was not completed but can be read."""

    @property
    def checked(self) -> bool:
        """Whether checksums covered all that has been read so far."""
        return False

    @property
    def progress(self) -> float:
        """Part of the file that has been read, 0 to 1; 0 if unknown."""
        return 0.0

    @abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in order of arrival; checks the declared counts at the end."""

    def attachment(self, name: str) -> bytes | None:  # noqa: ARG002  # only MCAP files have some
        """Return the attachment of that name, if there is one."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Release the file."""


@contextmanager
def readable(shown: Path) -> Iterator[None]:
    """Raise NotABagError, which names ``shown``, when the body cannot read it."""
    try:
        yield
    except NotAFileError as error:
        raise NotABagError(f"{shown} is not a file ({reason(error)}): give a rosbag2 file or folder.") from error
    except OSError as error:
        raise NotABagError(f"{shown} cannot be read ({reason(error)}): check the path and its permissions.") from error


def read_magic(path: Path, shown: Path) -> bytes:
    """Return the first bytes of a file; NotABagError when it cannot be read."""
    with readable(shown), open_input(path) as stream:
        return stream.read(18)


class UnpackBudget:
    """Counts what a file of so many bytes unpacks to, so that some kB of it cannot take gigabytes and minutes."""

    def __init__(self, size: int) -> None:
        self.limit = _UNPACKED + _RATIO * size
        self._taken = 0

    def restart(self) -> None:
        """Read the file from its beginning again."""
        self._taken = 0

    def take(self, count: int) -> None:
        """Note further bytes; ValueError when there are too many."""
        self._taken += count
        if self._taken > self.limit:
            raise ValueError(f"it unpacks to more than {shown_size(self.limit)}, too much for its size")


def unpack_file(path: Path, folder: Path) -> tuple[Path, str]:
    """Decompress a file that is compressed as a whole into ``folder``.

    Returns the path of the plain file, or ``path`` itself, and the compression: ``zstd``, ``lz4`` or empty.
    """
    magic = read_magic(path, path)
    if not magic.startswith((ZSTD_MAGIC, LZ4_MAGIC)):
        return path, ""
    kind = "zstd" if magic.startswith(ZSTD_MAGIC) else "lz4"
    target = folder / path.stem
    with readable(path):
        stream = open_input(path)
    budget = UnpackBudget(file_size(path))
    with stream, target.open("wb") as out:
        try:
            source: BinaryIO
            if kind == "zstd":
                source = zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)
            else:
                source = lz4.frame.LZ4FrameFile(stream)
            while piece := source.read(_PIECE):
                _take(budget, len(piece), path)
                out.write(piece)
        except _DECOMPRESSION_ERRORS as error:
            raise TruncatedBagError(
                f"The {kind} compression of {path} is damaged: copy the file again from its origin."
            ) from error
        except OSError as error:
            raise BagError(
                f"{path} cannot be decompressed into {folder} ({reason(error)}): make room there, or set TMPDIR."
            ) from error
    return target, kind


def has_checksum(data: bytes, kind: str) -> bool:
    """Tell whether compressed data, of which these are the first bytes, carry a checksum of their content."""
    if kind == "zstd":
        try:
            return bool(zstandard.get_frame_parameters(data).has_checksum)
        except zstandard.ZstdError:
            return False
    return kind == "lz4" and len(data) > _LZ4_FLAGS and bool(data[_LZ4_FLAGS] & 4)


def _take(budget: UnpackBudget, count: int, path: Path) -> None:
    try:
        budget.take(count)
    except ValueError as error:
        raise TruncatedBagError(f"{path} is not a recording, for {error}: give the recording itself.") from error


def decompress(data: bytes, kind: str, size: int | None = None) -> bytes:
    """Decompress a chunk (of ``size`` bytes) or a message, piece by piece, so that a false size takes no memory.

    Raises ValueError when the data are damaged, of an unknown kind, or not of the declared size.
    """
    if kind == "":
        plain = data
    elif kind in ("zstd", "lz4"):
        pieces, total = [], 0
        try:
            for piece in _pieces(data, kind, size):
                total += len(piece)
                if total > (LARGEST_CHUNK if size is None else size):
                    raise ValueError("its compressed data are larger than declared")
                pieces.append(piece)
        except (zstandard.ZstdError, RuntimeError, EOFError) as error:
            raise ValueError(f"its {kind} compression is damaged") from error
        plain = b"".join(pieces)
    else:
        raise ValueError(f"its compression '{kind[:20]}' is unknown")
    if size is not None and len(plain) != size:
        raise ValueError("its size differs from the declared one")
    return plain


def _pieces(data: bytes, kind: str, size: int | None) -> Iterator[bytes]:
    if kind == "zstd":
        if size is not None and 0 < size <= _AT_ONCE and zstandard.frame_content_size(data) == size:
            yield zstandard.ZstdDecompressor().decompress(data, allow_extra_data=False)
            return
        with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
            while piece := reader.read(_PIECE):
                yield piece
        return
    engine = lz4.frame.LZ4FrameDecompressor()
    while not engine.eof:
        piece = engine.decompress(data, max_length=_PIECE)
        data = b""
        if not piece and engine.needs_input:
            raise EOFError
        yield piece


def file_size(path: Path) -> int:
    """Return the size of a file in bytes, 0 if unknown."""
    try:
        return check_input(path)
    except OSError:
        return 0


def full_type(name: str) -> str:
    """Write ``package/Name`` as ``package/msg/Name``."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name
