"""An analysis and its files: ``analysis.json``, tables as CSV with a header row, ``maps.npz``; SI units throughout."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drive_id.analysis.field_weakening import DriveLimits
from drive_id.analysis.machine import MachineModel
from drive_id.analysis.maps import CurrentMaps
from drive_id.analysis.operation import Operation, OperationErrors
from drive_id.analysis.settings import AnalysisSettings
from drive_id.analysis.trajectories import CurrentLocus
from drive_id.common.messages import Message
from drive_id.common.quantity import Tabled, plain
from drive_id.common.version import VERSION
from drive_id.files.inputs.archive import npz_bytes
from drive_id.files.results.folder import replace_folder
from drive_id.result.result import InverterCurve, Result
from drive_id.result.tables import pandas_library
from drive_id.types import BoolArray, FloatArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

FORMAT = "drive_id/analysis"
MARKER = "analysis.json"
FORMAT_VERSION = 1
UNITS = {
    "current": "A", "i_d": "A", "i_q": "A", "psi_d": "Wb", "psi_q": "Wb", "torque": "Nm", "requested_torque": "Nm",
    "braking_torque": "Nm", "torque_ripple": "Nm", "speed": "rad/s, mechanical", "voltage": "V", "power": "W",
    "electrical_power": "W", "u_dc": "V", "L": "H", "L_d": "H", "L_q": "H", "L_dd": "H", "L_dq": "H", "L_qd": "H",
    "L_qq": "H", "kp": "V/A", "kp_d": "V/A", "kp_q": "V/A", "ki": "V/(A s)", "losses": "W", "copper_loss": "W",
    "iron_loss": "W", "inverter_loss": "W", "efficiency": "1", "saliency": "1", "angle": "rad", "resistance": "ohm",
    "phase_a": "V", "phase_b": "V", "phase_c": "V", "limit": "", "inside": "1",
}  # fmt: skip
"""Unit of each column and array by its name; that of a standard error ``sigma_X`` is that of X."""
SIDECAR = "csv-metadata.json"
"""Where the W3C's "CSV on the Web" looks for what the columns of the tables in a folder mean."""
_DIGITS = 12  # of numbers in CSV: more than any is accurate to
_RPM = math.pi / 30  # rad/s
Columns = Mapping[str, Iterable[Any]]


class Figure(NamedTuple):
    """A number with its standard error (NaN if unknown), its unit, and whether it rests on data."""

    value: float
    sigma: float
    unit: str
    inside: bool

    @classmethod
    def of(cls, value: float | FloatArray, sigma: float, unit: str, inside: bool | BoolArray) -> Figure:
        """Return a figure of numpy's numbers."""
        return cls(float(value), float(sigma), unit, bool(inside))


@dataclass(frozen=True, eq=False)
class SpeedRange:
    """Capability of the drive over speed at one DC-link voltage.

    Parameters
    ----------
    u_dc : float
        V.
    limits : DriveLimits
    corner : float
        Speed up to which the largest torque needs no field weakening, rad/s.
    motoring, braking : Operation
        (S,) points of the largest and of the most negative torque over the speed; NaN where no operation is possible.
    sigma_torque : (S,) float
        Standard error of the largest torque, Nm.
    requested : (N,) float
        Torques of the table of references, Nm.
    references : Operation
        (R, N) points of least current over speed and requested torque; the nearest torque that can be reached, NaN
        where no operation is possible.
    errors : OperationErrors
        Of the references.
    """

    u_dc: float
    limits: DriveLimits
    corner: float
    motoring: Operation
    braking: Operation
    sigma_torque: FloatArray
    requested: FloatArray
    references: Operation
    errors: OperationErrors


_NAMED = {
    "resistance": "R", "magnet_flux": "ψ_PM", "L_dd": "L_d at zero current", "L_qq": "L_q at zero current",
    "saliency": "L_q / L_d at zero current", "mtpa_angle": "MTPA angle at i_max", "kp_d": "k_p, d", "kp_q": "k_p, q",
    "ki": "k_i",
}  # fmt: skip
"""Names for people where they are not those of the figure in words; one spelling in all tables."""


