"""The recordings in a data directory, as their metadata describe them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from drive_id.errors import DriveIdError, OutputError
from drive_id.files.storage.metadata import read_metadata

METADATA = "metadata.yaml"


@dataclass(frozen=True)
class FoundRecording:
    """A recording: times in ns, size in bytes; an error says why it cannot be read as it is."""

    path: Path
    size: int
    begin: int = 0
    duration: int = 0
    messages: int = 0
    error: str = ""


def find_recordings(directory: Path, name: str, most: int) -> tuple[list[FoundRecording], int]:
    """Return the newest recordings of a data directory whose name contains ``name``, and how many there are.

    Raises
    ------
    OutputError
        When the directory cannot be read.
    """
    base = directory.expanduser().absolute()
    try:
        entries = (
            [each for each in base.iterdir() if name in each.name and _is_recording(each)] if base.exists() else []
        )
        entries.sort(key=lambda each: (each.stat().st_mtime, each.name), reverse=True)
    except OSError as error:
        raise OutputError(f"{base} cannot be read ({error.strerror or error}).") from error
    return [_found(each) for each in entries[:most]], len(entries)


def _is_recording(path: Path) -> bool:
    return not path.is_symlink() and path.is_dir() and any(path.glob("*.mcap"))


def _found(path: Path) -> FoundRecording:
    size = sum(file.lstat().st_size for file in path.iterdir())
    if not (path / METADATA).exists():
        said = f"{path} has no {METADATA}: it is being recorded, or was cut off (drive-id recover completes it)."
        return FoundRecording(path, size, error=said)
    try:
        found = read_metadata(path / METADATA)
    except DriveIdError as error:
        return FoundRecording(path, size, error=str(error))
    return FoundRecording(path, size, found.begin, found.duration, sum(found.counts.values()))
