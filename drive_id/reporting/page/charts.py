"""What the page draws: grids and curves as plain lists, which its script hands to plotly.

Grids are ``z[k][j]`` at ``i_q[k]``, ``i_d[j]``: plotly's rows are y. Values without meaning are None. Numbers keep five
significant digits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from drive_id.common.quantity import plain, scaled_unit
from drive_id.core.maps.flux_map import FluxMap
from drive_id.core.result.headline import slopes
from drive_id.reporting.page.content import map_difference
from drive_id.reporting.page.operation import LossMap, TorqueMap
from drive_id.result.pictures.panels import COLOURS
from drive_id.result.result import Result
from drive_id.types import BoolArray, FloatArray

MOST_POINTS = 97
"""Along an axis of a grid: finer maps are thinned, as a page of tens of MB opens in no browser."""
_Part = tuple[str, str, str, FloatArray, FloatArray | None]
"""Name, label, SI unit, values and standard errors of one map of a view."""
_listed = partial(plain, digits=5)
_RPM = 30 / np.pi


def charts_of(result: Result, operation: TorqueMap | None) -> dict[str, Any]:
    """Return the data of all charts, ready for JSON; a chart without data is None."""
    return {
        "i_max": result.i_max,
        "colours": [[share, to_hex(COLOURS(share))] for share in np.linspace(0, 1, 9).tolist()],
        "map": _map(result, operation),
        "limit": _limit(result, operation),
        "comparison": _comparison(result),
        "inverter": _inverter(result),
        "residuals": _residuals(result),
        "currents": _currents(result),
        "operation": _operation(operation),
    }


def _map(result: Result, operation: TorqueMap | None) -> dict[str, Any]:
    """Return axes, quantities over them, and where there are data."""
    found = result.flux_map.whole
    rows, columns = _thinned(len(found.i_d)), _thinned(len(found.i_q))
    at = np.ix_(rows, columns)
    known = found.inside[at]
    i_d, i_q = np.meshgrid(found.i_d[rows], found.i_q[columns], indexing="ij")
    inductances, errors = found.inductances(i_d, i_q), _sigma_inductances(result)[at]
    pairs: dict[str, list[_Part]] = {"Flux linkages ψ_d and ψ_q": [], "Standard errors of ψ_d and ψ_q": []}
    for c, psi, sigma in (("d", found.psi_d, found.sigma_d), ("q", found.psi_q, found.sigma_q)):
        pairs["Flux linkages ψ_d and ψ_q"].append((f"psi_{c}", f"ψ_{c}", "Wb", psi[at], sigma[at]))
        if np.isfinite(sigma[found.inside]).any():
            part = (f"sigma_{c}", f"σ of ψ_{c}", "Wb", sigma[at], None)
            pairs["Standard errors of ψ_d and ψ_q"].append(part)
    for heading, elements in (("Incremental L_dd and L_qq", ("dd", "qq")), ("Incremental L_dq and L_qd", ("dq", "qd"))):
        pairs[heading] = [_inductance(element, inductances, errors) for element in elements]
    ratio = inductances[..., 1, 1] / inductances[..., 0, 0]
    pairs["Saliency L_qq / L_dd"] = [("saliency", "L_qq / L_dd", "", ratio, None)]
    for h in result.harmonics:
        amplitudes = (np.hypot(h.psi_d_cos, h.psi_d_sin), np.hypot(h.psi_q_cos, h.psi_q_sin))
        pairs[f"Amplitude of harmonic {h.order}"] = [
            (f"h{h.order}_{c}", f"harmonic {h.order} of ψ_{c}", "Wb", x[at], None)
            for c, x in zip("dq", amplitudes, strict=True)
        ]
    if operation is not None:
        if operation.ripple is not None:
            pairs["Torque ripple, peak to peak"] = [("ripple", "ripple", "Nm", operation.ripple[at], None)]
        torque, sigma = _torque(result, found)
        pairs["Torque"] = [("torque", "torque", "Nm", torque[at], sigma[at])]
        if operation.losses is not None:
            pairs |= _losses(operation.losses, at)
    pairs = {heading: parts for heading, parts in pairs.items() if parts}
    quantities = [q for parts in pairs.values() for q in _quantities(parts, known, result.drive.sizes)]
    trajectory = result.diagnostics.trajectory if result.diagnostics else np.zeros((0, 2))
    return {
        "i_d": _listed(found.i_d[rows]),
        "i_q": _listed(found.i_q[columns]),
        "inside": result.flux_map.inside[at].T.astype(int).tolist(),
        "known": known.T.astype(int).tolist(),
        "quantities": quantities,
        "views": [{"label": heading, "parts": [part[0] for part in parts]} for heading, parts in pairs.items()],
        "trajectory": {"i_d": _listed(trajectory[:, 0]), "i_q": _listed(trajectory[:, 1])},
    }


def _losses(found: LossMap, at: Any) -> dict[str, list[_Part]]:
    """Return the losses as views: those of winding and inverter side by side, that of the iron with its speed."""
    parts = {name: (name, f"{name} loss", "W", *(x[at] for x in maps)) for name, maps in found.losses.items()}
    views = {"Losses of winding and inverter": [parts[name] for name in ("copper", "inverter") if name in parts]}
    if "iron" in parts:
        views[f"Iron loss at {found.speed * _RPM:.4g} rpm"] = [parts["iron"]]
    return views


def _inductance(element: str, values: FloatArray, errors: FloatArray) -> _Part:
    """Return an element of the incremental inductances (..., 2, 2), such as ``dq``."""
    flux, current = element[0], element[1]
    at = np.s_[..., "dq".index(flux), "dq".index(current)]
    return f"L_{element}", f"L_{element} = ∂ψ_{flux}/∂i_{current}", "H", values[at], errors[at]


def _sigma_inductances(result: Result) -> FloatArray:
    """Return the standard errors (D, Q, 2, 2) of the incremental inductances, H; NaN where not known."""
    found, modes = result.flux_map, result.drive.error_modes
    if modes is None:
        return np.full((*found.inside.shape, 2, 2), np.nan)
    axes = ((found.i_d, -2), (found.i_q, -1))
    changes = [[slopes(psi, modes.known, *axis) for axis in axes] for psi in (modes.psi_d, modes.psi_q)]
    return np.asarray(np.moveaxis(np.linalg.norm(changes, axis=2), (0, 1), (-2, -1)))


def _torque(result: Result, found: FluxMap) -> tuple[FloatArray, FloatArray]:
    """Return the torque (D, Q) and its standard error, Nm."""
    (i_d, i_q), modes = np.moveaxis(found.grid(), -1, 0), result.drive.error_modes
    factor = 1.5 * (result.pole_pairs or 0)
    torque = np.where(found.inside, factor * (found.psi_d * i_q - found.psi_q * i_d), np.nan)
    if modes is None:
        return torque, np.full_like(torque, np.nan)
    sigma = factor * np.linalg.norm(modes.psi_d * i_q - modes.psi_q * i_d, axis=0)
    return torque, np.where(found.inside, sigma, np.nan)


def _quantities(parts: Sequence[_Part], known: BoolArray, sizes: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Yield quantities that are shown side by side, in the unit of the result or else by their size in one."""
    largest = max(float(np.abs(part[3][known]).max(initial=0.0)) for part in parts)
    for name, label, unit, values, sigma in parts:
        scale, prefixed = scaled_unit(sizes.get(unit, largest), unit)
        told = sigma is not None and bool(np.isfinite(sigma).any())
        yield {
            "name": name,
            "label": label,
            "unit": prefixed,
            "z": _listed(scale * values.T),
            "sigma": _listed(scale * sigma.T) if sigma is not None and told else None,
            "signed": name == "torque",
        }


