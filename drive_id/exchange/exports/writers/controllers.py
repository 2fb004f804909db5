"""Parameters of small motor controllers: single numbers, taken at zero current."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable


def write_vesc(table: MapTable, options: ExportOptions) -> bytes:
    """Write the entries of VESC Tool's motor configuration that the map tells, with gains for the bandwidth.

    One gain serves both axes and all currents, so it follows from the smallest incremental inductance: no loop is then
    faster than the bandwidth.
    """
    resistance, at_zero = table.known_resistance(), table.at_zero
    values = {
        "foc_motor_r": resistance,
        "foc_motor_l": (at_zero.l_d + at_zero.l_q) / 2,
        "foc_motor_ld_lq_diff": at_zero.l_q - at_zero.l_d,
        "foc_motor_flux_linkage": at_zero.magnet,
        "foc_current_kp": table.machine.least_inductance * options.rate,
        "foc_current_ki": resistance * options.rate,
    }
    root = ET.Element("MCConfiguration")
    for name, value in values.items():
        ET.SubElement(root, name).text = f"{value:.9g}"
    root.insert(0, ET.Comment(f" {table.source} {table.gain_source} ".replace("--", "- -")))
    ET.indent(root)
    return b"<?xml version='1.0' encoding='utf-8'?>\n" + ET.tostring(root, encoding="unicode").encode() + b"\n"


def write_odrive(table: MapTable, options: ExportOptions) -> bytes:
    """Write what ``odrivetool restore-config`` reads; the torque constant is 3/2 p psi_m."""
    at_zero, pairs = table.at_zero, table.machine.known_pole_pairs()
    motor = {
        "phase_resistance": table.known_resistance(),
        "phase_inductance": table.machine.least_inductance,  # of which odrive computes its gains
        "pole_pairs": pairs,
        "torque_constant": 1.5 * pairs * at_zero.magnet,
        "ff_pm_flux_linkage": at_zero.magnet,
        "ff_pm_flux_linkage_valid": True,
        "motor_model_l_d": at_zero.l_d,
        "motor_model_l_q": at_zero.l_q,
        "motor_model_l_dq_valid": True,
        "current_control_bandwidth": options.rate,  # rad/s
    }
    tree = {f"axis0.config.motor.{name}": value for name, value in motor.items()}
    return (json.dumps(tree, indent=1) + "\n").encode()
