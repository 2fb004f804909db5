"""Lissajous figures and speeds from which a plan is chosen: all of them can be driven and evaluated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drive_id.core.experiment.trajectories import Lissajous
from drive_id.core.frames import space_vector
from drive_id.core.full.windows import LONGEST_WINDOW, WINDOW_ANGLE
from drive_id.core.planning.prediction import DROP_SHARE, synthesize
from drive_id.core.planning.settings import PlanSettings, RoughMachine
from drive_id.errors import ConfigurationError

LONGEST_FIGURE = 10.0
"""s; what lasts longer repeats its figure."""

FEWEST_CYCLES = 8
"""Of the higher frequency in a figure."""

_RATIOS = (1.0, 0.618, 0.382, 0.236)
"""Of the lower to the higher frequency."""
_SHARES = (1.0, 0.5)
"""Of the highest frequency allowed."""
_MOST_SPEEDS = 4
_BANDWIDTH_SHARE = 0.1
_SLOPE_VOLTAGE_SHARE = 0.2
_VOLTAGE_SHARE = 0.95
_FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Experiment:
    """A Lissajous figure, with one speed after the other on the way.

    Parameters
    ----------
    trajectory : Lissajous
    speeds : tuple of float
        Mechanical, rpm, for equal shares of the time; negative: backwards.
    duration : float
        At all speeds together, s.
    """

    trajectory: Lissajous
    speeds: tuple[float, ...]
    duration: float

    @property
    def share(self) -> float:
        """Duration at each speed, s."""
        return self.duration / len(self.speeds)

    @property
    def figure(self) -> float:
        """Duration, s, after which a figure for this experiment is to close."""
        return self.duration / math.ceil(self.duration / LONGEST_FIGURE)


def highest_frequency(settings: PlanSettings, machine: RoughMachine) -> float:
    """Return the highest frequency of the references, Hz, that controller, load machine and voltage allow."""
    volts_per_hertz = 2 * math.pi * machine.i_max * float(machine.inductance.max())
    by_voltage = _SLOPE_VOLTAGE_SHARE * machine.largest_voltage / volts_per_hertz
    return min(settings.frequency_max, _BANDWIDTH_SHARE * settings.current_bandwidth, by_voltage)


def speed_range(settings: PlanSettings, machine: RoughMachine, frequency: float) -> tuple[float, float]:
    """Return the lowest and the highest mechanical speed, rpm, at which figures can be driven and evaluated.

    Parameters
    ----------
    settings : PlanSettings
    machine : RoughMachine
    frequency : float
        Highest of the references, Hz.

    Raises
    ------
    ConfigurationError
        When there is none in the allowed range.
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
    """Return sets of speeds, rpm, within a range: never one alone where there can be two.

    One constant speed does not tell a resistance, nor a delay of the voltages, from a rotation of the map. Both
    directions tell apart what changes its sign with the speed from what does not, so they are used when they may.
    """
    steps = sorted({_rounded(speed, low, high) for speed in np.geomspace(low, high, _MOST_SPEEDS)})
    pairs = list(itertools.combinations(steps, 2))
    if reverse:
        both = [(a, -a) for a in steps] + [(a, -b) for a, b in pairs]
        return both + [(a, b, -b, -a) for a, b in pairs]
    return [*pairs] or [(steps[0],)]


def figures(i_max: float, highest: float, period: float) -> Iterator[Lissajous]:
    """Yield figures that close after a time.

    Their frequencies are coprime multiples of its inverse, so that the figure has closed by then and not before, and
    covers the disc with evenly spaced lines.

    Parameters
    ----------
    i_max : float
        A.
    highest : float
        Frequency, Hz.
    period : float
        s.

    Raises
    ------
    ConfigurationError
        When there is no time for a figure of so low frequencies.
    """
    if highest * period < FEWEST_CYCLES:
        raise ConfigurationError(
            f"In {period:.3g} s, references of up to {highest:.3g} Hz do not fill the disc: allow more time, up to "
            f"{LONGEST_FIGURE:g} s, or higher frequencies."
        )
    for share, ratio in itertools.product(_SHARES, _RATIOS):
        upper = math.floor(share * highest * period + 1e-9)
        lower = next(number for number in _nearest(round(ratio * upper), upper) if math.gcd(number, upper) == 1)
        for d, q in ((upper, lower), (lower, upper)):
            yield Lissajous(i_max, round(d / period, 6), round(q / period, 6))


def retimed(experiment: Experiment, duration: float, highest: float) -> Experiment:
    """Return an experiment of another duration, s, with the figure closing then that is most like the given one."""
    old, other = experiment.trajectory, replace(experiment, duration=duration)
    wanted = np.log([old.frequency_d, old.frequency_q])

    def distance(figure: Lissajous) -> float:
        return float(np.abs(np.log([figure.frequency_d, figure.frequency_q]) - wanted).sum())

    return replace(other, trajectory=min(figures(old.i_max, highest, other.figure), key=distance))


def needed_voltages(machine: RoughMachine, experiment: Experiment, sample_period: float) -> tuple[float, ...]:
    """Return the largest voltage amplitude, V, at each speed of an experiment, with an inverter's drop."""
    figures = (
        synthesize(machine, experiment.trajectory, speed, experiment.figure, sample_period)
        for speed in experiment.speeds
    )
    drop = DROP_SHARE * machine.u_dc
    return tuple(float(np.abs(space_vector(samples.u_abc)).max()) + drop for samples in figures)


def _nearest(number: int, below: int) -> Iterator[int]:
    """Yield the whole numbers from 1 to below ``below``, the nearest to ``number`` first."""
    yield from sorted(range(1, below), key=lambda candidate: abs(candidate - number))


def _rounded(speed: float, low: float, high: float) -> float:
    """Return a speed with two digits if these lie in the range."""
    short = float(f"{speed:.2g}")
    return short if low <= short <= high else round(speed, 3 - math.floor(math.log10(speed)))
