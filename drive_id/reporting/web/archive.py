"""All results below a folder, as a page lists, compares and plots them over time."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from drive_id.common.quantity import measured, plain, scaled_unit
from drive_id.core.maps.flux_map import FluxMap
from drive_id.errors import ConfigurationError, DriveIdError
from drive_id.files.results.folder import MARKER
from drive_id.result.result import Result

_NODES = 16
"""Nodes of a compared map from zero to i_max, within a factor of the root of 2."""
_DIGITS = 6
"""Significant digits of a map."""
_MOST_MAPS = 200
"""Results, the newest first, whose maps a page holds: each takes 30 kB."""
REPORT = "report.html"


@dataclass(frozen=True)
class Entry:
    """A result folder: its path, and what a page tells of it; ``error``, a sentence, where it cannot be read."""

    folder: Path
    row: dict[str, Any]

    def relative_to(self, base: Path) -> Entry:
        """Return the entry with its path from the folder of a page, and whether a report is there."""
        name = os.path.relpath(self.folder.resolve(), base.resolve())
        return replace(self, row=self.row | {"folder": name, "report": (self.folder / REPORT).is_file()})


class Archive:
    """The results below a folder; those that have not changed are read once.

    Raises ConfigurationError when it is not a folder.
    """

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise ConfigurationError(f"{root} is not a folder: give the folder that holds the results.")
        self.root = root
        self._known: dict[Path, tuple[int, Entry]] = {}

    def entries(self, base: Path | None = None) -> list[Entry]:
        """Return all results, the newest first; their folders relative to ``base``, default: that of the archive."""
        found = {}
        for folder in _result_folders(self.root):
            stamp = (folder / MARKER).stat().st_mtime_ns
            known = self._known.get(folder)
            found[folder] = known if known is not None and known[0] == stamp else (stamp, _entry(folder))
        self._known = found
        ordered = sorted((e for _, e in found.values()), key=lambda e: e.row.get("date", ""), reverse=True)
        return [e.relative_to(base or self.root) for e in ordered]


def entries_of(folders: Sequence[Path], base: Path) -> list[Entry]:
    """Return the entries of given result folders; raises a ResultError when one cannot be read."""
    return [Entry(folder, row_of(Result.load(folder))).relative_to(base) for folder in folders]


def rows(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Return what a page holds of entries: maps only of so many that it stays quick to open, one unit per quantity.

    Each quantity becomes its value and standard error in that unit, the unit, and its text.
    """
    values: dict[str, list[float]] = {}
    for entry in entries:
        for name, (value, *_) in entry.row.get("quantities", {}).items():
            kind = "L" if name in {"L_d", "L_q"} else name
            values.setdefault(kind, []).extend([abs(value)] if value else [])
    middle = {kind: math.sqrt(min(found) * max(found)) if found else 0.0 for kind, found in values.items()}
    sizes = middle | dict.fromkeys(("L_d", "L_q"), middle.get("L", 0.0))
    found = []
    for k, entry in enumerate(entries):
        told = {name: _told(q, sizes[name]) for name, q in entry.row.get("quantities", {}).items()}
        shown = {"quantities": told} if told else {}
        found.append(entry.row | shown | ({} if k < _MOST_MAPS else {"map": None}))
    return found


def _told(quantity: tuple[float | None, float | None, str], size: float) -> list[Any]:
    """Return a quantity in the unit for a size: value, standard error, unit and text."""
    *numbers, unit = quantity
    value, sigma = (math.nan if x is None else float(x) for x in numbers)
    factor, scaled = scaled_unit(size, unit)
    found: list[Any] = plain([factor * value, factor * sigma, scaled, measured(value, sigma, unit, size)])
    return found


def _entry(folder: Path) -> Entry:
    try:
        return Entry(folder, row_of(Result.load(folder)))
    except DriveIdError as error:
        return Entry(folder, {"error": str(error).replace(str(folder), "of this row")})


def row_of(result: Result) -> dict[str, Any]:
    """Return what a page tells of a result, ready for JSON: numbers that are not known are null."""
    quantities: dict[str, Any] = {}
    for q in result.headline:
        if "MTPA" not in q.name:  # inductances at zero current only: a column compares like with like
            quantities[q.name.partition(" at ")[0]] = [q.value, q.sigma, q.unit]
    return {
        "date": result.date,
        "machine": result.machine,
        "serial": result.provenance.settings.serial,
        "method": result.method,
        "turning": result.origin.turning,
        "quantities": plain(quantities),
        "coverage": plain(result.metrics["coverage"]),
        "warnings": list(result.warnings),
        "map": _map(result.drive.flux_map, result.i_max),
    }


def _map(found: FluxMap, i_max: float) -> dict[str, Any]:
    """Return the map where there are data, mWb, at multiples of a power of 2 A.

    Maps of one machine then have their nodes in common, whatever the radius of their disc: a page compares them
    without interpolating.
    """
    step = 2.0 ** round(math.log2(i_max / _NODES))
    last = int(i_max // step)
    k_d, k_q = (axis.ravel() for axis in np.mgrid[-last : last + 1, -last : last + 1])
    columns = np.stack([*found.psi_dq(step * k_d, step * k_q), *found.sigma(step * k_d, step * k_q)]) * 1e3
    known = np.isfinite(columns[:2]).all(axis=0)
    names = ("psi_d", "psi_q", "sigma_d", "sigma_q")
    values = {name: plain(column[known], _DIGITS) for name, column in zip(names, columns, strict=True)}
    return {"step": step, "k_d": k_d[known].tolist(), "k_q": k_q[known].tolist(), **values}


def _result_folders(root: Path) -> Iterator[Path]:
    """Yield the result folders below a folder; hidden folders are left out, links are not followed."""
    for folder, inner, files in os.walk(root):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        if MARKER in files:
            yield Path(folder)
