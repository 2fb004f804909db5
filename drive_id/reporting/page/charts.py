"""What the page draws: grids and curves as plain lists, which its script hands to plotly.

Grids are ``z[k][j]`` at ``i_q[k]``, ``i_d[j]``: plotly's rows are y. Values without meaning are None. Numbers keep five
significant digits.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from drive_id.pictures.panels import COLOURS
from drive_id.quantity import plain
from drive_id.reporting.page.content import map_difference
from drive_id.reporting.page.operation import TorqueMap
from drive_id.result.result import Result
from drive_id.types import FloatArray

MOST_POINTS = 97
"""Along an axis of a grid: finer maps are thinned, as a page of tens of MB opens in no browser."""
_listed = partial(plain, digits=5)
_RPM = 30 / np.pi


def charts_of(result: Result, operation: TorqueMap | None) -> dict[str, Any]:
    """Return the data of all charts, ready for JSON; a chart without data is None."""
    return {
        "i_max": result.i_max,
        "colours": [[share, to_hex(COLOURS(share))] for share in np.linspace(0, 1, 9).tolist()],
        "map": _map(result, operation),
        "comparison": _comparison(result),
        "inverter": _inverter(result),
        "residuals": _residuals(result),
        "currents": _currents(result),
        "operation": _operation(operation),
    }


def _map(result: Result, operation: TorqueMap | None) -> dict[str, Any]:
    """Return axes, quantities over them, and where there are data."""
    found = result.flux_map
    rows, columns = _thinned(len(found.i_d)), _thinned(len(found.i_q))
    at = np.ix_(rows, columns)
    inside = found.inside[at]
    i_d, i_q = np.meshgrid(found.i_d[rows], found.i_q[columns], indexing="ij")
    inductances = found.inductances(i_d, i_q)
    components = (("d", found.psi_d, found.sigma_d), ("q", found.psi_q, found.sigma_q))
    quantities = [
        _quantity(f"psi_{c}", f"ψ_{c}", "mWb", 1e3 * psi[at], 1e3 * sigma[at]) for c, psi, sigma in components
    ]
    for component, _, sigma in components:
        if np.isfinite(sigma[found.inside]).any():
            quantities.append(_quantity(f"sigma_{component}", f"σ of ψ_{component}", "µWb", 1e6 * sigma[at]))
    for row, flux in enumerate("dq"):
        for column, current in enumerate("dq"):
            name, values = f"L_{flux}{current}", 1e3 * inductances[..., row, column]
            quantities.append(_quantity(name, f"{name} = ∂ψ_{flux}/∂i_{current}", "mH", values))
    ratio = inductances[..., 1, 1] / inductances[..., 0, 0]
    quantities.append(_quantity("saliency", "Saliency L_qq / L_dd", "", ratio))
    if operation is not None:
        if operation.ripple is not None:
            quantities.append(_quantity("ripple", "Torque ripple, peak to peak", "Nm", operation.ripple[at]))
        quantities.append(_quantity("torque", "Torque", "Nm", operation.torque[at]))
    trajectory = result.diagnostics.trajectory if result.diagnostics else np.zeros((0, 2))
    return {
        "i_d": _listed(found.i_d[rows]),
        "i_q": _listed(found.i_q[columns]),
        "inside": inside.T.astype(int).tolist(),
        "quantities": quantities,
        "trajectory": {"i_d": _listed(trajectory[:, 0]), "i_q": _listed(trajectory[:, 1])},
    }


def _quantity(name: str, label: str, unit: str, values: FloatArray, sigma: FloatArray | None = None) -> dict[str, Any]:
    known = sigma is not None and bool(np.isfinite(sigma).any())
    return {
        "name": name,
        "label": label,
        "unit": unit,
        "z": _listed(values.T),
        "sigma": _listed(sigma.T) if sigma is not None and known else None,
    }


def _comparison(result: Result) -> dict[str, Any] | None:
    """Return the difference of the paper's maps from the result's, where there are data."""
    judged = result.diagnostics
    found = result.flux_map
    rows, columns = _thinned(len(found.i_d)), _thinned(len(found.i_q))
    at = np.ix_(rows, columns)
    methods = []
    for other in judged.comparisons if judged else ():
        if other.psi_d is None:
            continue
        apart = (1e3 * np.where(found.inside, x, np.nan)[at] for x in map_difference(result, other))
        methods.append({"name": other.method, **{f"psi_{c}": _listed(z.T) for c, z in zip("dq", apart, strict=True)}})
    if not methods:
        return None
    axes = {"i_d": _listed(found.i_d[rows]), "i_q": _listed(found.i_q[columns])}
    return {**axes, "own": result.method, "methods": methods}


def _inverter(result: Result) -> dict[str, Any] | None:
    curve = result.inverter_curve
    if not result.origin.inverter or not np.any(curve.voltage):
        return None
    sigma = result.drive.sigma_drop
    return {
        "current": _listed(curve.current),
        "voltage": _listed(curve.voltage),
        "sigma": None if sigma is None else _listed(sigma),
        "phases": None if curve.phases is None else [_listed(phase) for phase in curve.phases.T],
    }


def _residuals(result: Result) -> dict[str, Any] | None:
    judged = result.diagnostics
    if judged is None or not np.isfinite(judged.over_time.mean).any():
        return None
    time, angle = judged.over_time, judged.over_angle
    return {
        "time": {"x": _listed(time.time), **_components(mean=time.mean, rms=time.rms)},
        "angle": {"x": _listed(np.rad2deg(angle.angle)), **_components(mean=angle.mean, rms=angle.rms)},
    }


def _components(**curves: FloatArray) -> dict[str, list[Any]]:
    """Return both columns of curves (N, 2) by name, such as ``mean_d``."""
    return {f"{name}_{c}": _listed(x[:, axis]) for name, x in curves.items() for axis, c in enumerate("dq")}


def _currents(result: Result) -> dict[str, Any] | None:
    found = result.diagnostics.simulated if result.diagnostics else None
    if found is None:
        return None
    return {
        "time": _listed(found.time, digits=7),
        **_components(measured=found.measured, simulated=found.simulated),
        "bin_time": _listed(found.bin_time),
        **_components(deviation=found.deviation),
    }


def _operation(operation: TorqueMap | None) -> dict[str, Any] | None:
    if operation is None:
        return None
    speeds = operation.speeds
    return {
        "speeds": speeds
        and {
            "iron": speeds.iron,
            "speed": _listed(speeds.speed * _RPM),
            "largest": _listed(speeds.largest),
            "torque": _listed(speeds.torque),
            "efficiency": _listed(100 * speeds.efficiency.T),
        },
        "lines": [
            {
                "name": name,
                "i_d": _listed(line.i_d),
                "i_q": _listed(line.i_q),
                "torque": _listed(line.torque),
                "sigma": _listed(line.sigma_torque),
            }
            for name, line in operation.lines.items()
        ],
    }


def _thinned(count: int) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return at most 97 indices of an axis, its ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).round().astype(np.int64))
