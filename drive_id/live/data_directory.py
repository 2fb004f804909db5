"""Names of recordings that others give: none leads out of the data directory, and nothing is overwritten."""

from __future__ import annotations

import re
from datetime import datetime
from itertools import count
from pathlib import Path

from drive_id.errors import ConfigurationError, NotABagError, OutputError
from drive_id.files.storage.metadata import read_metadata

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+-]*", re.ASCII)
_LONGEST = 200  # characters: file systems take 255 bytes, and the files of a bag add to its name


def new_recording(directory: Path, name: str, now: datetime) -> Path:
    """Return the absolute path of a recording to be made.

    Parameters
    ----------
    directory : Path
        The data directory.
    name : str
        Without folders; if empty, the recording is named after the time.

    Raises
    ------
    ConfigurationError
        When the name is not allowed.
    OutputError
        When something of that name exists.
    """
    base = directory.expanduser().absolute()
    if not name:
        return free_path(base, now.strftime("recording_%Y-%m-%d_%H-%M-%S"))
    check_name(name)
    if _exists(base / name):
        raise OutputError(f"{base / name} exists already: choose another name, or remove it.")
    return base / name


def check_name(name: str) -> None:
    """Raise ConfigurationError unless a recording may have this name."""
    if len(name) > _LONGEST or not _NAME.fullmatch(name):
        raise ConfigurationError(
            f"'{_shown(name)}' is not a name for a recording: use letters, digits and _ . + -, begin with a letter or "
            f"digit, and use at most {_LONGEST} characters."
        )


def free_path(folder: Path, stem: str) -> Path:
    """Return the first of ``stem``, ``stem_2``, ``stem_3``, ... in a folder that is not there yet."""
    paths = (folder / (stem if number == 1 else f"{stem}_{number}") for number in count(1))
    return next(path for path in paths if not _exists(path))


def existing_recording(directory: Path, name: str) -> Path:
    """Return the real path of a recording.

    Parameters
    ----------
    directory : Path
        The data directory.
    name : str
        Relative to it, an absolute path inside it, or that of a recording elsewhere that our recorder has completed:
        what the recorder returned is found whatever the data directories of both nodes are.

    Raises
    ------
    ConfigurationError
        When the path leads out of the data directory, also through links.
    NotABagError
        When there is neither a file nor a folder of this name.
    """
    shown = _shown(name)
    base = directory.expanduser().absolute()
    if _is_ours(Path(name), base):
        base = Path(name).parent
    outside = ConfigurationError(
        f"'{shown}' is not within the data directory {base}: give the name of a recording in it, or set data_directory."
    )
    if not name.strip() or ".." in Path(name).parts or "\0" in name:
        raise outside
    try:
        real_base = base.resolve()
        path = (base / name).resolve()
        if not path.is_relative_to(real_base):
            raise outside
        if not (path.is_file() or path.is_dir()):
            raise NotABagError(f"There is no recording '{shown}' in {base}: give the name of one.")
        for entry in path.iterdir() if path.is_dir() else ():
            if entry.is_symlink() and not entry.resolve().is_relative_to(real_base):
                raise outside
            if not (entry.is_file() or entry.is_dir() or entry.is_symlink()):
                raise NotABagError(
                    f"The recording '{shown}' in {base} holds {_shown(entry.name)}, which is neither a file nor a "
                    "folder: remove it."
                )
    except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links
        raise NotABagError(f"The recording '{shown}' in {base} cannot be read ({error}): check its name.") from error
    return path


def _is_ours(path: Path, base: Path) -> bool:
    """Tell whether a path outside the data directory is that of a recording of our recorder."""
    if not path.is_absolute() or path.is_relative_to(base) or "\0" in str(path) or path.is_symlink():
        return False
    try:
        return read_metadata(path / "metadata.yaml").ours
    except NotABagError:
        return False


def _exists(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def _shown(name: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in name[:_LONGEST])
