"""Compiling, or loading from the disk, all that live samples need, before they arrive.

What only a fit needs is loaded by the first one, in a thread: it would double the memory of a node at rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drive_id.core import frames
from drive_id.core.fit_settings import FitSettings
from drive_id.core.signals.signal import Signal
from drive_id.live.identification.live_evidence import LiveEvidence

_COUNT = 2000  # samples: two seconds of them
_PERIOD = 1e-3  # s
_SPEED = 60.0  # rad/s
_INDUCTANCE = 0.01  # H
_MAGNET = 0.1  # Wb


def warm_up(settings: FitSettings) -> None:
    """Take in two seconds of a linear machine, as live samples are."""
    t = _PERIOD * np.arange(_COUNT, dtype=np.float64)
    i_d = np.cos(2 * np.pi * 1.1 * t) * np.sin(2 * np.pi * 3.7 * t)
    i_dq = np.stack([i_d, np.sin(2 * np.pi * 1.1 * t)], axis=-1)
    psi = _INDUCTANCE * i_dq + np.array([_MAGNET, 0.0])
    angle = _SPEED * t
    psi_s = (psi[:, 0] + 1j * psi[:, 1]) * np.exp(1j * angle)
    u_s = np.gradient(psi_s, _PERIOD)
    u_abc = frames.phases(u_s)
    stamp = np.rint(t * 1e9).astype(np.int64)
    position = np.stack([np.angle(np.exp(1j * angle)), np.full(_COUNT, _SPEED)], axis=-1)
    live = LiveEvidence(replace(settings, splines_d=8, splines_q=8, grid_points=33, i_max=1.0))
    for section, values in enumerate((frames.to_abc(i_dq, angle), u_abc, position)):
        rows = np.ascontiguousarray(values)  # as messages are decoded: kernels are compiled for each memory layout
        live.add(section, Signal(f"warm-up {section}", stamp, rows, _PERIOD, np.zeros(1, np.int64)))
    snapshot = live.snapshot()
    for piece in snapshot.rest:
        snapshot.gathered.add(piece)
    evidence = snapshot.gathered.evidence
    evidence.coverage()
    if evidence.windows is not None:
        evidence.windows.finished()
