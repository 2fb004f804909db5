"""One-pass statistics of the samples, gathered before fitting: findings and the range of the map."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence

import numpy as np

from drive_id.common.messages import Message
from drive_id.common.origins import FULL, ORIGINS
from drive_id.core import frames
from drive_id.core.accumulation.evidence import Evidence
from drive_id.core.accumulation.excerpts import Spans
from drive_id.core.checks.readings import degree_findings, reading_findings
from drive_id.core.checks.repeats import repeat_findings
from drive_id.core.checks.rotor import (
    SPEED_TOLERANCE,
    motion_findings,
    rotation_finding,
    speed_lag,
    standstill_finding,
    time_findings,
    unit_findings,
)
from drive_id.core.checks.single_samples import SingleSamples
from drive_id.core.checks.truncation import truncation_findings
from drive_id.core.checks.waveforms import waveform_findings
from drive_id.core.fit_settings import FitSettings
from drive_id.core.numerics.bspline import Axis
from drive_id.core.numerics.largest import KEPT, USUAL_QUANTILE, Largest, top_quantile
from drive_id.core.signals.join import Piece
from drive_id.core.signals.signal import finite_rows
from drive_id.errors import CoverageError, DataError, StandstillError
from drive_id.types import FloatArray, Samples

SPIKE_FACTOR = 1.2
"""Ratio to the usual amplitude above which a sample is a spike, which does not widen the map."""
_FAULT_FACTOR = 10.0
"""Ratio to the usual amplitude above which a sample shows a faulty sensor or field and is refused."""
_NOISE_SHARE = 0.1  # rms step over the range of a current: a trajectory takes many samples from end to end
_WINDOW = 128  # advances of the rotor summed before speed and angle are compared: noise of the speed averages out
_JUMP, _JUMP_FACTOR = 0.2, 5.0
"""Rad between angle and speed within a sample, beyond any resolver's error, and by how much more than usual where a
slow speed signal makes it large."""
_SPAN, _SPANS = 1 << 13, 16
"""Samples in a row of the excerpt, some turns of a slow machine, and their number, evenly spread, which is also that of
the gap-free runs that are checked: 131 072 samples in all take no time that users feel."""
_SHORTEST_RUN = 32  # samples that a run must have to hold a window
_ERRORS: dict[str, type[DataError]] = {
    "standstill": StandstillError,
    "held_references": CoverageError,
    "no_trajectory": CoverageError,
}
"""Errors by the code of the finding; all others are DataError."""


class Prescan:
    """Checks samples and finds the range of their currents, in one pass and in bounded memory.

    Arrays, bags and live samples all pass through it. The usual amplitude and the usual step of the angle (99.9 %
    quantiles) are exact up to ``1000 kept`` samples; all other statistics are always exact.

    Parameters
    ----------
    kept : int
        Largest amplitudes and largest jumps to keep.
    """

    def __init__(self, kept: int = KEPT) -> None:
        self.samples = 0
        self._turned: FloatArray = np.zeros((2, 1))  # so far, by the speed and by the angle, rad
        self._turned_low, self._turned_high = np.full(2, np.inf), np.full(2, -np.inf)
        self._advances: FloatArray = np.zeros((2, 0))  # from sample to sample since the last full window
        self._products: FloatArray = np.zeros(3)  # see _follow_rotor
        self._low: FloatArray = np.full(2, np.inf)  # of i_d and i_q, A
        self._high: FloatArray = np.full(2, -np.inf)
        self._step_square: FloatArray = np.zeros(2)
        self._steps = 0
        self._amplitudes = Largest(3, kept)  # with i_d, i_q, and whether the reference is known
        self._jumps = Largest(1, kept)  # with their time, s
        self._begin: int | None = None
        self._referenced = 0
        self._largest_reference = 0.0
        self._reference_low: FloatArray = np.full(2, np.inf)
        self._reference_high: FloatArray = np.full(2, -np.inf)
        self._periods: tuple[float, ...] = ()
        self._excerpt = Spans(_SPAN, _SPANS)
        self._single = SingleSamples()
        self._found: tuple[tuple[int, bool], tuple[Message, ...]] = (-1, True), ()  # of so many samples, turning or not

    def copy(self) -> Prescan:
        """Return an independent copy."""
        other = copy.copy(self)
        for name in ("_amplitudes", "_jumps", "_excerpt", "_single"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def add(self, samples: Samples, *, continues: bool = False) -> None:
        """Scan further samples.

        Parameters
        ----------
        continues : bool
            The samples continue the previous piece and begin with its last sample, which counts once.
        """
        if self._begin is None:
            self._begin = int(samples.stamp[0])
        new = slice(int(continues), None)
        self._excerpt.add(Piece(samples, continues))
        if samples.sample_period not in self._periods:
            self._periods += (samples.sample_period,)
        self.samples += len(samples) - continues
        i_dq = frames.to_dq(samples.i_abc, samples.angle)
        self._low, self._high = np.minimum(self._low, i_dq.min(axis=0)), np.maximum(self._high, i_dq.max(axis=0))
        rows, jumps = np.empty((len(samples), 4)), np.zeros((len(samples), 2))
        rows[:, 1:3], jumps[:, 1] = i_dq, (samples.stamp - self._begin) * 1e-9
        rows[new, 3] = self._add_references(samples.i_dq_reference, new)
        rows[:, 0] = np.sqrt(i_dq[:, 0] ** 2 + i_dq[:, 1] ** 2)
        for run in samples.runs():
            self._step_square = self._step_square + np.sum(np.diff(i_dq[run], axis=0) ** 2, axis=0)
            self._steps += run.stop - run.start - 1
            jumps[run, 0][1:] = self._follow_rotor(samples.angle[run], samples.speed[run] * samples.sample_period)
        self._single.add(samples, i_dq, jumps[:, 1], continues=continues)
        self._amplitudes.add(rows[new])
        self._jumps.add(jumps[new])

    @property
    def _usual(self) -> float:
        """Amplitude below which 99.9 % of the samples lie, A; 0 without samples."""
        return self._amplitudes.quantile() if self.samples else 0.0

    @property
    def radius(self) -> float:
        """Radius of the current disc, estimated from the samples, A; used as i_max if that is not set.

        It is the largest amplitude of the references. Samples without a reference (a recording without the topic)
        count with the amplitude below which 99.9 % of them lie, so a second recording without references widens the
        disc if it reaches further. The radius never exceeds the usual amplitude of all samples. It equals that
        amplitude if there are no references, or if the currents exceed them by more than 20 %.
        """
        usual, wanted = self._usual, self._largest_reference
        if SPIKE_FACTOR * wanted < usual:
            return usual
        if self._referenced == self.samples:
            return min(wanted, usual)
        rows = self._amplitudes.rows()
        without = rows[rows[:, 3] == 0, 0]
        other = top_quantile(without, self.samples - self._referenced, USUAL_QUANTILE) if len(without) else 0.0
        return min(max(wanted, other), usual)

    def findings(self, method: str = FULL.name) -> tuple[Message, ...]:
        """Return the findings so far, most basic first, without consequences of an error.

        The method tells whether the rotor has to turn or to stand still.
        """
        turning = ORIGINS[method].turning
        if self._found[0] != (self.samples, turning):
            self._found = (self.samples, turning), tuple(self._judge(turning=turning))
        return self._found[1]

    def check(self, method: str = FULL.name) -> tuple[Message, ...]:
        """Raise the first error among the findings for a method; return the warnings.

        Raises
        ------
        StandstillError
            When the machine turned by less than one electrical revolution: without speed, the flux induces no voltage.
        CoverageError
            When the references stand still, or a step of the current from sample to sample is as large as its range.
        DataError
            For all other findings that are errors; ``docs/findings.md`` lists them.
        """
        found = self.findings(method)
        for finding in found:
            if finding.kind == "error":
                raise _ERRORS.get(finding.code, DataError)(finding)
        return found

    def _judge(self, *, turning: bool) -> Iterator[Message]:
        runs = sorted((run for run in self._excerpt.runs() if len(run) >= _SHORTEST_RUN), key=len, reverse=True)
        runs = sorted(runs[:_SPANS], key=lambda run: int(run.stamp[0]))
        usual, none = self._usual, iter(())
        steps = (
            time_findings(self._periods),
            unit_findings(runs) if runs else none,
            self._on_jumps(),
            self._on_rotation(runs) if turning else none,
            degree_findings(runs, usual) if runs else none,
            self._on_trajectory(),
            self._single.findings(usual),
            repeat_findings(runs, usual) if runs else none,
            waveform_findings(runs, usual) if runs else none,
            truncation_findings(runs) if runs else none,
            motion_findings(runs) if runs else none,
            reading_findings(runs, usual) if runs else none,
        )
        for step in steps:
            refused = False
            for finding in step:
                refused = refused or finding.kind == "error"
                yield finding
            if refused:
                return

    def prepare(self, settings: FitSettings, *, compared: bool = False) -> Evidence:
        """Return empty evidence for the i_max of the settings or, by default, the radius and range of these samples.

        Without i_max, the axes of the map end at the largest currents, spikes excluded. ``compared`` is as in
        :class:`~drive_id.core.accumulation.evidence.Evidence`.
        """
        radius = self.radius
        if settings.i_max is not None:
            evidence = Evidence.within(settings, settings.i_max, compared=compared)
        else:
            rows = self._amplitudes.rows()
            trusted = rows[rows[:, 0] <= SPIKE_FACTOR * self._usual, 1:3]
            low = np.minimum(self._amplitudes.low[:2], trusted.min(axis=0, initial=np.inf))
            high = np.maximum(self._amplitudes.high[:2], trusted.max(axis=0, initial=-np.inf))
            d, q = Axis(low[0], high[0], settings.splines_d), Axis(low[1], high[1], settings.splines_q)
            evidence = Evidence(settings, d, q, radius, compared=compared)
        self.inform(evidence)
        return evidence

    def inform(self, evidence: Evidence) -> None:
        """Add the findings to evidence of these samples."""
        evidence.reached = self.radius
        evidence.findings = self.findings(evidence.settings.method) if self.samples else ()

    def _add_references(self, i_dq: FloatArray | None, new: slice) -> FloatArray | float:
        """Take the references (N, 2), A, and return which of them are known, as numbers (N,), or for all alike."""
        if i_dq is None:
            return 0.0
        rows = finite_rows(i_dq[new])
        known = i_dq[new][rows]
        self._referenced += len(known)
        self._largest_reference = max(self._largest_reference, float(np.hypot(*known.T).max(initial=0.0)))
        self._reference_low = np.minimum(self._reference_low, [axis.min(initial=np.inf) for axis in known.T])
        self._reference_high = np.maximum(self._reference_high, [axis.max(initial=-np.inf) for axis in known.T])
        return rows.astype(np.float64)

    def _follow_rotor(self, angle: FloatArray, expected: FloatArray) -> FloatArray:
        """Follow the rotor over one run; return by how much it advances otherwise than expected (N - 1,), rad.

        ``_products`` are sums over all full windows: of the squared turns by the speed and of their products with those
        by the angle, rad^2, and the way there and back by the angle, rad.

        Parameters
        ----------
        angle : (N,) float
            rad.
        expected : (N,) float
            Advance by the speed until the next sample, rad.
        """
        advances = np.stack([expected[:-1], frames.wrapped(np.diff(angle))])
        turned = np.cumsum(np.append(self._turned, advances, axis=1), axis=1)
        self._turned = turned[:, -1:].copy()
        self._turned_low = np.minimum(self._turned_low, turned[:, 1:].min(axis=1, initial=np.inf))
        self._turned_high = np.maximum(self._turned_high, turned[:, 1:].max(axis=1, initial=-np.inf))
        every = np.append(self._advances, advances, axis=1)
        full = every.shape[1] // _WINDOW * _WINDOW
        by_speed, by_angle = every[:, :full].reshape(2, -1, _WINDOW).sum(axis=2)
        self._advances = every[:, full:].copy()
        self._products = self._products + np.array([by_speed @ by_speed, by_speed @ by_angle, np.abs(by_angle).sum()])
        return np.abs(frames.wrapped(advances[1] - advances[0]))

    def _on_jumps(self) -> Iterator[Message]:
        if not self.samples:
            return
        jumps = self._jumps.rows()
        found = jumps[jumps[:, 0] > max(_JUMP, _JUMP_FACTOR * self._jumps.quantile())]
        if len(found):
            by, at = found[found[:, 1].argmin()]
            yield Message("angle_jump", jumps=len(found), time=at, jump=by)

    def _on_rotation(self, runs: Sequence[Samples]) -> Iterator[Message]:
        with np.errstate(invalid="ignore"):
            turned = max(float((self._turned_high - self._turned_low).max()), 0.0)
        if turned < 2 * np.pi:  # electrical: each position once
            yield standstill_finding(turned, float(self._products[2]))
            return
        expected, advance = self._advances.sum(axis=1)
        square, product = self._products[0] + expected**2, self._products[1] + expected * advance
        ratio = float(product / square) if square > 0 else 0.0
        if not abs(ratio - 1) <= SPEED_TOLERANCE and math.isnan(speed_lag(runs)):
            yield rotation_finding(ratio)

    def _on_trajectory(self) -> Iterator[Message]:
        if self._referenced == self.samples and (self._reference_low == self._reference_high).all():
            d, q = self._reference_low
            yield Message("held_references", i_d=d, i_q=q)
        step, moved = np.sqrt(self._step_square / max(self._steps, 1)), self._high - self._low
        if np.any(step >= _NOISE_SHARE * moved):
            worst = int(np.argmax(step / np.maximum(moved, 1e-300)))
            yield Message("no_trajectory", range=moved[worst], axis="dq"[worst])
        largest, usual = float(self._amplitudes.rows()[:, 0].max()), self._usual
        if largest > _FAULT_FACTOR * usual:
            yield Message("current_spike", largest=largest, usual=usual, share=USUAL_QUANTILE)
