"""MATLAB files for blocksets of MathWorks, for PLECS and for SyR-e."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.axes import clean
from drive_id.exchange.exports.control import control_table
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import FloatArray

_SPAN = 2 * np.pi / 3  # electrical angle after which Simscape repeats its tables, rad
_LOST = 0.03  # flux that tables of L_d and L_q may lose, relative to the largest
_TEMPERATURE = 20.0  # of windings and magnets in SyR-e's files, degrees Celsius: R is stated at it


def _file(
    variables: Callable[[MapTable, ExportOptions], dict[str, Any]],
) -> Callable[[MapTable, ExportOptions], bytes]:
    """Make a writer of version 5 of a function that returns variables; dictionaries become structs, 1-D arrays rows."""

    @wraps(variables)
    def write(table: MapTable, options: ExportOptions) -> bytes:
        from scipy.io import savemat  # noqa: PLC0415  # takes a quarter of a second, and only these formats need it

        stream = io.BytesIO()
        savemat(stream, variables(table, options), oned_as="row", do_compression=True, long_field_names=True)
        return stream.getvalue()

    return write


@_file
def write_simscape(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write tables [i_d, i_q, theta]; theta is mechanical, in degrees, from 0 to 120 / N, the first position repeated.

    Harmonics that do not repeat after a third of an electrical revolution are left out if they are small.

    Raises ConfigurationError when they are not, or the d axis is not symmetric about zero, as the block requires.
    """
    if not np.allclose(table.i_d, -table.i_d[::-1], rtol=0, atol=1e-9 * max(table.i_d[-1], 0.0)):
        raise ConfigurationError(
            f"The d axis runs from {table.i_d[0]:g} to {table.i_d[-1]:g} A, but Simscape wants it symmetric about 0: "
            "choose --range -X X or such an --axis-d."
        )
    table = table.repeating(_SPAN)
    pairs = table.machine.known_pole_pairs()
    theta = np.append(table.angles(_SPAN), _SPAN)
    psi_d, psi_q = table.psi_theta(theta)
    return {
        "nPolePairs": float(pairs),
        "idVec2": table.i_d,
        "iqVec2": table.i_q,
        "xVec2": np.degrees(theta) / pairs,
        "fluxD_dq0": psi_d,
        "fluxQ_dq0": psi_q,
        "flux0_dq0": np.zeros_like(psi_d),
        "Torque_dq0": table.torque_theta(theta),
        "Rs": table.known_resistance(),
        "inside": table.inside,
    }


