"""What an experiment would tell method ``full``, before it is made.

With white residuals of deviation sigma the covariance of all unknowns is ``sigma^2 (Z'Z + P)^-1``, where P, the penalty
on the map's roughness, stands for what is known of maps beforehand: between the lines of a figure nothing else is. Z
needs no measurement: it consists of currents and angles at the ends of the windows, and of integrals over them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drive_id.core import frames
from drive_id.core.experiment.trajectories import Trajectory
from drive_id.core.full.model import FLUX_DEGREE, RESISTANCE, FullModel, ModelSpec, roughness
from drive_id.core.full.solver import FullSolution, Solver
from drive_id.core.full.windows import WINDOW_ANGLE, WindowCutter, Windows
from drive_id.core.maps.coenergy import GradientSpline
from drive_id.core.planning.settings import RoughMachine
from drive_id.types import FloatArray, Samples

PENALTY = 1e-3
"""Of the map's roughness: what cross-validation finds for recordings of ten seconds."""
DROP_SHARE = 0.01
"""Height of an inverter's drop that nobody knows, as a share of the DC link."""
CURVE_ERROR = 1e-5
"""What the fitted inverter curve misses, as a share of the DC link: it counts the more, the longer a window lasts."""

_SAMPLES_PER_WINDOW = 8
_COARSEST = 1e-3
"""s."""
_GRID = 25
_CURVE_NODES = 50
_CURVE_FOOT = 0.02


@dataclass(frozen=True)
class Prediction:
    """Deviations to be expected from the noise of the currents and the misfit of the inverter's curve, as fractions.

    Parameters
    ----------
    flux_d, flux_q : float
        Root mean square over the disc, of the largest flux of that axis.
    resistance : float
    inverter : float
        Root mean square of the curve up to i_max, of its height.
    free_resistance : float
        Of the resistance if the maps were not known to be reciprocal.
    """

    flux_d: float
    flux_q: float
    resistance: float
    inverter: float
    free_resistance: float

    @property
    def flux(self) -> float:
        """The larger one of both axes."""
        return max(self.flux_d, self.flux_q)

    def values(self) -> FloatArray:
        """Return all of them, (5,)."""
        return np.array([self.flux_d, self.flux_q, self.resistance, self.inverter, self.free_resistance])


@dataclass(frozen=True, eq=False)
class RoughModel(FullModel):
    """The model of method ``full`` with as many cells as wanted, and without the harmonics of the sensors.

    Parameters
    ----------
    cells : int
        Of the flux map along each axis.
    """

    cells: int

    @classmethod
    def over(cls, i_max: float, cells: int) -> RoughModel:
        """Cover the disc of a radius, A; with the sixth harmonic, which every machine has."""
        return cls(np.array([-i_max, -i_max]), np.array([i_max, i_max]), i_max, (6,), cells)

    @cached_property
    def flux(self) -> GradientSpline:
        """Space of the flux map."""
        return GradientSpline.within(self.low, self.high, self.cells, FLUX_DEGREE)

    @property
    def all_orders(self) -> tuple[int, ...]:
        """Harmonics in the order of their columns."""
        return self.orders


@dataclass(frozen=True, eq=False)
class Information:
    """What windows at one speed tell.

    Parameters
    ----------
    normal : (size, size) float
        Z'Z.
    rows : float
    window : float
        Mean duration of a window, s.
    """

    normal: FloatArray
    rows: float
    window: float

    def lasting(self, factor: float) -> Information:
        """Return what comes of an experiment that repeats itself this many times."""
        return Information(factor * self.normal, factor * self.rows, self.window)


