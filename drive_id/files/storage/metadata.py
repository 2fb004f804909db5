"""``metadata.yaml`` of rosbag2: read in any version, written as version 9, or 8 for bags of older distributions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import yaml

from drive_id.errors import NotABagError
from drive_id.files.inputs.input_file import read_text_input, reason
from drive_id.files.inputs.yaml_tree import line_of, load_yaml
from drive_id.files.storage.container import full_type
from drive_id.files.storage.durable import sync_folder, write_synced

_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LARGEST = 1 << 23  # bytes of metadata.yaml, with thousands of topics
_MOST_FILES = 20_000  # a file a minute for two weeks
_MOST_TOPICS = 20_000  # far more than any robot has


WRITTEN = "samples_written:"
"""How entries of ``custom_data`` begin that our recorder writes for each topic."""


class ChangeMark(NamedTuple):
    """Where our recorder saw another drive begin: log time of the first message, ns, and why."""

    log_time: int
    reason: str


@dataclass(frozen=True)
class BagMetadata:
    """Content of ``metadata.yaml``: files in order, message counts and types by topic, compression of messages."""

    files: tuple[str, ...]
    counts: dict[str, int]
    types: dict[str, str]
    message_compression: str
    changes: tuple[ChangeMark, ...] = ()
    begin: int = 0  # log time of the first message, ns
    duration: int = 0  # ns
    ours: bool = False  # our recorder has completed it


def read_metadata(path: Path) -> BagMetadata:
    """Read ``metadata.yaml`` of rosbag2, any version; raises NotABagError, which names what is wrong."""
    advice = "rewrite it with 'ros2 bag reindex', or remove it to read the files without it."
    try:
        return _parsed(path)
    except OSError as error:
        raise NotABagError(f"{path} cannot be read ({reason(error)}): {advice}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        said = f"it is not YAML, see line {line}" if (line := line_of(error)) else str(error).split("\n")[0]
        raise NotABagError(f"{path} is damaged ({said}): {advice}") from error


def _parsed(path: Path) -> BagMetadata:
    tree = load_yaml(read_text_input(path, _LARGEST))
    information = _item(tree, "rosbag2_bagfile_information", dict)
    files = _item(information, "relative_file_paths", list)
    if not files or not all(isinstance(name, str) and PurePosixPath(name).name for name in files):
        raise ValueError("relative_file_paths is not a list of file names")
    if len(files) > _MOST_FILES:
        raise ValueError(f"it names {len(files)} files")
    counts: dict[str, int] = {}
    types: dict[str, str] = {}
    topics = _item(information, "topics_with_message_count", list)
    if len(topics) > _MOST_TOPICS:
        raise ValueError(f"it names {len(topics)} topics")
    for entry in topics:
        topic = _item(entry, "topic_metadata", dict)
        name = _item(topic, "name", str)
        counts[name] = counts.get(name, 0) + _item(entry, "message_count", int)
        types[name] = full_type(_item(topic, "type", str))
    mode, form = information.get("compression_mode"), information.get("compression_format")
    compression = form if isinstance(mode, str) and mode.lower() == "message" and isinstance(form, str) else ""
    names = tuple(PurePosixPath(name).name for name in files)
    custom, begin = information.get("custom_data"), information.get("starting_time")
    return BagMetadata(
        names, counts, types, compression, tuple(_changes(custom)),
        begin=_nanoseconds(begin, "nanoseconds_since_epoch"),
        duration=_nanoseconds(information.get("duration"), "nanoseconds"),
        ours=isinstance(custom, dict) and any(str(key).startswith(WRITTEN) for key in custom),
    )  # fmt: skip


def _nanoseconds(tree: Any, key: str) -> int:
    value = tree.get(key) if isinstance(tree, dict) else None
    return value if type(value) is int and 0 <= value < 1 << 63 else 0


def _changes(custom: Any) -> Iterator[ChangeMark]:
    """Yield the marks of our recorder; custom data of others are of no concern."""
    if not isinstance(custom, dict):
        return
    for number in count(2):
        begins, reason = (custom.get(f"recording_{number}:{name}") for name in ("begins", "because"))
        if not (isinstance(begins, str) and begins.isdecimal() and len(begins) < 20 and isinstance(reason, str)):
            return
        yield ChangeMark(int(begins), reason)


def _item(tree: Any, key: str, kind: type) -> Any:
    if not isinstance(tree, dict) or key not in tree:
        raise ValueError(f"it has no {key}")
    if not isinstance(tree[key], kind) or isinstance(tree[key], bool):
        raise TypeError(f"{key} is not of type {kind.__name__}")
    return tree[key]


@dataclass(frozen=True)
class Qos:
    """Quality of service of a topic, where it can differ from rosbag2's defaults."""

    depth: int = 1000
    reliability: str = "reliable"
    durability: str = "volatile"

    def profile(self) -> dict[str, Any]:
        """Return the profile in the form of metadata version 9."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }


@dataclass
class TopicEntry:
    """One topic: name, type, RIHS01 hash, QoS profiles in the form of YAML, and complete definition of its type."""

    name: str
    type_name: str
    hash: str
    offered_qos: list[Any]
    definition: str = ""


@dataclass
class FileEntry:
    """One file: name, log times of its first and last message (ns; ``first`` is None without any), message counts."""

    name: str
    first: int | None = None
    last: int = 0
    counts: dict[str, int] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Messages in the file."""
        return sum(self.counts.values())

    def note(self, topic: str, log_time: int) -> None:
        """Count one message."""
        if self.first is None or log_time < self.first:
            self.first = log_time
        self.last = max(self.last, log_time)
        self.counts[topic] = self.counts.get(topic, 0) + 1

    def times(self) -> dict[str, Any]:
        """Return start, duration and count in the form of the metadata."""
        return {
            "starting_time": {"nanoseconds_since_epoch": self.first or 0},
            "duration": {"nanoseconds": 0 if self.first is None else self.last - self.first},
            "message_count": self.count,
        }


def bag_information(
    topics: Sequence[TopicEntry], files: Sequence[FileEntry], distro: str, custom: Mapping[str, str] | None
) -> dict[str, Any]:
    """Return the content of ``metadata.yaml``, with ``custom`` as its ``custom_data``."""
    starts = [file.first for file in files if file.first is not None]
    counts = sum((Counter(file.counts) for file in files), Counter[str]())
    whole = FileEntry("", min(starts, default=None), max((file.last for file in files), default=0), counts)
    times = whole.times()
    profiles = [profile for topic in topics for profile in topic.offered_qos if isinstance(profile, dict)]
    by_number = any(isinstance(profile.get("history"), int) for profile in profiles)  # in one text, before version 9
    return {
        "version": 8 if by_number else 9,
        "storage_identifier": "mcap",
        "duration": times["duration"],
        "starting_time": times["starting_time"],
        "message_count": times["message_count"],
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": (
                        yaml.safe_dump(topic.offered_qos, sort_keys=False) if by_number else topic.offered_qos
                    ),
                    "type_description_hash": topic.hash,
                },
                "message_count": counts[topic.name],
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **file.times()} for file in files],
        "custom_data": dict(custom) if custom else None,
        "ros_distro": distro,
    }


def write_metadata(folder: Path, information: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml`` to the disk, all of it or nothing; OSError when it cannot be written."""
    tree = yaml.safe_dump({"rosbag2_bagfile_information": dict(information)}, sort_keys=False)
    partial = folder / "metadata.yaml.partial"
    write_synced(partial, tree.encode())
    partial.replace(folder / "metadata.yaml")
    sync_folder(folder)