@_file
def write_simscape_2d(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write tables of apparent inductances with ``psi_d = Ld i_d + pmFlux`` and ``psi_q = Lq i_q``.

    ``pmFluxMatrix`` is psi_d at i_d = 0, which changes with i_q, so that Ld is finite everywhere. psi_q at i_q = 0,
    which is zero in a symmetric machine, is lost.
    """
    i_d, i_q = table.grid
    l_d, l_q = table.machine.apparent_inductances(i_d, i_q)
    magnet, rest = table.machine.psi_dq(0.0 * i_d, i_q)[0], table.machine.psi_dq(i_d, 0.0 * i_q)[1]
    lost = np.abs(rest[table.inside]).max()
    if lost > _LOST * float(np.nanmax(np.hypot(*table.psi))):
        raise ConfigurationError(
            f"psi_q is up to {lost:.3g} Wb at i_q = 0, which tables of L_q cannot hold: export --format simscape "
            "instead."
        )
    return {
        "nPolePairs": float(table.machine.known_pole_pairs()),
        "idVec": table.i_d,
        "iqVec": table.i_q,
        "LdMatrix": table.masked(l_d),
        "LqMatrix": table.masked(l_q),
        "pmFluxMatrix": table.masked(magnet),
        "pmFlux": float(table.machine.psi_dq(0.0, 0.0)[0]),
        "Rs": table.known_resistance(),
        "inside": table.inside,
    }


@_file
def write_motor_control(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write the struct ``pmsm`` of Motor Control Blockset, whose look-up tables ``PMSMLUT`` have method FluxDQ.

    ``FluxDTable``, ``FluxQTable`` and ``TorqueTable`` [i_d, i_q] are over a column ``idVec`` and a row ``iqVec``. Where
    the DC-link voltage is known, there are also the references ``idRefTable``, ``iqRefTable`` [torque, speed] over
    ``trefVec`` (Nm) and ``wrpmVec`` (rpm).
    """
    machine, at_zero = table.machine, table.at_zero
    lut = {
        "method": "FluxDQ",
        "idVec": table.i_d[:, None],
        "iqVec": table.i_q[None, :],
        "FluxDTable": table.psi[0],
        "FluxQTable": table.psi[1],
        "TorqueTable": table.torque,
    }
    if machine.u_dc is not None:
        control = control_table(table)
        lut |= {
            "trefVec": control.torque[:, None],
            "wrpmVec": control.speed[None, :] * (30 / np.pi),
            "idRefTable": control.i_d.T,
            "iqRefTable": control.i_q.T,
        }
    pmsm = {
        "p": float(machine.known_pole_pairs()),
        "Rs": table.known_resistance(),
        "Ld": at_zero.l_d,
        "Lq": at_zero.l_q,
        "FluxPM": at_zero.magnet,
        "I_rated": machine.i_max,
        "PMSMLUT": lut,
    }
    return {"pmsm": pmsm, "inside": table.inside}


@_file
def write_powertrain(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write Powertrain Blockset's machine: ``id``, ``iq`` [psi_d, psi_q] over ``flux_d``, ``flux_q``, ``Rs``, ``P``."""
    psi_d, psi_q, i_d, i_q = inverse_maps(table)
    return {
        "flux_d": psi_d,
        "flux_q": psi_q,
        "id": i_d,
        "iq": i_q,
        "Rs": table.known_resistance(),
        "P": float(table.machine.known_pole_pairs()),
    }


@_file
def write_powertrain_controller(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write the fluxes ``lambda_d``, ``lambda_q`` [i_d, i_q], and references ``id_ref``, ``iq_ref`` [speed, torque].

    Breakpoints are ``id_index``, ``iq_index`` (A), ``wbp`` (mechanical, rad/s) and ``tbp`` (Nm).
    """
    control = control_table(table)
    return {
        "id_index": table.i_d,
        "iq_index": table.i_q,
        "lambda_d": table.psi[0],
        "lambda_q": table.psi[1],
        "id_ref": control.i_d,
        "iq_ref": control.i_q,
        "wbp": control.speed,
        "tbp": control.torque,
        "Rs": table.known_resistance(),
        "P": float(table.machine.known_pole_pairs()),
        "inside": table.inside,
    }


def inverse_maps(table: MapTable) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return axes of psi_d (D,) and psi_q (Q,), Wb, and the currents i_d and i_q (D, Q), A, that belong to them.

    The axes have as many points as those of the table, and cover the fluxes that it holds. Currents without data are
    NaN unless the table is filled.

    Raises ConfigurationError when the continued map does not reach all these fluxes.
    """
    psi_d, psi_q = (
        clean(np.linspace(float(np.nanmin(psi)), float(np.nanmax(psi)), len(axis)))
        for psi, axis in zip(table.psi, (table.i_d, table.i_q), strict=True)
    )
    i_d, i_q = table.machine.current(psi_d[:, None], psi_q)
    if table.filled:
        if np.isnan(i_d).any():
            raise ConfigurationError(
                "The continued map does not reach all fluxes of its rectangle: choose a smaller --range."
            )
        return psi_d, psi_q, i_d, i_q
    known = table.machine.inside(i_d, i_q)
    return psi_d, psi_q, np.where(known, i_d, np.nan), np.where(known, i_q, np.nan)


@_file
def write_plecs(table: MapTable, options: ExportOptions) -> dict[str, Any]:
    """Write air-gap flux linkages and incremental inductances [i_d, i_q], without the stator leakage ``Lsigma``."""
    (i_d, i_q), (psi_d, psi_q), leakage = table.grid, table.psi, options.leakage_inductance
    L = table.inductances - leakage * np.eye(2)
    least = float(np.nanmin(np.linalg.eigvalsh((L + np.swapaxes(L, -1, -2)) / 2)[table.inside]))
    if leakage > 0 and least <= 0:
        raise ConfigurationError(
            f"--leakage is {leakage:g} H, but the least inductance is {leakage + least:.3g} H: give less than that."
        )
    return {
        "id": table.i_d,
        "iq": table.i_q,
        "psid": psi_d - leakage * i_d,
        "psiq": psi_q - leakage * i_q,
        **{f"L{a}{b}": L[..., j, k] for j, a in enumerate("dq") for k, b in enumerate("dq")},
        "Lsigma": leakage,
        "R": table.known_resistance(),
        "p": float(table.machine.known_pole_pairs()),
        "inside": table.inside,
    }


@_file
def write_syre(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write ``Id Iq Fd Fq T dT dTpp`` [iq, id] with ``per.tempPP`` and ``dataSet``; the axis type is 'PM'."""
    positions = float(len(table.angles(2 * np.pi)))
    return {
        **_syre_flux_map(table),
        "per": {"tempPP": _TEMPERATURE},
        "dataSet": {"axisType": "PM", "NumOfRotPosPP": positions, "AngularSpanPP": 360.0},
    }


@_file
def write_syre_model(table: MapTable, _: ExportOptions) -> dict[str, Any]:
    """Write the struct ``motorModel`` with maps [iq, id] of flux, incremental inductance and, inverse, of current."""
    machine, L = table.machine, table.inductances
    data = {
        "motorName": table.result.machine or "drive_id",
        "pathname": "",
        "motorType": "PM",
        "axisType": "PM",
        "Rs": table.known_resistance(),
        "p": float(machine.known_pole_pairs()),
        "Imax": machine.i_max,
        "i0": machine.i_max,
        "Vdc": np.nan if machine.u_dc is None else machine.u_dc,
        "nmax": np.nan,
        "J": np.nan,
        "tempCu": _TEMPERATURE,
        "tempPM": _TEMPERATURE,
        "n3phase": 1.0,
    }
    i_d, i_q = np.meshgrid(table.i_d, table.i_q)
    psi_d, psi_q, current_d, current_q = inverse_maps(table)
    flux_d, flux_q = np.meshgrid(psi_d, psi_q)
    model: dict[str, Any] = {
        "data": data,
        "FluxMap_dq": _syre_flux_map(table),
        "IncInductanceMap_dq": {
            "Id": i_d,
            "Iq": i_q,
            **{f"L{a}{b}": L[..., j, k].T for j, a in enumerate("dq") for k, b in enumerate("dq")},
        },
        "FluxMapInv_dq": {"Fd": flux_d, "Fq": flux_q, "Id": current_d.T, "Iq": current_q.T},
    }
    if table.harmonics:
        over = np.append(table.angles(2 * np.pi), 2 * np.pi)
        fluxes = dict(zip(("Fd", "Fq"), table.psi_theta(over), strict=True))
        axes = {"Id": table.i_d, "Iq": table.i_q, "th": np.degrees(over)}
        turning = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
        model["FluxMap_dqt"] = axes | {"data": turning | fluxes | {"T": table.torque_theta(over)}}
    return {"motorModel": model}


def _syre_flux_map(table: MapTable) -> dict[str, FloatArray]:
    """Return flux linkages and torque over the currents [iq, id], as by MATLAB's ``meshgrid``."""
    i_d, i_q = np.meshgrid(table.i_d, table.i_q)
    psi_d, psi_q = table.psi
    torque = table.torque_theta(table.angles(2 * np.pi))
    return {
        "Id": i_d,
        "Iq": i_q,
        "Fd": psi_d.T,
        "Fq": psi_q.T,
        "T": torque.mean(axis=-1).T,
        "dT": torque.std(axis=-1).T,
        "dTpp": np.ptp(torque, axis=-1).T,
    }
