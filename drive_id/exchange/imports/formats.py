"""The formats that can be imported, and how they are detected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.matlab import read_motor_cad, read_syre_flux, read_syre_model
from drive_id.exchange.imports.npz import read_npz
from drive_id.exchange.imports.points import MapPoints
from drive_id.exchange.imports.source import Source
from drive_id.exchange.imports.text import read_csv
from drive_id.files.inputs.matlab import load_matlab


@dataclass(frozen=True)
class ImportFormat:
    """A format of map files."""

    title: str
    read: Callable[[Source], MapPoints]  # raises ConfigurationError
    mark: str = ""  # variable that tells a MATLAB file of this format from others


IMPORTS: Mapping[str, ImportFormat] = {
    "npz": ImportFormat("our machine files and flux_map.npz, maps of motulator", read_npz),
    "syre": ImportFormat("SyR-e motor model", read_syre_model, "motorModel"),
    "syre-flux": ImportFormat("SyR-e fdfq_idiq_n256.mat", read_syre_flux, "Fd"),
    "motor-cad": ImportFormat("Motor-CAD SaturationLossMap.mat", read_motor_cad, "Id_Peak"),
    "csv": ImportFormat("text with one row for each point, or one matrix for each flux", read_csv),
}
_SUFFIXES = {".npz": "npz", ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv"}


def format_of(source: Source) -> str:
    """Return the name of a file's format: the given one, or that of its suffix and its variables.

    Raises ConfigurationError when the name is unknown, or the file does not tell its format.
    """
    known = ", ".join(IMPORTS)
    if source.format is not None:
        if source.format not in IMPORTS:
            raise ConfigurationError(f"There is no import format '{source.format}': choose {known}.")
        return source.format
    suffix = source.path.suffix.lower()
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    if suffix == ".mat":
        variables = load_matlab(source.path, f"'{source.path}'")
        for found, entry in IMPORTS.items():
            if entry.mark and entry.mark in variables:
                return found
        names = ", ".join(sorted(name for name in variables if not name.startswith("__"))) or "nothing"
        raise ConfigurationError(
            f"'{source.path}' is no map of SyR-e or Motor-CAD (it holds {names}): export such a file, or a .csv file."
        )
    raise ConfigurationError(f"The name '{source.path.name}' does not tell a format: give --format ({known}).")
