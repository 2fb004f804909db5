"""Paths that others name, kept within one folder."""

from __future__ import annotations

from pathlib import Path

from drive_id.errors import ConfigurationError, NotABagError

_LONGEST_SHOWN = 200


def confined_bag(directory: Path, name: str) -> Path:
    """Return the real path of a recording that was asked for by name.

    Parameters
    ----------
    directory : Path
        The folder of all recordings.
    name : str
        Relative to it, or an absolute path in it.

    Raises
    ------
    ConfigurationError
        When it leads out of the folder, be it by links.
    NotABagError
        When there is nothing of this name, or neither a file nor a folder.
    """
    shown = "".join(character if character.isprintable() else "?" for character in name[:_LONGEST_SHOWN])
    base = directory.expanduser().absolute()
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
        inner = path.iterdir() if path.is_dir() else ()
        if any(entry.is_symlink() and not entry.resolve().is_relative_to(real_base) for entry in inner):
            raise outside
    except (OSError, RuntimeError) as error:  # RuntimeError: a loop of links
        raise NotABagError(f"The recording '{shown}' in {base} cannot be read ({error}): check its name.") from error
    return path
