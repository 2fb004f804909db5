"""Prediction of the standard errors of method ``full`` before any measurement (optimal experiment design).

With white residuals of standard deviation sigma the covariance of all unknowns is ``sigma^2 (Z'Z + P)^-1``. The
roughness penalty P is the prior on the map between the lines of the figure. Z needs no measurement: it consists of the
currents and angles at the ends of the windows and of integrals over the windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from drive_id.core import frames
from drive_id.core.experiment.trajectories import Trajectory
from drive_id.core.full.model import RESISTANCE, FullModel, ModelSpec, roughness
from drive_id.core.full.resolution import Resolution
from drive_id.core.full.solver import FullSolution, Solver
from drive_id.core.full.windows import WINDOW_ANGLE, WindowCutter, Windows
from drive_id.core.maps.coenergy import bent_edges
from drive_id.core.numerics.normal_equations import triangle_of
from drive_id.core.planning.settings import RoughMachine
from drive_id.types import FloatArray, Samples

PENALTY = 1e-3  # weight of the roughness penalty: the one that cross-validation finds for recordings of ten seconds
DROP_SHARE = 0.01  # assumed height of an unknown inverter's voltage error, as a fraction of the DC-link voltage
CURVE_ERROR = 1e-5
"""Assumed misfit of the inverter curve, as a fraction of the DC-link voltage; it weighs more in longer windows."""

_SAMPLES_PER_WINDOW = 8  # of synthesized samples: a figure is smooth within a window
_COARSEST = 1e-3  # longest period of synthesized samples, s
_GRID = 25  # points of the map along each axis at which its standard errors are averaged
_CURVE_NODES = 50  # currents at which those of the curve are averaged
_CURVE_FOOT = 0.02  # the lowest of them, by i_max


@dataclass(frozen=True)
class Prediction:
    """Expected standard errors from current noise and misfit of the inverter curve, as fractions."""

    flux_d: float  # root mean square over the disc, by the largest flux of that axis
    flux_q: float  # likewise
    resistance: float
    inverter: float  # root mean square of the curve up to i_max, by its height
    free_resistance: float  # of the resistance without the assumption of reciprocal maps

    @property
    def flux(self) -> float:
        """The larger one of both axes."""
        return max(self.flux_d, self.flux_q)

    def values(self) -> FloatArray:
        """Return all of them, (5,)."""
        return np.array([self.flux_d, self.flux_q, self.resistance, self.inverter, self.free_resistance])


@dataclass(frozen=True, eq=False)
class FisherMatrix:
    """Fisher information of the windows at one speed, for unit variance."""

    normal: FloatArray  # Z'Z, (size, size)
    rows: float
    window: float  # mean duration of a window, s

    def lasting(self, factor: float) -> FisherMatrix:
        """Return the information of this many repetitions."""
        return FisherMatrix(factor * self.normal, factor * self.rows, self.window)


def rough_model(i_max: float, cells: int) -> FullModel:
    """Return the model over a disc of radius ``i_max``, A, with the sixth harmonic, which every machine has."""
    edges = bent_edges(-i_max, i_max, cells)
    return FullModel(np.full(2, -i_max), np.full(2, i_max), i_max, (6,), cells=Resolution(edges, edges))


def synthesize(
    machine: RoughMachine, trajectory: Trajectory, speed: float, seconds: float, sample_period: float
) -> Samples:
    """Return noise-free samples of a drive that follows a trajectory perfectly at a mechanical speed, rpm.

    The sample period, s, is a lower bound: it is longer where a window of 60 degrees needs fewer samples.
    """
    omega = machine.electrical(speed)
    period = float(np.clip(WINDOW_ANGLE / abs(omega) / _SAMPLES_PER_WINDOW, sample_period, _COARSEST))
    period = max(period, sample_period)
    count = max(2, round(seconds / period))
    time = period * np.arange(count + 1, dtype=np.float64)
    i_dq, angle = trajectory(time), omega * time
    turn = np.exp(1j * angle)
    psi_s = (machine.flux(i_dq) @ np.array([1.0, 1j])) * turn
    u_s = np.diff(psi_s) / period + machine.resistance * (i_dq @ np.array([1.0, 1j]) * turn)[:-1]
    return Samples(
        stamp=np.round(time[:-1] * 1e9).astype(np.int64),
        i_abc=frames.to_abc(i_dq[:-1], angle[:-1]),
        u_abc=frames.phases(u_s),
        angle=angle[:-1],
        speed=np.full(count, omega),
        sample_period=period,
    )


def fisher_information(model: FullModel, samples: Samples, most_windows: int) -> FisherMatrix:
    """Return Z'Z of samples, extrapolated from at most ``most_windows`` of their windows."""
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()])
    chosen = windows.thinned(most_windows)
    each = sparse.eye_array(model.size, format="csr")
    rows = model.design_times(chosen, each, model.orders).reshape(-1, model.size)
    information = FisherMatrix(rows.T @ rows, float(len(rows)), float(windows.duration.mean()))
    return information.lasting(len(windows) / len(chosen))