def synthesize(
    machine: RoughMachine, trajectory: Trajectory, speed: float, seconds: float, sample_period: float
) -> Samples:
    """Return noise-free samples of a drive that follows a trajectory perfectly.

    Parameters
    ----------
    machine : RoughMachine
    trajectory : Trajectory
    speed : float
        Mechanical, rpm.
    seconds : float
    sample_period : float
        At least, s; longer where a window of 60 degrees has more samples than the information needs.
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


def inform(model: RoughModel, samples: Samples, most_windows: int) -> Information:
    """Accumulate Z'Z of samples, from ``most_windows`` of their windows at most, which count for the others, too."""
    cutter = WindowCutter(model.shapes)
    windows = Windows.joined([*cutter.cut(samples), *cutter.finish()])
    chosen = windows.part(slice(None, None, -(-len(windows) // most_windows)))
    rows = model.design(chosen).reshape(-1, model.size)
    information = Information(rows.T @ rows, float(len(rows)), float(windows.duration.mean()))
    return information.lasting(len(windows) / len(chosen))


def predict(model: RoughModel, parts: Sequence[Information], machine: RoughMachine, current_noise: float) -> Prediction:
    """Predict the deviations of a fit to all parts of an experiment.

    Parameters
    ----------
    model : RoughModel
    parts : sequence of Information
        One for each speed.
    machine : RoughMachine
    current_noise : float
        Deviation of each phase current's noise as a fraction of i_max.
    """
    total = np.sum([part.normal for part in parts], axis=0)
    solver = Solver(model, total[None], np.array([sum(part.rows for part in parts)]))
    variances = [_residual_variance(machine, current_noise, part.window) for part in parts]
    noise = np.sum([variance * part.normal for variance, part in zip(variances, parts, strict=True)], axis=0)
    noise += np.average(variances, weights=[part.rows for part in parts]) * roughness(model, total, PENALTY)
    resistance_form, ohm = np.eye(1, model.size, RESISTANCE), 1.0 / max(machine.resistance, 1e-12)
    free = _deviations(solver.solve(ModelSpec(False, model.all_orders, penalty=PENALTY)), noise, resistance_form)
    reciprocal = solver.solve(ModelSpec(True, model.all_orders, penalty=PENALTY))
    flux = _deviations(reciprocal, noise, _flux_forms(model)).reshape(-1, 2)
    flux_d, flux_q = np.sqrt((flux**2).mean(axis=0)) / machine.largest_flux
    curve = np.sqrt((_deviations(reciprocal, noise, _curve_forms(model)) ** 2).mean()) / (DROP_SHARE * machine.u_dc)
    resistance = ohm * _deviations(reciprocal, noise, resistance_form)[0]
    return Prediction(float(flux_d), float(flux_q), float(resistance), float(curve), float(ohm * free[0]))


def _residual_variance(machine: RoughMachine, current_noise: float, window: float) -> float:
    """Return the variance of one component of a window's residual, (Vs)^2.

    It is L (n_end - n_start), where n has 2/3 of the variance of a phase current's noise, and what the inverter's curve
    is not known to, integrated over the window.
    """
    square = 2 / 3 * (current_noise * machine.i_max) ** 2
    return float(2 * np.mean(machine.inductance**2) * square + (CURVE_ERROR * machine.u_dc * window) ** 2)


def _deviations(solution: FullSolution, noise: FloatArray, forms: FloatArray) -> FloatArray:
    """Return the deviations (K,) of linear forms (K, size) of the columns for scores of covariance ``noise``."""
    outer = solution.basis @ solution.gain(solution.basis.T @ forms.T)
    return np.asarray(np.sqrt(np.sum(outer * (noise @ outer), axis=0)))


def _flux_forms(model: RoughModel) -> FloatArray:
    """Return the forms (2 P, size) of psi_d and psi_q at P points of the disc in turn."""
    axis = np.linspace(-model.i_max, model.i_max, _GRID)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    points = points[np.hypot(*points.T) <= model.i_max]
    forms = np.zeros((len(points), 2, model.size))
    forms[:, :, model.map] = model.flux.rows(points).dense(model.flux.parameters)
    return forms.reshape(-1, model.size)


def _curve_forms(model: RoughModel) -> FloatArray:
    """Return the forms (K, size) of the inverter's curve at currents up to i_max."""
    current = model.i_max * np.linspace(_CURVE_FOOT, 1.0, _CURVE_NODES)
    forms = np.zeros((_CURVE_NODES, model.size))
    forms[:, model.phase_columns()[:, 0]] = model.shapes(current)
    return forms
