"""The records of an MCAP file in the order in which they were written, without believing any declared length."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar, cast

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from drive_id.errors import BagError, NotABagError
from drive_id.files.storage.storage import MCAP_MAGIC, decompress, file_size, reason

RECORD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")  # times, size, checksum, length of the compression's name
_CHUNK_INDEX = struct.Struct("<QQQQI")  # times, where the chunk begins, its length, length of the offsets
_OFFSET = struct.Struct("<HQ")  # of a channel's messages
FOOTER_LENGTH = 20
_DATA_END = struct.Struct("<BQI")
_TAIL = RECORD.size + FOOTER_LENGTH + len(MCAP_MAGIC)
_LARGEST_CHUNK = 1 << 30
_WINDOW = 1 << 20
_NOTHING = 0  # no opcode, but what a disk shows of a part that was never written
PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)

Parsed = TypeVar("Parsed", bound=records.McapRecord)


class DamageError(Exception):
    """The file cannot be read on from here; the text says why."""


class BreakError(DamageError):
    """The file ends here, within a record: nothing comes after."""


class Record(NamedTuple):
    """One record: its kind, where it begins in the file, its content, and where it ends."""

    opcode: int
    position: int
    body: bytes
    end: int


class McapRecords:
    """A file, open for reading its records.

    Parameters
    ----------
    path : Path
    shown : Path
        What to call it in messages.

    Raises
    ------
    NotABagError
        When it cannot be opened.
    """

    def __init__(self, path: Path, shown: Path) -> None:
        self._shown = shown
        self._has_crc = True
        self._window, self._begin = b"", 0
        self.size = file_size(path)
        self.whole = len(MCAP_MAGIC)
        """Where the record that was read last begins, or the one that could not be read."""
        try:
            self._stream = path.open("rb")
        except OSError as error:
            raise NotABagError(f"{shown} cannot be read ({reason(error)}): check its permissions.") from error

    def close(self) -> None:
        """Release the file."""
        self._stream.close()

    def read(self, position: int, length: int) -> bytes:
        """Read exactly ``length`` bytes, which must lie within the file."""
        if position < 0 or length < 0 or position + length > self.size:
            raise BreakError(f"it breaks off within the record at byte {max(position, 0)}")
        begin = position - self._begin
        if begin < 0 or begin + length > len(self._window):
            self._look_at(position, length)
            begin = 0
        return self._window[begin : begin + length]

    def _look_at(self, position: int, length: int) -> None:
        """Read some of the file ahead, for most records are small."""
        try:
            self._stream.seek(position)
            self._window = b""
            self._window = self._stream.read(max(length, _WINDOW))
            self._begin = position
        except OSError as error:
            raise BagError(f"{self._shown} cannot be read ({reason(error)}): check the disk or the network.") from error
        if len(self._window) < length:
            raise BreakError(f"it breaks off at byte {position + len(self._window)}")

    def record(self, position: int) -> Record:
        """Read the record that begins there."""
        if position >= self.size:
            raise BreakError("it breaks off before its end")
        opcode, length = RECORD.unpack(self.read(position, RECORD.size))
        if opcode == _NOTHING:
            raise BreakError(f"it breaks off at byte {position}")
        end = position + RECORD.size + length
        return Record(opcode, position, self.read(position + RECORD.size, length), end)

    def has_record(self, position: int) -> bool:
        """Tell whether a whole record begins there."""
        try:
            self.record(position)
        except DamageError:
            return False
        return True

    def header(self) -> records.Header | None:
        """Return the header, if the file begins with one."""
        try:
            first = self.record(len(MCAP_MAGIC))
            return parsed(records.Header, first.body, first.position) if first.opcode == Opcode.HEADER else None
        except DamageError:
            return None

    def data_section(self, end: int | None = None) -> Iterator[Record]:
        """Yield the records up to the end of the data, or up to byte ``end``, and check the checksum of them all."""
        crc = zlib.crc32(MCAP_MAGIC)
        position = len(MCAP_MAGIC)
        while position != end:
            self.whole = position
            record = self.record(position)
            if record.opcode == Opcode.DATA_END:
                declared = parsed(records.DataEnd, record.body, position).data_section_crc
                if declared and declared != crc:
                    raise DamageError("the checksum of its data is wrong")
                return
            if record.opcode == Opcode.FOOTER:
                raise DamageError("the end of its data is missing")
            if self._has_crc:
                crc = zlib.crc32(record.body, zlib.crc32(RECORD.pack(record.opcode, len(record.body)), crc))
            yield record
            position = record.end

    def footer(self) -> int:
        """Check the end of the file and return where its summary begins (0: none)."""
        tail = self.read(self.size - _TAIL, _TAIL) if self.size >= _TAIL + len(MCAP_MAGIC) else b""
        if not tail.endswith(MCAP_MAGIC) or RECORD.unpack_from(tail) != (Opcode.FOOTER, FOOTER_LENGTH):
            raise BreakError("it breaks off before its end")
        summary_start, _, crc = struct.unpack_from("<QQI", tail, RECORD.size)
        if summary_start > self.summary_end:
            raise DamageError("its footer points behind its end")
        end = int(summary_start or self.summary_end) - _DATA_END.size
        self._has_crc = end < 0 or _DATA_END.unpack(self.read(end, _DATA_END.size)) != (Opcode.DATA_END, 4, 0)
        if summary_start and crc:
            covered = self.read(summary_start, self.size - len(MCAP_MAGIC) - 4 - summary_start)
            if zlib.crc32(covered) != crc:
                raise DamageError("the checksum of its summary is wrong")
        return int(summary_start)

    @property
    def summary_end(self) -> int:
        """Where the footer begins in a whole file."""
        return self.size - _TAIL


def chunk_records(record: Record) -> tuple[str, Iterator[tuple[int, memoryview]]]:
    """Unpack a chunk: its compression, and its records as pairs of opcode and content."""
    compression, plain = plain_chunk(record)
    return compression, split_records(plain, record.position)


def plain_chunk(record: Record) -> tuple[str, bytes]:
    """Unpack a chunk: its compression, and its records as they stand in it."""
    try:
        _, _, size, crc, length = _CHUNK.unpack_from(record.body)
        begin = _CHUNK.size + length + 8
        compression = record.body[_CHUNK.size : begin - 8].decode()
        (compressed,) = struct.unpack_from("<Q", record.body, begin - 8)
        if begin + compressed != len(record.body):
            raise ValueError("length")
    except (struct.error, ValueError) as error:
        raise DamageError(f"the record at byte {record.position} is damaged") from error
    try:
        if size > _LARGEST_CHUNK:
            raise ValueError(f"it declares {size} bytes")
        plain = decompress(record.body[begin:], compression, size)
        if crc and zlib.crc32(plain) != crc:
            raise ValueError("its checksum is wrong")
    except ValueError as error:
        raise DamageError(f"the chunk at byte {record.position} is damaged ({error})") from error
    return compression, plain


class ChunkIndex(NamedTuple):
    """What the summary of a file says of a chunk: where it begins, its channels, its compression."""

    position: int
    channels: frozenset[int]
    compression: str


def chunk_index(body: bytes, position: int) -> ChunkIndex:
    """Parse an index record of a chunk; there are many of them in a long recording."""
    try:
        _, _, start, _, length = _CHUNK_INDEX.unpack_from(body)
        offsets = body[_CHUNK_INDEX.size : _CHUNK_INDEX.size + length]
        channels = frozenset(channel for channel, _ in _OFFSET.iter_unpack(offsets))
        at = _CHUNK_INDEX.size + length + 8
        (length,) = struct.unpack_from("<I", body, at)
        struct.unpack_from("<QQ", body, at + 4 + length)
        return ChunkIndex(start, channels, body[at + 4 : at + 4 + length].decode())
    except (struct.error, ValueError) as error:
        raise DamageError(f"the record at byte {position} is damaged") from error


def split_records(data: bytes, position: int) -> Iterator[tuple[int, memoryview]]:
    """Yield the records of a plain chunk at byte ``position`` of the file as pairs of opcode and content."""
    plain, inner = memoryview(data), 0
    while inner < len(plain):
        if inner + RECORD.size > len(plain):
            raise DamageError(f"the chunk at byte {position} is damaged (it ends within a record)")
        opcode, length = RECORD.unpack_from(plain, inner)
        inner += RECORD.size
        if length > len(plain) - inner:
            raise DamageError(f"the chunk at byte {position} is damaged (it ends within a record)")
        yield opcode, plain[inner : inner + length]
        inner += length


def parsed(kind: type[Parsed], body: bytes | memoryview, position: int) -> Parsed:
    """Parse the content of one record."""
    try:
        return cast(Parsed, kind.read(ReadDataStream(BytesIO(body))))  # type: ignore[attr-defined]  # not in the base
    except PARSE_ERRORS as error:
        raise DamageError(f"the record at byte {position} is damaged") from error
