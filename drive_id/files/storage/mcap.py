"""MCAP files, read in the order in which they were written, with every checksum and declared count checked.

``mcap.StreamReader`` parses the records and checks the checksum of the data section. It trusts the file in four places,
where this module does not: a declared length is compared with the bytes that are there before memory is taken for it;
chunks are unpacked piece by piece and no further than their declared size; the checksums of the summary and of
attachments are checked, too; and of the records inside a chunk, whose lengths are checked, messages are not copied.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TypeVar, cast

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import CRCValidationError, StreamReader

from drive_id.common.messages import Message
from drive_id.common.quantity import counted
from drive_id.errors import BagError, MessageCountError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import open_input, reason, shown_size
from drive_id.files.storage.container import (
    LARGEST_CHUNK,
    MCAP_MAGIC,
    RawMessage,
    Storage,
    TopicInfo,
    UnpackBudget,
    decompress,
    file_size,
    full_type,
    has_checksum,
    merged_topics,
)

RECORD = struct.Struct("<BQ")
"""Opcode and length, before the content of each record."""
MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time, before the data of a message."""
RECORDER_LIBRARY = "drive_id recorder"
"""Name in the header of files written live: one that breaks off behind a whole chunk lacks only what came later."""

_FOOTER = struct.Struct("<QQI")
_TAIL = RECORD.size + _FOOTER.size + len(MCAP_MAGIC)
_LARGEST_RECORD = LARGEST_CHUNK + (1 << 20)
_MOST_DEFINED = 1 << 18
"""Schemas and channels in one file, and in one chunk with repetitions; both have numbers of 16 bits."""
_LARGEST_BREAK = 1 << 22  # bytes between a damage and the end of the file that a power cut leaves
_BUFFER = 1 << 20  # bytes: a bag is read from front to back
_NEVER_WRITTEN = 0
"""No opcode, but what a disk returns where the size of a file was stored and its content was not."""
_NO_SCHEMA = records.Schema(id=0, name="", encoding="", data=b"")
_PARSE_ERRORS = (McapError, struct.error, ValueError, OverflowError, MemoryError)

Parsed = TypeVar("Parsed", bound=records.McapRecord)


class DamageError(Exception):
    """The file is damaged; the text says where."""


class RecordError(DamageError):
    """One record is damaged: the next begins at :attr:`McapFile.end`."""


class BreakError(DamageError):
    """The file ends here, within a record or before its end mark."""


class _Reader(StreamReader):
    """Leaves the indices of messages behind each chunk empty: parsing them takes a third of the time."""

    def _read_record(self, opcode: int, length: int) -> records.McapRecord | None:
        if opcode == Opcode.MESSAGE_INDEX:
            return records.MessageIndex(channel_id=0, records=[])
        return super()._read_record(opcode, length)


