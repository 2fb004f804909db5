"""What real drives do besides the model, each as a few columns of the same regression.

With psi_s = e^{j theta} f(i) and small effects, each changes the balance over a window to first order, by a known
vector times an unknown:

==================  ==========================================================  =====================================
effect              unknown                                                     column
==================  ==========================================================  =====================================
iron_loss           G, conductance parallel to the induced voltage e            -[e^{j theta} f'(i) e]
hysteresis          G omega                                                     -[e^{j theta} f'(i) e / abs(omega)]
current_latency     tau, time constant of the currents' filter or their delay   [u_s - omega e^{j theta}
                                                                                (j f - f'(i) j i)]
angle_latency       tau                                                         [omega e^{j theta} (j f - f'(i) j i)]
flux_lag            tau times the share of the flux that lags by a short tau    -[e^{j theta} f'(i) di/dt]
flux_lag_...ms      share of the flux that lags by this time                    -[e^{j theta} (f(i) - f(i_lag))]
copper_heating      rise of R over the recording                                int i_s h dt, h: heat int i^2 dt
magnet_heating      change over the recording of psi_d and of the current       h [e^{j theta}], h [e^{j theta} f'(i)]
                    that stands for the magnet
copper_recordings   R of a recording minus that of the first                    int i_s
magnet_recordings   the same, of a recording minus that of the first            [e^{j theta}], [e^{j theta} f'(i)]
eccentricity        error of the angle, cosine and sine of theta / p, per run   [e^{j theta} cos (j f - f'(i) j i)]
eccentric_rotor     share of the flux, cosine and sine of theta / p, per run    [e^{j theta} cos f]
resolver_first      error of the angle, cosine and sine of theta                likewise
resolver_second     error of the angle, cosine and sine of 2 theta              likewise
dc_link             share of the DC link's variation that acts on the voltages  -int u_s (u_dc / mean - 1) dt
phase_resistance    R of phases a and b above the mean, c below                 of int i_a, int i_b, int i_c
voltage_gains       gain mismatch of the voltages, complex                      -conj(int u_s)
==================  ==========================================================  =====================================

[x] is the difference of x at the ends of the window, f' the Jacobian of the map as far as it is known, i the current
in the rotor frame, and e = u - R i - drop the induced voltage. All columns use earlier samples only, e the voltage held
before: a controller answers the noise of a sample with voltage and current, which would bias them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.model import EFFECT_COLUMNS, EFFECTS, MOST_RECORDINGS, MOST_RUNS, RESISTANCE, FullModel
from drive_id.core.full.windows import LAGS, Windows
from drive_id.core.maps.flux_models import jacobian
from drive_id.types import FloatArray

_SLOWEST = 1.0
"""Speed below which hysteresis is not told from noise, rad/s."""


@dataclass(frozen=True, eq=False)
class EffectColumns:
    """The columns of all effects, linearized about an estimate.

    Parameters
    ----------
    model : FullModel
    estimate : (size,) float
        See :class:`~drive_id.core.full.solver.FullSolution`.
    heat : float
        Largest int i^2 dt within a recording, A^2 s, to which heating is relative.
    link : float
        Mean DC-link voltage, V; NaN where it is not known.
    pole_pairs : int or None
        For the mechanical angle.
    """

    model: FullModel
    estimate: FloatArray
    heat: float
    link: float
    pole_pairs: int | None

    def __call__(self, windows: Windows) -> ComplexArray:
        """Return the columns (N, EFFECT_COLUMNS) of N windows."""
        resistance = float(self.estimate[RESISTANCE])
        ends = self._ends(windows)
        turn, i_dq, psi, through, tilt = ends.turn, ends.i_dq, ends.psi, ends.through, ends.tilt
        i_s = i_dq * turn
        drop = self._drop(i_s, windows)
        half_turn = np.exp(0.5j * windows.period[:, None] * windows.speed)  # since the mean of the held voltage
        e = (windows.held * half_turn - resistance * i_s - drop) / turn
        speed = np.where(np.abs(windows.speed) < _SLOWEST, np.inf, np.abs(windows.speed))
        heat = (windows.heat / max(self.heat, 1e-12))[:, None]
        out = np.zeros((len(windows), EFFECT_COLUMNS), np.complex128)

        def put(name: str, *columns: ComplexArray) -> None:
            start = EFFECTS[name].start
            for k, column in enumerate(columns):
                out[:, start + k] = column

        put("iron_loss", -between(turn * through(e)))
        put("hysteresis", -between(turn * through(e / speed)))
        put("current_latency", between(windows.held - windows.speed * tilt))  # with the ripple of a held voltage
        put("angle_latency", between(windows.speed * tilt))
        put("flux_lag", -between(turn * through(windows.slope)))
        now = windows.lagging[..., -1]
        leading = self._mean_flux(now)
        for k, lag in enumerate(LAGS):
            lagging = self._mean_flux(now - windows.lagging[..., k])
            put(f"flux_lag_{1e3 * lag:g}ms", -between(turn * (leading - lagging)))
        put("copper_heating", windows.current * heat[:, 0])
        of_magnet = between(turn), between(turn * through(np.ones_like(i_dq)))
        put("magnet_heating", *(column * heat[:, 0] for column in of_magnet))
        later = [windows.recording == k + 1 for k in range(MOST_RECORDINGS - 1)]
        put("copper_recordings", *(windows.current * own for own in later))
        put("magnet_recordings", *(column * own for own in later for column in of_magnet))
        if self.pole_pairs is not None and self.pole_pairs > 1:
            waves = _mechanical_waves(windows, self.pole_pairs)
            put("eccentricity", *(between(tilt * wave) for wave in waves))
            put("eccentric_rotor", *(between(turn * psi * wave) for wave in waves))
        put("resolver_first", *(between(tilt * f(windows.angle)) for f in (np.cos, np.sin)))
        put("resolver_second", *(between(tilt * f(2 * windows.angle)) for f in (np.cos, np.sin)))
        if np.isfinite(self.link):
            put("dc_link", -np.nan_to_num(windows.link / self.link - windows.voltage))
        a, b, c = 2 / 3 * (frames.phases(windows.current) * np.exp(1j * frames.PHASE_SHIFTS)).T
        put("phase_resistance", a - c, b - c)
        put("voltage_gains", -windows.voltage.conj(), -1j * windows.voltage.conj())
        return out

    def eccentricity(self, windows: Windows, candidates: Iterable[int]) -> Iterator[tuple[int, ComplexArray]]:
        """Yield numbers of pole pairs and the columns (N, 2 MOST_RUNS) of an eccentric resolver."""
        tilt = self._ends(windows).tilt
        for pole_pairs in candidates:
            waves = _mechanical_waves(windows, pole_pairs)
            yield pole_pairs, np.stack([between(tilt * wave) for wave in waves], axis=1)

    def _ends(self, windows: Windows) -> _Ends:
        """Evaluate the map, its harmonics and its Jacobian at the ends."""
        model, estimate = self.model, self.estimate
        flat, angle = windows.i_dq.reshape(-1, 2), windows.angle.reshape(-1, 1)
        flux, by_angle = model.flux.rows(flat).dot(estimate[model.map]), np.zeros((len(flat), 2))
        harmonic = model.harmonic.rows(flat)
        for order in model.orders:
            if estimate[model.harmonics[order]].any():
                a, b = (harmonic.dot(half) for half in np.split(estimate[model.harmonics[order]], 2))
                cosine, sine = np.cos(order * angle), np.sin(order * angle)
                flux, by_angle = flux + a * cosine + b * sine, by_angle + order * (b * cosine - a * sine)
        slopes = jacobian(model.flux, estimate[model.map], flat)
        shape, pair = windows.angle.shape, np.array([1.0, 1j])
        return _Ends(
            turn=np.exp(1j * windows.angle),
            i_dq=(flat @ pair).reshape(shape),
            psi=(flux @ pair).reshape(shape),
            by_angle=(by_angle @ pair).reshape(shape),
            slopes=np.moveaxis(np.einsum("nac,a->nc", slopes, pair).reshape(*shape, 2), -1, 0),
        )

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


class _Ends(NamedTuple):
    """The map at the ends of N windows, (N, 2) each."""

    turn: ComplexArray  # e^{j theta}
    i_dq: ComplexArray  # A
    psi: ComplexArray  # f(i, theta), Wb
    by_angle: ComplexArray  # its derivative by theta, Wb
    slopes: ComplexArray  # (2, N, 2), derivatives of the mean map by i_d and i_q, H

    def through(self, x: ComplexArray) -> ComplexArray:
        """Return f'(i) x."""
        return np.asarray(self.slopes[0] * x.real + self.slopes[1] * x.imag)

    @property
    def tilt(self) -> ComplexArray:
        """Change of the flux in the stator frame by an error of the angle, Wb."""
        return self.turn * (1j * self.psi + self.by_angle - self.through(1j * self.i_dq))


def between(x: ComplexArray) -> ComplexArray:
    """Return the differences (N,) of what is given at both ends of windows, (N, 2)."""
    return np.asarray(x[:, 1] - x[:, 0])


def _mechanical_waves(windows: Windows, pole_pairs: int) -> list[FloatArray]:
    """Return cosine and sine (N, 2) of the mechanical angle, in each run."""
    mechanical = windows.turned / pole_pairs
    waves = np.cos(mechanical), np.sin(mechanical)
    return [(windows.run == k)[:, None] * wave for k in range(MOST_RUNS) for wave in waves]
