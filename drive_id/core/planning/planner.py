"""Plan an experiment: the Lissajous figure and the speeds that determine a drive best in a given time.

Every candidate is rated by the standard errors that method ``full`` would reach, see
:mod:`~drive_id.core.planning.prediction`. They fall with the root of the time, which gives the duration for a wanted
accuracy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.common.arguments import expect
from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.frames import space_vector
from drive_id.core.full.windows import LONGEST_WINDOW, WINDOW_ANGLE
from drive_id.core.numerics.threads import one_blas_thread
from drive_id.core.planning.prediction import (
    DROP_SHARE,
    FisherMatrix,
    Prediction,
    fisher_information,
    predict,
    rough_model,
    synthesize,
)
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError
from drive_id.types import FloatArray, Progress, silent

PAPER_FREQUENCIES = (3.7, 1.1)  # of d and q, Hz
PAPER_SPEED = 500.0  # rpm

_SHORTEST = 4.0  # s; less leaves gaps between the lines of the figure
_FIRST_GUESS = 10.0  # s
_RESERVE = 1.05  # factor on the duration that the wanted accuracy needs: it was predicted for another one
_WEIGHTS = np.array([2.0, 2.0, 1.0, 1.0, 1.0])
"""Of the logarithms of the standard errors in the cost: logarithms need no scales."""
_MARGIN = 0.95  # standard error by the paper's that no plan should exceed
_LOSS = 20.0  # cost of exceeding it, by its logarithm: no gain of another makes up for it
_COARSE = (8, 2000)  # cells of the map along each axis, and windows, to choose speeds
_MIDDLE = (12, 3000)  # to choose the figure
_FINE = (16, 6000)  # to predict the standard errors
LONGEST_FIGURE = 10.0  # s; longer experiments repeat the figure
FEWEST_CYCLES = 8  # of the higher frequency, in one figure
_RATIOS = (1.0, 0.618, 0.382, 0.236)  # of the lower to the higher frequency
_SHARES = (1.0, 0.5)  # of the highest frequency allowed
_MOST_SPEEDS = 4  # speeds from the lowest to the highest that are combined
_BANDWIDTH_SHARE = 0.1  # highest frequency of the references by the bandwidth of the current controller
_SLOPE_VOLTAGE_SHARE = 0.2  # part of the largest voltage that the slopes of the references may take
_VOLTAGE_SHARE = 0.95  # part of the largest voltage that an experiment may take
_FEWEST_SAMPLES = 4  # in a window, at the highest speed


@dataclass(frozen=True)
class PlannedExperiment:
    """An experiment to choose from: a Lissajous figure driven at one or several speeds."""

    trajectory: Lissajous
    speeds: tuple[float, ...]  # mechanical, rpm, each for an equal share of the time; negative: backwards
    duration: float  # all speeds together, s

    @property
    def share(self) -> float:
        """Duration at each speed, s."""
        return self.duration / len(self.speeds)

    @property
    def figure(self) -> float:
        """Time after which the figure closes, s."""
        return self.duration / math.ceil(self.duration / LONGEST_FIGURE)


@dataclass(frozen=True)
class Plan:
    """The proposed experiment and its predicted accuracy."""

    settings: PlanSettings
    machine: RoughMachine
    experiment: PlannedExperiment
    prediction: Prediction
    paper: PlannedExperiment  # the paper's, of the same duration
    paper_prediction: Prediction
    voltages: tuple[float, ...]  # largest amplitude needed at each speed, V

    @property
    def met(self) -> bool:
        """Whether the predicted accuracy is as wanted."""
        return 100 * self.prediction.flux <= self.settings.accuracy

    def reason(self) -> str:
        """Say in one sentence why this experiment was chosen."""
        share = _measures(self.prediction) / _measures(self.paper_prediction)
        return (
            "Of the figures and speeds that the bench allows, these determine flux, R and inverter best: the standard "
            f"errors are {share.min():.2f} to {share.max():.2f} times those of the paper's experiment of the "
            "same duration."
        )

    def statements(self) -> list[str]:
        """Say what separates the unknowns in this experiment, and what it cannot determine."""
        free, bound = 100 * self.prediction.free_resistance, 100 * self.prediction.resistance
        speeds = self.experiment.speeds
        sentences = []
        if len(speeds) == 1:
            sentences.append(
                "At one constant speed only the reciprocity of the maps separates R from a rotation of the map: "
                f"without it, the transients of the figure determine R to {free:.2g} %, with it to {bound:.2g} %."
            )
            sentences.append("At one speed, a delay of the voltages looks like a rotation of the map, too.")
        else:
            several, both = len({abs(speed) for speed in speeds}) > 1, min(speeds) < 0
            what = f"several speeds{' in both directions' if both else ''}" if several else "two directions"
            sentences.append(
                f"The {what} separate R from a rotation of the map: even without reciprocity, R is determined "
                f"to {free:.2g} %, and so is a delay of the voltages."
            )
        return [
            *sentences,
            "Cannot be separated: the linear part of the inverter's voltage error, from R.",
            "Cannot be separated: an angle offset, from a rotated map.",
            "Cannot be separated: a common gain of voltages or currents, from a gain of the flux.",
        ]

    def warnings(self) -> list[str]:
        """Say what is not as wanted."""
        found, reached, wanted = [], 100 * self.prediction.flux, self.settings.accuracy
        if not self.met:
            needed = self.experiment.duration * (reached / wanted) ** 2
            found.append(
                f"In {self.experiment.duration:g} s the flux reaches {reached:.2g} %, not the wanted {wanted:g} %: "
                f"allow {needed:.3g} s, or reduce the noise."
            )
        inside = self.settings.speed_min <= PAPER_SPEED <= self.settings.speed_max
        if not inside or self.machine.steady_voltage(PAPER_SPEED) > self.machine.largest_voltage:
            found.append(
                f"The bench does not allow the paper's {PAPER_SPEED:g} rpm: the comparison assumes that it does."
            )
        return found


@one_blas_thread()
def plan(settings: PlanSettings, tell: Progress = silent) -> Plan:
    """Propose an experiment.

    Parameters
    ----------
    settings : PlanSettings
        With all data of the machine.
    tell : callable, optional

    Raises
    ------
    ConfigurationError
        When data are missing, or the bench cannot cover the disc.
    """
    expect(settings, PlanSettings, "settings", "give drive_id.PlanSettings(i_max=..., ...)")
    machine = RoughMachine.from_settings(settings)
    highest = highest_frequency(settings, machine)
    low, high = speed_range(settings, machine, highest)
    duration = settings.duration or min(_FIRST_GUESS, settings.duration_max)

    tell("Choosing the speeds", 0.0)
    usual = PlannedExperiment(Lissajous(machine.i_max, highest, 0.618 * highest), (low,), duration)
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


class _Scout:
    """Predicts experiments and caches the information of each figure at each speed."""

    def __init__(self, settings: PlanSettings, machine: RoughMachine, fineness: tuple[int, int]) -> None:
        cells, self._windows = fineness
        self.settings, self.machine = settings, machine
        self._model = rough_model(machine.i_max, cells)
        self._known: dict[tuple[Lissajous, float, float], FisherMatrix] = {}

    def predict(self, experiment: PlannedExperiment) -> Prediction:
        parts = [self._information(experiment, speed) for speed in experiment.speeds]
        return predict(self._model, parts, self.machine, self.settings.current_noise)

    def _information(self, experiment: PlannedExperiment, speed: float) -> FisherMatrix:
        """Return the information of the experiment's share at one speed."""
        key = experiment.trajectory, speed, experiment.figure
        if key not in self._known:
            samples = synthesize(self.machine, *key, self.settings.sample_period)
            self._known[key] = fisher_information(self._model, samples, self._windows)
        return self._known[key].lasting(experiment.share / experiment.figure)