class McapFile:
    """An MCAP file below ``mcap.StreamReader``, which reads from it by :meth:`read`.

    Raises NotABagError, which names it ``shown``, when it cannot be opened.
    """

    def __init__(self, path: Path, shown: Path) -> None:
        self._shown = shown
        self.size = file_size(path)
        self.begin, self.end = 0, 0
        """Where the record begins that was read last or could not be read, and where it ends as it declares."""
        self._position = 0
        self._budget = UnpackBudget(self.size)
        self._unchecked = self._whole_checked = False
        try:
            self._stream = open_input(path, buffering=_BUFFER)
        except OSError as error:
            raise NotABagError(f"{shown} cannot be read ({reason(error)}): check its permissions.") from error

    def close(self) -> None:
        """Release the file."""
        self._stream.close()

    def read(self, length: int) -> bytes:
        """Return ``length`` bytes of the current record, or of the next one when the current one is at its end."""
        if self._position == self.end:
            self._enter_record()
        if not 0 <= length <= self.end - self._position:
            raise RecordError(f"the record at byte {self.begin} is damaged")
        try:
            data = self._stream.read(length)
        except OSError as error:
            raise BagError(f"{self._shown} cannot be read ({reason(error)}): check the disk or the network.") from error
        self._position += len(data)
        if len(data) < length:
            raise BreakError(f"it breaks off at byte {self._position}")
        return data

    def read_at(self, position: int, length: int) -> bytes:
        """Return ``length`` bytes from anywhere in the file."""
        if position < 0 or length < 0 or position + length > self.size:
            raise BreakError(f"it breaks off within the record at byte {max(position, 0)}")
        self._seek(position)
        self.end = position + length
        return self.read(length)

    def has_record(self, position: int) -> bool:
        """Tell whether a record begins there that ends within the file."""
        self._seek(position)
        try:
            self._enter_record()
        except DamageError:
            return False
        return True

    def header(self) -> records.Header | None:
        """Return the header, if the file begins with one."""
        try:
            _, first = next(self.read_records())
        except DamageError:
            return None
        return first if isinstance(first, records.Header) else None

    def data(self, begin: int = len(MCAP_MAGIC), end: int | None = None) -> Iterator[tuple[int, records.McapRecord]]:
        """Yield position and record from byte ``begin`` to byte ``end``, by default all of the data section.

        The checksum of the section is checked at its end, when it was read from its beginning.
        """
        if begin == end:
            return
        self._budget.restart()
        self._unchecked = False
        for position, record in self.read_records(begin):
            if isinstance(record, records.DataEnd):
                self._whole_checked = bool(record.data_section_crc) and begin == len(MCAP_MAGIC)
                return
            if isinstance(record, records.Footer):
                raise DamageError("the end of its data is missing")
            if isinstance(record, records.Message):
                self._unchecked = True
            yield position, record
            if self.end == end:
                return

    def read_records(self, begin: int = len(MCAP_MAGIC)) -> Iterator[tuple[int, records.McapRecord]]:
        """Yield position and record from byte ``begin`` to the footer."""
        whole = begin == len(MCAP_MAGIC)
        self._seek(0 if whole else begin)
        self.end = begin
        reader = _Reader(
            cast(IO[bytes], self), skip_magic=not whole, emit_chunks=True, validate_crcs=True, record_size_limit=None
        )
        try:
            for record in reader.records:
                yield self.begin, record
                if isinstance(record, records.Footer):
                    return
        except CRCValidationError as error:
            raise DamageError("the checksum of its data is wrong") from error
        except _PARSE_ERRORS as error:
            raise RecordError(f"the record at byte {self.begin} is damaged") from error

    def unpack(self, chunk: records.Chunk, position: int) -> bytes:
        """Unpack the records of a chunk at byte ``position``; see :func:`plain_chunk`."""
        try:
            self._budget.take(chunk.uncompressed_size)
        except ValueError as error:
            raise BreakError(str(error)) from error
        if not chunk.uncompressed_crc and not has_checksum(chunk.data[:18], chunk.compression):
            self._unchecked = True
        return plain_chunk(chunk, position)

    @property
    def checked(self) -> bool:
        """Whether checksums covered all messages read since the beginning."""
        return self._whole_checked or not self._unchecked

    def footer(self) -> int:
        """Check the end of the file and return where its summary begins (0: none)."""
        tail = self.read_at(self.size - _TAIL, _TAIL) if self.size >= _TAIL + len(MCAP_MAGIC) else b""
        if not tail.endswith(MCAP_MAGIC) or RECORD.unpack_from(tail) != (Opcode.FOOTER, _FOOTER.size):
            raise BreakError("it breaks off before its end")
        summary_start, _, crc = _FOOTER.unpack_from(tail, RECORD.size)
        if summary_start > self.size - _TAIL:
            raise DamageError("its footer points behind its end")
        if summary_start and crc:
            covered = self.read_at(summary_start, self.size - len(MCAP_MAGIC) - 4 - summary_start)
            if zlib.crc32(covered) != crc:
                raise DamageError("the checksum of its summary is wrong")
        return int(summary_start)

    def _enter_record(self) -> None:
        """Compare what the next record declares with the size of the file."""
        self.begin = self._position
        if self.begin >= self.size:
            raise BreakError("it breaks off before its end")
        broken = BreakError(f"it breaks off within the record at byte {self.begin}")
        if self.begin + RECORD.size > self.size:
            raise broken
        opcode, length = RECORD.unpack(self.read_at(self.begin, RECORD.size))
        self._seek(self.begin)
        if opcode == _NEVER_WRITTEN:
            raise BreakError(f"it breaks off at byte {self.begin}")
        if self.begin + RECORD.size + length > self.size:
            raise broken
        if length > _LARGEST_RECORD:
            raise BreakError(f"the record at byte {self.begin} declares {shown_size(length)}")
        self.end = self.begin + RECORD.size + length

    def _seek(self, position: int) -> None:
        self._stream.seek(position)
        self._position = position


def plain_chunk(chunk: records.Chunk, position: int) -> bytes:
    """Unpack the records of a chunk at byte ``position`` and check their checksum."""
    try:
        if chunk.uncompressed_size > LARGEST_CHUNK:
            raise ValueError(f"it declares {shown_size(chunk.uncompressed_size)}")
        plain = decompress(chunk.data, chunk.compression, chunk.uncompressed_size)
        if chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc:
            raise ValueError("its checksum is wrong")
    except ValueError as error:
        raise DamageError(f"the chunk at byte {position} is damaged ({error})") from error
    return plain


