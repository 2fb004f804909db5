"""CSV: one row for each point, with standard errors, torque and incremental inductances."""

from __future__ import annotations

import numpy as np

from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable

_UNITS = "i A, psi and sigma Wb, torque Nm, L H, inside 1 where there are data"


def write(table: MapTable, options: ExportOptions) -> bytes:  # noqa: ARG001  # a Writer
    """Write comments with the machine's data, headings, and rows with i_q running fastest."""
    lines = [f"# {name}: {value}" for name, value in (table.facts() | {"units": _UNITS}).items()]
    columns = {"i_d": table.grid[0], "i_q": table.grid[1]}
    columns |= {name: values for name, (values, _, _) in table.quantities.items()}
    columns["inside"] = table.inside.astype(np.float64)
    lines.append(",".join(columns))
    rows = np.stack([values.ravel() for values in columns.values()], axis=-1)
    lines += [",".join(f"{value:.12g}" for value in row) for row in rows.tolist()]
    return ("\n".join(lines) + "\n").encode()
