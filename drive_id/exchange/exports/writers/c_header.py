"""A C99 header: tables of psi_d and psi_q, and functions that interpolate them."""

from __future__ import annotations

import math
from pathlib import Path
from string import Template

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import FloatArray

_TEMPLATE = Path(__file__).with_name("flux_map.h")
_PER_LINE = 8


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write one self-contained header, which needs ``math.h`` only."""
    machine = table.machine
    constants = {
        "DRIVE_ID_RESISTANCE": (machine.resistance if np.isfinite(machine.resistance) else None, "ohm"),
        "DRIVE_ID_POLE_PAIRS": (machine.pole_pairs, "1"),
        "DRIVE_ID_I_MAX": (machine.i_max, "A, largest current amplitude"),
        "DRIVE_ID_U_DC": (machine.u_dc, "V"),
    }
    lines = [f"#define {name} {_real(value)} /* {unit} */" for name, (value, unit) in constants.items() if value]
    lines += [f"#define DRIVE_ID_ND {len(table.i_d)}", f"#define DRIVE_ID_NQ {len(table.i_q)}", ""]
    lines += _array("drive_id_i_d", "[DRIVE_ID_ND]", table.i_d[None, :], "A")
    lines += _array("drive_id_i_q", "[DRIVE_ID_NQ]", table.i_q[None, :], "A")
    note = "Wb, row-major [i_d][i_q]"
    lines += _array("drive_id_psi_d_table", "[DRIVE_ID_ND * DRIVE_ID_NQ]", table.psi[0], note)
    lines += _array("drive_id_psi_q_table", "[DRIVE_ID_ND * DRIVE_ID_NQ]", table.psi[1], note)
    lines += [
        "/* 1 where there are data */",
        "static const unsigned char drive_id_inside_table[DRIVE_ID_ND * DRIVE_ID_NQ] = {",
    ]
    lines += [" " + ",".join("1" if known else "0" for known in row) + "," for row in table.inside.tolist()]
    template = Template(_TEMPLATE.read_text(encoding="ascii"))
    name, source = _comment(table.result.machine or "unknown"), _comment(table.source)
    return template.substitute(name=name, source=source, content="\n".join([*lines, "};"])).encode("ascii")


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
