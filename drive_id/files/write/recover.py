"""Recovery: a complete copy of what can be read of a truncated or damaged MCAP recording."""

from __future__ import annotations

import re
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap import records

from drive_id.common.quantity import counted
from drive_id.errors import EmptyTopicError, NotABagError
from drive_id.files.inputs.yaml_tree import load_yaml
from drive_id.files.storage.bag import present_files
from drive_id.files.storage.container import MCAP_MAGIC, SQLITE_MAGIC, read_magic, unpack_file
from drive_id.files.storage.mcap import DamageError, McapFile, RecordError, chunk_records
from drive_id.files.storage.metadata import FileEntry, TopicEntry, bag_information, read_metadata, write_metadata
from drive_id.files.write.rosbag2_writer import McapOutput, open_unbuffered, whole_or_nothing

_LIBRARY = "drive_id recover"
_NUMBER = re.compile(r"_(\d+)\.mcap")
"""Number of a file in its recording."""
_CHUNK_SIZE = 512 * 1024  # bytes, as the recorder writes


@dataclass(frozen=True)
class Recovery:
    """Result of a recovery."""

    output: Path  # the complete recording
    topics: dict[str, int]  # messages by topic
    duration: float  # between the first and the last message, s
    damage: tuple[str, ...]  # sentences about what could not be recovered; empty when the recording was complete


def recover_bag(path: Path, output: Path | None = None) -> Recovery:
    """Write what can be read of an MCAP recording as a new, complete one; the original is not changed.

    ``path`` is a storage file or a folder, whose ``metadata.yaml`` is ignored; the folder ``output``, by default beside
    it with ``_recovered`` appended, appears whole or not at all.

    Raises NotABagError when it is no MCAP recording, EmptyTopicError when there is no message to recover, OutputError
    when the output exists or cannot be written.
    """
    files = present_files(path)
    absolute = path.absolute()
    output = output or absolute.with_name((absolute.name if path.is_dir() else absolute.stem) + "_recovered")
    with whole_or_nothing(output) as folder:
        folder.mkdir()
        return _recover_files(files, path, folder, output)


def _recover_files(files: tuple[Path, ...], path: Path, folder: Path, output: Path) -> Recovery:
    topics: dict[str, TopicEntry] = {}
    entries: list[FileEntry] = []
    damage: list[str] = []
    distro = ""
    for file in files:
        with ExitStack() as stack:
            plain, _ = unpack_file(file, Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="drive_id_"))))
            magic = read_magic(plain, file)
            if not magic.startswith(MCAP_MAGIC):
                if magic.startswith(SQLITE_MAGIC) or len(files) == 1:
                    raise NotABagError(
                        f"{file} is not an MCAP file: recover sqlite3 files with 'sqlite3 FILE .recover'."
                    )
                damage.append(f"{file}: its start was never written to disk; the file is left out.")
                continue
            source = McapFile(plain, file)
            stack.callback(source.close)
            copy = _Copy(source, file, folder / f"{output.name}_{len(entries)}.mcap", topics)
            stack.callback(copy.output.release)
            copy.run()
        damage += copy.damage
        distro = distro or copy.distro
        if copy.entry.count:
            entries.append(copy.entry)
        else:
            (folder / copy.entry.name).unlink()
    if not entries:
        said = f": {damage[0]}" if damage else "."
        raise EmptyTopicError(f"{path} holds no message that could be recovered{said}")
    information = bag_information(list(topics.values()), entries, distro, None)
    write_metadata(folder, information)
    damage += _missing(path, files, sum(entry.count for entry in entries))
    counts = {name: sum(entry.counts.get(name, 0) for entry in entries) for name in topics}
    return Recovery(output, counts, information["duration"]["nanoseconds"] * 1e-9, tuple(damage))


def _missing(path: Path, files: tuple[Path, ...], messages: int) -> list[str]:
    """Say which files of a folder are missing, by its metadata or else by the numbers in their names."""
    there = {file.name for file in files}
    try:
        metadata = read_metadata(path / "metadata.yaml")
    except NotABagError:  # none, or a damaged one
        numbers = {int(found.group(1)) for name in there if (found := _NUMBER.search(name))}
        gaps = sorted(set(range(min(numbers, default=0), max(numbers, default=0))) - numbers)
        said = ", ".join(map(str, gaps))
        return [f"{path}: by the numbers of its files, {said} {'are' if gaps[1:] else 'is'} missing."] if gaps else []
    lost = sum(metadata.counts.values()) - messages
    names = ", ".join(name for name in metadata.files if name not in there)
    more = f", with {counted(lost, 'message')}" if lost > 0 else ""
    return [f"{path}: {names} is missing, which metadata.yaml names{more}."] if names else []


