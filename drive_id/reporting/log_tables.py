"""Tables of a log that was looked at."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.markup import escape
from rich.table import Table

from drive_id.inspection.clock import timed
from drive_id.inspection.contents import ROWS, Contents
from drive_id.inspection.inspect import Inspection
from drive_id.reporting.tables import plain_table

_MOST_FIELDS = 60  # of a topic that are listed


def inspection_tables(found: Inspection) -> Iterator[Table]:
    """Yield the contents, and the overview if there is one."""
    yield from contents_tables(found.contents)
    if rows := found.rows():
        table = plain_table("Joined samples", ["Quantity", "Value"])
        for row in rows:
            table.add_row(*row)
        yield table


def contents_tables(contents: Contents) -> Iterator[Table]:
    """Yield topics or groups with their rates, and the range of their fields."""
    title, group = f"{contents.path}: {contents.kind}", "Topic" if contents.is_bag else "Group"
    blocks = any(entry.block > 1 for entry in contents.tables)
    numbers = ["Messages" if contents.is_bag else "Rows", "Hz", *(["Samples/s"] if blocks else [])]
    groups = plain_table(title, [group, "Type"], numbers)
    fields = plain_table(f"Fields, ranges of at most the first {ROWS} samples", ["Field"], ["Least", "Largest"])
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
