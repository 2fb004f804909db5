"""Converts results to messages, also for displays, and says how requests name them."""

from __future__ import annotations

import array
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from drive_id_msgs.msg import FitReport, FluxMap, OperatingPoint, ResultInfo
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2, PointField

from drive_id.common.messages import Message
from drive_id.core.result.identification import IdentifiedDrive
from drive_id.files.results.identification import Provenance
from drive_id.live.identification.identifier import Reply
from drive_id.live.identification.operating_points import Point
from drive_id.live.identification.result_folders import FoundResult
from drive_id.nodes.support.signal_messages import headed, time_of

_OF_MECHANICS = {
    name: name
    for name in (
        "inertia", "sigma_inertia", "friction", "sigma_friction", "viscous_friction", "sigma_viscous_friction",
        "load", "sigma_load", "cogging_visible",
    )
} | {"torque_gain": "gain", "sigma_torque_gain": "sigma_gain"}  # fmt: skip
"""Fields of the message, and of :class:`~drive_id.core.result.identification.Mechanics`."""

NAMES = {name: name for name in ("machine", "serial", "bench", "notes")} | {"operator": "operator_name"}
"""Settings of a fit that name it, and fields of a request; ``operator`` is a word of C++."""

_OF_BAG = {".mcap", ".db3"}
"""Suffixes of the files of a bag."""

FIELDS = ("x", "y", "z", "i_d", "i_q", "psi_d", "psi_q", "sigma", "coverage")
"""Of each point, float32; see :func:`flux_map_points`."""


def flux_map_message(reply: Reply, frame_id: str) -> FluxMap:
    """Return the message of the identified map; an empty one if the request failed."""
    message = FluxMap()
    identification = reply.identification
    if identification is None:
        return message
    headed(message, reply.stamp, frame_id)
    message.method = identification.method
    message.provisional = reply.provisional
    message.folder = reply.output
    if reply.provenance is not None:
        message.machine, message.serial = reply.provenance.machine, reply.provenance.settings.serial
        message.session, message.recordings = reply.provenance.session, recordings(reply.provenance)
    flux_map = identification.flux_map
    for name in ("i_d", "i_q", "psi_d", "psi_q", "sigma_d", "sigma_q"):
        setattr(message, name, _doubles(getattr(flux_map, name)))
    message.inside = flux_map.inside.ravel().tolist()
    for name in ("resistance", "sigma_resistance", "voltage_error", "sigma_voltage_error"):
        setattr(message, name, getattr(identification, name))
    if identification.origin.inverter:
        message.inverter_current = _doubles(identification.inverter_current)
        message.inverter_voltage = _doubles(identification.inverter_voltage)
    message.i_max = identification.i_max
    message.coverage = identification.report.coverage
    _fill_warnings(message, reply.warnings)
    message.harmonic_orders = array.array("I", [harmonic.order for harmonic in flux_map.harmonics])
    for name in ("psi_d_cos", "psi_d_sin", "psi_q_cos", "psi_q_sin"):
        amplitudes = [getattr(harmonic, name).ravel() for harmonic in flux_map.harmonics]
        setattr(message, f"harmonic_{name}", _doubles(np.concatenate(amplitudes) if amplitudes else []))
    _fill_calibrations(message, identification)
    return message


def fit_report_message(reply: Reply) -> FitReport:
    """Return the report of the fit, or of the samples only if the request failed."""
    message = FitReport(folder=reply.output, stamp=time_of(reply.stamp))
    _fill_warnings(message, reply.warnings)
    mechanics = reply.identification.mechanics if reply.identification is not None else None
    for field, name in _OF_MECHANICS.items():
        value = getattr(mechanics, name, None)  # without mechanics, nothing is known
        setattr(message, field, math.nan if value is None else value)
    if mechanics is not None:
        message.cogging_orders = array.array("I", [found.order for found in mechanics.cogging])
        message.cogging_amplitudes = _doubles([found.amplitude for found in mechanics.cogging])
        message.cogging_sigmas = _doubles([found.sigma for found in mechanics.cogging])
    if reply.identification is not None:
        report = reply.identification.report
        for name in message.get_fields_and_field_types():
            if name != "warnings" and hasattr(report, name):
                setattr(message, name, getattr(report, name))
        _fill_calibrations(message, reply.identification)
    elif reply.samples is not None:
        message.samples_read = reply.samples.samples
        message.gaps = reply.samples.gaps
        _fill_warnings(message, reply.samples.warnings)
    return message


