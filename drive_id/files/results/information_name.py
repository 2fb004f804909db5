"""Tells an information file from a bag without loading what reads it."""

from __future__ import annotations

from pathlib import Path

from drive_id.files.inputs.input_file import open_input

SUFFIX = ".info"
_ZIP_MAGIC = b"PK"


def is_information(path: Path) -> bool:
    """Tell whether a path names an information file, readable or not; anything else may be a bag."""
    try:
        if not path.is_file():
            return path.suffix == SUFFIX and not path.exists()
        with open_input(path) as file:
            return path.suffix == SUFFIX or file.read(2) == _ZIP_MAGIC
    except (OSError, ValueError):
        return False
