"""Names of recordings, confined to one folder."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path

from drive_id.errors import ConfigurationError, OutputError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", re.ASCII)
_LONGEST = 200


def recording_path(directory: Path, name: str, now: datetime) -> Path:
    """Return the absolute path of a recording to be made.

    Parameters
    ----------
    directory : Path
        The data directory.
    name : str
        Of the recording, without folder; empty: named after the time.
    now : datetime

    Raises
    ------
    ConfigurationError
        When the name is none.
    OutputError
        When something of that name exists.
    """
    base = directory.expanduser().absolute()
    if not name:
        stem = now.strftime("recording_%Y-%m-%d_%H-%M-%S")
        free = (base / stem, *(base / f"{stem}_{number}" for number in range(2, 1000)))
        return next(path for path in free if not _exists(path))
    if len(name) > _LONGEST or not _NAME.fullmatch(name):
        shown = "".join(character if character.isprintable() else "?" for character in name[:_LONGEST])
        raise ConfigurationError(
            f"'{shown}' is no name for a recording: give one without folders, of letters, digits and _ . + -, that "
            f"begins with a letter or digit and has at most {_LONGEST} characters."
        )
    if _exists(base / name):
        raise OutputError(f"{base / name} exists already: choose another name, or remove it.")
    return base / name


def _exists(path: Path) -> bool:
    return path.is_symlink() or path.exists()