def _fill_warnings(message: FluxMap | FitReport, warnings: Sequence[Message]) -> None:
    message.warnings = list(map(str, warnings))
    message.warning_codes = [warning.code for warning in warnings]
    message.warning_values = [json.dumps(warning.tree()["values"]) for warning in warnings]


def _fill_calibrations(message: FluxMap | FitReport, identification: IdentifiedDrive) -> None:
    found = identification.calibrations
    message.calibration_names = [entry.name for entry in found]
    message.calibration_values = _doubles([entry.value for entry in found])
    message.calibration_sigmas = _doubles([entry.sigma for entry in found])
    message.calibration_units = [entry.unit for entry in found]
    message.calibration_applied = [entry.applied for entry in found]


def fill(response: Any, reply: Reply, frame_id: str) -> Any:
    """Fill the response of the service with a reply."""
    response.success = reply.success
    response.code = reply.code
    response.message = reply.message
    response.flux_map = flux_map_message(reply, frame_id)
    response.report = fit_report_message(reply)
    response.output = reply.output
    return response


def recordings(provenance: Provenance) -> list[str]:
    """Return the recordings that a result is of: bags, and files that are no part of one."""
    paths = (Path(file) for file in provenance.inputs)
    return list(dict.fromkeys(str(path.parent if path.suffix in _OF_BAG else path) for path in paths))


def result_info(found: FoundResult) -> ResultInfo:
    """Return the message of a result in a list."""
    known = found.provenance
    message = ResultInfo(
        folder=str(found.folder), date=known.date, method=found.method, machine=known.machine, session=known.session,
        recordings=recordings(known),
        **{NAMES[name]: getattr(known.settings, name) for name in NAMES if name != "machine"},
    )  # fmt: skip
    for name in ("resistance", "sigma_resistance", "i_max", "coverage"):
        setattr(message, name, getattr(found, name))
    return message


def flux_map_points(flux_map: FluxMap) -> PointCloud2:
    """Return a map as a point cloud.

    ``x`` and ``y`` are i_d and i_q relative to i_max, ``z`` is the flux linkage relative to the largest one, so that a
    view with equal axes shows the shape. ``sigma`` is the standard error of the flux vector, Wb, NaN without data;
    ``coverage`` is 1 where the recorded currents cover the point, else 0.
    """
    shape = len(flux_map.i_d), len(flux_map.i_q)
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    psi_d, psi_q, sigma_d, sigma_q = (
        np.frombuffer(column, np.float64).reshape(shape)
        for column in (flux_map.psi_d, flux_map.psi_q, flux_map.sigma_d, flux_map.sigma_q)
    )
    inside = np.array(flux_map.inside, np.bool_).reshape(shape)
    psi = np.hypot(psi_d, psi_q)
    largest = psi[inside].max() if inside.any() else psi.max(initial=1.0)
    columns = (
        i_d / flux_map.i_max, i_q / flux_map.i_max, psi / (largest or 1.0), i_d, i_q, psi_d, psi_q,
        np.hypot(sigma_d, sigma_q), inside,
    )  # fmt: skip
    points = np.stack([column.astype(np.float32) for column in columns], axis=-1)
    step = 4 * len(FIELDS)
    return PointCloud2(
        header=flux_map.header,
        height=shape[0],
        width=shape[1],
        fields=[
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, name in enumerate(FIELDS)
        ],
        is_bigendian=False,
        point_step=step,
        row_step=step * shape[1],
        data=array.array("B", points.astype("<f4").tobytes()),
        is_dense=bool(np.isfinite(points).all()),
    )


def operating_point_message(point: Point, frame_id: str) -> OperatingPoint:
    """Return the message of an operating point."""
    return headed(OperatingPoint(i_d=point.i_d, i_q=point.i_q, speed=point.speed), point.stamp, frame_id)


def _doubles(values: ArrayLike) -> array.array[float]:
    return array.array("d", np.asarray(values, np.float64).tobytes())
