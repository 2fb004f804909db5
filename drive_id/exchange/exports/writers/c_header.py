"""A C99 header for the controller: flux linkages, gains, drop and temperature, and functions that read the tables."""

from __future__ import annotations

import math
from pathlib import Path
from string import Template

import numpy as np

from drive_id.exchange.exports.gains import ControlGains, q15
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.temperature import COPPER, REFERENCE_TEMPERATURE
from drive_id.types import FloatArray

_TEMPLATE = Path(__file__).with_name("flux_map.h")
_PER_LINE = 8
_DROP_POINTS, _DROP_ERROR = 129, 5e-4
"""Most points of the drop's table, and its largest error relative to the largest drop."""
_SIZE = "[DRIVE_ID_ND * DRIVE_ID_NQ]"


def write(table: MapTable, options: ExportOptions) -> bytes:
    """Write one self-contained header, which needs ``math.h`` and ``stdint.h`` only.

    Numbers that need the resistance or the DC-link voltage are left out where it is unknown.
    """
    return with_drop(table, options, *_thinned(table.machine.inverter_current, table.machine.inverter_voltage))


def with_drop(table: MapTable, options: ExportOptions, current: FloatArray, voltage: FloatArray) -> bytes:
    """Write the header of :func:`write` with the inverter's drop at these phase currents, A, and voltages, V, (C,)."""
    machine, gains, found = table.machine, ControlGains.of(table, options), table.result
    slope = (found.drive.magnet_coefficient or (0.0, 0.0))[0]
    held = REFERENCE_TEMPERATURE if found.provenance.temperature is None else found.provenance.temperature
    assumed = "" if found.provenance.temperature is not None else ", assumed: no temperature was recorded"
    margin = f"leaves a phase margin of {math.degrees(gains.phase_margin):.3g} degrees at {gains.delay:.4g} s of delay"
    limited = "no delay is considered" if math.isnan(gains.delay) else margin
    constants = {
        "RESISTANCE": (gains.resistance, "ohm"),
        "RESISTANCE_CELSIUS": (held, f"degrees Celsius{assumed}"),
        "COPPER": (COPPER, "1/K"),
        "MAGNET_SLOPE": (float(slope), "Wb/K" if slope else "Wb/K: none was identified"),
        "MAGNET_CELSIUS": (REFERENCE_TEMPERATURE, "degrees Celsius"),
        "POLE_PAIRS": (machine.pole_pairs, "1"),
        "I_MAX": (machine.i_max, "A, largest current amplitude"),
        "U_DC": (machine.u_dc, "V"),
        "BANDWIDTH": (gains.bandwidth, f"rad/s, of the current controllers; {limited}"),
        "KI": (gains.bandwidth * gains.resistance, "V/(A s)"),
        "PLL_KP": (gains.pll[0], "1/s"),
        "PLL_KI": (gains.pll[1], "1/s^2"),
    }
    lines = [
        f"#define DRIVE_ID_{name} {_real(value)} /* {unit} */"
        for name, (value, unit) in constants.items()
        if value is not None and math.isfinite(value)
    ]
    sizes = {"ND": len(table.i_d), "NQ": len(table.i_q), "NC": len(current)}
    lines += [*(f"#define DRIVE_ID_{name} {size}" for name, size in sizes.items()), ""]
    lines += _array("drive_id_i_d", "[DRIVE_ID_ND]", table.i_d[None, :], "A")
    lines += _array("drive_id_i_q", "[DRIVE_ID_NQ]", table.i_q[None, :], "A")
    lines += _array("drive_id_drop_current", "[DRIVE_ID_NC]", current[None, :], "A, of a phase")
    lines += _array("drive_id_drop_voltage", "[DRIVE_ID_NC]", voltage[None, :], "V")
    maps = {"psi_d": (table.psi[0], "Wb"), "psi_q": (table.psi[1], "Wb")}
    maps |= {"l_dd": (gains.l_dd, "H"), "l_qq": (gains.l_qq, "H")}
    for name, (values, unit) in maps.items():
        lines += _array(f"drive_id_{name}_table", _SIZE, values, f"{unit}, row-major [i_d][i_q]")
    lines += ["/* 1 where there are data */", f"static const unsigned char drive_id_inside_table{_SIZE} = {{"]
    lines += [" " + ",".join("1" if known else "0" for known in row) + "," for row in table.inside.tolist()]
    lines += ["};", "", *(_per_unit(table, gains, options) if machine.u_dc else ())]
    template = Template(_TEMPLATE.read_text(encoding="ascii"))
    name, source = _comment(table.result.machine or "unknown"), _comment(table.source)
    return template.substitute(name=name, source=source, content="\n".join(lines)).encode("ascii")


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


def _per_unit(table: MapTable, gains: ControlGains, options: ExportOptions) -> list[str]:
    """Return the gains per unit in fixed point: kp over the current, and ki times the sample period."""
    u_base, i_base = table.machine.known_u_dc() / math.sqrt(3), table.machine.i_max
    lines = [
        f"#define DRIVE_ID_U_BASE {_real(u_base)} /* V, u_dc / sqrt(3) */",
        f"#define DRIVE_ID_I_BASE {_real(i_base)} /* A, i_max */",
    ]
    scale = gains.bandwidth * i_base / u_base
    for axis, inductance in (("d", gains.l_dd), ("q", gains.l_qq)):
        numbers, shift = q15(scale * inductance)
        lines.append(f"#define DRIVE_ID_KP_{axis.upper()}_SHIFT {shift} /* value = number * 2^-shift, per unit */")
        lines.append(f"static const int16_t drive_id_kp_{axis}_q15{_SIZE} = {{")
        lines += [" " + ",".join(map(str, row)) + "," for row in numbers.tolist()] + ["};"]
    if options.sample_period is not None and gains.resistance > 0:
        number, shift = q15(np.array([scale * gains.resistance * options.sample_period]))
        lines.append(f"#define DRIVE_ID_KI_T_Q15 {number[0]} /* ki times sample period, per unit */")
        lines.append(f"#define DRIVE_ID_KI_T_SHIFT {shift}")
    return lines


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
    if math.isnan(value):
        return "DRIVE_ID_NAN"
    text = f"{value:.9g}"
    return f"DRIVE_ID_C({text if any(mark in text for mark in '.e') else text + '.0'})"
