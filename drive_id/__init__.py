"""Identify flux maps, resistance and inverter voltage error of electric drives from recordings.

>>> import drive_id
>>> result = drive_id.fit("my_bag", method="full", signals="my_signals.yaml")  # doctest: +SKIP
>>> result = drive_id.load("out/demo/recording_full")  # doctest: +SKIP
>>> psi_d, psi_q = result.flux_map.psi_dq(-100.0, 150.0)  # doctest: +SKIP

Names are loaded when they are first used, so that ``import drive_id`` takes no time (PEP 562).
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drive_id.analysis.analyze import analyze
    from drive_id.analysis.folder import Analysis
    from drive_id.analysis.machine import MachineModel
    from drive_id.analysis.settings import AnalysisSettings
    from drive_id.bench.settings import SimulationSettings
    from drive_id.core.fit_settings import FitSettings
    from drive_id.core.maps.flux_map import FluxMap
    from drive_id.core.planning.planner import plan
    from drive_id.core.planning.settings import PlanSettings
    from drive_id.core.steady.operating_data import OperatingData
    from drive_id.errors import DriveIdError
    from drive_id.exchange.exports.exporting import export_map as export
    from drive_id.exchange.imports.importing import import_map
    from drive_id.fitting.fit import fit
    from drive_id.fitting.result import Identification, load, report
    from drive_id.fitting.simulated import simulate
    from drive_id.fitting.sources import read_bag
    from drive_id.inspection.inspect import Inspection, check
    from drive_id.result.comparison import Comparison, compare
    from drive_id.result.tables import samples_frame
    from drive_id.types import MachineMap, Samples, on_bar

__version__: str

__all__ = [
    "Analysis", "AnalysisSettings", "Comparison", "DriveIdError", "FitSettings", "FluxMap", "Identification",
    "Inspection", "MachineMap", "MachineModel", "OperatingData", "PlanSettings", "Samples", "SimulationSettings",
    "analyze", "check", "compare", "export", "fit", "import_map", "load", "on_bar", "plan", "read_bag", "report",
    "samples_frame", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> object:  # noqa: C901, PLR0912  # one branch for each home
    home: object
    if name in ("Analysis", "AnalysisSettings", "MachineModel", "analyze"):
        from drive_id.analysis import analyze as home
    elif name in ("Comparison", "compare"):
        from drive_id.result import comparison as home
    elif name == "DriveIdError":
        from drive_id import errors as home
    elif name == "FitSettings":
        from drive_id.core import fit_settings as home
    elif name == "FluxMap":
        from drive_id.core.result import identification as home
    elif name in ("Identification", "load", "report"):
        from drive_id.fitting import result as home
    elif name in ("Inspection", "check"):
        from drive_id.inspection import inspect as home
    elif name in ("MachineMap", "Samples", "on_bar"):
        from drive_id import types as home
    elif name == "OperatingData":
        from drive_id.core.steady import operating_data as home
    elif name in ("PlanSettings", "plan"):
        from drive_id.core.planning import planner as home
    elif name == "SimulationSettings":
        from drive_id.bench import settings as home
    elif name == "export":
        from drive_id.exchange.exports import exporting as home
    elif name == "fit":
        from drive_id.fitting import fit as home
    elif name == "import_map":
        from drive_id.exchange.imports import importing as home
    elif name == "read_bag":
        from drive_id.fitting import sources as home
    elif name == "samples_frame":
        from drive_id.result import tables as home
    elif name == "simulate":
        from drive_id.fitting import simulated as home
    elif name == "__version__":
        from drive_id.common import version as home
    else:
        raise AttributeError(f"module 'drive_id' has no attribute '{name}'")
    found: object = getattr(home, {"__version__": "VERSION", "export": "export_map"}.get(name, name))
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
