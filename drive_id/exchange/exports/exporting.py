"""Export a result to a file for another tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drive_id.common.arguments import path_of
from drive_id.core.maps.flux_models import positive_definite
from drive_id.errors import CoverageError, OutputError
from drive_id.exchange.exports.formats import export_format
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.files.results.folder import check_absent, replace_file
from drive_id.result.result import Result


@dataclass(frozen=True)
class Exported:
    """What was written."""

    points: int  # of the table; 0 for formats without tables
    missing: int  # points without data
    filled: bool  # they hold a continuation
    gaps: str = ""  # what has become of them otherwise
    remarks: tuple[str, ...] = ()  # further sentences on what the file holds

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences."""
        if not self.missing:
            return self.remarks
        told = f"{self.gaps}; choose a smaller --range or a larger --grid, or --fill them with a continuation."
        if self.filled:
            told = "they hold a continuation of the map, which was not measured."
        return (f"{self.missing} of {self.points} points of the table have no data: {told}", *self.remarks)


def content_of(result: Result, name: str, options: ExportOptions | None = None) -> tuple[bytes, Exported]:
    """Return the content of a file in a format, and a description of it.

    Raises ConfigurationError when the format is unknown, or cannot hold this result, and CoverageError when no point of
    the table has data.
    """
    chosen, wanted = export_format(name), options or ExportOptions()
    wanted = replace(wanted, filled=wanted.filled or not chosen.gaps)
    table = MapTable.of(result, wanted, simulated=chosen.simulated)
    if not chosen.grid and not table.machine.inside(0.0, 0.0):
        raise CoverageError(f"The map has no data at zero current, from which --format {name} takes its numbers.")
    content = chosen.write(table, wanted)
    told = [*table.remarks]
    if chosen.grid and not chosen.refines:
        told.append(table.coarse)
    told.append(table.fold)
    wrong = np.count_nonzero(~positive_definite(table.inductances) & np.isfinite(table.psi[0]))
    if wrong and chosen.grid:
        told.append(f"At {wrong} of {table.inside.size} points the matrix of inductances is not positive definite.")
    remarks = tuple(filter(None, told))
    if not chosen.grid:
        return content, Exported(0, 0, filled=False, remarks=remarks)
    return content, Exported(table.inside.size, table.missing, wanted.filled, chosen.gaps, remarks)


def export_map(
    result: Result | str | Path,
    name: str,
    path: str | Path,
    options: ExportOptions | None = None,
    *,
    force: bool = False,
) -> Exported:
    """Write a result in the format of another tool, all of the file or nothing.

    Parameters
    ----------
    result : drive_id.Identification or path
        Or its folder.
    name : str
        Of the format, see :data:`~.formats.EXPORTS`.
    path : path
        File to write.
    options : ExportOptions, optional
    force : bool
        Replace an existing file.

    Raises
    ------
    OutputError
        When the suffix of the file name does not match the format, the file exists and ``force`` is not given, or it
        cannot be written.
    ConfigurationError, CoverageError
        See :func:`content_of`.
    """
    result = result if isinstance(result, Result) else Result.load(result)
    path, usual = path_of(path), export_format(name).suffix
    if path.suffix.lower() != usual:
        said = f"ends in {path.suffix}" if path.suffix else "has no suffix"
        raise OutputError(f"{path} {said}, but --format {name} writes {usual} files: name it {path.stem}{usual}.")
    if not force:
        check_absent(path)
    content, exported = content_of(result, name, options)
    replace_file(path, content)
    return exported