def _limit(result: Result, operation: TorqueMap | None) -> dict[str, Any] | None:
    """Return what voltage ellipses need; None where voltage or pole pairs are unknown."""
    if operation is None or not result.u_dc or not operation.corner > 0:
        return None
    speeds = [float(f"{factor * operation.corner * _RPM:.2g}") for factor in (1.0, 1.5, 2.5)]
    return {"voltage": result.u_dc / np.sqrt(3), "pole_pairs": result.pole_pairs, "speeds": speeds}


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
        apart = [np.where(found.inside, x, np.nan)[at] for x in map_difference(result, other)]
        scale, unit = scaled_unit(result.drive.sizes.get("Wb", 0.0), "Wb")
        fluxes = {f"psi_{c}": _listed(scale * z.T) for c, z in zip("dq", apart, strict=True)}
        methods.append({"name": other.method, "unit": unit, **fluxes})
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
    time, angle, plane = judged.over_time, judged.over_angle, judged.over_plane
    return {
        "time": {"x": _listed(time.time), **_components(mean=time.mean, rms=time.rms)},
        "angle": {"x": _listed(np.rad2deg(angle.angle)), **_components(mean=angle.mean, rms=angle.rms)},
        "plane": plane
        and {
            "i_d": _listed(plane.i_d),
            "i_q": _listed(plane.i_q),
            "commanded": plain(plane.commanded, 4),
            **{
                f"{name}_{c}": _listed(x[..., k].T)
                for name, x in (("mean", plane.mean), ("rms", plane.rms))
                for k, c in enumerate("dq")
            },
        },
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