class _Copy:
    """Copies the whole records of one file."""

    def __init__(self, source: McapFile, shown: Path, target: Path, topics: dict[str, TopicEntry]) -> None:
        header = source.header()
        profile = header.profile if header else ""
        self.output = McapOutput(
            target, open_unbuffered, chunk_size=_CHUNK_SIZE, compression="zstd", library=_LIBRARY, profile=profile
        )
        self.entry = self.output.entry
        self.damage: list[str] = []
        self.distro = ""
        self._shown = shown
        self._topics = topics
        self._schemas: dict[int, int] = {0: 0}
        self._types: dict[int, str] = {}
        self._channels: dict[int, tuple[int, str]] = {}
        self._file = source
        self._writer = self.output.writer

    def run(self) -> None:
        """Copy all whole records, and complete the copy."""
        position = len(MCAP_MAGIC)
        while position:
            position = self._copy_from(position)
        self.output.finish(bag_information(list(self._topics.values()), [self.entry], self.distro, None))

    def _copy_from(self, begin: int) -> int:
        """Copy the records from byte ``begin`` on; return where to go on behind a damaged one, 0 at the end."""
        try:
            for position, record in self._file.data(begin):
                self._copy_record(record, position)
        except RecordError as damage:
            self.damage.append(f"{self._shown}: {damage}; it is left out.")
            return self._file.end
        except DamageError as damage:
            lost = self._file.size - self._file.begin
            self.damage.append(
                f"{self._shown}: {damage}" + (f"; it lost its last {counted(lost, 'byte')}." if lost > 0 else ".")
            )
        return 0

    def _copy_record(self, record: records.McapRecord, position: int) -> None:
        """Copy one record; a damaged one is left out and named."""
        try:
            if isinstance(record, records.Chunk):
                plain = self._file.unpack(record, position)
                for _ in chunk_records(plain, position):
                    pass  # all of it or nothing
                for inner in chunk_records(plain, position):
                    self._copy_content(inner, position)
            else:
                self._copy_content(record, position)
        except DamageError as damage:
            self.damage.append(f"{self._shown}: {damage}; it is left out.")

    def _copy_content(self, record: records.McapRecord, position: int) -> None:
        if isinstance(record, records.Message):
            if record.channel_id not in self._channels:
                raise DamageError(f"a message at byte {position} belongs to no channel")
            number, topic = self._channels[record.channel_id]
            data = bytes(record.data)
            self._writer.add_message(number, record.log_time, data, record.publish_time, record.sequence)
            self.entry.note(topic, record.log_time)
        elif isinstance(record, records.Schema):
            if record.id not in self._schemas:
                self._schemas[record.id] = self._writer.register_schema(record.name, record.encoding, record.data)
                self._types[record.id] = record.name
        elif isinstance(record, records.Channel):
            self._copy_channel(record, position)
        elif isinstance(record, records.Attachment):
            times = record.create_time, record.log_time
            self._writer.add_attachment(*times, record.name, record.media_type, record.data)
        elif isinstance(record, records.Metadata):
            if record.name == "rosbag2":
                tree = _loaded(record.metadata.get("serialized_metadata", ""))
                distro = tree.get("ros_distro") if isinstance(tree, dict) else ""
                self.distro = self.distro or (distro if isinstance(distro, str) else "")
            else:
                self._writer.add_metadata(record.name, record.metadata)

    def _copy_channel(self, channel: records.Channel, position: int) -> None:
        if channel.id in self._channels:
            return
        if channel.schema_id not in self._schemas:
            raise DamageError(f"the schema of {channel.topic}, at byte {position}, is missing")
        number = self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas[channel.schema_id], channel.metadata
        )
        self._channels[channel.id] = (number, channel.topic)
        if channel.topic not in self._topics:
            profiles = _loaded(channel.metadata.get("offered_qos_profiles", ""))
            self._topics[channel.topic] = TopicEntry(
                channel.topic,
                self._types.get(channel.schema_id, ""),
                channel.metadata.get("topic_type_hash", ""),
                profiles if isinstance(profiles, list) else [],
            )


def _loaded(text: str) -> Any:
    """Return a YAML document; None for a damaged one."""
    try:
        return load_yaml(text)
    except (yaml.YAMLError, ValueError):
        return None
