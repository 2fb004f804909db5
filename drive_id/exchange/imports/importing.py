"""Import a file of another tool as a result like that of a fit."""

from __future__ import annotations

from dataclasses import asdict, replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from drive_id.common.arguments import path_of
from drive_id.common.messages import Message
from drive_id.common.origins import IMPORTED
from drive_id.core.fit_settings import FitSettings
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.methods.parameters import FitReport
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.conventions import converted
from drive_id.exchange.imports.formats import IMPORTS, format_of
from drive_id.exchange.imports.gridding import gridded
from drive_id.exchange.imports.plausibility import check_plausible, large_flux, outlier, torque_ratio
from drive_id.exchange.imports.points import MapPoints
from drive_id.exchange.imports.source import Source
from drive_id.files.results.identification import Provenance
from drive_id.files.storage.bag import file_digest
from drive_id.fitting.result import Identification

_COVERAGE_POINTS = 101  # along an axis, by which the covered share of the disc is counted


def import_map(source: Source | str | Path) -> Identification:
    """Read a flux map of another tool.

    Parameters
    ----------
    source : Source or path

    Returns
    -------
    drive_id.Identification
        With method ``imported``. Standard errors are NaN unless the file has them; the inverter's drop is zero.

    Raises
    ------
    ConfigurationError
        When the file cannot be read, or holds a map that no machine has; the message names the options that would make
        it plausible.
    """
    source = source if isinstance(source, Source) else Source(path_of(source, "source"))
    name = format_of(source)

    def read(order: str) -> MapPoints:
        points = IMPORTS[name].read(replace(source, conventions=replace(source.conventions, order=order)))
        theta = None if points.theta is None else points.theta + np.radians(source.angle_offset)
        return replace(points, theta=theta)

    points = read(source.conventions.order)
    if source.axis is not None and points.axis is not None and source.axis != points.axis:
        raise ConfigurationError(
            f"--axis {source.axis} contradicts '{source.path}', whose axes are of type {points.axis}: leave it out."
        )
    conventions = replace(source.conventions, axis=source.axis or points.axis or "pm")

    def transposed() -> MapPoints | None:
        try:
            return read("qd" if conventions.order == "dq" else "dq")
        except ConfigurationError:  # the axes have different lengths, so there is but one order
            return None

    check_plausible(points, conventions, transposed)
    ours = converted(points, conventions)
    statements = [Message("imported", file=source.path.name, title=IMPORTS[name].title, **asdict(conventions))]
    return _result(source, ours, statements)


def _result(source: Source, points: MapPoints, statements: list[Message]) -> Identification:
    found, scalars, ratio = gridded(points), points.scalars, torque_ratio(points)
    pairs = scalars.get("pole_pairs")
    if pairs is not None and pairs != round(pairs):
        raise ConfigurationError(f"The number of pole pairs is {pairs:g}: give a whole number (--pole-pairs).")
    wording, size = "import_grid.scattered" if found.scattered else "import_grid", found.flux_map.psi_d.shape
    statements.append(Message(wording, points_d=size[0], points_q=size[1], rms=found.rms, mirrored=found.mirrored))
    if points.sigma_dq is None or not np.isfinite(points.sigma_dq).any():
        statements.append(Message("sigma_unknown"))
    if pairs is None and ratio is not None:
        pairs = float(round(ratio))
        statements.append(Message("torque_of_pole_pairs", pole_pairs=round(ratio)))
    warnings = [outlier(points.i_dq, points.mean_psi_dq), large_flux(points.mean_psi_dq)]
    # of the disc, half disc or quarter disc that the axes cover
    reach = float(min(np.abs(axis).max() for axis in (found.flux_map.i_d, found.flux_map.i_q)))
    i_max, count = scalars.get("i_max", reach), len(points.i_dq)
    drive = IdentifiedDrive(
        method=IMPORTED.name,
        i_max=i_max,
        resistance=scalars.get("resistance", np.nan),
        sigma_resistance=np.nan,
        voltage_error=0.0,
        sigma_voltage_error=np.nan,
        inverter_current=np.array([-i_max, 0.0, i_max]),
        inverter_voltage=np.zeros(3),
        flux_map=found.flux_map,
        report=FitReport(
            samples_read=count,
            samples_used=count,
            coverage=_coverage(found.flux_map, i_max),
            warnings=tuple(filter(None, warnings)),
        ),
        statements=tuple(statements),
    )
    files = [source.path] if source.psi_q_file is None else [source.path, source.psi_q_file]
    provenance = Provenance(
        inputs={str(path): file_digest(path) for path in files},
        settings=FitSettings(),
        machine=source.machine or points.machine or source.path.stem,
        pole_pairs=None if pairs is None else round(pairs),
        u_dc=scalars.get("u_dc"),
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )
    return Identification(drive, provenance)


def _coverage(flux_map: FluxMap, i_max: float) -> float:
    """Return the share of the disc that the map covers."""
    axis = np.linspace(-i_max, i_max, _COVERAGE_POINTS)
    i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
    disc = np.hypot(i_d, i_q) <= i_max
    return float(np.isfinite(flux_map.psi_dq(i_d[disc], i_q[disc])[0]).mean())