def _best(scout: _Scout, trials: Iterable[PlannedExperiment]) -> PlannedExperiment:
    """Return the experiment of least cost, which is high where one standard error exceeds the paper's."""
    trials = list(trials)
    paper = _measures(scout.predict(_paper(scout.machine, trials[0].duration)))

    def rank(trial: PlannedExperiment) -> float:
        prediction = scout.predict(trial)
        excess = np.log(_measures(prediction) / (_MARGIN * paper))
        return float(_WEIGHTS @ np.log(prediction.values())) + _LOSS * float(np.maximum(excess, 0.0).sum())

    return min(trials, key=rank)


def _measures(prediction: Prediction) -> FloatArray:
    return prediction.values()[:4]


def _paper(machine: RoughMachine, duration: float) -> PlannedExperiment:
    return PlannedExperiment(Lissajous(machine.i_max, *PAPER_FREQUENCIES), (PAPER_SPEED,), duration)


def highest_frequency(settings: PlanSettings, machine: RoughMachine) -> float:
    """Return the highest frequency of the references, Hz, that controller, load machine and voltage allow."""
    volts_per_hertz = 2 * math.pi * machine.i_max * float(machine.inductance.max())
    by_voltage = _SLOPE_VOLTAGE_SHARE * machine.largest_voltage / volts_per_hertz
    return min(settings.frequency_max, _BANDWIDTH_SHARE * settings.current_bandwidth, by_voltage)