def predict(model: FullModel, parts: Sequence[FisherMatrix], machine: RoughMachine, current_noise: float) -> Prediction:
    """Predict the standard errors of a fit to all parts of an experiment, one for each speed.

    ``current_noise`` is the standard deviation of each phase current's noise as a fraction of i_max.
    """
    total = np.sum([part.normal for part in parts], axis=0)
    solver = Solver(model, [triangle_of(total)], np.array([sum(part.rows for part in parts)]))
    variances = [_residual_variance(machine, current_noise, part.window) for part in parts]
    noise = np.sum([variance * part.normal for variance, part in zip(variances, parts, strict=True)], axis=0)
    noise += np.average(variances, weights=[part.rows for part in parts]) * roughness(model, total, PENALTY)
    resistance_form, ohm = np.eye(1, model.size, RESISTANCE), 1.0 / max(machine.resistance, 1e-12)
    free = _standard_errors(solver.solve(ModelSpec(False, model.orders, penalty=PENALTY)), noise, resistance_form)
    reciprocal = solver.solve(ModelSpec(True, model.orders, penalty=PENALTY))
    flux = _standard_errors(reciprocal, noise, _flux_forms(model)).reshape(-1, 2)
    flux_d, flux_q = np.sqrt((flux**2).mean(axis=0)) / machine.largest_flux
    curve = np.sqrt((_standard_errors(reciprocal, noise, _curve_forms(model)) ** 2).mean()) / (
        DROP_SHARE * machine.u_dc
    )
    resistance = ohm * _standard_errors(reciprocal, noise, resistance_form)[0]
    return Prediction(float(flux_d), float(flux_q), float(resistance), float(curve), float(ohm * free[0]))


def _residual_variance(machine: RoughMachine, current_noise: float, window: float) -> float:
    """Return the variance of one component of a window's residual, (Vs)^2.

    The sum of L (n_end - n_start), where n has 2/3 of the variance of a phase current's noise, and of the misfit of the
    inverter curve integrated over the window.
    """
    square = 2 / 3 * (current_noise * machine.i_max) ** 2
    return float(2 * np.mean(machine.inductance**2) * square + (CURVE_ERROR * machine.u_dc * window) ** 2)


def _standard_errors(solution: FullSolution, noise: FloatArray, forms: FloatArray) -> FloatArray:
    """Return the standard errors (K,) of linear forms (K, size) of the unknowns, for scores of covariance ``noise``."""
    outer = solution.basis @ solution.gain(solution.basis.T @ forms.T)
    return np.asarray(np.sqrt(np.sum(outer * (noise @ outer), axis=0)))


def _flux_forms(model: FullModel) -> FloatArray:
    """Return the linear forms (2 P, size) of psi_d and psi_q at P points of the disc, interleaved."""
    axis = np.linspace(-model.i_max, model.i_max, _GRID)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    points = points[np.hypot(*points.T) <= model.i_max]
    forms = np.zeros((len(points), 2, model.size))
    forms[:, :, model.map] = model.flux.rows(points).dense(model.flux.parameters)
    return forms.reshape(-1, model.size)


def _curve_forms(model: FullModel) -> FloatArray:
    """Return the linear forms (K, size) of the inverter curve at currents up to i_max."""
    current = model.i_max * np.linspace(_CURVE_FOOT, 1.0, _CURVE_NODES)
    forms = np.zeros((_CURVE_NODES, model.size))
    forms[:, model.phase_columns()[:, 0]] = model.shapes(current)
    return forms
