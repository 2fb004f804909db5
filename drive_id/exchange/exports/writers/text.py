"""Text: CSV with one row for each point, and tables for ``Modelica.Blocks.Tables.CombiTable2Ds``."""

from __future__ import annotations

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable

_UNITS = "i A, psi and sigma Wb, torque Nm, L H, inside 1 where there are data"


def write_csv(table: MapTable, _: ExportOptions) -> bytes:
    """Write comments with the machine's data, headings, and rows with i_q running fastest."""
    lines = [f"# {name}: {value}" for name, value in (table.facts() | {"units": _UNITS}).items()]
    columns = {"i_d": table.grid[0], "i_q": table.grid[1]}
    columns |= {name: values for name, (values, _, _) in table.quantities.items()}
    columns["inside"] = table.inside.astype(np.float64)
    lines.append(",".join(columns))
    rows = np.stack([values.ravel() for values in columns.values()], axis=-1)
    lines += [",".join(f"{value:.12g}" for value in row) for row in rows.tolist()]
    return ("\n".join(lines) + "\n").encode()


def write_modelica(table: MapTable, _: ExportOptions) -> bytes:
    """Write one matrix for each quantity: u1 = i_d in the first column, u2 = i_q in the first row."""
    tables = {name: values for name, (values, _, _) in table.quantities.items() if not name.startswith("sigma")}
    tables["inside"] = table.inside.astype(np.float64)
    lines = ["#1", "# u1: i_d, A; u2: i_q, A; psi Wb, torque Nm, L H; peak values, d on the magnet axis"]
    for name, values in tables.items():
        rows = np.block([[np.zeros((1, 1)), table.i_q[None, :]], [table.i_d[:, None], values]])
        lines += ["", f"double {name}({rows.shape[0]},{rows.shape[1]})"]
        lines += [" ".join(f"{value:.10g}" for value in row) for row in rows.tolist()]
    return ("\n".join(lines) + "\n").encode("ascii")
