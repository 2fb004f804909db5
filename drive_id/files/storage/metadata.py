"""``metadata.yaml`` as rosbag2 writes it: of version 9, or 8 for bags of older distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Qos:
    """The quality of service that a topic was offered with, as far as it is not rosbag2's default."""

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
    """One topic: name, type, RIHS01 hash, QoS as YAML has it, and the complete definition of its type."""

    name: str
    type_name: str
    hash: str
    offered_qos: list[Any]
    definition: str = ""


@dataclass
class FileEntry:
    """One file: its name, log times of its first and last message (ns; ``first`` is None without any), messages."""

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
        """Return begin, duration and count in the form of the metadata."""
        return _times(self.first, self.last, self.count)


def bag_information(
    topics: Sequence[TopicEntry], files: Sequence[FileEntry], distro: str, custom: Mapping[str, str] | None
) -> dict[str, Any]:
    """Put together the content of ``metadata.yaml``.

    Parameters
    ----------
    topics : sequence of TopicEntry
    files : sequence of FileEntry
        In order.
    distro : str
        Name of the ROS 2 distribution.
    custom : mapping of str to str, optional
        ``custom_data`` of the recording.
    """
    starts = [file.first for file in files if file.first is not None]
    last = max((file.last for file in files), default=0)
    times = _times(min(starts, default=None), last, sum(file.count for file in files))
    by_number = any(_by_number(topic.offered_qos) for topic in topics)
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
                "message_count": sum(file.counts.get(topic.name, 0) for file in files),
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


def _by_number(offered_qos: Any) -> bool:
    """Tell whether policies are written as before version 9: by their numbers, in one text."""
    return any(isinstance(profile, dict) and isinstance(profile.get("history"), int) for profile in offered_qos)


def write_metadata(folder: Path, information: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml``, which appears whole or not at all; OSError when it cannot be written."""
    tree = yaml.safe_dump({"rosbag2_bagfile_information": dict(information)}, sort_keys=False)
    partial = folder / "metadata.yaml.partial"
    partial.write_text(tree, encoding="utf-8")
    partial.replace(folder / "metadata.yaml")


def _times(first: int | None, last: int, count: int) -> dict[str, Any]:
    return {
        "starting_time": {"nanoseconds_since_epoch": first or 0},
        "duration": {"nanoseconds": 0 if first is None else last - first},
        "message_count": count,
    }
