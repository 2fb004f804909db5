"""Parameters of small motor controllers: single numbers, taken at zero current."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET

from drive_id.exchange.exports.current_control import TOLERANCE
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable

_DAMPING = 0.7
"""Of the closed loop at least: its current then overshoots by 5 % without the zero of the controller."""


def write_vesc(table: MapTable, options: ExportOptions) -> bytes:
    """Write the entries of VESC Tool's motor configuration that the map tells, with gains for the bandwidth.

    One gain serves both axes and all currents, see :func:`_gains`.
    """
    (kp, ki), resistance, at_zero = _gains(table, options), table.known_resistance(), table.at_zero
    values = {
        "foc_motor_r": resistance,
        "foc_motor_l": (at_zero.l_d + at_zero.l_q) / 2,
        "foc_motor_ld_lq_diff": at_zero.l_q - at_zero.l_d,
        "foc_motor_flux_linkage": at_zero.magnet,
        "foc_current_kp": kp,
        "foc_current_ki": ki,
    }
    root = ET.Element("MCConfiguration")
    for name, value in values.items():
        ET.SubElement(root, name).text = f"{value:.9g}"
    root.insert(0, ET.Comment(f" {table.source} {' '.join(table.remarks)} ".replace("--", "- -")))
    ET.indent(root)
    return b"<?xml version='1.0' encoding='utf-8'?>\n" + ET.tostring(root, encoding="unicode").encode() + b"\n"


def write_odrive(table: MapTable, options: ExportOptions) -> bytes:
    """Write what ``odrivetool restore-config`` reads; the torque constant is 3/2 p psi_m.

    ODrive computes ``kp = bandwidth L`` and ``ki = bandwidth R``, so these two follow from the gains of :func:`_gains`.
    """
    at_zero, pairs, resistance = table.at_zero, table.machine.known_pole_pairs(), table.known_resistance()
    kp, ki = _gains(table, options)
    rate = ki / resistance if resistance > 0 else options.rate
    motor = {
        "phase_resistance": resistance,
        "phase_inductance": kp / rate,
        "pole_pairs": pairs,
        "torque_constant": 1.5 * pairs * at_zero.magnet,
        "ff_pm_flux_linkage": at_zero.magnet,
        "ff_pm_flux_linkage_valid": True,
        "motor_model_l_d": at_zero.l_d,
        "motor_model_l_q": at_zero.l_q,
        "motor_model_l_dq_valid": True,
        "current_control_bandwidth": rate,  # rad/s
    }
    tree = {f"axis0.config.motor.{name}": value for name, value in motor.items()}
    return (json.dumps(tree, indent=1) + "\n").encode()


def _gains(table: MapTable, options: ExportOptions) -> tuple[float, float]:
    """Return kp, V/A, and ki, V/(A s), of one controller for both axes and all currents; say what they rest on.

    kp follows from the smallest incremental inductance, so that no loop is faster than the bandwidth. The damping
    ``(R + kp) / (2 sqrt(ki L))`` is least with the largest one; where it is too small, ki is lowered.
    """
    resistance, (least, most) = table.known_resistance(), table.machine.inductance_range
    kp, largest = least * options.rate, (1 + TOLERANCE) * most
    ki = min(resistance * options.rate, ((resistance + kp) / (2 * _DAMPING)) ** 2 / largest)
    damping = (resistance + kp) / (2 * math.sqrt(ki * largest)) if ki > 0 else math.inf
    how = " of the nearest monotone map (the map itself is not monotone)" if table.fold else ""
    lowered = "" if ki == resistance * options.rate else f", for which the integral gain is {ki:.3g} V/(A s)"
    table.remarks.append(
        f"The bandwidth is {options.bandwidth:.4g} Hz. The gains rest on the smallest incremental inductance within "
        f"i_max{how}, {least * 1e3:.3g} mH, so that no axis is faster than the bandwidth (at zero current: L_d "
        f"{table.at_zero.l_d * 1e3:.3g} mH, L_q {table.at_zero.l_q * 1e3:.3g} mH). The damping is at least "
        f"{damping:.2g}, where the inductance is {100 * TOLERANCE:.0f} % more than its largest, "
        f"{most * 1e3:.3g} mH{lowered}."
    )
    return kp, ki
