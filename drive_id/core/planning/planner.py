"""Plan an experiment: the Lissajous figure and the speeds that tell most about a drive in a given time.

Every candidate is scored by what method ``full`` would make of it, see :mod:`~drive_id.core.planning.prediction`.
Deviations fall with the root of the time, which gives the duration for a wanted accuracy.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.planning.candidates import (
    FEWEST_CYCLES,
    Experiment,
    figures,
    highest_frequency,
    needed_voltages,
    retimed,
    speed_range,
    speed_sets,
)
from drive_id.core.planning.prediction import Information, Prediction, RoughModel, inform, predict, synthesize
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.types import FloatArray, Progress, silent

PAPER_FREQUENCIES = (3.7, 1.1)
"""Hz, of d and q."""
PAPER_SPEED = 500.0
"""rpm."""

_SHORTEST = 4.0
"""s; less leaves gaps between the lines of the figure."""
_FIRST_GUESS = 10.0  # s
_RESERVE = 1.05
_WEIGHTS = np.array([2.0, 2.0, 1.0, 1.0, 1.0])
_MARGIN, _LOSS = 0.95, 20.0
_COARSE, _MIDDLE, _FINE = (8, 2000), (12, 3000), (16, 6000)
"""Cells of the map along each axis, and windows."""


@dataclass(frozen=True)
class Plan:
    """A proposal and what to expect of it.

    Parameters
    ----------
    settings : PlanSettings
    machine : RoughMachine
    experiment : Experiment
    prediction : Prediction
    paper : Experiment
        The paper's, of equal duration.
    paper_prediction : Prediction
    voltages : tuple of float
        Largest amplitude that the experiment needs at each speed, V.
    """

    settings: PlanSettings
    machine: RoughMachine
    experiment: Experiment
    prediction: Prediction
    paper: Experiment
    paper_prediction: Prediction
    voltages: tuple[float, ...]

    @property
    def met(self) -> bool:
        """Whether the wanted accuracy is to be expected."""
        return 100 * self.prediction.flux <= self.settings.accuracy

    def reason(self) -> str:
        """Say in a sentence why this experiment."""
        share = _measures(self.prediction) / _measures(self.paper_prediction)
        return (
            "Of the figures and speeds that the bench allows, these tell most about flux, R and inverter together: the "
            f"deviations are {share.min():.2f} to {share.max():.2f} times those of the paper's experiment in the same "
            "time."
        )

    def statements(self) -> list[str]:
        """Say in sentences what tells the unknowns apart in this experiment, and what stays open."""
        free, bound = 100 * self.prediction.free_resistance, 100 * self.prediction.resistance
        speeds = self.experiment.speeds
        sentences = []
        if len(speeds) == 1:
            sentences.append(
                f"One constant speed leaves R and a rotation of the map to the reciprocity of the maps: without it, "
                f"R is known to {free:.2g} % from the transients of the figure, with it to {bound:.2g} %."
            )
            sentences.append("A delay of the voltages, too, looks like a rotation of the map at one speed.")
        else:
            what = "several speeds" if len({abs(speed) for speed in speeds}) > 1 else "two directions"
            if len({abs(speed) for speed in speeds}) > 1 and min(speeds) < 0:
                what = "several speeds in both directions"
            sentences.append(
                f"The {what} separate R from a rotation of the map: even without reciprocity, R is known to "
                f"{free:.2g} %, and a delay of the voltages shows, too."
            )
        sentences.append(
            "No experiment of this kind tells the linear part of the inverter's drop from R, an offset of the angle "
            "from a turned map, or a common gain of voltages or currents from one of the flux."
        )
        return sentences

    def warnings(self) -> list[str]:
        """Say in sentences what is not as wanted."""
        found = []
        if not self.met:
            found.append(
                f"In {self.experiment.duration:g} s the flux comes to {100 * self.prediction.flux:.2g} %, not to the "
                f"wanted {self.settings.accuracy:g} %: allow {self.needed_duration():.3g} s, or reduce the noise."
            )
        if self.paper_infeasible():
            found.append(
                f"The paper's {PAPER_SPEED:g} rpm are not allowed on this bench: the comparison holds as if they were."
            )
        return found

    def needed_duration(self) -> float:
        """Return the duration for the wanted accuracy, s."""
        ratio = 100 * self.prediction.flux / self.settings.accuracy
        return self.experiment.duration * ratio**2

    def paper_infeasible(self) -> bool:
        """Tell whether the paper's speed lies outside of the allowed range or above the voltage limit."""
        inside = self.settings.speed_min <= PAPER_SPEED <= self.settings.speed_max
        return not inside or self.machine.steady_voltage(PAPER_SPEED) > self.machine.largest_voltage


