"""Tables for ``Modelica.Blocks.Tables.CombiTable2Ds``, as text."""

from __future__ import annotations

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.types import FloatArray


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write one matrix for each quantity: u1 = i_d in the first column, u2 = i_q in the first row."""
    tables = {name: values for name, (values, _, _) in table.quantities.items() if not name.startswith("sigma")}
    tables["inside"] = table.inside.astype(np.float64)
    lines = ["#1", "# u1: i_d, A; u2: i_q, A; psi Wb, torque Nm, L H; peak values, d on the magnet axis"]
    for name, values in tables.items():
        lines += _matrix(name, table, values)
    return ("\n".join(lines) + "\n").encode("ascii")


def _matrix(name: str, table: MapTable, values: FloatArray) -> list[str]:
    rows = np.block([[np.zeros((1, 1)), table.i_q[None, :]], [table.i_d[:, None], values]])
    text = [" ".join(f"{value:.10g}" for value in row) for row in rows.tolist()]
    return ["", f"double {name}({rows.shape[0]},{rows.shape[1]})", *text]
