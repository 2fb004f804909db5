"""The formats that can be imported, and how they are detected."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.matlab import load, read_motor_cad, read_syre_flux, read_syre_model
from drive_id.exchange.imports.npz import read_npz
from drive_id.exchange.imports.points import MapPoints
from drive_id.exchange.imports.source import Source
from drive_id.exchange.imports.text import read_csv


@dataclass(frozen=True)
class ImportFormat:
    """A format of map files.

    Parameters
    ----------
    read : callable
        Returns the points of a :class:`~.source.Source`; raises ConfigurationError.
    mark : str
        Variable that tells a MATLAB file of this format from others.
    """

    title: str
    read: Callable[[Source], MapPoints]
    mark: str = ""


IMPORTS: Mapping[str, ImportFormat] = {
    "npz": ImportFormat("our machine files and flux_map.npz, maps of motulator", read_npz),
    "syre": ImportFormat("SyR-e motor model", read_syre_model, "motorModel"),
    "syre-flux": ImportFormat("SyR-e fdfq_idiq_n256.mat", read_syre_flux, "Fd"),
    "motor-cad": ImportFormat("Motor-CAD SaturationLossMap.mat", read_motor_cad, "Id_Peak"),
    "csv": ImportFormat("text with one row for each point, or one matrix for each flux", read_csv),
}
_SUFFIXES = {".npz": "npz", ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv"}


def format_of(source: Source, name: str | None) -> str:
    """Return the name of a file's format: the given one, or that of its suffix and its variables.

    Raises ConfigurationError when the name is unknown, or the file does not tell its format.
    """
    known = ", ".join(IMPORTS)
    if name is not None:
        if name not in IMPORTS:
            raise ConfigurationError(f"There is no import format '{name}': choose {known}.")
        return name
    suffix = source.path.suffix.lower()
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix]
    if suffix == ".mat":
        variables = load(source)
        for found, entry in IMPORTS.items():
            if entry.mark and entry.mark in variables:
                return found
        names = ", ".join(sorted(name for name in variables if not name.startswith("__"))) or "nothing"
        raise ConfigurationError(
            f"'{source.path}' is no map of SyR-e or Motor-CAD (it holds {names}): export such a file, or a .csv file."
        )
    raise ConfigurationError(f"The name '{source.path.name}' does not tell a format: give --format ({known}).")
