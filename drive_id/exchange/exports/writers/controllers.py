"""Parameters of small motor controllers: single numbers, taken at zero current."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from typing import NamedTuple

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable


class _Numbers(NamedTuple):
    resistance: float
    l_d: float
    l_q: float
    magnet: float
    least: float


def write_vesc(table: MapTable, options: ExportOptions) -> bytes:
    """Write the entries of VESC Tool's motor configuration that the map tells, with gains for the bandwidth.

    One gain serves both axes and all currents, so it follows from the smallest incremental inductance: no loop is then
    faster than the bandwidth.
    """
    found = _numbers(table)
    values = {
        "foc_motor_r": found.resistance,
        "foc_motor_l": (found.l_d + found.l_q) / 2,
        "foc_motor_ld_lq_diff": found.l_q - found.l_d,
        "foc_motor_flux_linkage": found.magnet,
        "foc_current_kp": found.least * options.bandwidth,
        "foc_current_ki": found.resistance * options.bandwidth,
    }
    root = ET.Element("MCConfiguration")
    for name, value in values.items():
        ET.SubElement(root, name).text = f"{value:.9g}"
    root.insert(0, ET.Comment(f" {table.source} {table.gain_source} ".replace("--", "- -")))
    ET.indent(root)
    return b"<?xml version='1.0' encoding='utf-8'?>\n" + ET.tostring(root, encoding="unicode").encode() + b"\n"


def write_odrive(table: MapTable, options: ExportOptions) -> bytes:
    """Write what ``odrivetool restore-config`` reads; the torque constant is 3/2 p psi_m."""
    found = _numbers(table)
    motor = {
        "phase_resistance": found.resistance,
        "phase_inductance": found.least,  # of which odrive computes its gains
        "pole_pairs": table.machine.known_pole_pairs(),
        "torque_constant": 1.5 * table.machine.known_pole_pairs() * found.magnet,
        "ff_pm_flux_linkage": found.magnet,
        "ff_pm_flux_linkage_valid": True,
        "motor_model_l_d": found.l_d,
        "motor_model_l_q": found.l_q,
        "motor_model_l_dq_valid": True,
        "current_control_bandwidth": options.bandwidth,
    }
    tree = {f"axis0.config.motor.{name}": value for name, value in motor.items()}
    return (json.dumps(tree, indent=1) + "\n").encode()


def _numbers(table: MapTable) -> _Numbers:
    L = table.machine.control_inductances(0.0, 0.0)
    magnet = float(table.machine.psi_dq(0.0, 0.0)[0])
    return _Numbers(table.known_resistance(), float(L[0, 0]), float(L[1, 1]), magnet, table.machine.least_inductance)
