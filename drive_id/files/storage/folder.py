"""The files of a recording: which they are, in which order, and what ``metadata.yaml`` says of them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from drive_id.errors import NotABagError
from drive_id.files.storage.container import reason

_ENDINGS = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".mcap.lz4", ".db3.lz4", ".mcap.zst", ".db3.zst")
_LARGEST_METADATA = 1 << 26


@dataclass(frozen=True)
class BagMetadata:
    """What ``metadata.yaml`` says: files in order, message counts and types by topic, compression of messages."""

    files: tuple[str, ...]
    counts: dict[str, int]
    types: dict[str, str]
    message_compression: str


def storage_files(path: Path) -> tuple[tuple[Path, ...], BagMetadata | None]:
    """Find the storage files of a recording, in order.

    Raises
    ------
    NotABagError
        When there is none, or ``metadata.yaml`` is unreadable or names a file that is not there.
    """
    try:
        if not path.exists():
            raise NotABagError(f"{path} does not exist: give a rosbag2 file or folder.")
        if not path.is_dir():
            return (path,), None
        present = _present(path)
        metadata = read_metadata(path / "metadata.yaml") if (path / "metadata.yaml").exists() else None
    except OSError as error:
        raise NotABagError(f"{path} cannot be read ({reason(error)}): check the path and its permissions.") from error
    if metadata is None:
        if not present:
            raise NotABagError(f"{path} is a folder without an .mcap or .db3 file: give a rosbag2 folder.")
        return tuple(present), None
    files = tuple(path / name for name in metadata.files)
    for file in files:
        if not file.is_file():
            raise NotABagError(
                f"metadata.yaml of {path} names {file.name}, which is not there: complete the folder, or rewrite "
                "metadata.yaml with 'ros2 bag reindex'."
            )
    left = [entry.name for entry in present if entry not in files]
    if left:
        raise NotABagError(
            f"{path} holds {left[0]}, which its metadata.yaml does not name: rewrite metadata.yaml with "
            "'ros2 bag reindex', or move the file away."
        )
    return files, metadata


def present_files(path: Path) -> tuple[Path, ...]:
    """Find the storage files of a recording, in order of their names, whatever ``metadata.yaml`` says.

    Raises
    ------
    NotABagError
        When there is none.
    """
    try:
        if not path.exists():
            raise NotABagError(f"{path} does not exist: give a rosbag2 file or folder.")
        files = _present(path) if path.is_dir() else [path]
    except OSError as error:
        raise NotABagError(f"{path} cannot be read ({reason(error)}): check the path and its permissions.") from error
    if not files:
        raise NotABagError(f"{path} is a folder without an .mcap or .db3 file: give a rosbag2 folder.")
    return tuple(files)


def _present(folder: Path) -> list[Path]:
    return sorted(
        (entry for entry in folder.iterdir() if entry.name.endswith(_ENDINGS) and entry.is_file()), key=_natural
    )


def read_metadata(path: Path) -> BagMetadata:
    """Read ``metadata.yaml`` of rosbag2, any version.

    Raises
    ------
    NotABagError
        When it is not such a file; names what is wrong.
    """
    advice = "rewrite it with 'ros2 bag reindex', or remove it to read the files without it."
    try:
        state = path.stat()
        if state.st_size > _LARGEST_METADATA:
            raise ValueError("it is too large")
        return _parsed(path, state.st_mtime_ns, state.st_size)
    except OSError as error:
        raise NotABagError(f"{path} cannot be read ({reason(error)}): {advice}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        said = f"it is no YAML in line {line}" if (line := _line(error)) else str(error).split("\n")[0]
        raise NotABagError(f"{path} is damaged ({said}): {advice}") from error


@lru_cache(maxsize=8)
def _parsed(path: Path, _time: int, _size: int) -> BagMetadata:
    """Parse the file once, as long as it does not change: that takes longer than reading some seconds of samples."""
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    information = _item(tree, "rosbag2_bagfile_information", dict)
    files = _item(information, "relative_file_paths", list)
    if not files or not all(isinstance(name, str) and PurePosixPath(name).name for name in files):
        raise ValueError("relative_file_paths is not a list of file names")
    counts: dict[str, int] = {}
    types: dict[str, str] = {}
    for entry in _item(information, "topics_with_message_count", list):
        topic = _item(entry, "topic_metadata", dict)
        name = _item(topic, "name", str)
        counts[name] = counts.get(name, 0) + _item(entry, "message_count", int)
        types[name] = _item(topic, "type", str)
    by_message = str(information.get("compression_mode")).lower() == "message"
    compression = str(information.get("compression_format")) if by_message else ""
    names = tuple(PurePosixPath(name).name for name in files)
    return BagMetadata(names, counts, types, compression)


def _item(tree: Any, key: str, kind: type) -> Any:
    if not isinstance(tree, dict) or key not in tree:
        raise ValueError(f"it has no {key}")
    if not isinstance(tree[key], kind) or isinstance(tree[key], bool):
        raise TypeError(f"{key} is not of type {kind.__name__}")
    return tree[key]


def _line(error: BaseException) -> int:
    mark = getattr(error, "problem_mark", None)
    return 0 if mark is None else mark.line + 1


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts ``bag_10`` behind ``bag_9``."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"([0-9]+)", path.name)]