@one_blas_thread(with_scipy=True)
def plan(settings: PlanSettings, tell: Progress = silent) -> Plan:
    """Propose an experiment.

    Parameters
    ----------
    settings : PlanSettings
        Complete in what concerns the machine.
    tell : callable, optional

    Raises
    ------
    ConfigurationError
        When something is missing, or the drive cannot be driven over the disc.
    """
    machine = RoughMachine.from_settings(settings)
    highest = highest_frequency(settings, machine)
    low, high = speed_range(settings, machine, highest)
    duration = settings.duration or min(_FIRST_GUESS, settings.duration_max)

    tell("Choosing the speeds", 0.0)
    usual = Experiment(Lissajous(machine.i_max, highest, 0.618 * highest), (low,), duration)
    usual = retimed(usual, duration, highest)
    sets = [replace(usual, speeds=speeds) for speeds in speed_sets(low, high, reverse=settings.reverse)]
    best = _best(_Scout(settings, machine, _COARSE), sets)

    tell("Choosing the figure", 0.4)
    at_one = [
        replace(usual, trajectory=figure, speeds=best.speeds[:1])
        for figure in figures(machine.i_max, highest, usual.figure)
    ]
    best = replace(best, trajectory=_best(_Scout(settings, machine, _MIDDLE), at_one).trajectory)

    tell("Comparing with the paper's experiment", 0.8)
    scout = _Scout(settings, machine, _FINE)
    prediction = scout.predict(best)
    if settings.duration is None:
        needed = duration * (100 * prediction.flux / settings.accuracy) ** 2
        duration = float(
            min(max(math.ceil(_RESERVE * needed), _SHORTEST, FEWEST_CYCLES / highest), settings.duration_max)
        )
        best = retimed(best, duration, highest)
        prediction = scout.predict(best)
    paper = _paper(machine, duration)
    voltages = needed_voltages(machine, best, settings.sample_period)
    return Plan(settings, machine, best, prediction, paper, scout.predict(paper), voltages)


def cost(prediction: Prediction) -> float:
    """Return the sum of the logarithms of all deviations, those of the flux counting twice: no scale has to be set."""
    return float(_WEIGHTS @ np.log(prediction.values()))


class _Scout:
    """Predicts experiments, remembering what each figure tells at each speed."""

    def __init__(self, settings: PlanSettings, machine: RoughMachine, fineness: tuple[int, int]) -> None:
        cells, self._windows = fineness
        self.settings, self.machine = settings, machine
        self._model = RoughModel.over(machine.i_max, cells)
        self._known: dict[tuple[Lissajous, float, float], Information] = {}

    def predict(self, experiment: Experiment) -> Prediction:
        parts = [self._inform(experiment, speed) for speed in experiment.speeds]
        return predict(self._model, parts, self.machine, self.settings.current_noise)

    def _inform(self, experiment: Experiment, speed: float) -> Information:
        """Return the information of the whole figure at one speed, for the share of it that falls to this speed."""
        key = experiment.trajectory, speed, experiment.figure
        if key not in self._known:
            samples = synthesize(self.machine, *key, self.settings.sample_period)
            self._known[key] = inform(self._model, samples, self._windows)
        return self._known[key].lasting(experiment.share / experiment.figure)


def _best(scout: _Scout, trials: Iterable[Experiment]) -> Experiment:
    """Return the experiment of least cost; being no better than the paper's in one of the deviations costs a lot."""
    trials = list(trials)
    paper = _measures(scout.predict(_paper(scout.machine, trials[0].duration)))

    def rank(trial: Experiment) -> float:
        prediction = scout.predict(trial)
        excess = np.log(_measures(prediction) / (_MARGIN * paper))
        return cost(prediction) + _LOSS * float(np.maximum(excess, 0.0).sum())

    return min(trials, key=rank)


def _measures(prediction: Prediction) -> FloatArray:
    return prediction.values()[:4]


def _paper(machine: RoughMachine, duration: float) -> Experiment:
    return Experiment(Lissajous(machine.i_max, *PAPER_FREQUENCIES), (PAPER_SPEED,), duration)