def chunk_records(
    chunk: bytes, position: int, known: set[bytes] | None = None, wanted: Collection[int] | None = None
) -> Iterator[records.McapRecord]:
    """Yield the messages, schemas and channels in the unpacked chunk at byte ``position``; messages are not copied.

    Schemas and channels in ``known`` are skipped, and others added to it; so are messages of other channels than those
    ``wanted``, if these are given.
    """
    known = set() if known is None else known
    plain, inner, defined = memoryview(chunk), 0, 0
    while inner < len(plain):
        body = inner + RECORD.size
        opcode, length = RECORD.unpack_from(plain, inner) if body <= len(plain) else (0, 0)
        if body + length > len(plain) or opcode == _NEVER_WRITTEN:
            raise DamageError(f"the chunk at byte {position} is damaged (it ends within a record)")
        inner = body + length
        if opcode == Opcode.MESSAGE:
            if length < MESSAGE.size:
                raise DamageError(f"a message at byte {position} is too short")
            channel, sequence, log_time, publish_time = MESSAGE.unpack_from(plain, body)
            if wanted is not None and channel not in wanted:
                continue
            data = cast(bytes, plain[body + MESSAGE.size : inner])
            yield records.Message(channel, log_time, data, publish_time, sequence)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            content = bytes(plain[body - RECORD.size : inner])
            defined += 1
            if max(defined, len(known)) > _MOST_DEFINED:
                raise DamageError(f"the chunk at byte {position} is damaged (it defines too many channels)")
            if content in known:
                continue
            known.add(content)
            kind = records.Schema if opcode == Opcode.SCHEMA else records.Channel
            yield _parsed(kind, content[RECORD.size :], position)


def _parsed(kind: type[Parsed], body: bytes | memoryview, position: int) -> Parsed:
    try:
        return cast(Parsed, kind.read(ReadDataStream(BytesIO(body))))  # type: ignore[attr-defined]  # not in the base
    except _PARSE_ERRORS as error:
        raise DamageError(f"the record at byte {position} is damaged") from error