@dataclass(frozen=True, eq=False, repr=False)
class Analysis(Tabled):
    """What :func:`drive_id.analyze` returns.

    Parameters
    ----------
    result : drive_id.Identification
    settings : AnalysisSettings
    model : MachineModel
        The drive as functions of the current: torque, inductances, inverse map.
    figures : dict of str to Figure
        Single numbers by name.
    mtpa, mtpv : CurrentLocus
    speed_ranges : tuple of SpeedRange
        One for each DC-link voltage; none where it is not known.
    maps : CurrentMaps
    compensation : InverterCurve
        Voltage to add to each phase over its current.
    statements : tuple of Message
        Sentences: what the figures include, and where they rest on no data.
    """

    result: Result
    settings: AnalysisSettings
    model: MachineModel
    figures: dict[str, Figure]
    mtpa: CurrentLocus
    mtpv: CurrentLocus
    speed_ranges: tuple[SpeedRange, ...]
    maps: CurrentMaps
    compensation: InverterCurve
    statements: tuple[Message, ...]

    @property
    def summary(self) -> str:
        """Machine, method, largest torque and corner speed."""
        corner = self.figures.get("corner_speed")
        reach = "" if corner is None else f" up to {corner.value / _RPM:.4g} rpm"
        return f"Analysis: {self.result.caption()}, {self.figures['max_torque'].value:.4g} Nm{reach}"

    def rows(self) -> list[tuple[str, ...]]:
        """Return name and value of the figures, as ``drive-id analyze`` prints them."""
        found: list[tuple[str, ...]] = []
        for name, figure in self.figures.items():
            factor, unit = (1 / _RPM, "rpm") if figure.unit == "rad/s" else (1.0, figure.unit)
            shown = self.result.told(factor * figure.value, factor * figure.sigma, unit)
            known = "" if figure.inside else " (extrapolated)"
            found.append((_NAMED.get(name, name.replace("_", " ")), shown + known))
        return found

    def to_pandas(self) -> pd.DataFrame:
        """Return the figures as rows: value, standard error, unit, and whether they rest on data.

        Raises
        ------
        ConfigurationError
            When pandas is not installed.
        """
        found: pd.DataFrame = pandas_library().DataFrame.from_dict(self.figures, "index", columns=Figure._fields)
        return found

    def plot(self, ax: Axes | None = None) -> Canvas:
        """Draw the largest torque over the speed at each DC-link voltage, with the band of two standard errors.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Default: that of a new figure.

        Returns
        -------
        matplotlib.figure.Figure
        """
        from drive_id.result.pictures.plots import draw_torque_speed  # noqa: PLC0415  # matplotlib takes half a second

        found = {f"{x.u_dc:.4g} V": (x.motoring.speed, x.motoring.torque, x.sigma_torque) for x in self.speed_ranges}
        return draw_torque_speed(found, ax)

    def _repr_png_(self) -> bytes | None:
        """Return the picture of :meth:`plot`, for notebooks and exports of them; None without a DC-link voltage."""
        from drive_id.result.pictures.picture import SCREEN_DPI, rendered  # noqa: PLC0415  # matplotlib takes half a second

        return rendered(self.plot(), dpi=SCREEN_DPI) if self.speed_ranges else None

    def save(self, directory: str | Path, *, force: bool = False) -> None:
        """Write ``analysis.json``, the CSV tables and ``maps.npz``, all of them or nothing.

        Parameters
        ----------
        directory : path
            Created when missing; an earlier analysis in it is replaced.
        force : bool
            Write into a folder that holds other files.

        Raises
        ------
        OutputError
            When the folder is not ours to write, or cannot be written.
        """
        text = json.dumps(analysis_tree(self), indent=1, allow_nan=False) + "\n"
        files = {name: _csv(columns) for name, columns in tables(self).items()}
        units = json.dumps(_sidecar(tables(self)), indent=1) + "\n"
        files |= {"maps.npz": npz_bytes(self.maps.arrays()), SIDECAR: units.encode(), MARKER: text.encode()}
        replace_folder(Path(directory), files, marker=MARKER, kind=FORMAT, force=force)


def analysis_tree(analysis: Analysis) -> dict[str, Any]:
    """Return the content of ``analysis.json``; numbers that are not finite become null."""
    result, model, settings = analysis.result, analysis.model, analysis.settings
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "machine": result.machine,
        "method": result.method,
        "date": result.date,
        "pole_pairs": model.pole_pairs,
        "i_max": settings.i_max or result.i_max,
        "u_dc": [entry.u_dc for entry in analysis.speed_ranges],
        "u_max": [entry.limits.u_max for entry in analysis.speed_ranges],
        "temperature": model.temperature,
        "magnet_temperature": model.magnet_temperature,
        "iron_loss": asdict(model.iron),
        "figures": {
            name: plain(figure._asdict()) for name, figure in analysis.figures.items()
        },
        "statements": list(analysis.statements),
        "warnings": list(result.warnings),
        "settings": asdict(settings),
        "files": [*tables(analysis), SIDECAR, "maps.npz"],
        "units": UNITS,
        "version": VERSION,
    }  # fmt: skip


