"""A C99 header for the controller: flux linkages, gains, drop and temperature, and functions that read the tables."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from string import Template

import numpy as np

from drive_id.common.temperature import COPPER, REFERENCE_TEMPERATURE
from drive_id.core.maps.flux_map import FluxMap
from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.current_control import CurrentControl, designed
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import BoolArray, FloatArray, IntArray

_TEMPLATE = Path(__file__).with_name("flux_map.h")
_PER_LINE = 8  # numbers of a table
_DROP_POINTS = 129  # at most, of the table of the drop
_DROP_ERROR = 5e-4  # largest of this table, relative to the largest drop
_BYTES = 20  # of the mask in a line
_WIDTH = 117  # of comments
_PLL = 0.2
"""Bandwidth of the observer of the angle relative to that of the current controllers, which it must not follow."""
_Q15 = 2**15 - 1  # largest number of 16 bits with a sign
_SIZE = "[DRIVE_ID_ND * DRIVE_ID_NQ]"


def write(table: MapTable, options: ExportOptions) -> bytes:
    """Write one self-contained header, which needs ``math.h`` and ``stdint.h`` only.

    Numbers that need the resistance or the DC-link voltage are left out where it is unknown.
    """
    control = designed(table, options)
    table.remarks.extend([*control.remarks, control.table.coarse])
    return header(control, options, *_thinned(table.machine.inverter_current, table.machine.inverter_voltage))


def header(control: CurrentControl, options: ExportOptions, current: FloatArray, voltage: FloatArray) -> bytes:
    """Write a header with the inverter's drop at these phase currents, A, and voltages, V, (C,)."""
    table, bandwidth = control.table, control.bandwidth
    machine, found, inductances = table.machine, table.result, control.inductances
    slope = (found.drive.magnet_coefficient or (0.0, 0.0))[0]
    held = REFERENCE_TEMPERATURE if found.provenance.temperature is None else found.provenance.temperature
    assumed = "" if found.provenance.temperature is not None else ", assumed: no temperature was recorded"
    constants = {
        "RESISTANCE": (machine.resistance, "ohm"),
        "RESISTANCE_CELSIUS": (held, f"degrees Celsius{assumed}"),
        "COPPER": (COPPER, "1/K"),
        "MAGNET_SLOPE": (float(slope), "Wb/K" if slope else "Wb/K: none was identified"),
        "MAGNET_CELSIUS": (
            REFERENCE_TEMPERATURE,
            f"degrees Celsius{'' if slope else ', of no effect without a slope'}",
        ),
        "POLE_PAIRS": (machine.pole_pairs, "1"),
        "I_MAX": (machine.i_max, "A, largest current amplitude"),
        "CELL": (machine.cell, "A, largest diagonal of a cell of the map: what is known nearer than that to I_MAX"),
        "U_DC": (machine.u_dc, "V"),
        "BANDWIDTH": (bandwidth, "rad/s, of the current controllers"),
        "KI": (bandwidth * machine.resistance, "V/(A s)"),
        "PLL_KP": (2 * _PLL * bandwidth, "1/s"),  # critically damped
        "PLL_KI": ((_PLL * bandwidth) ** 2, "1/s^2"),
    }
    lines = [
        f"#define DRIVE_ID_{name} {_real(value)} /* {unit} */"
        for name, (value, unit) in constants.items()
        if value is not None and math.isfinite(value)
    ]
    known_d, known_q, known = _known(machine.flux_map)
    sizes = {"ND": len(table.i_d), "NQ": len(table.i_q), "NC": len(current), "KD": len(known_d), "KQ": len(known_q)}
    lines += [*(f"#define DRIVE_ID_{name} {size}" for name, size in sizes.items()), ""]
    lines += _array("drive_id_i_d", "[DRIVE_ID_ND]", table.i_d[None, :], "A")
    lines += _array("drive_id_i_q", "[DRIVE_ID_NQ]", table.i_q[None, :], "A")
    lines += _array("drive_id_drop_current", "[DRIVE_ID_NC]", current[None, :], "A, of a phase")
    lines += _array("drive_id_drop_voltage", "[DRIVE_ID_NC]", voltage[None, :], "V")
    maps = {"psi_d": (table.psi[0], "Wb"), "psi_q": (table.psi[1], "Wb")}
    maps |= {"l_dd": (inductances["d"], "H"), "l_qq": (inductances["q"], "H")}
    for name, (values, unit) in maps.items():
        lines += _array(f"drive_id_{name}_table", _SIZE, values, f"{unit}, row-major [i_d][i_q]")
    lines += _array("drive_id_known_d", "[DRIVE_ID_KD]", known_d[None, :], "A")
    lines += _array("drive_id_known_q", "[DRIVE_ID_KQ]", known_q[None, :], "A")
    bits = np.packbits(known.ravel(), bitorder="little").tolist()
    lines += ["/* one bit for each cell of these, row-major: whether it has data */"]
    lines += [f"static const unsigned char drive_id_known_bits[{len(bits)}] = {{"]
    lines += [" " + ",".join(map(str, bits[k : k + _BYTES])) + "," for k in range(0, len(bits), _BYTES)]
    lines += ["};", "", *(_per_unit(table, inductances, bandwidth, options) if machine.u_dc else ())]
    template = Template(_TEMPLATE.read_text(encoding="ascii"))
    name, texts = _comment(table.result.machine or "unknown"), (table.source, *control.remarks)
    source = "\n * ".join(textwrap.wrap(_comment(" ".join(texts)), _WIDTH))
    return template.substitute(name=name, source=source, content="\n".join(lines)).encode("ascii")