class McapStorage(Storage):
    """An MCAP file, named ``shown`` in errors; ``salvage`` describes what can be read of a damaged one."""

    kind = "mcap"

    def __init__(self, path: Path, shown: Path, *, salvage: bool = False) -> None:
        self._shown = shown
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._chunk_channels: dict[int, frozenset[int]] = {}
        self._counts: Counter[int] | None = None
        self._attachments: list[tuple[str, int, int]] = []
        self._compressions: set[str] = set()
        self._break: int | None = None
        self._file = McapFile(path, shown)
        try:
            self._open(salvage)
        except BaseException:
            self._file.close()
            raise
        self.topics = tuple(merged_topics(self._topic_infos()).values())
        self.compression = "+".join(sorted(self._compressions - {""}))

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in order of arrival; checks checksums and declared counts.

        Raises TruncatedBagError when the file is damaged, MessageCountError when a count differs.
        """
        wanted = {key: channel.topic for key, channel in self._channels.items() if channel.topic in topics}
        found: Counter[int] = Counter()
        try:
            for _, record in self._scan(wanted.keys()):
                if isinstance(record, records.Message) and record.channel_id in wanted:
                    found[record.channel_id] += 1
                    yield RawMessage(wanted[record.channel_id], record.log_time, record.data)
        except DamageError as damage:
            raise self._damaged(str(damage)) from damage
        declared = found if self._counts is None else self._counts
        for key, topic in wanted.items():
            if found[key] != declared[key]:
                raise MessageCountError(
                    f"{self._shown} declares {counted(declared[key], 'message')} on {topic} but holds {found[key]}: "
                    "copy the file again from its origin, or rebuild it with 'drive-id recover'."
                )

    @property
    def checked(self) -> bool:
        """Whether checksums covered all that has been read so far."""
        return self._file.checked

    @property
    def progress(self) -> float:
        """Part of the file that has been read, 0 to 1."""
        return min(self._file.end / max(self._file.size, 1), 1.0)

    def attachment(self, name: str) -> bytes | None:
        """Return the attachment of that name, if there is one; TruncatedBagError when it is damaged."""
        for found, position, length in self._attachments:
            if found == name:
                try:
                    body = self._file.read_at(position + RECORD.size, length - RECORD.size)
                    (crc,) = struct.unpack("<I", body[-4:])
                    if crc and crc != zlib.crc32(body[:-4]):
                        raise DamageError("checksum")
                    return bytes(_parsed(records.Attachment, body, position).data)
                except (DamageError, *_PARSE_ERRORS) as error:
                    raise self._damaged(f"its attachment '{name}' is damaged") from error
        return None

    # -- opening ---------------------------------------------------------------------------------------------------

    def _open(self, salvage: bool) -> None:
        try:
            if (summary_start := self._file.footer()) and self._read_summary(summary_start):
                return
        except DamageError as damage:
            header = self._file.header() if isinstance(damage, BreakError) else None
            if header is not None and header.library == RECORDER_LIBRARY:
                self._open_unfinished(salvage)
                return
            if not salvage:
                raise self._damaged(str(damage)) from damage
            self.damage = str(damage)
        try:
            self._index_by_scan()
        except DamageError as damage:
            if not salvage:
                raise self._damaged(str(damage)) from damage
            self.damage = self.damage or str(damage)

    def _open_unfinished(self, salvage: bool) -> None:
        """Open a file that the recorder did not complete, up to where it breaks off."""
        try:
            self._index_by_scan()
            self.damage, broken = "its index is missing", self._file.begin
        except DamageError as damage:
            self.damage, broken = str(damage), self._file.begin
            far = self._file.size - broken > _LARGEST_BREAK
            within = not isinstance(damage, BreakError) and self._file.has_record(self._file.end)
            if far or within:  # more follows than the recorder can have left unwritten
                if not salvage:
                    raise self._damaged(str(damage)) from damage
                return
        self._break = broken
        seconds = (self.end - self.start) * 1e-9
        self.warning = Message("not_completed", file=str(self._shown), damage=self.damage, seconds=seconds)

    def _read_summary(self, start: int) -> bool:
        """Read the summary section; tell whether it describes the whole file."""
        statistics: records.Statistics | None = None
        for _, record in self._file.read_records(start):
            if isinstance(record, records.AttachmentIndex):
                self._attachments.append((record.name, record.offset, record.length))
            elif isinstance(record, records.ChunkIndex):
                self._compressions.add(record.compression)
                if record.message_index_offsets:
                    self._chunk_channels[record.chunk_start_offset] = frozenset(record.message_index_offsets)
            elif isinstance(record, records.Statistics):
                statistics = record
            else:
                self._note(record)
        if statistics is None or statistics.channel_count != len(self._channels):
            return False
        self._counts = Counter(statistics.channel_message_counts)
        self.start, self.end = statistics.message_start_time, statistics.message_end_time
        return set(self._counts) <= set(self._channels)

    def _index_by_scan(self) -> None:
        """Describe a file without a usable summary by reading all of it."""
        counts: Counter[int] = Counter()
        self._attachments.clear()
        try:
            for position, record in self._scan(None):
                if isinstance(record, records.Message):
                    self.start = min(self.start, record.log_time) if counts else record.log_time
                    self.end = max(self.end, record.log_time)
                    counts[record.channel_id] += 1
                elif isinstance(record, records.Attachment):
                    self._attachments.append((record.name, position, self._file.end - position))
                else:
                    self._note(record)
        finally:
            self._counts = counts

    def _topic_infos(self) -> Iterator[TopicInfo]:
        for key, channel in self._channels.items():
            schema = self._schemas.get(channel.schema_id, _NO_SCHEMA)
            count = None if self._counts is None else self._counts[key]
            text = schema.data.decode(errors="replace")
            yield TopicInfo(
                channel.topic, full_type(schema.name), count, channel.message_encoding, schema.encoding, text
            )

    # -- records ---------------------------------------------------------------------------------------------------

    def _scan(self, wanted: Collection[int] | None) -> Iterator[tuple[int, records.McapRecord]]:
        """Yield position and record in file order, chunks unpacked if they may hold ``wanted`` channels (None: all)."""
        known: set[bytes] = set()
        for position, record in self._file.data(end=self._break):
            held = self._chunk_channels.get(position)
            if not isinstance(record, records.Chunk):
                yield position, record
            elif wanted is None or held is None or not held.isdisjoint(wanted):
                self._compressions.add(record.compression)
                for inner in chunk_records(self._file.unpack(record, position), position, known, wanted):
                    yield position, inner

    def _note(self, record: records.McapRecord) -> None:
        if isinstance(record, records.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, records.Channel):
            self._channels[record.id] = record

    def _damaged(self, why: str) -> TruncatedBagError:
        return TruncatedBagError(
            f"{self._shown} is not a complete recording, for {why}: recover it first with 'drive-id recover'."
        )
