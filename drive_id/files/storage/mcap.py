"""MCAP files, read record by record in the order in which they were written.

A reader of its own rather than by index: the order of arrival matters for finding backward stamps, damage anywhere in
the file must show, and no declared length may be believed before it is compared with what is there. The ``mcap``
package parses the small records.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, NoReturn

from mcap import records
from mcap.opcode import Opcode

from drive_id.errors import MessageCountError, TruncatedBagError
from drive_id.files.storage.mcap_records import (
    MESSAGE,
    PARSE_ERRORS,
    RECORD,
    BreakError,
    DamageError,
    McapRecords,
    Record,
    chunk_index,
    chunk_records,
    parsed,
    plain_chunk,
    split_records,
)
from drive_id.files.storage.storage import RawMessage, TopicInfo

RECORDER_LIBRARY = "drive_id recorder"
"""Marks, in the header, files that are written live: one that breaks off behind whole chunks lacks only its end."""
_LARGEST_BREAK = 1 << 22


class PlainChunk(NamedTuple):
    """Records that stand together in a file, unpacked, and where they begin, byte."""

    data: bytes
    position: int


class McapStorage:
    """Storage back-end for MCAP files; see :class:`~drive_id.files.storage.storage.Storage`."""

    kind = "mcap"

    def __init__(self, path: Path, shown: Path, *, salvage: bool = False) -> None:
        self._shown = shown
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, records.Channel] = {}
        self._skippable: dict[int, frozenset[int]] = {}
        self._counts: Counter[int] | None = None
        self._attachments: list[tuple[str, int, int]] = []
        self._kinds: set[str] = set()
        self.start, self.end = 0, 0
        self.damage = ""
        self.warning = ""
        self._break: int | None = None
        self._next = 0
        self._file = McapRecords(path, shown)
        try:
            self._open(salvage)
        except BaseException:
            self._file.close()
            raise
        self.topics = self._topic_infos()
        self.compression = "+".join(sorted(self._kinds))

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in order of arrival; checks checksums and declared counts.

        Raises
        ------
        TruncatedBagError
            When the file is damaged.
        MessageCountError
            When fewer or more messages are there than the file declares.
        """
        wanted = self.channels(topics)
        found: Counter[int] = Counter()
        try:
            for channel, log_time, data in self._scan(frozenset(wanted)):
                found[channel] += 1
                yield RawMessage(wanted[channel], log_time, data)
        except DamageError as damage:
            raise self._damaged(str(damage)) from damage
        self.check_counts(wanted, found)

    def channels(self, topics: Collection[str]) -> dict[int, str]:
        """Return the channels of topics."""
        return {key: channel.topic for key, channel in self._channels.items() if channel.topic in topics}

    def chunks(self, channels: Collection[int]) -> Iterator[PlainChunk]:
        """Yield the parts of the file in which there can be messages of the channels; their counts are not checked.

        Raises
        ------
        TruncatedBagError
            When the file is damaged.
        """
        try:
            for record in self._file.data_section(self._break):
                self._next = record.end
                if record.opcode == Opcode.CHUNK:
                    held = self._skippable.get(record.position)
                    if held is None or not held.isdisjoint(channels):
                        yield PlainChunk(plain_chunk(record)[1], record.position)
                elif record.opcode == Opcode.MESSAGE:
                    yield PlainChunk(RECORD.pack(record.opcode, len(record.body)) + record.body, record.position)
        except DamageError as damage:
            raise self._damaged(str(damage)) from damage

    @property
    def progress(self) -> float:
        """How much of the file was read last, 0 to 1."""
        return min(self._next / max(self._file.size, 1), 1.0)

    def refuse(self, chunk: PlainChunk) -> NoReturn:
        """Raise what is wrong with a damaged chunk."""
        try:
            for opcode, body in split_records(chunk.data, chunk.position):
                if opcode == Opcode.MESSAGE:
                    list(self._message(body, chunk.position, frozenset()))
        except DamageError as damage:
            raise self._damaged(str(damage)) from damage
        raise self._damaged(f"the chunk at byte {chunk.position} is damaged")

    def check_counts(self, wanted: Mapping[int, str], found: Mapping[int, int]) -> None:
        """Raise MessageCountError when the messages found on channels are not as many as the file declares."""
        if self._counts is None:
            return
        for key, topic in wanted.items():
            if found.get(key, 0) != self._counts[key]:
                raise MessageCountError(
                    f"{self._shown} declares {self._counts[key]} messages on {topic} but holds {found.get(key, 0)}: "
                    "copy the file again from its origin, or rebuild it with 'drive-id recover'."
                )

    def attachment(self, name: str) -> bytes | None:
        """Return the attachment of that name, if there is one; TruncatedBagError when it is damaged."""
        for found, offset, length in self._attachments:
            if found == name:
                try:
                    return self._attachment_data(offset, length)
                except (DamageError, *PARSE_ERRORS) as error:
                    raise self._damaged(f"its attachment '{name}' is damaged") from error
        return None

    def _attachment_data(self, offset: int, length: int) -> bytes:
        body = self._file.read(offset, length)
        crc = struct.unpack("<I", body[-4:])[0]
        if crc and crc != zlib.crc32(body[:-4]):
            raise ValueError("checksum")
        return parsed(records.Attachment, body, offset).data

    # -- opening ---------------------------------------------------------------------------------------------------

    def _open(self, salvage: bool) -> None:
        try:
            summary_start = self._file.footer()
            complete = summary_start > 0 and self._read_summary(summary_start)
        except DamageError as damage:
            if isinstance(damage, BreakError) and self._is_live():
                self._open_broken_off(salvage)
                return
            if not salvage:
                raise self._damaged(str(damage)) from damage
            self.damage = str(damage)
            complete = False
        if complete:
            return
        self._counts = None
        try:
            self._index_by_scan()
        except DamageError as damage:
            if not salvage:
                raise self._damaged(str(damage)) from damage
            self.damage = self.damage or str(damage)

    def _is_live(self) -> bool:
        """Tell whether the recorder wrote this file."""
        header = self._file.header()
        return header is not None and bool(header.library == RECORDER_LIBRARY)

    def _open_broken_off(self, salvage: bool) -> None:
        """Open a file that the recorder did not complete, up to where it breaks off."""
        try:
            self._index_by_scan()
            self.damage = "its index is missing"
        except DamageError as damage:
            self.damage = str(damage)
            far = self._file.size - self._file.whole > _LARGEST_BREAK
            within = not isinstance(damage, BreakError) and self._file.has_record(self._next)
            if far or within:  # what follows could be more than what the recorder had not yet flushed
                if not salvage:
                    raise self._damaged(str(damage)) from damage
                return
        self._break = self._file.whole
        self.warning = (
            f"{self._shown} was not completed, as after a power cut or the end of the recorder ({self.damage}): "
            f"{(self.end - self.start) * 1e-9:.3f} s of it could be read."
        )

    def _read_summary(self, start: int) -> bool:
        """Read the summary section; tell whether it describes the whole file."""
        statistics: records.Statistics | None = None
        position = start
        while position < self._file.summary_end:
            opcode, _, body, end = self._file.record(position)
            if opcode == Opcode.ATTACHMENT_INDEX:
                index = parsed(records.AttachmentIndex, body, position)
                self._attachments.append((index.name, index.offset + RECORD.size, index.length - RECORD.size))
            elif opcode == Opcode.CHUNK_INDEX:
                chunk = chunk_index(body, position)
                self._kinds.add(chunk.compression)
                if chunk.channels:
                    self._skippable[chunk.position] = chunk.channels
            elif opcode == Opcode.STATISTICS:
                statistics = parsed(records.Statistics, body, position)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._note(opcode, body, position)
            position = end
        if statistics is None or statistics.channel_count != len(self._channels):
            return False
        self._kinds.discard("")
        self._counts = Counter(statistics.channel_message_counts)
        self.start, self.end = statistics.message_start_time, statistics.message_end_time
        return set(self._counts) <= set(self._channels)

    def _index_by_scan(self) -> None:
        """Describe a file without a usable summary by reading all of it."""
        counts: Counter[int] = Counter()
        self._attachments.clear()
        try:
            for channel, log_time, _ in self._scan(None):
                self.start = min(self.start, log_time) if counts else log_time
                self.end = max(self.end, log_time)
                counts[channel] += 1
        finally:
            self._counts = counts

    def _topic_infos(self) -> tuple[TopicInfo, ...]:
        infos: dict[str, TopicInfo] = {}
        for key, channel in self._channels.items():
            schema = self._schemas.get(channel.schema_id)
            before = infos.get(channel.topic)
            count = None if self._counts is None else self._counts[key] + ((before.count or 0) if before else 0)
            name = "" if schema is None else _full_type(schema.name)
            if before is not None and before.type_name != name:
                name = f"{before.type_name} and {name}"
            infos[channel.topic] = TopicInfo(
                channel.topic,
                name,
                count,
                channel.message_encoding,
                "" if schema is None else schema.encoding,
                "" if schema is None else schema.data.decode(errors="replace"),
            )
        return tuple(infos.values())

    # -- records ---------------------------------------------------------------------------------------------------

    def _scan(self, wanted: frozenset[int] | None) -> Iterator[tuple[int, int, bytes | memoryview]]:
        """Yield channel, log time and data of each message in file order; all channels, noted too, for ``None``."""
        for record in self._file.data_section(self._break):
            self._next = record.end
            if record.opcode == Opcode.CHUNK:
                channels = self._skippable.get(record.position)
                if wanted is None or channels is None or not wanted.isdisjoint(channels):
                    yield from self._chunk_messages(record, wanted)
            elif record.opcode == Opcode.MESSAGE:
                yield from self._message(memoryview(record.body), record.position, wanted)
            elif wanted is None:
                self._note(record.opcode, record.body, record.position)

    def _chunk_messages(self, record: Record, wanted: frozenset[int] | None) -> Iterator[tuple[int, int, memoryview]]:
        compression, inner = chunk_records(record)
        if compression:
            self._kinds.add(compression)
        for opcode, body in inner:
            if opcode == Opcode.MESSAGE:
                yield from self._message(body, record.position, wanted)
            elif wanted is None:
                self._note(opcode, body, record.position)

    def _message(
        self, body: memoryview, position: int, wanted: frozenset[int] | None
    ) -> Iterator[tuple[int, int, memoryview]]:
        if len(body) < MESSAGE.size:
            raise DamageError(f"a message at byte {position} is too short")
        channel, _, log_time, _ = MESSAGE.unpack_from(body)
        if wanted is None or channel in wanted:
            yield channel, log_time, body[MESSAGE.size :]

    def _note(self, opcode: int, body: bytes | memoryview, position: int) -> None:
        """Remember schemas, channels and where attachments are."""
        if opcode == Opcode.SCHEMA:
            schema = parsed(records.Schema, body, position)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = parsed(records.Channel, body, position)
            self._channels[channel.id] = channel
        elif opcode == Opcode.ATTACHMENT:
            attachment = parsed(records.Attachment, body, position)
            self._attachments.append((attachment.name, position + RECORD.size, len(body)))

    def _damaged(self, why: str) -> TruncatedBagError:
        return TruncatedBagError(
            f"{self._shown} is not a complete recording, for {why}: recover it first with 'drive-id recover'."
        )


def _full_type(name: str) -> str:
    """Write ``package/Name`` as ``package/msg/Name``."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name