def tables(analysis: Analysis) -> dict[str, Columns]:
    """Return all tables by file name, each as columns by name."""
    model, ranges = analysis.model, analysis.speed_ranges
    over_speed = {"field_weakening.csv": _references, "torque_speed.csv": _envelope} if ranges else {}
    return {
        "mtpa.csv": _trajectory(analysis.mtpa),
        "mtpv.csv": _trajectory(analysis.mtpv),
        **{name: _joined([columns(model, entry) for entry in ranges]) for name, columns in over_speed.items()},
        "compensation.csv": _compensation(analysis.compensation),
    }


def _sidecar(files: Mapping[str, Columns]) -> dict[str, Any]:
    """Return the columns of the tables with their units, as W3C's "Metadata Vocabulary for Tabular Data" wants them."""

    def column(name: str) -> dict[str, str]:
        unit = UNITS[name.removeprefix("sigma_")]
        kind = {"datatype": "string"} if name == "limit" else {"datatype": "number"}
        return {"name": name, "titles": name} | kind | ({"schema:unitText": unit} if unit else {})

    described = [{"url": file, "tableSchema": {"columns": [*map(column, columns)]}} for file, columns in files.items()]
    return {"@context": "http://www.w3.org/ns/csvw", "tables": described}


def _trajectory(points: CurrentLocus) -> Columns:
    names = ("current", "i_d", "i_q", "psi_d", "psi_q", "torque", "sigma_torque", "sigma_angle", "inside")
    return {name: getattr(points, name) for name in names}


def _references(model: MachineModel, entry: SpeedRange) -> Columns:
    points, errors = entry.references, entry.errors
    columns = {
        "torque": points.torque,
        "speed": points.speed,
        "i_d": points.stator[..., 0],
        "i_q": points.stator[..., 1],
        "voltage": points.voltage,
        "limit": entry.limits.names(points),
        "requested_torque": np.broadcast_to(entry.requested, points.torque.shape),
        "current": points.current,
        "power": points.power,
        "copper_loss": points.copper,
        "iron_loss": points.iron,
        "inverter_loss": points.inverter,
        "efficiency": points.efficiency,
        "sigma_torque": errors.torque,
        "sigma_voltage": errors.voltage,
        "sigma_losses": errors.losses,
        "sigma_efficiency": errors.efficiency,
        "inside": points.inside(model),
        "u_dc": np.full(points.torque.shape, entry.u_dc),
    }
    return {name: values.ravel() for name, values in columns.items()}


def _envelope(model: MachineModel, entry: SpeedRange) -> Columns:
    points = entry.motoring
    return {
        "speed": points.speed,
        "torque": points.torque,
        "power": points.mechanical,
        "sigma_torque": entry.sigma_torque,
        "sigma_power": points.speed * entry.sigma_torque,
        "i_d": points.stator[:, 0],
        "i_q": points.stator[:, 1],
        "current": points.current,
        "voltage": points.voltage,
        "limit": entry.limits.names(points),
        "electrical_power": points.power,
        "efficiency": points.efficiency,
        "braking_torque": entry.braking.torque,
        "inside": points.inside(model),
        "u_dc": np.full(len(points.speed), entry.u_dc),
    }


def _compensation(curve: InverterCurve) -> Columns:
    sigma = np.full(len(curve.current), np.nan) if curve.sigma is None else curve.sigma
    phases = {} if curve.phases is None else dict(zip(("phase_a", "phase_b", "phase_c"), curve.phases.T, strict=True))
    return {"current": curve.current, "voltage": curve.voltage, "sigma_voltage": sigma, **phases}


def _joined(parts: Sequence[Columns]) -> Columns:
    return {name: [entry for part in parts for entry in part[name]] for name in parts[0]}


def _csv(columns: Columns) -> bytes:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([_cell(entry) for entry in row])
    return stream.getvalue().encode()


def _cell(entry: Any) -> str:
    return entry if isinstance(entry, str) else f"{float(entry):.{_DIGITS}g}"
