"""Check what stands still where it must not: repeated samples, held currents, and an inverter that has tripped."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.types import Samples

_TURNING = 1e-3  # rad per sample, above which no current repeats by itself
_LEAST_REPEATED = 2e-3
"""Share of samples that repeat the currents of the one before, from which on it is told."""
_HELD = 0.2
"""The same from which on the currents are held, and a fit is refused: every sample of some is no measurement."""
_SAME_ROWS = 0.8
"""Share of repeated currents whose voltages repeat as well, from which on whole rows do."""
_STEPS = 5.0
"""Median step of a current that moves by its least step, below which a coarse converter explains that it repeats.
A current of no more is none."""
_OFF = 0.02
"""Current by i_max below which the inverter may be off."""
_OFF_SAMPLES, _OFF_TIME, _OFF_TURN = 50, 0.02, 0.5
"""Least samples in a row, s, and rad that the rotor turns meanwhile.

A swinging shaft has currents near zero for 8 ms, in which the inverter takes the voltage.
"""
_ADJACENT = 1.5
"""Sample periods between runs up to which one continues the other."""
_NOT_INDUCED = 0.2
"""Deviation of the voltage in d and q meanwhile, by the rms voltage, from that of a magnet, which follows the speed."""


def repeat_findings(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield repeated currents and parts without current whose voltages no machine has, by excerpts of one run each."""
    yield from _repeated(runs)
    yield from _tripped(runs, i_max)


def _repeated(runs: Sequence[Samples]) -> Iterator[Message]:
    """Yield currents that are those of the sample before though the rotor turns."""
    steps = np.concatenate([np.abs(np.diff(run.i_abc, axis=0)) for run in runs])
    turning = np.concatenate([np.abs(run.speed[1:]) * run.sample_period > _TURNING for run in runs])
    least = steps[steps > 0].min(initial=np.inf)  # a drive at rest reads a few steps of its converter, and repeats them
    flowing = np.concatenate([np.abs(run.i_abc[1:]).max(axis=1) > _STEPS * least for run in runs])
    voltages = np.concatenate([np.all(np.diff(run.u_abc, axis=0) == 0, axis=1) for run in runs])
    at = np.concatenate([run.stamp[1:] for run in runs])
    told = turning & flowing
    repeated = told & np.all(steps == 0, axis=1)
    moving = steps[told & ~repeated]
    share = float(repeated.sum() / max(told.sum(), 1))
    if share < _LEAST_REPEATED or not len(moving):
        return
    if np.median(moving.max(axis=1)) < _STEPS * moving[moving > 0].min():
        return
    values = {"share": share, "time": float(at[repeated][0] - runs[0].stamp[0]) * 1e-9}
    rows = float(np.mean(voltages[repeated])) > _SAME_ROWS
    if share > _HELD:
        yield Message("held_currents", every=1 / (1 - share), rows=rows, **values)
    else:
        yield Message("repeated_rows", rows=rows, **values)


def _tripped(runs: Sequence[Samples], i_max: float) -> Iterator[Message]:
    """Yield the first part without current in which the voltages are not those that a magnet induces."""
    u_rms = float(np.sqrt(np.mean(np.concatenate([np.abs(frames.space_vector(run.u_abc)) ** 2 for run in runs]))))
    for part in _without_current(runs, _OFF * i_max):
        u = np.concatenate([frames.space_vector(piece.u_abc) * np.exp(-1j * piece.angle) for piece in part])
        speed = np.concatenate([piece.speed for piece in part])
        turned = float(np.abs(speed).sum() * part[0].sample_period)
        if len(u) < max(_OFF_SAMPLES, _OFF_TIME / part[0].sample_period) or turned < _OFF_TURN:
            continue
        none, induced = not u.any(), speed * (speed @ u) / (speed @ speed)
        if none or float(np.sqrt(np.mean(np.abs(u - induced) ** 2))) > _NOT_INDUCED * u_rms:
            at, end = (float(stamp - runs[0].stamp[0]) * 1e-9 for stamp in (part[0].stamp[0], part[-1].stamp[-1]))
            yield Message("inverter_tripped.idle" if none else "inverter_tripped", time=at, end=end)
            return


def _without_current(runs: Sequence[Samples], least: float) -> Iterator[list[Samples]]:
    """Yield the parts with less current than that, A; those that continue over several runs as one."""
    part: list[Samples] = []
    for run in runs:
        marked = np.abs(frames.space_vector(run.i_abc)) < least
        edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]])))
        for start, stop in edges.reshape(-1, 2).tolist():
            if part and (start or run.stamp[0] - part[-1].stamp[-1] > _ADJACENT * run.sample_period * 1e9):
                yield part
                part = []
            part.append(run.part(start, stop))
    if part:
        yield part
