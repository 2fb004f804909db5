"""The length and rate of a file of columns are told before anything is fitted."""

from __future__ import annotations

import numpy as np
import pytest

from drive_id.files.read.info import bag_info
from drive_id.inspection.spans import with_spans
from drive_id.reporting.tables import info_table


def described(path, header, rows):
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return with_spans(bag_info(path))


def test_the_time_column_tells_length_and_rate(tmp_path):
    time = 3.0 + np.arange(70_001) * 1e-4  # more rows than are read at once
    found = described(tmp_path / "log.csv", "i_a,t_ms", np.column_stack([np.sin(time), 1e3 * time]))
    assert [topic.count for topic in found.topics] == [70_001, 70_001]
    assert found.duration == pytest.approx(7.0)
    assert info_table(found).title.endswith("70001 rows in 7 s: 10000 Hz")


def test_without_a_time_column_the_rows_are_counted(tmp_path):
    found = described(tmp_path / "log.csv", "a,b", np.ones((5, 2)))
    assert (found.messages, found.duration, found.complete) == (5, 0.0, True)


def test_a_torn_last_row_is_no_time(tmp_path):
    good = "".join(f"{k}e-4,1\n" for k in range(70_000))
    (tmp_path / "log.csv").write_text(f"t,a\n{good}what,3,4\n", encoding="utf-8")
    found = with_spans(bag_info(tmp_path / "log.csv"))
    assert (found.messages, found.duration) == (70_001, pytest.approx(6.9999))
