"""``diagnostics.npz`` of a result folder: what a report shows of the recordings besides the result's numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drive_id.core.result.diagnostics import ComparedMethod, Diagnostics
from drive_id.core.validation.residuals import AngleBins, PlaneBins, TimeBins
from drive_id.core.validation.simulated_current import SimulatedCurrent
from drive_id.errors import ResultError
from drive_id.files.inputs.archive import npz_bytes, read_arrays
from drive_id.types import FloatArray

DIAGNOSTICS = "diagnostics.npz"
_LARGEST = 1 << 27  # bytes of arrays, a hundred times those of a fit
_FORMAT_VERSION = 1
_NUMBERS = (
    "resistance", "sigma_resistance", "voltage_error", "sigma_voltage_error", "residual_rms", "mad_d", "mad_q",
    "nrmse_d", "nrmse_q",
)  # fmt: skip


def diagnostics_bytes(diagnostics: Diagnostics) -> bytes:
    """Return the content of ``diagnostics.npz``, in single precision: it is made for pictures."""
    arrays: dict[str, Any] = {"format_version": _FORMAT_VERSION, "residual_rms": diagnostics.residual_rms}
    arrays |= _prefixed("angle", diagnostics.over_angle._asdict())
    arrays |= _prefixed("time", diagnostics.over_time._asdict())
    if diagnostics.over_plane is not None:
        arrays |= _prefixed("plane", diagnostics.over_plane._asdict())
    arrays["trajectory"] = _single(diagnostics.trajectory)
    if diagnostics.simulated is not None:
        simulated = diagnostics.simulated
        arrays |= _prefixed("current", {entry.name: getattr(simulated, entry.name) for entry in fields(simulated)})
    arrays["methods"] = np.array([found.method for found in diagnostics.comparisons], np.str_)
    arrays["failures"] = np.array([found.failure for found in diagnostics.comparisons], np.str_)
    arrays["samples"] = np.array([found.samples for found in diagnostics.comparisons], np.int64)
    for name in _NUMBERS:
        arrays[f"methods_{name}"] = np.array([getattr(found, name) for found in diagnostics.comparisons])
    for found in diagnostics.comparisons:
        if found.psi_d is not None and found.psi_q is not None:
            arrays |= _prefixed(found.method, {"psi_d": found.psi_d, "psi_q": found.psi_q})
    return npz_bytes(arrays)


def read_diagnostics(content: bytes, shape: tuple[int, ...]) -> Diagnostics | None:
    """Read the content of ``diagnostics.npz`` beside a flux map of this shape; None for a file of a newer version.

    When the file is damaged, it raises whatever numpy and zipfile do, see
    :func:`~drive_id.files.results.identification.read_judged`.
    """
    arrays = read_arrays(content, largest=_LARGEST)
    if int(arrays["format_version"]) > _FORMAT_VERSION:
        return None
    angle, time = (_table(arrays, name) for name in ("angle", "time"))
    trajectory = np.asarray(arrays["trajectory"], np.float64)
    if trajectory.shape[1:] != (2,):
        raise ResultError("the trajectory is not made of i_d and i_q")
    simulated = None
    if "current_time" in arrays:
        names = [entry.name for entry in fields(SimulatedCurrent)]
        values = {name: np.asarray(arrays[f"current_{name}"], np.float64) for name in names}
        excerpt, bins = (len(values["time"]), 2), (len(values["bin_time"]), 2)
        if (
            any(values[name].shape != excerpt for name in ("measured", "simulated"))
            or values["deviation"].shape != bins
        ):
            raise ResultError("the simulated currents do not fit their times")
        simulated = SimulatedCurrent(**values)
    return Diagnostics(
        over_angle=AngleBins(*angle),
        over_time=TimeBins(*time),
        over_plane=_plane(arrays),
        residual_rms=float(arrays["residual_rms"]),
        trajectory=trajectory,
        simulated=simulated,
        comparisons=tuple(_comparison(arrays, number, shape) for number in range(len(arrays["methods"]))),
    )


def _comparison(arrays: Mapping[str, NDArray[Any]], number: int, shape: tuple[int, ...]) -> ComparedMethod:
    method = str(arrays["methods"][number])
    maps: dict[str, FloatArray] = {}
    if f"{method}_psi_d" in arrays:
        maps = {name: np.asarray(arrays[f"{method}_{name}"], np.float64) for name in ("psi_d", "psi_q")}
        if any(values.shape != shape for values in maps.values()):
            raise ResultError(f"the map of method {method} does not fit the flux map")
    return ComparedMethod(
        method=method,
        failure=str(arrays["failures"][number]),
        samples=int(arrays["samples"][number]),
        psi_d=maps.get("psi_d"),
        psi_q=maps.get("psi_q"),
        **{name: float(arrays[f"methods_{name}"][number]) for name in _NUMBERS},
    )


def _table(arrays: Mapping[str, NDArray[Any]], axis: str) -> tuple[FloatArray, ...]:
    """Return the axis (B,) of bins, and mean and rms (B, 2)."""
    found = tuple(np.asarray(arrays[f"{axis}_{name}"], np.float64) for name in (axis, "mean", "rms"))
    if any(values.shape != (len(found[0]), 2) for values in found[1:]):
        raise ResultError(f"the residuals over {axis} do not fit their bins")
    return found


def _plane(arrays: Mapping[str, NDArray[Any]]) -> PlaneBins | None:
    """Return the residual over the current plane; None of a file of an earlier version."""
    if "plane_i_d" not in arrays:
        return None
    i_d, i_q, mean, rms, commanded = (np.asarray(arrays[f"plane_{name}"], np.float64) for name in PlaneBins._fields)
    shape = (*i_d.shape, *i_q.shape, 2)
    if i_d.ndim != 1 or mean.shape != shape or rms.shape != shape or commanded.ndim:
        raise ResultError("the residuals over the current plane do not fit their cells")
    return PlaneBins(i_d, i_q, mean, rms, float(commanded))


def _prefixed(prefix: str, arrays: Mapping[str, FloatArray | float]) -> dict[str, NDArray[np.float32]]:
    return {f"{prefix}_{name}": _single(values) for name, values in arrays.items()}


def _single(values: FloatArray | float) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)
