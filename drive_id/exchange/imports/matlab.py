"""Maps in ``.mat`` files: SyR-e's models and flux files, and Motor-CAD's saturation and loss map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.imports.npz import known_scalars, real
from drive_id.exchange.imports.points import MapPoints, of_grid
from drive_id.exchange.imports.source import Source
from drive_id.files.inputs.matlab import load_matlab
from drive_id.files.machines.syre import read_syre
from drive_id.types import FloatArray


def read_syre_model(source: Source) -> MapPoints:
    """Read SyR-e's ``motorModel``, in the axes of the file."""
    values, axis = read_syre(source.path)
    names = {"R": "resistance", "pole_pairs": "pole_pairs", "i_max": "i_max", "u_dc": "u_dc"}
    scalars = known_scalars({ours: values[name] for name, ours in names.items() if name in values}, source.scalars)
    turning = "psi_d_theta" in values
    psi = (values["psi_d_theta"], values["psi_q_theta"]) if turning else (values["psi_d"], values["psi_q"])
    i_dq, psi_dq = of_grid(values["id"], values["iq"], *psi)
    theta = np.radians(values["theta_e_deg"]) if turning else None
    return MapPoints(i_dq, psi_dq, theta, scalars=scalars, axis=axis, machine=source.path.stem).complete()


def read_syre_flux(source: Source) -> MapPoints:
    """Read SyR-e's ``fdfq_idiq_n256.mat``: ``Id Iq Fd Fq`` and, if there, ``T`` and ``dataSet.axisType``."""
    values = load_matlab(source.path, f"'{source.path}'")
    i_dq, psi_dq = (_stacked(source, values, names) for names in (("Id", "Iq"), ("Fd", "Fq")))
    torque = _array(source, values, "T").ravel() if "T" in values else None
    axis = getattr(values.get("dataSet"), "axisType", None)
    axis, scalars = None if axis is None else str(axis).lower(), known_scalars({}, source.scalars)
    return MapPoints(i_dq, psi_dq[..., None], torque=torque, scalars=scalars, axis=axis).complete()


def read_motor_cad(source: Source) -> MapPoints:
    """Read Motor-CAD's ``SaturationLossMap.mat``.

    ``Id_Peak`` and ``Iq_Peak`` are grids, in polar or rectangular coordinates; ``Flux_Linkage_D/Q`` or, over electrical
    degrees in ``Angular_Rotor_Position``, ``Angular_Flux_Linkage_D/Q`` have one more axis.
    """
    values = load_matlab(source.path, f"'{source.path}'")
    i_dq = _stacked(source, values, ("Id_Peak", "Iq_Peak"))
    angular = "Angular_Flux_Linkage_D" in values and "Angular_Rotor_Position" in values
    theta: FloatArray | None = None
    if angular:
        parts = [_array(source, values, f"Angular_Flux_Linkage_{axis}") for axis in "DQ"]
        if any(part.ndim != 3 or part.shape[0] * part.shape[1] != len(i_dq) for part in parts):
            raise ConfigurationError(
                f"The angular flux linkages in '{source.path}' do not fit Id_Peak: export it again."
            )
        degrees = _array(source, values, "Angular_Rotor_Position").reshape(-1, parts[0].shape[2])[0]
        psi = np.stack([part.reshape(len(i_dq), -1) for part in parts], axis=1)
        if abs(degrees[-1] - degrees[0] - 360) < 1e-6 or (
            len(degrees) > 4 and np.allclose(psi[..., 0], psi[..., -1], rtol=0, atol=1e-9 * np.abs(psi).max())
        ):
            degrees, psi = degrees[:-1], psi[..., :-1]
        theta = np.radians(source.electrical(degrees))
    else:
        psi = _stacked(source, values, ("Flux_Linkage_D", "Flux_Linkage_Q"))[..., None]
    torque = None
    if "Electromagnetic_Torque" in values:
        torque = _array(source, values, "Electromagnetic_Torque").ravel()
    elif "Angular_Electromagnetic_Torque" in values:
        torque = _array(source, values, "Angular_Electromagnetic_Torque").reshape(len(i_dq), -1).mean(axis=1)
    scalars: dict[str, Any] = {}
    if "Phase_Resistance_DC_at_20C" in values:
        scalars["resistance"] = values["Phase_Resistance_DC_at_20C"]
    if np.size(values.get("Speed", ())) == 1 and np.size(values.get("Frequency", ())) == 1:
        pairs = 60 * float(values["Frequency"]) / float(values["Speed"])
        scalars["pole_pairs"] = round(pairs) if abs(pairs - round(pairs)) < 1e-3 else np.nan
    if torque is not None and len(torque) != len(i_dq):
        raise ConfigurationError(f"The torque in '{source.path}' does not fit Id_Peak: export it again.")
    # The d axis of Motor-CAD is that of the magnet; zero current appears once for each angle of a polar grid.
    _, first = np.unique(np.round(i_dq / np.ptp(i_dq, axis=0), 9), axis=0, return_index=True)
    first.sort()
    torque, scalars = None if torque is None else torque[first], known_scalars(scalars, source.scalars)
    return MapPoints(i_dq[first], psi[first], theta, torque, scalars=scalars).complete()


def _array(source: Source, values: Mapping[str, Any], name: str) -> FloatArray:
    if name not in values:
        raise ConfigurationError(f"'{source.path}' has no '{name}': export it again with this field.")
    return real(source.path, name, values[name])


def _stacked(source: Source, values: Mapping[str, Any], names: tuple[str, str]) -> FloatArray:
    """Return two arrays of equal shape as (N, 2)."""
    parts = [_array(source, values, name) for name in names]
    if parts[0].shape != parts[1].shape:
        raise ConfigurationError(f"{' and '.join(names)} in '{source.path}' have different shapes: export it again.")
    return np.stack([part.ravel() for part in parts], axis=-1)
