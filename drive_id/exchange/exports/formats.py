"""The formats that can be exported: one writer each, ours and those of other installed packages."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.metadata import entry_points

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers import c_header, controllers, fmu, matlab, netcdf, npz, text

Writer = Callable[[MapTable, ExportOptions], bytes]
"""Returns the content of a file; raises ConfigurationError when the format cannot hold the table."""


@dataclass(frozen=True)
class ExportFormat:
    """A format of exported files."""

    title: str  # the tool that reads it
    suffix: str  # usual end of the file's name
    write: Writer
    grid: bool = True  # it holds tables over the current plane, not a few numbers
    gaps: str = "they are marked as NaN"  # what becomes of points without data; empty: they hold a continuation
    refines: bool = False  # it refines the table where it needs to
    simulated: bool = True  # it holds the nearest monotone map where the map itself folds: solvers fail on folds


EXPORTS: Mapping[str, ExportFormat] = {
    "csv": ExportFormat("text with one row for each point", ".csv", text.write_csv, simulated=False),
    "netcdf": ExportFormat("netCDF 3, for xarray", ".nc", netcdf.write, simulated=False),
    "machine": ExportFormat("machine file of drive_id", ".npz", npz.write_machine),
    "motulator": ExportFormat("flux map of motulator", ".npz", npz.write_motulator),
    "gradnet-data": ExportFormat(
        "training data of motulator-gradnet", ".npz", npz.write_gradnet_data, gaps="they are left out", simulated=False
    ),
    "syre": ExportFormat("SyR-e flux file fdfq_idiq_n256.mat", ".mat", matlab.write_syre, gaps=""),
    "syre-model": ExportFormat("SyR-e motor model (MMM)", ".mat", matlab.write_syre_model, gaps=""),
    "simscape": ExportFormat(
        "Simscape FEM-Parameterized PMSM, 3-D flux linkages", ".mat", matlab.write_simscape, gaps=""
    ),
    "simscape-2d": ExportFormat("Simscape PMSM with tabulated inductances", ".mat", matlab.write_simscape_2d, gaps=""),
    "motor-control": ExportFormat("Motor Control Blockset", ".mat", matlab.write_motor_control, gaps=""),
    "powertrain": ExportFormat("Powertrain Blockset flux-based PMSM", ".mat", matlab.write_powertrain, gaps=""),
    "powertrain-controller": ExportFormat(
        "Powertrain Blockset flux-based PM controller", ".mat", matlab.write_powertrain_controller, gaps=""
    ),
    "c-header": ExportFormat("C99 header with its reader", ".h", c_header.write, gaps="", refines=True),
    "fmu": ExportFormat("FMU of FMI 3.0 with its C sources", ".fmu", fmu.write, gaps="", refines=True),
    "fmu-2": ExportFormat(
        "FMU of FMI 2.0 with its C sources", ".fmu", partial(fmu.write, version=2), gaps="", refines=True
    ),
    "plecs": ExportFormat("PLECS non-excited synchronous machine", ".mat", matlab.write_plecs, gaps=""),
    "modelica": ExportFormat("Modelica CombiTable2D", ".txt", text.write_modelica, gaps=""),
    "vesc": ExportFormat("VESC motor configuration", ".xml", controllers.write_vesc, grid=False),
    "odrive": ExportFormat("ODrive configuration", ".json", controllers.write_odrive, grid=False),
}


GROUP = "drive_id.exporters"
"""Entry points of other packages by which they add formats: each names an :class:`ExportFormat`."""


def export_format(name: str) -> ExportFormat:
    """Return a format; upper case and underscores in its name do not matter.

    Raises ConfigurationError when there is none of this name, and the message tells which are near; or when that of
    another package is none.
    """
    known = name.lower().replace("_", "-").replace(" ", "-")
    if known in EXPORTS:
        return EXPORTS[known]
    others = {entry.name: entry for entry in entry_points(group=GROUP)}
    if known not in others:
        raise ConfigurationError(f"There is no export format '{name}': {_instead(known, others)}.")
    found = others[known].load()
    if not isinstance(found, ExportFormat):
        raise ConfigurationError(f"The export format '{known}' ({others[known].value}) is no ExportFormat.")
    return found


def _instead(name: str, others: Iterable[str]) -> str:
    """Say what may be meant: the formats of files of this kind, the nearest name, or else all names by kind of file."""
    kinds: dict[str, list[str]] = {}
    for known, format_ in EXPORTS.items():
        kinds.setdefault(format_.suffix, []).append(known)
    if of_kind := kinds.get(".mat" if name == "matlab" else f".{name.removeprefix('.')}"):
        return f"files of this kind can be {', '.join(of_kind)}; choose one by the tool that reads it"
    if near := difflib.get_close_matches(name, [*EXPORTS, *others], 1):
        return f"did you mean {near[0]}"
    listed = "; ".join(f"{kind}: {', '.join(names)}" for kind, names in kinds.items())
    return f"choose {listed}" + "".join(f", {other}" for other in others)
