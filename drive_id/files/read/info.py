"""Contents of a recording, without reading its messages and without numpy, for a fast ``drive-id info``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drive_id.common.quantity import counted
from drive_id.errors import BagError, DriveIdError
from drive_id.files.logs.log_kind import log_kind
from drive_id.files.storage.bag import open_bag
from drive_id.files.storage.container import TRUTH_ATTACHMENT, TopicInfo, file_size

if TYPE_CHECKING:
    from drive_id.files.logs.column_log import ColumnLog

_LONGEST_SENTENCE = 2000  # characters of what is said of a damaged bag


@dataclass(frozen=True, kw_only=True)
class BagInfo:
    """Contents of a recording, as its files declare them."""

    path: str
    storage: str  # such as mcap or sqlite3
    compression: str = ""  # "(file)" after it means whole files, "(message)" single messages
    files: tuple[str, ...]
    size: int  # of all files, bytes
    topics: tuple[TopicInfo, ...]
    messages: int
    start: int = 0  # log time of the first message, ns
    duration: float = 0.0  # between first and last message, s
    complete: bool = True
    problem: str = ""  # what is wrong with an incomplete one
    ground_truth: bool = False  # that of a simulation is attached


def bag_info(path: Path) -> BagInfo:
    """Describe a recording, also an incomplete one; raises BagError when nothing of it can be read."""
    if log_kind(path):
        from drive_id.files.logs.open_log import open_log  # noqa: PLC0415  # numpy takes longer than to list a bag

        with printable_errors(), open_log(path) as log:
            return _log_info(log)
    with printable_errors(), open_bag(path, salvage=True) as bag:
        problems = [storage.damage for storage in bag.storages if storage.damage]
        declared = bag.metadata.counts if bag.metadata else {}
        for name, topic in bag.topics.items():
            if not problems and topic.count is not None and declared.get(name, topic.count) != topic.count:
                problems.append(
                    f"metadata.yaml declares {counted(declared[name], 'message')} on {name}, the files {topic.count}"
                )
        truth = None
        with suppress(BagError):
            truth = bag.attachment(TRUTH_ATTACHMENT)
        counts = [topic.count or 0 for topic in bag.topics.values()]
        times = [(storage.start, storage.end) for storage in bag.storages if storage.end]
        start = min((first for first, _ in times), default=0)
        end = max((last for _, last in times), default=0)
        return BagInfo(
            path=str(path),
            storage="+".join(sorted({storage.kind for storage in bag.storages})),
            compression=bag.compression,
            files=tuple(str(file) for file in bag.files),
            size=sum(file_size(file) for file in bag.files),
            topics=tuple(sorted(bag.topics.values(), key=lambda topic: topic.name)),
            messages=sum(counts),
            start=start,
            duration=(end - start) * 1e-9,
            complete=not problems,
            problem="; ".join(problems),
            ground_truth=truth is not None,
        )


def _log_info(log: ColumnLog) -> BagInfo:
    """Describe a file of columns: each stands for a topic, its rows for messages."""
    columns = tuple(
        TopicInfo(f"{group.name}: {name}" if group.name else name, kind, group.rows, "")
        for group in log.groups
        for name, kind in group.columns.items()
    )
    return BagInfo(
        path=str(log.path),
        storage=log.kind,
        files=(str(log.path),),
        size=file_size(log.path),
        topics=columns,
        messages=max((group.rows or 0 for group in log.groups), default=0),
    )


@contextmanager
def printable_errors() -> Iterator[None]:
    """Replace unprintable characters in errors, and cut long ones: damaged bags have such names."""
    try:
        yield
    except DriveIdError as error:
        said = str(error)
        if len(said) > _LONGEST_SENTENCE:
            said = f"{said[: _LONGEST_SENTENCE - 200]} ... {said[-200:]}"
        text = "".join(character if character.isprintable() else " " for character in said)
        if text == str(error):
            raise
        raise type(error)(text) from error
