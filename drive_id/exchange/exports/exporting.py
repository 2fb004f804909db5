"""Export a result to a file for another tool."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drive_id.errors import CoverageError, OutputError
from drive_id.exchange.exports.formats import ExportFormat, export_format
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers import c_header, matlab
from drive_id.files.results.folder import check_absent, replace_file
from drive_id.result.result import Result

_COARSE = 0.01  # error of bilinear interpolation, by the largest flux, above which it is told


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
    table = MapTable.of(result, wanted)
    if not chosen.grid and not table.machine.inside(0.0, 0.0):
        raise CoverageError(f"The map has no data at zero current, from which --format {name} takes its numbers.")
    content = chosen.write(table, wanted)
    bandwidth = f"The bandwidth is {wanted.bandwidth:g} Hz."
    if not chosen.grid:
        return content, Exported(0, 0, filled=False, remarks=(f"{bandwidth} {table.gain_source}",))
    remarks = (*([bandwidth] if chosen.write is c_header.write else []), *_remarks(table, chosen))
    return content, Exported(table.inside.size, table.missing, wanted.filled, chosen.gaps, remarks)


def _remarks(table: MapTable, chosen: ExportFormat) -> tuple[str, ...]:
    out = []
    if table.interpolation_error > _COARSE * float(np.nanmax(np.hypot(*table.psi))):
        out.append(f"The table is coarse: choose a larger --grid, or read it with splines. {table.source}")
    if not table.machine.monotone_inside:
        out.append(
            "The map is not monotone everywhere within the data: inductances and gains of single numbers are those of "
            "the nearest monotone map, and the tables hold the map itself; set monotone in the fit for a monotone one."
        )
    if chosen.write is matlab.write_powertrain:
        missing = int(np.isnan(matlab.inverse_maps(table)[2]).sum())
        if missing:
            out.append(
                f"{missing} of {table.inside.size} currents of the inverse table are NaN, for no data reach these "
                "fluxes, and Simulink refuses NaN: choose a smaller --range, or --fill them with a continuation."
            )
    return tuple(out)


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
    path, usual = Path(path), export_format(name).suffix
    if path.suffix.lower() != usual:
        said = f"ends in {path.suffix}" if path.suffix else "has no suffix"
        raise OutputError(f"{path} {said}, but --format {name} writes {usual} files: name it {path.stem}{usual}.")
    if not force:
        check_absent(path)
    content, exported = content_of(result, name, options)
    replace_file(path, content)
    return exported