def speed_range(settings: PlanSettings, machine: RoughMachine, frequency: float) -> tuple[float, float]:
    """Return the lowest and the highest mechanical speed, rpm, at which figures can be driven and evaluated.

    ``frequency`` is the highest of the references, Hz. Raises ConfigurationError when no allowed speed is one.
    """
    per_rpm = machine.electrical(1.0)
    slowest = WINDOW_ANGLE / LONGEST_WINDOW / per_rpm
    fastest = WINDOW_ANGLE / (_FEWEST_SAMPLES * settings.sample_period) / per_rpm
    low, high = max(settings.speed_min, slowest), min(settings.speed_max, fastest)
    if low > high:
        raise ConfigurationError(
            f"The fit needs 60 degrees electrical in {_FEWEST_SAMPLES} samples to {LONGEST_WINDOW:g} s, which is from "
            f"{slowest:.4g} to {fastest:.4g} rpm, and {settings.speed_min:g} to {settings.speed_max:g} rpm are "
            "allowed: allow other speeds, or sample faster."
        )
    limit = _VOLTAGE_SHARE * machine.largest_voltage - DROP_SHARE * machine.u_dc
    limit -= 2 * math.pi * math.sqrt(2) * frequency * machine.i_max * float(machine.inductance.max())
    if machine.steady_voltage(low) > limit:
        raise ConfigurationError(
            f"At {low:.4g} rpm the disc of {machine.i_max:g} A takes {machine.steady_voltage(low):.4g} V, where "
            f"u_dc / sqrt(3) leaves {limit:.4g} V for it: reduce i_max or speed_min, or raise u_dc."
        )
    inside, outside = low, high
    while machine.steady_voltage(high) > limit and outside - inside > 1e-3 * low:
        middle = 0.5 * (inside + outside)
        inside, outside = (middle, outside) if machine.steady_voltage(middle) <= limit else (inside, middle)
    return low, high if machine.steady_voltage(high) <= limit else inside


def speed_sets(low: float, high: float, *, reverse: bool) -> list[tuple[float, ...]]:
    """Return sets of speeds, rpm, within a range; two or more wherever possible.

    One constant speed cannot separate resistance or voltage delay from a rotation of the map. Both directions separate
    what changes its sign with the speed from what does not, so they are used where the bench allows it.
    """
    steps = sorted({_rounded(speed, low, high) for speed in np.geomspace(low, high, _MOST_SPEEDS)})
    pairs = list(itertools.combinations(steps, 2))
    if reverse:
        both = [(a, -a) for a in steps] + [(a, -b) for a, b in pairs]
        return both + [(a, b, -b, -a) for a, b in pairs]
    return [*pairs] or [(steps[0],)]


def figures(i_max: float, highest: float, period: float) -> Iterator[Lissajous]:
    """Yield figures of an amplitude, A, up to the highest frequency, Hz, that close after a period, s.

    Their frequencies are coprime multiples of its inverse, so that the figure closes then and not before, and covers
    the disc with evenly spaced lines. Raises ConfigurationError when the period is too short for these frequencies.
    """
    if highest * period < FEWEST_CYCLES:
        raise ConfigurationError(
            f"In {period:.3g} s, references of up to {highest:.3g} Hz do not cover the disc: allow more time, up to "
            f"{LONGEST_FIGURE:g} s, or higher frequencies."
        )
    for share, ratio in itertools.product(_SHARES, _RATIOS):
        upper = math.floor(share * highest * period + 1e-9)
        wanted, coprime = round(ratio * upper), (number for number in range(1, upper) if math.gcd(number, upper) == 1)
        lower = min(coprime, key=lambda number: abs(number - wanted))
        for d, q in ((upper, lower), (lower, upper)):
            yield Lissajous(i_max, round(d / period, 6), round(q / period, 6))


def retimed(experiment: PlannedExperiment, duration: float, highest: float) -> PlannedExperiment:
    """Return an experiment of another duration, s, with the most similar figure that closes then."""
    old, other = experiment.trajectory, replace(experiment, duration=duration)
    wanted = np.log([old.frequency_d, old.frequency_q])

    def distance(figure: Lissajous) -> float:
        return float(np.abs(np.log([figure.frequency_d, figure.frequency_q]) - wanted).sum())

    return replace(other, trajectory=min(figures(old.i_max, highest, other.figure), key=distance))


def needed_voltages(machine: RoughMachine, experiment: PlannedExperiment, sample_period: float) -> tuple[float, ...]:
    """Return the largest voltage amplitude, V, at each speed of an experiment, the inverter's error included."""
    figures = (
        synthesize(machine, experiment.trajectory, speed, experiment.figure, sample_period)
        for speed in experiment.speeds
    )
    drop = DROP_SHARE * machine.u_dc
    return tuple(float(np.abs(space_vector(samples.u_abc)).max()) + drop for samples in figures)


def _rounded(speed: float, low: float, high: float) -> float:
    """Return a speed rounded to two digits if that lies in the range."""
    short = float(f"{speed:.2g}")
    return short if low <= short <= high else round(speed, 3 - math.floor(math.log10(speed)))
