"""Tables and picture of a log that was looked at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.markup import escape
from rich.table import Table

from drive_id.inspection.contents import Contents
from drive_id.inspection.inspect import Inspection

_MOST_FIELDS = 60


def inspection_tables(found: Inspection) -> Iterator[Table]:
    """Yield the contents, and the overview if there is one."""
    yield contents_table(found.contents)
    if found.overview is None:
        return
    view = found.overview
    table = Table(title="Joined samples", title_justify="left")
    table.add_column("Quantity")
    table.add_column("Value")
    low, mean, high = view.speed * 30 / np.pi
    (d_low, q_low), (d_high, q_high) = view.i_dq_range.tolist()
    table.add_row("Samples", f"{view.samples} every {view.sample_period * 1e6:.6g} us, {view.duration:.4g} s")
    table.add_row("Gaps", f"{view.runs - 1}, {view.time_lost:.4g} s in total")
    table.add_row("Electrical speed", f"{low:.5g} to {high:.5g} rpm, mean {mean:.5g} rpm")
    table.add_row("Turn per sample", f"{np.rad2deg(view.turn):.3g} degrees electrical")
    table.add_row("i_d", f"{d_low:.4g} to {d_high:.4g} A")
    table.add_row("i_q", f"{q_low:.4g} to {q_high:.4g} A")
    table.add_row("Disc", f"{view.i_max:.4g} A, {100 * view.coverage:.0f} % visited")
    yield table


def contents_table(contents: Contents) -> Table:
    """List topics or groups, and their fields."""
    table = Table(title=escape(f"{contents.path}: {contents.kind}"), title_justify="left")
    for name in ("Topic" if contents.is_bag else "Group", "Field", "Type"):
        table.add_column(name, overflow="fold")
    for name in ("Rows", "Rate, Hz", "Least", "Largest"):
        table.add_column(name, justify="right", no_wrap=True)
    for entry in contents.tables:
        rate = f"{1 / entry.period:.6g}" if entry.period else ""
        rows = "?" if entry.rows is None else str(entry.rows)
        table.add_row(escape(entry.name), escape(entry.problem), escape(entry.kind), rows, rate, "", "")
        for name, x in list(entry.columns.items())[:_MOST_FIELDS]:
            known = x[np.isfinite(x)]
            ends = (f"{known.min():.6g}", f"{known.max():.6g}") if len(known) else ("", "")
            table.add_row("", escape(name), escape(entry.types.get(name, "")), "", "", *ends)
    return table
