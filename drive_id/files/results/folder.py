"""Folders of result files: written whole or not at all, and never over files that are not ours."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from drive_id.common.interrupts import held, note_complete
from drive_id.common.quantity import counted
from drive_id.errors import OutputError
from drive_id.files.inputs.input_file import open_input, read_json_input
from drive_id.files.storage.durable import exchanged, make_folder, sync_folder, write_synced

FORMAT = "drive_id/identification"
MARKER = "identification.json"
"""The file by which a folder is known as a result of a fit, and the format that it names."""
LARGEST_MARKER = 1 << 23
"""Bytes."""
_INFORMATION, _ZIP_MAGIC = ".info", b"PK"
"""Suffix and beginning of an information file."""
_MOST_NAMED = 3  # files in a message
_TAIL, _MEMBER = 1 << 12, b"header.npy"
"""Last bytes of an information file, within which it names its last array, and that name; other zip files hold logs."""
_STAGED = ".drive_id-"
"""How the names of folders begin in which files are written before they are put in their place."""


def check_output(directory: Path, *, force: bool = False, marker: str = MARKER, kind: str = FORMAT) -> None:
    """Check, before the work is done, that results may be written to a folder.

    A folder is known as ours by its JSON file ``marker``, which names the format ``kind``. Raises OutputError when it
    is a file, holds other files than our earlier results and ``force`` is not given, or cannot be written.
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


def check_recordings(directory: Path, inputs: Mapping[str, str], *, force: bool = False) -> None:
    """Check that a folder holds no result of other recordings than ``inputs``, file to its sha256.

    Raises OutputError when it does and ``force`` is not given, with what differs.
    """
    try:
        inputs_before = read_json_input(directory / MARKER, LARGEST_MARKER)["inputs"]
        earlier = {str(entry["file"]): str(entry["sha256"]) for entry in inputs_before}
    except (TypeError, KeyError):
        return  # no result, or one that cannot be read
    if force or not earlier or set(earlier.values()) == set(inputs.values()):
        return
    names, given = ([Path(name).name for name in known] for known in (earlier, inputs))
    changed = sorted(set(names) & set(given)) if sorted(names) == sorted(given) else []
    of = f"an earlier {_listed(changed)}" if changed else _listed(names)
    raise OutputError(
        f"The output folder {directory} holds the result of {of}, and not of {_listed(given) or 'these samples'}: give "
        "another folder, or --force to replace it."
    )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_MOST_NAMED])
    return f"{shown} and {counted(len(names) - _MOST_NAMED, 'other')}" if len(names) > _MOST_NAMED else shown


def check_absent(path: Path) -> None:
    """Check, before the work is done, that a path is free and can be written.

    Raises OutputError when something is there already, or the path cannot be written.
    """
    try:
        if _is_there(path):
            raise OutputError(f"The output {path} exists already: remove it or give another name.")
        _check_base(path, path.parent)
    except OSError as error:
        raise _refused(path, error) from error


def check_own(path: Path, mark: str, within: int = -1) -> None:
    """Check, before the work is done, that a path is free or holds a file of ours, by a mark in its first bytes.

    Raises OutputError as :func:`check_absent` does.
    """
    try:
        with open_input(path) as opened:
            if mark.encode() in opened.read(within):
                return
    except (OSError, ValueError):
        pass  # not ours
    check_absent(path)


def replace_folder(
    directory: Path,
    files: Mapping[str, bytes],
    *,
    marker: str,
    kind: str,
    force: bool = False,
    stale: Collection[str] = (),
) -> None:
    """Write files to a folder in one step: at any moment, even after a kill or a power cut, it is the old or the new.

    A new folder with the files, and with links to what else the old one holds, is exchanged with the old one. Where
    that is impossible (a mounted or the current folder, a parent that is not writable, another system than Linux)
    the files are replaced one by one, ``marker`` first: its digests then tell which files are not yet its own.

    Files of earlier results that are ``stale`` are removed; other files stay. Raises OutputError, see
    :func:`check_output`; also when the disk is full.
    """
    check_output(directory, force=force, marker=marker, kind=kind)
    try:
        target = directory.resolve()
        for name in files:
            if (target / name).is_dir():
                raise IsADirectoryError(errno.EISDIR, f"{name} in it is a folder")
        with held():
            grown = make_folder(target.parent, exist_ok=True)
            if not _put_in_place(target, files, {*files, *stale}):
                _replace_each(target, files, marker, stale)
            note_complete(directory)
        for folder in {*grown, target.parent}:
            sync_folder(folder)
    except OSError as error:
        raise _refused(directory, error) from error


def _put_in_place(target: Path, files: Mapping[str, bytes], replaced: Collection[str]) -> bool:
    """Put a new folder in the place of one, or of none; tell whether that was possible."""
    if target == Path.cwd() or target in Path.cwd().parents or not os.access(target.parent, os.W_OK | os.X_OK):
        return False
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=_STAGED, ignore_cleanup_errors=True) as temporary:
        staged = Path(temporary) / "results"
        staged.mkdir()
        for name, content in files.items():
            write_synced(staged / name, content)
        if not target.is_dir():
            sync_folder(staged)
            try:
                staged.rename(target)
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
            else:
                return True  # otherwise another one was faster
        shutil.copytree(
            target,
            staged,
            symlinks=True,
            ignore=lambda folder, names: set(replaced).intersection(names) if Path(folder) == target else (),
            copy_function=_linked,
            dirs_exist_ok=True,
        )
        sync_folder(staged)
        return exchanged(staged, target)


def _replace_each(target: Path, files: Mapping[str, bytes], marker: str, stale: Collection[str]) -> None:
    target.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target, prefix=_STAGED) as temporary:
        for name, content in files.items():
            write_synced(Path(temporary) / name, content)
        for name in sorted(files, key=lambda name: name != marker):
            (Path(temporary) / name).replace(target / name)
        for name in stale:
            (target / name).unlink(missing_ok=True)
    sync_folder(target)


def _linked(source: str, target: str) -> None:
    """Link a file to another name, or copy it where the file system knows no links."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        shutil.copy2(source, target, follow_symlinks=False)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file completely or not at all, in the place of one of this name; folders above it are created.

    Raises OutputError when it cannot be written.
    """
    try:
        with held():
            grown = make_folder(path.parent, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=path.parent, prefix=_STAGED) as temporary:
                staged = Path(temporary) / "file"
                write_synced(staged, content)
                staged.replace(path)
            note_complete(path)
        for folder in {*grown, path.parent}:
            sync_folder(folder)
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


def is_information(path: Path) -> bool:
    """Tell whether a path names an information file, readable or not; anything else may be a bag."""
    try:
        if not path.is_file():
            return path.suffix == _INFORMATION and not path.exists()
        with open_input(path) as file:
            if path.suffix == _INFORMATION or file.read(2) != _ZIP_MAGIC:
                return path.suffix == _INFORMATION
            file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
            return _MEMBER in file.read()
    except (OSError, ValueError):
        return False


def is_ours(marker: Path, kind: str = FORMAT) -> bool:
    """Tell whether a JSON file names a format of ours."""
    return read_json_input(marker, LARGEST_MARKER).get("format") == kind
