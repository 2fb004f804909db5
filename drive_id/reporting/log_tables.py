"""Tables of a log that was looked at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.markup import escape
from rich.table import Table

from drive_id.inspection.clock import timed
from drive_id.inspection.contents import Contents
from drive_id.inspection.inspect import Inspection
from drive_id.reporting.tables import plain_table

_MOST_FIELDS = 60  # of a topic that are listed


def inspection_tables(found: Inspection) -> Iterator[Table]:
    """Yield the contents, and the overview if there is one."""
    yield from contents_tables(found.contents)
    if found.overview is None:
        return
    seen = found.overview.figures
    table = plain_table("Joined samples", ["Quantity", "Value"])
    low, mean, high = (seen[name] * 30 / np.pi for name in ("speed_min", "speed_mean", "speed_max"))
    every = f"{seen['sample_period'] * 1e6:.6g} µs"
    table.add_row("Samples", f"{seen['samples']} every {every}, {seen['duration']:.4g} s")
    table.add_row("Gaps", f"{seen['runs'] - 1}, {seen['time_lost']:.4g} s in total")
    table.add_row("Electrical speed", f"{low:.5g} to {high:.5g} rpm, mean {mean:.5g} rpm")
    table.add_row("Turn per sample", f"{np.rad2deg(seen['turn_per_sample']):.3g}° electrical")
    table.add_row("i_d", f"{seen['i_d_min']:.4g} to {seen['i_d_max']:.4g} A")
    table.add_row("i_q", f"{seen['i_q_min']:.4g} to {seen['i_q_max']:.4g} A")
    table.add_row("Disc", f"{seen['i_max']:.4g} A, {100 * seen['coverage']:.0f} % visited")
    yield table


def contents_tables(contents: Contents) -> Iterator[Table]:
    """Yield topics or groups with their rates, and the range of their fields."""
    title, group = f"{contents.path}: {contents.kind}", "Topic" if contents.is_bag else "Group"
    blocks = any(entry.block > 1 for entry in contents.tables)
    numbers = ["Messages" if contents.is_bag else "Rows", "Hz", *(["Samples/s"] if blocks else [])]
    groups = plain_table(title, [group, "Type"], numbers)
    fields = plain_table("Fields", ["Field"], ["Least", "Largest"])
    for table in contents.tables:
        entry = timed(table, contents)
        rate, samples = (f"{1 / (entry.period * n):.6g}" if entry.period else "" for n in (entry.block, 1))
        rows = "?" if entry.rows is None else str(entry.rows)
        kind = ": ".join(filter(None, (entry.kind, entry.problem)))
        groups.add_row(escape(entry.name), escape(kind), rows, rate, *([samples] if blocks else []))
        fields.add_row(f"[bold]{escape(entry.name)}[/bold]" if entry.name else "", "", "")
        for name, x in list(entry.columns.items())[:_MOST_FIELDS]:
            known = x[np.isfinite(x)]
            ends = (f"{known.min():.6g}", f"{known.max():.6g}") if len(known) else ("", "")
            fields.add_row(f"  {escape(name)}", *ends)
    yield groups
    yield fields
