"""A log that must be read as a whole is refused in one sentence if it does not fit into memory."""

from __future__ import annotations

import numpy as np
import pytest
from column_files import write_csv, write_parquet

from drive_id.errors import ConfigurationError
from drive_id.files.messages.signals_file import parse_signals
from drive_id.files.read import memory
from drive_id.files.read.memory import BYTES_PER_SAMPLE, available_memory
from drive_id.files.read.reader import bag_pieces

N = 150_000
SIGNALS = """
defaults: {{stamp: t, stamp_unit: s, sample_period: 1e-4{more}}}
currents: {{fields: [ia, ib, ic]}}
voltages: {{fields: [ua, ub, uc]}}
resolver: {{angle: theta, speed: omega}}
"""


def read(path, more):
    signals = parse_signals(SIGNALS.format(more=more), "test")
    return sum(len(piece.samples) - piece.continues for piece in bag_pieces(path, signals, threads=False))


@pytest.mark.cases
@pytest.mark.parametrize("write", [write_parquet, write_csv])
def test_a_log_larger_than_memory_is_refused(write, tmp_path, monkeypatch):
    theta = np.round(0.02 * np.arange(N), 4)
    phases = {f"{name}{p}": np.round(np.sin(theta - k), 3) for name in "iu" for k, p in enumerate("abc")}
    path = write(tmp_path / "log.csv", {"t": 1e-4 * np.arange(N), **phases, "theta": theta, "omega": 0 * theta + 200.0})
    need = N * BYTES_PER_SAMPLE
    monkeypatch.setattr(memory, "available_memory", lambda: round(0.8 * need))
    with pytest.raises(ConfigurationError, match=r"log.csv must be read as a whole, which takes about 0.07\d* GB"):
        read(path, ", equally_spaced: true")
    assert read(path, "") == N
    monkeypatch.setattr(memory, "available_memory", lambda: round(1.5 * need))
    assert read(path, ", equally_spaced: true") == N


def test_the_memory_of_this_machine():
    found = available_memory()
    assert found is None or 1e7 < found < 1e14