def _known(found: FluxMap) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the cells (K, L) with data at all corners, and their edges (K + 1,), (L + 1,), A; equal rows are one."""
    cells = found.inside[1:, 1:] & found.inside[1:, :-1] & found.inside[:-1, 1:] & found.inside[:-1, :-1]
    first = [np.append(True, (np.diff(cells, axis=axis) != 0).any(axis=1 - axis)) for axis in (0, 1)]
    i_d, i_q = (np.append(axis[:-1][own], axis[-1]) for axis, own in zip((found.i_d, found.i_q), first, strict=True))
    return i_d, i_q, cells[np.ix_(*first)]


def _thinned(current: FloatArray, voltage: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return of phase currents, A, and the identified drop, V, (C,), as few points as straight lines need."""
    kept = [0, len(current) - 1]
    enough = _DROP_ERROR * float(np.abs(voltage).max())
    while len(kept) < min(_DROP_POINTS, len(current)):
        off = np.abs(np.interp(current, current[kept], voltage[kept]) - voltage)
        if off.max() <= enough:
            break
        kept = sorted([*kept, int(off.argmax())])
    return current[kept], voltage[kept]


def _per_unit(
    table: MapTable, inductances: dict[str, FloatArray], bandwidth: float, options: ExportOptions
) -> list[str]:
    """Return the gains per unit in fixed point: kp over the current, and ki times the sample period."""
    u_base, i_base = table.machine.known_u_dc() / math.sqrt(3), table.machine.i_max
    lines = [
        f"#define DRIVE_ID_U_BASE {_real(u_base)} /* V, u_dc / sqrt(3) */",
        f"#define DRIVE_ID_I_BASE {_real(i_base)} /* A, i_max */",
    ]
    scale, resistance = bandwidth * i_base / u_base, table.machine.resistance
    for axis, inductance in inductances.items():
        numbers, shift = _q15(scale * inductance)
        lines.append(f"#define DRIVE_ID_KP_{axis.upper()}_SHIFT {shift} /* value = number * 2^-shift, per unit */")
        lines.append(f"static const int16_t drive_id_kp_{axis}_q15{_SIZE} = {{")
        lines += [" " + ",".join(map(str, row)) + "," for row in numbers.tolist()] + ["};"]
    if options.sample_period is not None and resistance > 0:
        number, shift = _q15(np.array([scale * resistance * options.sample_period]))
        lines.append(f"#define DRIVE_ID_KI_T_Q15 {number[0]} /* ki times sample period, per unit */")
        lines.append(f"#define DRIVE_ID_KI_T_SHIFT {shift}")
    return lines


def _q15(values: FloatArray) -> tuple[IntArray, int]:
    """Return values as int16 numbers, and the shift: ``value = number * 2^-shift``, the largest in 15 bits."""
    largest = float(np.abs(values).max(initial=0.0))
    if not (largest > 0 and math.isfinite(largest)):
        raise ConfigurationError("The gains are zero or not finite: check resistance and map.")
    shift = math.floor(math.log2(_Q15 / largest))
    return np.rint(values * 2.0**shift).astype(np.int64), shift


def _comment(text: str) -> str:
    """Return text that cannot end a comment."""
    plain = "".join(character if " " <= character <= "~" else "?" for character in text)
    return plain.replace("*/", "* /").replace("??", "? ?")


def _real(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return f"((drive_id_real){value!r})"


def _array(name: str, size: str, rows: FloatArray, unit: str) -> list[str]:
    lines = [f"/* {unit} */", f"static const drive_id_real {name}{size} = {{"]
    for row in rows:
        words = [_literal(value) for value in row.tolist()]
        lines += [" " + ",".join(words[k : k + _PER_LINE]) + "," for k in range(0, len(words), _PER_LINE)]
    return [*lines, "};", ""]


def _literal(value: float) -> str:
    """Return a constant that is exact in single precision: suffixed, so that no conversion is needed."""
    text = f"{value:.9g}"
    return f"DRIVE_ID_C({text if any(mark in text for mark in '.e') else text + '.0'})"
