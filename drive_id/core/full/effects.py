"""Effects of real drives that the model lacks, each as a few columns of the same regression.

With psi_s = e^{j theta} f(i), a small effect changes the voltage balance of a window, to first order, by a known vector
times an unknown:

==================  ==========================================================  =====================================
effect              unknown                                                     column
==================  ==========================================================  =====================================
iron_loss           G, conductance parallel to the induced voltage e            -[e^{j theta} f'(i) e]
hysteresis          G omega                                                     -[e^{j theta} f'(i) e / abs(omega)]
coercivity          constant iron current along e                               -[e^{j theta} f'(i) e / abs(e)]
current_latency     tau, time constant of the currents' filter or their delay   [u_s - omega e^{j theta}
                                                                                (j f - f'(i) j i)]
angle_latency       tau                                                         [omega e^{j theta} (j f - f'(i) j i)]
flux_lag            tau times the share of the flux that lags by a short tau    -[e^{j theta} f'(i) di/dt]
flux_lag_...ms      share of the flux that lags by this time                    -[e^{j theta} (f(i) - f(i_lag))]
copper_heating      rise of R over the recording                                int i_s h dt, h: heat int i^2 dt, less
                                                                                what is given off (``winding_heat.py``)
magnet_heating      change over the recording of psi_d and of the current       h [e^{j theta}], h [e^{j theta} f'(i)]
                    that stands for the magnet
copper_recordings   R of a recording minus that of the first                    int i_s
magnet_recordings   the same, of a recording minus that of the first            [e^{j theta}], [e^{j theta} f'(i)]
eccentricity        error of the angle, cosine and sine of theta / p, per run   [e^{j theta} cos (j f - f'(i) j i)]
eccentric_rotor     share of the flux, cosine and sine of theta / p, per run    [e^{j theta} cos f]
resolver_first      error of the angle, cosine and sine of theta                likewise
resolver_second     error of the angle, cosine and sine of 2 theta              likewise
dc_link             share of the DC link's variation that acts on the voltages  -int u_s (u_dc / mean - 1) dt
link_ripple         cosine and sine of a ripple of the DC link that was not     -int u_s cos 2 pi f t dt
                    recorded, relative, per run
link_sag            relative fall of the DC link per power p that is taken      int u_s p
phase_resistance    R of phases a and b above the mean, c below                 of int i_a, int i_b, int i_c
voltage_gains       gain mismatch of the voltages, complex                      -conj(int u_s)
current_rotation    a: the currents read are i (1 + j a)                        -j R int i_s - int h'(i) j i
                                                                                - [e^{j theta} f'(i) j i]
current_gains       gain mismatch g, complex: those read are i + g conj(i)      the same with i*, the image of i
current_offset      o, complex: those read are i + o                            the same with e^{-j theta}
remainder           none: what the columns above, linear in the effects, leave  [e^{j (theta + eps)} f((i + di)
                    of the flux at the estimated effects, and what the current  e^{-j eps}) - e^{j theta} (f + ...)]
                    does between samples, see ``between_samples.py``             + int (R i_s + drop) - its quadrature
==================  ==========================================================  =====================================

[x] is the difference of x between the ends of the window, f' the Jacobian of the present estimate of the map, i the
current in the rotor frame, and e = u - R i - drop the induced voltage. All columns use earlier samples only; e uses the
voltage held before. The controller responds to the noise of a sample with voltage and current, which would bias them.

For effects of several percent of the current, the second order matters. Let di and eps be the changes of current and
angle by the effects, both at the estimate. The remainder is the exact change of the flux minus its linear part. It has
no unknown of its own and makes the repeated linearization converge to the nonlinear model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.between_samples import between_samples
from drive_id.core.full.link_ripple import ripple_columns
from drive_id.core.full.model import (
    EFFECT_COLUMNS,
    EFFECTS,
    MOST_RECORDINGS,
    MOST_RUNS,
    RESISTANCE,
    FullModel,
    ModelSpec,
)
from drive_id.core.full.winding_heat import WindingHeat
from drive_id.core.full.windows import LAGS, WindowCutter, Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.types import TINY, FloatArray, Samples

OF_RECORDINGS = (
    "copper_heating",
    "magnet_heating",
    "copper_recordings",
    "magnet_recordings",
    "eccentricity",
    "eccentric_rotor",
    "link_ripple",
)
"""Effects that depend on the number of a recording or a run, or on the time since the start."""

OF_SENSORS = ("current_rotation", "current_gains", "current_offset")
"""Effects of the current sensors, not of the drive, in the order of ``Windows.sensed``."""

_SLOWEST = 1.0
"""Speed below which hysteresis cannot be distinguished from noise, rad/s."""

_MOST_POLE_PAIRS = 16
"""Tried where the number is not known: as many as common machines have."""

_BENDS = 0.1
"""Of a cell of the map: a shift of the current by which a cubic spline keeps its slope within some percent."""


def between(x: ComplexArray) -> ComplexArray:
    """Return the differences (N,) between the ends of windows (N, 2)."""
    return np.asarray(x[:, 1] - x[:, 0])


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns of all effects, linearized about an estimate."""

    model: FullModel
    estimate: FloatArray  # (size,), see :class:`~drive_id.core.full.solver.FullSolution`
    heat: float  # largest int i^2 dt within a recording, A^2 s, to which heating is relative
    link: float  # mean DC-link voltage, V; NaN where it is not known
    pole_pairs: int | None  # for the mechanical angle
    ripple: float = 0.0  # frequency of a ripple of the DC link, Hz; 0 without
    winding: WindingHeat | None = None  # course of its temperature; None: it gives off no heat

    def __call__(self, windows: Windows) -> ComplexArray:
        """Return the columns (N, EFFECT_COLUMNS) of N windows."""
        turn: ComplexArray = np.exp(1j * windows.angle)
        i_dq: ComplexArray = windows.i_dq[..., 0] + 1j * windows.i_dq[..., 1]
        through = self._jacobian(windows)
        psi, by_angle = self._flux(i_dq, windows.angle)
        currents, waves = self._currents(windows, turn), self._waves(windows)
        tilt = turn * (1j * psi + by_angle - through(1j * i_dq))  # by an error of the angle
        heat = windows.heat / max(self.heat, 1e-12)
        of_magnet = between(turn), between(turn * through(np.ones_like(i_dq)))
        own = [windows.recording == k + 1 for k in range(MOST_RECORDINGS - 1)]
        i_a, i_b, i_c = 2 / 3 * (frames.phases(windows.current) * np.exp(1j * frames.PHASE_SHIFTS)).T
        columns = {name: [between(turn * through(shift)) for shift in shifts] for name, shifts in currents.items()}
        image, unit = windows.current.conj(), windows.duration.astype(np.complex128)
        read = [1j * windows.current, image, 1j * image, unit, 1j * unit]
        dropped = windows.drop_scale * np.einsum("nlk,l->kn", windows.sensed, self.model.coarse_drop(self.estimate))
        resisted = iter(self.estimate[RESISTANCE] * np.stack(read) + dropped)
        for name in OF_SENSORS:
            columns[name] = [column - next(resisted) for column in columns[name]]
        columns |= {
            "current_latency": [between(windows.held - windows.speed * tilt)],  # with the ripple of a held voltage
            "angle_latency": [between(windows.speed * tilt)],
            "flux_lag": [-between(turn * through(windows.slope))],
            "copper_heating": [windows.current * (heat if self.winding is None else self.winding(windows))],
            "magnet_heating": [column * heat for column in of_magnet],
            "copper_recordings": [windows.current * own_windows for own_windows in own],
            "magnet_recordings": [column * own_windows for own_windows in own for column in of_magnet],
            "phase_resistance": [i_a - i_c, i_b - i_c],
            "link_sag": [windows.loaded],
            "voltage_gains": [-windows.voltage.conj(), -1j * windows.voltage.conj()],
            **{name: [between(tilt * wave) for wave in of_order] for name, of_order in waves.items()},
        }
        now = windows.lagging[..., -1]
        leading = self._mean_flux(now)
        for k, lag in enumerate(LAGS):
            lagging = self._mean_flux(now - windows.lagging[..., k])
            columns[f"flux_lag_{1e3 * lag:g}ms"] = [-between(turn * (leading - lagging))]
        if "eccentricity" in waves:
            columns["eccentric_rotor"] = [between(turn * psi * wave) for wave in waves["eccentricity"]]
        if np.isfinite(self.link):
            columns["dc_link"] = [-np.nan_to_num(windows.link / self.link - windows.voltage)]

        if self.ripple:
            of_link = ripple_columns(windows)(self.ripple).T
            columns["link_ripple"] = [(windows.run == k) * wave for k in range(MOST_RUNS) for wave in of_link]

        shift = self._sum(currents) + sum(
            self._value("magnet_recordings")[2 * k + 1] * own_windows[:, None] for k, own_windows in enumerate(own)
        )
        shift = shift + self._value("magnet_heating")[1] * heat[:, None]
        further = shift if windows.moved is None else shift - windows.moved
        late = self._value("current_latency") * windows.speed  # the currents belong to an earlier angle
        error = self._sum(waves).real + self._value("angle_latency") * windows.speed - late
        columns["remainder"] = [between_samples(self.model, self.estimate, windows, psi)]
        if shift.any() or error.any():
            ahead = np.exp(1j * error)
            changed = self._flux((i_dq + further) * ahead.conj(), windows.angle + error)[0]
            ripple = 0.5 * np.square(np.maximum(late * np.sign(windows.speed), 0.0)) * (psi - through(i_dq))
            remainder = turn * (ahead * changed - psi - through(shift) - ripple) - error * tilt
            columns["remainder"][0] = columns["remainder"][0] + between(remainder)
        out = np.zeros((len(windows), EFFECT_COLUMNS), np.complex128)
        for name, own_columns in columns.items():
            for k, column in enumerate(own_columns):
                out[:, EFFECTS[name].start + k] = column
        return out

    def likely_pole_pairs(self, windows: Windows) -> int:
        """Return the number of pole pairs at which resolver eccentricity reduces the residuals most."""
        i_dq: ComplexArray = windows.i_dq[..., 0] + 1j * windows.i_dq[..., 1]
        psi, by_angle = self._flux(i_dq, windows.angle)
        tilt = np.exp(1j * windows.angle) * (1j * psi + by_angle - self._jacobian(windows)(1j * i_dq))
        left, weights = self.model.residuals(windows, self.estimate).T.ravel(), np.sqrt(windows.weights)[:, None]
        shares = {}
        for pairs in range(2, _MOST_POLE_PAIRS + 1):
            z = weights * np.stack([between(tilt * wave) for wave in _mechanical_waves(windows, pairs)], axis=1)
            rows = np.concatenate([z.real, z.imag])
            shares[pairs] = float(np.sum((rows @ np.linalg.lstsq(rows, left, rcond=1e-9)[0]) ** 2))
        return max(shares, key=lambda pairs: shares[pairs])

    def _value(self, name: str) -> FloatArray:
        return self.estimate[self.model.effect(name)]

    def _sum(self, parts: Mapping[str, Sequence[FloatArray | ComplexArray]]) -> ComplexArray:
        """Return the sum (N, 2) of parts per unit of each effect, at the estimate."""
        both = [(part, x) for name, own in parts.items() for part, x in zip(own, self._value(name), strict=False)]
        return np.asarray(sum(part * x for part, x in both), np.complex128)

    def _jacobian(self, windows: Windows) -> Callable[[ComplexArray], ComplexArray]:
        """Return the function f'(i) x of x (N, 2)."""
        flat = windows.i_dq.reshape(-1, 2)
        slopes = jacobian(self.model.flux, self.estimate[self.model.map], flat).reshape(len(windows), 2, 2, 2)
        d, q = (slopes[..., 0, k] + 1j * slopes[..., 1, k] for k in (0, 1))
        return lambda x: np.asarray(d * x.real + q * x.imag)

    def bends(self, spec: ModelSpec, kept: Sequence[Windows]) -> bool:
        """Tell whether the effects of a variant move a current by so much that the slope of the map there differs."""
        cells = self.model.resolution
        least = _BENDS * min(float(np.diff(cells.d).min()), float(np.diff(cells.q).min()))
        return bool(spec.effects) and any(
            float(np.abs(self._shift(windows)).max(initial=0.0)) > least for windows in kept
        )

    def moved(self, windows: Windows) -> Windows:
        """Return windows whose currents ``i_dq`` are those in the map at the estimate, where the map reaches them.

        About them the flux is linear in all unknowns to first order, so that the normal equations are those of the
        nonlinear fit even where an effect moves the current by more than the map bends over, as iron loss does in a
        machine whose bridges saturate at small currents.
        """
        measured, shift = windows.measured, self._shift(windows)
        inside = self.model.contains(replace(windows, i_dq=frames.as_pairs(measured + shift)))
        shift = np.where(inside[:, None], shift, 0.0)
        return replace(windows, i_dq=frames.as_pairs(measured + shift), moved=shift, effects=None)

    def _shift(self, windows: Windows) -> ComplexArray:
        """Return by how much the effects at the estimate move the currents (N, 2) in the map, A."""
        return self._sum(self._currents(windows, np.exp(1j * windows.angle)))

    def _currents(self, windows: Windows, turn: ComplexArray) -> dict[str, list[ComplexArray]]:
        """Return the currents (N, 2) that each effect adds to that of the map, per unit."""
        i_dq = windows.measured
        i_s = i_dq * turn
        e = (windows.held - float(self.estimate[RESISTANCE]) * i_s - self._drop(i_s, windows)) / turn
        speed = np.where(np.abs(windows.speed) < _SLOWEST, np.inf, np.abs(windows.speed))
        mirrored = i_s.conj() / turn
        return {
            "iron_loss": [-e],
            "hysteresis": [-e / speed],
            "coercivity": [-e / np.maximum(np.abs(e), TINY)],
            "current_rotation": [-1j * i_dq],
            "current_gains": [-mirrored, -1j * mirrored],
            "current_offset": [-turn.conj(), -1j * turn.conj()],
        }

    def _waves(self, windows: Windows) -> dict[str, list[FloatArray]]:
        """Return the angle errors (N, 2) of the resolver, per unit of each effect."""
        waves = {
            name: [f(order * windows.angle) for f in (np.cos, np.sin)]
            for name, order in (("resolver_first", 1), ("resolver_second", 2))
        }
        if self.pole_pairs is not None and self.pole_pairs > 1:
            waves["eccentricity"] = _mechanical_waves(windows, self.pole_pairs)
        return waves

    def voltages(self, recordings: Sequence[Samples], length: int) -> list[FloatArray]:
        """Return the phase voltages (N, 3) caused by the effects of the drive, V.

        Without those of its current sensors, and without ``link_ripple``, whose phase holds for the recorded runs only.

        Parameters
        ----------
        recordings : sequence of Samples
            The whole ones, unless the estimate has none of the effects ``OF_RECORDINGS``.
        length : int
            Samples over which the voltage is averaged.
        """
        cutter, out, estimate = WindowCutter(self.model.shapes), [], self.estimate.copy()
        for name in (*OF_SENSORS, "link_ripple"):
            estimate[self.model.effect(name)] = 0.0
        of_drive = replace(self, estimate=estimate)
        for number, samples in enumerate(recordings):
            cutter.restart(0.0, number)
            voltage = np.zeros(len(samples), np.complex128)
            for start, windows in cutter.adjacent(samples, length):
                taken = of_drive(windows) @ estimate[self.model.effects] / windows.duration
                voltage[start : start + length * len(taken)] = np.repeat(taken, length)
            out.append(frames.phases(voltage))
        return out

    def _flux(self, i_dq: ComplexArray, at: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return f(i, theta) and its derivative by theta (N, 2), Wb, at currents, A, and angles (N, 2), rad."""
        psi, by_angle = self._mean_flux(i_dq), np.zeros_like(i_dq)
        harmonic = self.model.harmonic.rows(frames.as_pairs(i_dq.ravel()))
        for order, columns in self.model.harmonics.items():
            halves = np.split(self.estimate[columns], 2)
            if self.estimate[columns].any():
                a, b = ((harmonic.dot(half) @ np.array([1.0, 1j])).reshape(at.shape) for half in halves)
                cosine, sine = np.cos(order * at), np.sin(order * at)
                psi, by_angle = psi + a * cosine + b * sine, by_angle + order * (b * cosine - a * sine)
        return psi, by_angle

    def _mean_flux(self, i_dq: ComplexArray) -> ComplexArray:
        """Return f(i) (N, 2) at currents (N, 2), A, in Wb."""
        psi = self.model.flux.rows(frames.as_pairs(i_dq.ravel())).dot(self.estimate[self.model.map])
        return np.asarray((psi @ np.array([1.0, 1j])).reshape(i_dq.shape))

    def _drop(self, i_s: ComplexArray, windows: Windows) -> ComplexArray:
        """Return the inverter's drop at the ends (N, 2) in the stator frame, V."""
        model = self.model
        shapes = model.shapes(frames.phases(i_s.ravel()))  # (2 N, 3, S)
        drops = np.einsum("nps,sp->np", shapes, self.estimate[model.phase_columns()])
        return np.asarray(frames.space_vector(drops).reshape(i_s.shape) * windows.drop_scale[:, None])


def _mechanical_waves(windows: Windows, pole_pairs: int) -> list[FloatArray]:
    """Return cosine and sine (N, 2) of the mechanical angle, in each run."""
    mechanical = windows.turned / pole_pairs
    waves = np.cos(mechanical), np.sin(mechanical)
    return [(windows.run == k)[:, None] * wave for k in range(MOST_RUNS) for wave in waves]
