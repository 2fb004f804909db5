"""Rows and length of a file of columns, from its time columns alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from drive_id.errors import DriveIdError
from drive_id.files.logs.column_log import OWN_TIME, Column, ColumnLog
from drive_id.files.logs.open_log import open_log
from drive_id.files.read.info import BagInfo
from drive_id.inspection.clock import TimeColumn, time_column
from drive_id.inspection.contents import Table, read_contents


def with_spans(info: BagInfo) -> BagInfo:
    """Return the description of a file of columns with its rows and its longest time, as far as it can be read."""
    path, topics, longest, problems = Path(info.path), list(info.topics), 0.0, []
    start = 0
    with open_log(path) as log:
        for table in read_contents(path).tables:
            columns = slice(start, start := start + len(table.types))
            if not table.columns and table.stamp_source != "own":
                continue  # no numbers to count
            try:
                rows, seconds = _span(log, table)
            except DriveIdError as error:
                problems.append(str(error))
                continue
            topics[columns] = [replace(topic, count=rows) for topic in topics[columns]]
            longest = max(longest, seconds)
    return replace(
        info, topics=tuple(topics), messages=max((topic.count or 0 for topic in topics), default=0), duration=longest,
        complete=not problems, problem="; ".join(problems),
    )  # fmt: skip


def _span(log: ColumnLog, table: Table) -> tuple[int, float]:
    """Return the rows of a group of columns, and the time between the first and the last; 0 where none is known."""
    found = TimeColumn(OWN_TIME, "ns") if table.stamp_source == "own" else time_column(table)
    column, rows = Column(table.name, found.name if found else next(iter(table.columns), "")), 0
    ends: list[float] = []
    for part in log.parts([column]):
        values = part.values[column]
        rows += len(values)
        if found:
            known = values[np.isfinite(values)]
            ends += [float(x) for x in (*known[:1], *known[-1:])]
            del ends[1:-1]
    return rows, (ends[-1] - ends[0] if ends else 0.0) * (found.tick if found else 0.0) * 1e-9
