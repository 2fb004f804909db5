"""Folders of result files: written whole or not at all, and never over files that are not ours."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path

from drive_id.errors import OutputError
from drive_id.files.inputs.input_file import read_text_input

FORMAT = "drive_id/identification"
MARKER = "identification.json"
"""The file by which a folder is known as a result of a fit, and the format that it names."""
LARGEST_MARKER = 1 << 23
"""Bytes."""


def check_output(directory: Path, *, force: bool = False, marker: str = MARKER, kind: str = FORMAT) -> None:
    """Check, before the work is done, that results may be written to a folder.

    Parameters
    ----------
    directory : Path
    force : bool
        Allow a folder that holds other files.
    marker, kind : str
        JSON file, and the format it names, by which a folder is known as ours.

    Raises
    ------
    OutputError
        When it is a file, holds other files than our earlier results and ``force`` is not given, or cannot be written.
    """
    try:
        if not _is_there(directory):
            _check_base(directory, directory.parent)
            return
        if not directory.is_dir():
            raise OutputError(f"The output {directory} is a file: give a folder.")
        _check_base(directory, directory)
        if any(directory.iterdir()) and not force and not is_ours(directory / marker, kind):
            raise OutputError(
                f"The output folder {directory} holds files that are not results of drive_id: give another folder, or "
                "--force to write beside them."
            )
    except OSError as error:
        raise _refused(directory, error) from error


def check_absent(path: Path) -> None:
    """Check, before the work is done, that a path is free and can be written.

    Raises
    ------
    OutputError
        When something is there already, or the path cannot be written.
    """
    try:
        if _is_there(path):
            raise OutputError(f"The output {path} exists already: remove it or give another name.")
        _check_base(path, path.parent)
    except OSError as error:
        raise _refused(path, error) from error


def replace_folder(
    directory: Path,
    files: Mapping[str, bytes],
    *,
    marker: str,
    kind: str,
    force: bool = False,
    stale: Collection[str] = (),
) -> None:
    """Write files to a folder so that they appear under their names only when all of them are complete.

    Parameters
    ----------
    directory : Path
        Created when missing; other files in it stay.
    files : mapping of str to bytes
    marker, kind, force
        See :func:`check_output`.
    stale : collection of str
        Files of earlier results to remove.

    Raises
    ------
    OutputError
        See :func:`check_output`; also when the disk is full.
    """
    check_output(directory, force=force, marker=marker, kind=kind)
    try:
        exists = directory.is_dir()
        base = directory if exists else directory.parent  # where a file can be renamed to its place
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=base, prefix=".drive_id-") as temporary:
            staged = Path(temporary) / "results"
            staged.mkdir()
            for name, content in files.items():
                (staged / name).write_bytes(content)
            if not exists:
                staged.rename(directory)
                return
            for name in sorted(files, key=lambda name: name == marker):
                (staged / name).replace(directory / name)
            for name in stale:
                (directory / name).unlink(missing_ok=True)
    except OSError as error:
        raise _refused(directory, error) from error


def replace_file(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, in the place of one of this name; folders above it are created.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".drive_id-") as temporary:
            staged = Path(temporary) / "file"
            staged.write_bytes(content)
            staged.replace(path)
    except OSError as error:
        raise _refused(path, error) from error


def _is_there(path: Path) -> bool:
    """Tell whether the name is taken, if only by a dangling link; raises OSError for impossible names."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def _check_base(path: Path, base: Path) -> None:
    while not _is_there(base) and base != base.parent:
        base = base.parent
    if not base.is_dir() or not os.access(base, os.W_OK | os.X_OK):
        raise OutputError(f"The output {path} cannot be written because of {base}: give another name.")


def _refused(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"The output {path} cannot be written ({error.strerror or type(error).__name__}): make room or give another "
        "name."
    )


def is_result(path: Path) -> bool:
    """Tell whether a path is meant as the result folder of a fit, readable or not."""
    return (path / MARKER).is_file()


def is_ours(marker: Path, kind: str = FORMAT) -> bool:
    """Tell whether a JSON file names a format of ours."""
    try:
        tree = json.loads(read_text_input(marker, LARGEST_MARKER))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(tree, dict) and tree.get("format") == kind
