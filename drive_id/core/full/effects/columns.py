"""The columns of all effects, linearized about an estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.between_samples import between_samples
from drive_id.core.full.effects.catalogue import CATALOGUE
from drive_id.core.full.effects.effect import Ends, Linearized, between
from drive_id.core.full.effects.resolver import mechanical_waves
from drive_id.core.full.model import EFFECT_COLUMNS, EFFECTS, RESISTANCE, FullModel, ModelSpec
from drive_id.core.full.winding_heat import WindingHeat
from drive_id.core.full.windows import WindowCutter, Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.types import TINY, FloatArray, Samples

_MOST_POLE_PAIRS = 16
"""Tried where the number is not known: as many as common machines have."""
_WIDEST, _DROP_POINTS = 2.0, 2001
"""Phase currents, in i_max, between which the inverter's drop is tabulated, and points: each step is i_max / 500."""
_FILTER_STEPS = 64
"""Over which the drop within the time constant of a filter is averaged: a step at a zero crossing is within 1/64."""
_BENDS = 0.1
"""Of a cell of the map: a shift of the current by which a cubic spline keeps its slope within some percent."""


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns of all effects, linearized about an estimate."""

    model: FullModel
    estimate: FloatArray  # (size,), see :class:`~drive_id.core.full.solver.FullSolution`
    heat: float  # largest int i^2 dt within a recording, A^2 s, to which heating is relative
    link: float  # mean DC-link voltage, V; NaN where it is not known
    spans: FloatArray  # (R, 2), when the windows of each recording begin and end, s
    pole_pairs: int | None  # for the mechanical angle
    ripple: float = 0.0  # frequency of a ripple of the DC link, Hz; 0 without
    winding: WindingHeat | None = None  # course of its temperature; None: it gives off no heat
    delay: float = 0.0  # of the voltages, samples
    divided: str = "section"  # what tells the parts of the data apart, see ``effect.divided``
    steady: float | None = None  # the one speed of all data, rad/s; None where there are several

    def __call__(self, windows: Windows) -> ComplexArray:
        """Return the columns (N, EFFECT_COLUMNS) of N windows."""
        at = self._at(windows)
        out = np.zeros((len(windows), EFFECT_COLUMNS), np.complex128)
        for name, effect in CATALOGUE.items():
            for k, column in enumerate(effect.columns(at)):
                out[:, EFFECTS[name].start + k] = column
        out[:, EFFECTS["remainder"]] = np.stack([self._remainder(at), self._placed(at)], axis=1)
        return out

    def _remainder(self, at: Linearized) -> ComplexArray:
        """Return what the columns leave of the flux (N,) at the estimate, and what the current does between samples."""
        windows, i_dq = at.windows, _as_complex(at.windows.i_dq)
        remainder = between_samples(self.model, self.estimate, windows, at.psi, at.delay)
        shift, error = self._shift(at), self._turned(at)
        for name, value in self._present():
            shift = shift + CATALOGUE[name].magnetizing(at, value)
            remainder = remainder + CATALOGUE[name].beyond(at, value)
        if shift.any() or error.any():
            if windows.moved is not None and windows.righted is not None:
                shift, error = shift - windows.moved, error - windows.righted
            late = at.filter * windows.speed
            passed = 1 / (1 + 1j * late)  # by the filter
            ahead, moving = np.exp(1j * (error + late)) * passed, at.filter * windows.slope * passed
            changed = self._flux((i_dq + shift) / ahead, windows.angle + error, late)[0]
            changed = changed + at.through(moving) - at.through(moving / passed) * passed
            left = at.turn * (ahead * changed - at.psi - at.through(shift)) - error * at.tilt
            remainder = remainder + between(left)
        if at.filter > 0:
            remainder = remainder + between(self._drop_by_filter(at))
        return remainder

    def _drop_by_filter(self, at: Linearized) -> ComplexArray:
        """Return the integral (N, 2), up to the ends, of the filtered drop minus the drop of the filtered currents, Vs.

        A phase current i that rises by v within the time constant was i + v then. After a step, the filtered drop
        follows e^{-t/tau}, and that of the filtered current steps when it crosses zero.
        """
        current = self.model.i_max * np.linspace(-_WIDEST, _WIDEST, _DROP_POINTS)
        drop = (self.model.shapes(current) @ self._drops).T
        windows, rise = at.windows, at.filter * at.rate
        later, out = (np.arange(_FILTER_STEPS) + 0.5) / _FILTER_STEPS, np.zeros(rise.shape, np.complex128)
        for axis, table in zip(np.exp(1j * frames.PHASE_SHIFTS), drop, strict=True):
            i, v = ((x * at.turn * axis.conj()).real[..., None] for x in (at.currents, rise))
            unlike = np.interp(i + v * later, current, table) - np.interp(i + v * (1 + np.log(later)), current, table)
            out += 2 / 3 * axis * unlike.mean(axis=-1)
        return out * at.filter * windows.drop_scale[:, None]

    def _placed(self, at: Linearized) -> ComplexArray:
        """Return minus the part (N,) of the effects' columns that is in the currents and angles of the windows."""
        windows = at.windows
        if windows.moved is None or windows.righted is None:
            return np.zeros(len(windows), np.complex128)
        return -between(at.turn * at.through(windows.moved) + windows.righted * at.tilt)

    def _present(self) -> list[tuple[str, FloatArray]]:
        """Return the effects that are in the estimate, with their values."""
        return [(name, value) for name in CATALOGUE if (value := self._value(name)).any()]

    def _ends(self, windows: Windows) -> Ends:
        turn: ComplexArray = np.exp(1j * windows.angle)
        i_s = windows.measured * turn
        fallen = self._fallen(i_s, windows)
        induced = (windows.held - float(self.estimate[RESISTANCE]) * i_s - frames.space_vector(fallen)) / turn
        part = getattr(windows, self.divided)
        tracking = float(np.sqrt(max(self._value("angle_tracking")[0], 0.0)))
        begin, end = self._spans(windows)
        elapsed = windows.time + 0.5 * (windows.duration - begin - end)
        return Ends(
            windows, windows.measured, turn, induced, fallen, self.pole_pairs, part, self.steady or 0.0, tracking,
            elapsed,
        )  # fmt: skip

    def _spans(self, windows: Windows) -> FloatArray:
        """Return when the recording of each window begins and ends (2, N), s; of live data, some may be later."""
        return np.asarray(self.spans[np.minimum(windows.recording, len(self.spans) - 1)].T)

    def _at(self, windows: Windows) -> Linearized:
        ends, i_dq, through = self._ends(windows), _as_complex(windows.i_dq), self._jacobian(windows)
        psi, by_angle = self._flux(i_dq, windows.angle)
        image, unit = windows.current.conj(), windows.duration.astype(np.complex128)
        half = 0.5 * (windows.turned[:, 1] - windows.turned[:, 0])
        turning = unit * ends.turn[:, 0] * np.exp(1j * half) * np.sinc(half / np.pi)
        read = np.stack([1j * windows.current, image, 1j * image, unit, 1j * unit, turning, 1j * turning])
        begin, end = self._spans(windows)
        resistance = float(self.estimate[RESISTANCE])
        heat, drop = windows.heat / max(self.heat, 1e-12), self.model.coarse_drop(self.estimate)
        return Linearized(
            **vars(ends),
            psi=psi,
            tilt=ends.turn * (1j * psi + by_angle - through(1j * i_dq)),
            through=through,
            mean_flux=self._mean_flux,
            ohmic=resistance * windows.current,
            dropped=resistance * read + windows.drop_scale * np.einsum("nlk,l->kn", windows.sensed, drop),
            rectified=windows.drop_scale[:, None] * np.einsum("nlp,l->np", windows.rectified[:, :-1], drop),
            drops=windows.drop_scale[:, None] * np.einsum("nsp,sp->np", windows.shape, self._drops),
            shapes=self.model.shapes,
            heat=heat,
            warmth=[heat] if self.winding is None else self.winding.courses(windows),
            link=self.link,
            course=ends.elapsed / np.maximum(end - begin, TINY),
            ripple=self.ripple,
            filter=max(self.late_currents, 0.0),
            delay=self.delay,
        )

    def likely_pole_pairs(self, windows: Windows) -> int:
        """Return the number of pole pairs at which an eccentric resolver or rotor reduces the residuals most."""
        at = self._at(windows)
        left, weights = self.model.residuals(windows, self.estimate).T.ravel(), np.sqrt(windows.weights)[:, None]
        shares = {}
        for pairs in range(2, _MOST_POLE_PAIRS + 1):
            waves = at.in_runs(mechanical_waves(windows, pairs))
            turned = [vector * wave for wave in waves for vector in (at.tilt, at.turn * at.psi)]
            z = weights * np.stack([between(column) for column in turned], axis=1)
            rows = np.concatenate([z.real, z.imag])
            shares[pairs] = float(np.sum((rows @ np.linalg.lstsq(rows, left, rcond=1e-9)[0]) ** 2))
        return max(shares, key=lambda pairs: shares[pairs])

    @property
    def _drops(self) -> FloatArray:
        """Return the coefficients (S, 3) of the shapes of each phase's drop, V."""
        return self.estimate[self.model.phase_columns()]

    @property
    def late_currents(self) -> float:
        """Time by which the currents are late, s."""
        return float(self._value("current_latency")[0])

    def _value(self, name: str) -> FloatArray:
        return self.estimate[self.model.effect(name)]

    def _jacobian(self, windows: Windows) -> Callable[[ComplexArray], ComplexArray]:
        """Return the function f'(i) x of x (N, 2)."""
        flat = windows.i_dq.reshape(-1, 2)
        slopes = jacobian(self.model.flux, self.estimate[self.model.map], flat).reshape(len(windows), 2, 2, 2)
        d, q = (slopes[..., 0, k] + 1j * slopes[..., 1, k] for k in (0, 1))
        return lambda x: np.asarray(d * x.real + q * x.imag)

    def bends(self, spec: ModelSpec, kept: Sequence[Windows]) -> bool:
        """Tell whether the effects of a variant move a current by so much that the slope of the map there differs."""

        def moves(windows: Windows) -> float:
            ends = self._ends(windows)
            moved = ends.currents * (np.exp(-1j * self._turned(ends)) - 1) + self._shift(ends)
            return float(np.abs(moved).max(initial=0.0))

        cells = self.model.resolution
        least = _BENDS * min(float(np.diff(cells.d).min()), float(np.diff(cells.q).min()))
        return bool(spec.effects) and any(moves(windows) > least for windows in kept)

    def moved(self, windows: Windows) -> Windows:
        """Return windows whose currents and angles are those in the map at the estimate, where the map reaches them.

        About them the flux is linear in all unknowns to first order, so that the normal equations are those of the
        nonlinear fit even where an effect moves the current by more than the map bends over, as iron loss does in a
        machine whose bridges saturate at small currents, or a late angle at several speeds.
        """
        measured = windows.measured

        def placed(error: FloatArray, shift: ComplexArray) -> Windows:
            back = np.exp(-1j * error)
            return replace(
                windows, angle=windows.angle + error, i_dq=frames.as_pairs(measured * back + shift), moved=shift,
                righted=error, slope=windows.slope * back, lagging=windows.lagging * back[..., None], effects=None,
            )  # fmt: skip

        error = self._turned(self._ends(windows))
        shift = self._shift(self._ends(placed(error, np.zeros_like(measured))))
        inside = self.model.contains(placed(error, shift))[:, None]
        return placed(np.where(inside, error, 0.0), np.where(inside, shift, 0.0))

    def _shift(self, at: Ends) -> ComplexArray:
        """Return by how much the effects at the estimate move the currents (N, 2) in the map, A."""
        moving = [CATALOGUE[name].shifted(at, value) for name, value in self._present()]
        return np.asarray(sum(moving, np.zeros(at.turn.shape)), np.complex128)

    def _turned(self, at: Ends) -> FloatArray:
        """Return by how much the effects at the estimate make the measured angles (N, 2) too small, rad."""
        turning = [CATALOGUE[name].turned(at, value) for name, value in self._present()]
        return np.asarray(sum(turning, np.zeros(at.turn.shape)), np.float64)

    def voltages(
        self, recordings: Sequence[Samples], length: int, conditions: Sequence[tuple[float, float]]
    ) -> list[FloatArray]:
        """Return the phase voltages (N, 3) caused by the effects of the drive, its temperatures and its DC link, V.

        Without those of its current sensors, and without those whose phase holds for the recorded runs only.

        Parameters
        ----------
        recordings : sequence of Samples
            The whole ones, unless the estimate has no effect ``of_recordings``.
        length : int
            Samples over which the voltage is averaged.
        conditions : sequence of (float, float)
            Of each recording, see :meth:`~drive_id.core.fit_settings.FitSettings.conditions`.
        """
        cutter, out, estimate = WindowCutter(self.model.shapes), [], self.estimate.copy()
        for name, effect in CATALOGUE.items():
            if effect.of_sensors or effect.of_recorded_runs:
                estimate[self.model.effect(name)] = 0.0
        of_drive = replace(self, estimate=estimate)
        for number, (samples, own) in enumerate(zip(recordings, conditions, strict=True)):
            cutter.restart(0.0, number)
            cutter.set_conditions(*own)
            voltage = np.zeros(len(samples), np.complex128)
            for start, windows in cutter.adjacent(samples, length):
                taken = of_drive(windows.accelerated()) @ estimate[self.model.effects]
                taken = (taken + self.model.by_conditions(windows, estimate)) / windows.duration
                voltage[start : start + length * len(taken)] = np.repeat(taken, length)
            out.append(frames.phases(voltage))
        return out

    def _flux(
        self, i_dq: ComplexArray, at: FloatArray, late: FloatArray | float = 0.0
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return f(i, theta) and its derivative by theta (N, 2), Wb, at currents, A, and angles (N, 2), rad.

        A filter by which the mean flux is ``late``, rad, passes less of harmonics, and delays them by less.
        """

        def passed(order: int) -> ComplexArray:
            return np.asarray(np.exp(1j * order * late) * (1 + 1j * late) / (1 + 1j * (1 + order) * late))

        psi, by_angle = self._mean_flux(i_dq), np.zeros_like(i_dq)
        harmonic = self.model.harmonic.rows(frames.as_pairs(i_dq.ravel()))
        for order, columns in self.model.harmonics.items():
            halves = np.split(self.estimate[columns], 2)
            if self.estimate[columns].any():
                a, b = ((harmonic.dot(half) @ np.array([1.0, 1j])).reshape(at.shape) for half in halves)
                wave = np.exp(1j * order * at)
                fore, back = 0.5 * (a - 1j * b) * wave, 0.5 * (a + 1j * b) * wave.conj()
                psi = psi + fore * passed(order) + back * passed(-order)
                by_angle = by_angle + 1j * order * (fore - back)
        return psi, by_angle

    def _mean_flux(self, i_dq: ComplexArray) -> ComplexArray:
        """Return f(i) (N, 2) at currents (N, 2), A, in Wb."""
        psi = self.model.flux.rows(frames.as_pairs(i_dq.ravel())).dot(self.estimate[self.model.map])
        return np.asarray((psi @ np.array([1.0, 1j])).reshape(i_dq.shape))

    def _fallen(self, i_s: ComplexArray, windows: Windows) -> FloatArray:
        """Return the inverter's drop (N, 2, 3) in each phase at the ends, V."""
        shapes = self.model.shapes(frames.phases(i_s))  # (N, 2, 3, S)
        return np.asarray(np.einsum("nmps,sp->nmp", shapes, self._drops) * windows.drop_scale[:, None, None])


def _as_complex(pairs: FloatArray) -> ComplexArray:
    """Return d + jq (...,) of pairs (..., 2)."""
    return np.asarray(pairs[..., 0] + 1j * pairs[..., 1])
