"""The folders of a node's results: names for new ones, a quota for old ones, and the last map for the next start."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from drive_id.common.health import Level, Observation
from drive_id.errors import ConfigurationError, DriveIdError, OutputError, ResultError
from drive_id.files.inputs.input_file import read_json_input
from drive_id.files.results.folder import is_result, replace_file
from drive_id.files.results.identification import Provenance, read_outline
from drive_id.fitting.result import Identification, load
from drive_id.live.data_directory import free_path
from drive_id.live.identification.identification_settings import IdentificationSettings

_FOLDER = re.compile(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_(psm|joint|full|locked)(_\d+)?", re.ASCII)
_FORMAT = "drive_id/last_map"
_LONGEST_NOTE = 10_000  # bytes


@dataclass(frozen=True, eq=False)
class LastMap:
    """The last result of a node, its folder, and the stamp of its last sample, ns."""

    result: Identification
    folder: Path
    stamp: int


@dataclass(frozen=True, eq=False)
class FoundResult:
    """What a result folder tells without its map."""

    folder: Path
    method: str
    provenance: Provenance
    resistance: float  # ohm
    sigma_resistance: float
    i_max: float  # A
    coverage: float


class ResultFolders:
    """Folders that a node, by its full name, makes for its results, all in one, which nodes of others may share."""

    def __init__(self, settings: IdentificationSettings, node: str) -> None:
        self._settings = settings
        self._base = Path(settings.output_directory).expanduser().absolute()
        self._note = self._base / f".last{node.replace('/', '.')}.json"
        self._node = node
        self._trouble = ""

    def note(self, folder: Path, stamp: int) -> None:
        """Remember a result for the next start, and remove the oldest folders beyond the quota."""
        try:
            tree = {"format": _FORMAT, "node": self._node, "folder": folder.name, "stamp": stamp}
            replace_file(self._note, (json.dumps(tree, indent=1) + "\n").encode())
            self._trouble = ""
            self.tidy()
        except (DriveIdError, OSError) as error:
            self._trouble = f"The folder of the results cannot be kept in order: {error}"

    def last(self) -> LastMap | None:
        """Return the result that was noted last; None if there is none that can be read."""
        note = _read_note(self._note)
        if note is None or note.node != self._node:
            return None
        folder = self._base / note.folder
        try:
            return LastMap(load(folder), folder, note.stamp)
        except DriveIdError as error:
            self._trouble = f"The last map is not published again: {error}"
            return None

    def find(self, machine: str, serial: str, most: int) -> tuple[list[FoundResult], int]:
        """Return the newest results, those of a machine or serial number if named, and how many there are.

        Raises
        ------
        OutputError
            When the folder of the results cannot be read.
        """
        try:
            paths = [path for path in self._base.iterdir() if self._is_own(path)] if self._base.exists() else []
            paths.sort(key=_age, reverse=True)
        except OSError as error:
            raise OutputError(f"{self._base} cannot be read ({error.strerror or error}).") from error
        if not (machine or serial):
            return [found for path in paths[:most] if (found := _outline(path)) is not None], len(paths)
        all_found = [found for path in paths if (found := _outline(path)) is not None]
        fits = [
            each for each in all_found
            if machine in {"", each.provenance.machine} and serial in {"", each.provenance.settings.serial}
        ]  # fmt: skip
        return fits[:most], len(fits)

    def get(self, folder: str, machine: str, serial: str) -> LastMap:
        """Return the result in a folder, which has to fit, or the newest one that fits, see :meth:`find`.

        Raises
        ------
        ConfigurationError
            When the folder is not one of a node's results.
        ResultError
            When there is no such result, it is damaged, or it is that of another machine or serial number.
        """
        if folder:
            path = self._base / folder
            if path.parent != self._base or not self._is_own(path):
                raise ConfigurationError(f"'{folder}' is not a result in {self._base}: see ~/list_results.")
        else:
            found, _ = self.find(machine, serial, 1)
            if not found:
                of = f" of machine '{machine}', serial '{serial}'" if machine or serial else ""
                raise ResultError(f"There is no result{of} in {self._base}.")
            path = found[0].folder
        result = load(path)
        held = {"machine": result.machine, "serial": result.provenance.settings.serial}
        for name, asked in (("machine", machine), ("serial", serial)):
            if asked not in {"", held[name]}:
                there = f"is of {name} '{held[name]}'" if held[name] else f"names no {name}"
                raise ResultError(f"The result in {path} {there}, and {name} '{asked}' was asked for.")
        return LastMap(result, path, result.last_stamp)

    def tidy(self) -> None:
        """Remove the oldest folders beyond the quota, but none that a node would publish again.

        Only folders with the names and the files of a node's results count, and only they are removed.
        """
        most, largest = self._settings.results_count, self._settings.results_size * 1e6
        found = [path for path in self._base.iterdir() if self._is_own(path)]
        notes = (_read_note(path) for path in self._base.glob(".last.*.json"))
        kept = {note.folder for note in notes if note is not None}
        sizes = {path: _size(path) for path in sorted(found, key=_age)}
        for path in [path for path in sizes if path.name not in kept]:  # oldest first
            if not (most and len(sizes) > most) and not (largest and sum(sizes.values()) > largest):
                return
            shutil.rmtree(path)
            del sizes[path]

    @staticmethod
    def _is_own(path: Path) -> bool:
        return _FOLDER.fullmatch(path.name) is not None and not path.is_symlink() and is_result(path)

    def findings(self) -> list[Observation]:
        """Return what is wrong with the folders."""
        return [(Level.WARN, self._trouble)] if self._trouble else []


def _outline(path: Path) -> FoundResult | None:
    """Return what a folder holds; None if it is damaged, or was removed meanwhile."""
    try:
        tree, provenance = read_outline(path)
        numbers = [tree["resistance"], tree["sigma_resistance"], tree["i_max"], tree["metrics"]["coverage"]]
    except (ResultError, KeyError):
        return None
    return FoundResult(path, str(tree["method"]), provenance, *(math.nan if x is None else float(x) for x in numbers))


def new_folder(settings: IdentificationSettings, method: str) -> Path:
    """Return the path of a folder that is not there yet, named after time and method."""
    base = Path(settings.output_directory).expanduser().absolute()
    return free_path(base, datetime.now().astimezone().strftime(f"%Y-%m-%d_%H-%M-%S_{method}"))


def _age(path: Path) -> tuple[float, str]:
    return path.stat().st_mtime, path.name


def _size(path: Path) -> int:
    return sum(file.lstat().st_size for file in path.rglob("*"))


class _Note(NamedTuple):
    """What a node noted of its last result: its full name, the folder, and the stamp of the last sample, ns."""

    node: str
    folder: str
    stamp: int


def _read_note(path: Path) -> _Note | None:
    tree = read_json_input(path, _LONGEST_NOTE)
    if tree.get("format") != _FORMAT:
        return None
    node, folder, stamp = (tree.get(name) for name in ("node", "folder", "stamp"))
    if not isinstance(node, str) or not isinstance(folder, str) or not isinstance(stamp, int):
        return None
    return _Note(node, folder, stamp) if _FOLDER.fullmatch(folder) and 0 <= stamp < 2**63 else None
