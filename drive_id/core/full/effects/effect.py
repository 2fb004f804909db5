"""What an effect of a real drive is: its columns of the regression, what physics allows, and how it is reported."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from drive_id.common.messages import Message
from drive_id.core import frames
from drive_id.core.frames import ComplexArray
from drive_id.core.full.windows import Windows, held_shares
from drive_id.types import TINY, FloatArray, IntArray

_LATENESS = 1.5
"""Of the currents by which firmware compensates, sample periods: it takes those of the sample before, and holds."""
MOST_RUNS, MOST_PARTS = 4, 8
"""Most runs with separate mechanical angles, and most parts of the data with separate temperatures."""
CERTAIN = 3.0
"""Standard errors from which on a sign, or a share that is not possible, is certain."""
VOLTAGE_MISMATCH = "voltage_gain_mismatch"


@dataclass(frozen=True)
class Calibration:
    """One estimated effect or sensor fault."""

    name: str
    value: float  # estimate, and below its standard error
    sigma: float
    unit: str
    applied: bool  # whether the signals are corrected by it
    message: Message  # the finding, and the reason if it was not applied
    doubtful: bool = False  # the data contradict this fault, or it is too large to be corrected


def between(x: ComplexArray) -> ComplexArray:
    """Return the differences (N,) between the ends of windows (N, 2)."""
    return np.asarray(x[:, 1] - x[:, 0])


def divided(kept: Iterable[Windows]) -> str:
    """Return what tells the parts of the data apart, between which a drive may change.

    The sections between pauses, or the recordings where those are too many.
    """
    return "section" if max(int(windows.section.max()) for windows in kept) < MOST_PARTS else "recording"


def parts(kept: Sequence[Windows]) -> int:
    """Return the number of parts of the data."""
    by = divided(kept)
    return 1 + max(int(getattr(windows, by).max()) for windows in kept)


@dataclass(frozen=True, eq=False)
class Ends:
    """N windows, and what moves the currents at their ends."""

    windows: Windows
    currents: ComplexArray  # (N, 2), measured in the rotor frame, A
    turn: ComplexArray  # (N, 2), e^{j theta}
    induced: ComplexArray  # (N, 2), voltage e in the rotor frame, V
    fallen: FloatArray  # (N, 2, 3), drop of the inverter in each phase, V
    pole_pairs: int | None
    part: IntArray  # (N,), number of the part of the data, see :func:`divided`
    steady: float  # the one speed of all data, rad/s; 0 where there are several
    tracking: float  # square root of the lag of the angle per acceleration, s
    elapsed: FloatArray  # (N,), time of the middle since that of the recording, s

    @property
    def rate(self) -> ComplexArray:
        """Time derivative (N, 2) of the current's space vector, turned to the rotor frame, A/s."""
        return self.windows.slope + 1j * self.windows.speed * self.currents

    def in_runs(self, waves: Sequence[FloatArray | ComplexArray]) -> list[Any]:
        """Return waves (N,) or (N, 2) in each run, as columns of their own."""
        runs = [self.windows.run == k for k in range(MOST_RUNS)]
        return [wave * (run[:, None] if wave.ndim > 1 else run) for run in runs for wave in waves]

    def of_parts(self) -> list[FloatArray]:
        """Tell for each part of the data but the first which windows are of it."""
        return [self.part == k + 1 for k in range(MOST_PARTS - 1)]


@dataclass(frozen=True, eq=False)
class Linearized(Ends):
    """What an estimate says of these ends, about which effects are linearized."""

    psi: ComplexArray  # (N, 2), f, Wb
    tilt: ComplexArray  # (N, 2), change of the stator's flux by an error of the angle, Wb
    through: Callable[[ComplexArray], ComplexArray]  # f'(i) x of x (N, 2)
    mean_flux: Callable[[ComplexArray], ComplexArray]  # f(i), averaged over the rotor position
    dropped: FloatArray  # (K, N), voltage in which each error of the currents is read, Vs
    ohmic: ComplexArray  # (N,), integral of R i, Vs
    rectified: FloatArray  # (N, 3), integral of the magnitude of the drop of each phase, Vs
    drops: FloatArray  # (N, 3), integral of the drop of each phase, Vs
    shapes: Callable[[FloatArray], FloatArray]  # shapes (..., S) of the drop at phase currents (...), A
    heat: FloatArray  # (N,), relative to the largest within a recording
    warmth: list[FloatArray]  # (N,), rise of the winding's temperature, likewise, see ``WindingHeat.courses``
    link: float  # mean DC-link voltage, V; NaN where it is not known
    course: FloatArray  # (N,), that time over the duration of the recording
    ripple: float  # Hz; 0 without
    filter: float  # time constant of the currents' filter, s; 0 without
    delay: float  # of the voltages, samples

    def through_inverse(self, x: ComplexArray) -> ComplexArray:
        """Return f'(i)^-1 x of x (N, 2)."""
        d, q = (self.through(np.full_like(x, unit)) for unit in (1, 1j))
        return np.asarray(((x.conj() * q).imag + 1j * (d.conj() * x).imag) / (d.conj() * q).imag)

    @cached_property
    def compensations(self) -> list[ComplexArray]:
        """``[h(i)_s]`` (N,) at the ends for each shape h of the drop, i being late by what firmware compensates by."""
        windows, ago = self.windows, _LATENESS / 2 * self.windows.period[:, None]
        shapes = self.shapes(frames.phases(self.turn * (self.currents - ago * self.rate)))  # (N, 2, 3, S)
        return [windows.drop_scale * between(frames.space_vector(each)) for each in np.moveaxis(shapes, -1, 0)]

    @cached_property
    def step(self) -> ComplexArray:
        """Difference (N,) between the ends of the voltage, at each that between the samples around it, V."""
        return between(self.windows.held_after(0.5))

    @cached_property
    def voltage(self) -> ComplexArray:
        """Integral (N,) of the delayed voltage, Vs."""
        return np.asarray(self.windows.voltage - np.sum(held_shares(self.delay) * self.windows.shifted, axis=1))

    @cached_property
    def drop(self) -> ComplexArray:
        """Integral (N,) of the drop, Vs."""
        return frames.space_vector(self.drops)

    @cached_property
    def power(self) -> FloatArray:
        """Power (N,) that the machine takes, weighted by the voltage, W."""
        voltage = self.windows.voltage
        return np.asarray((self.windows.loaded * voltage.conj()).real / np.maximum(np.abs(voltage) ** 2, TINY))

    @cached_property
    def spared(self) -> FloatArray:
        """Power (N,) of the drop, which that of a dead time does not take from the link, W."""
        return np.asarray(np.sum(self.fallen * frames.phases(self.currents * self.turn), axis=2).mean(axis=1))

    @cached_property
    def leading(self) -> ComplexArray:
        """Flux (N, 2) that does not lag, Wb."""
        return self.mean_flux(self.windows.lagging[..., -1])


@dataclass(frozen=True)
class Recorded:
    """What is known of recordings, which decides on the effects that they can show."""

    runs: int
    parts: int  # of the data, see :func:`divided`
    link: bool  # whether the DC link was recorded
    temperatures: bool  # whether temperatures are given
    pole_pairs: bool  # whether their number is
    sensors: bool  # whether faults of the current sensors are looked for
    turned: frozenset[str] | None  # which of currents and voltages a log held in d and q, if that is known


@dataclass(frozen=True, eq=False)
class Fitted:
    """What a fit tells of effects that it lacks."""

    values: Mapping[str, FloatArray]  # (K,), of the effects that it has
    resistance: float  # ohm
    magnet: float  # flux at zero current, Wb
    link: bool  # whether the DC link was recorded


@dataclass(frozen=True, eq=False)
class Reported:
    """An effect that was found, to be reported."""

    value: FloatArray  # (K,), estimates of its columns
    sigma: FloatArray  # (K,), their standard errors
    sigma_of: Callable[[FloatArray], FloatArray]  # standard errors (L,) of combinations (K, L)
    met: Callable[[int], bool]  # whether the data have any of a column
    rivals: tuple[str, ...]
    open: bool  # whether one of them would change what users read
    several_speeds: bool
    fastest: float  # largest electrical speed, rad/s
    period: float  # sample period, s
    resistance: float  # ohm
    inductance: float  # d psi_d / d i_d at zero current, H
    i_max: float
    drop: float  # of the inverter, mean of the phases at i_max, V
    pole_pairs: int | None
    link: float  # mean DC-link voltage, V; NaN where it is not known
    links: tuple[float, float]  # lowest and highest mean of a second, V, likewise
    ripple: float  # Hz
    turns: float  # of the ripple within the longest run
    time_constant: float  # of the winding's heat, s; infinite where it stays
    parts: tuple[dict[str, float], ...]  # recording, and time of its data where a pause ends within, s, of each part

    def entry(
        self, name: str, value: float, sigma: float, unit: str, key: str = "", *, scale: float = 1.0, **more: Any
    ) -> Calibration:
        """Return a value and its standard error, shown in a unit of which an SI unit is ``scale``; ``more`` is told."""
        rivals = ",".join(self.rivals) or None
        told = {"value": value, "sigma": sigma, **more, "rivals": rivals, "several_speeds": self.several_speeds}
        open_ = self.open and abs(value) > CERTAIN * sigma  # of several values, those that are nothing are not in doubt
        shown, doubtful = float(scale * value), open_ or name == VOLTAGE_MISMATCH
        return Calibration(name, shown, float(scale * sigma), unit, True, Message(key or name, **told), doubtful)

    def of_parts(self) -> Iterator[tuple[int, dict[str, float], float, float]]:
        """Yield for each part but the first that has data its number from 1, what tells it, value and error."""
        for k, (x, dx) in enumerate(zip(self.value, self.sigma, strict=True)):
            if self.met(k):
                yield k + 2, self.parts[k + 1], float(x), float(dx)

    @cached_property
    def amplitude(self) -> tuple[float, float]:
        """Amplitude of cosine and sine, rms over the runs that have them, and its standard error."""
        pairs, errors = self.value.reshape(-1, 2), self.sigma.reshape(-1, 2)
        met = [k for k in range(len(pairs)) if self.met(2 * k)]
        amplitude = np.sqrt(np.mean(np.sum(pairs[met] ** 2, axis=1)))
        return float(amplitude), float(np.sqrt(np.mean(errors[met] ** 2) / len(met)))


@dataclass(frozen=True)
class DriveEffect(ABC):
    """An effect that the model lacks: it changes the voltage balance of a window by known vectors times its unknowns.

    A subclass gives its columns, or the currents that it adds to that of the map, or errors of the angle, from which
    the columns follow. What makes several effects of one kind differ are the fields.
    """

    name: str
    width: ClassVar[int] = 1
    """Number of unknowns."""
    turns: ClassVar[bool] = False
    """Whether it turns the flux against the currents: at one speed, only the map's bends tell such effects apart."""
    late: ClassVar[bool] = False
    """Whether currents or angle are late. If both are by the same time, the voltages are early by it: data hold one."""
    rotates: ClassVar[bool] = False
    """Whether, at one speed, it rotates the flux against the currents, or does so beside another one: data hold one."""
    of_log: ClassVar[bool] = False
    """Whether a log turned a signal. At one speed, data hold it beside a delay by half or whole samples, which shifts
    as well; in a log of every n-th sample it looks like the misfit."""
    of_link: ClassVar[bool] = False
    """Whether it is a variation of the DC link, which resembles the misfit of a map."""
    positive: ClassVar[bool] = False
    """Whether physics allows no negative value."""
    at_rest: ClassVar[bool] = False
    """Whether it shows while the rotor stands still."""
    of_recordings: ClassVar[bool] = False
    """Whether it depends on the number of a part of the data or a run, or on the time since the start."""
    of_sensors: ClassVar[bool] = False
    """Whether it is of the current sensors, not of the drive."""
    of_speeds: ClassVar[bool] = False
    """Whether it shows only where speeds differ."""
    of_recorded_runs: ClassVar[bool] = False
    """Whether its phase holds for the recorded runs only, so that no simulation can have it."""
    moves_steps: ClassVar[bool] = False
    """Whether the drop steps at other times than those at which the measured currents change their signs."""
    attuned: ClassVar[bool] = False
    """Whether its columns have a frequency or a time constant, which is found anew with each linearization."""
    beside: ClassVar[str] = ""
    """Effect beside which alone it is tried."""
    cause: ClassVar[str] = ""
    """Physical cause that it shares with others, which are no rivals."""
    price: ClassVar[float] = 0.0
    """Share of the squared residuals that it must save beyond what each effect must: others would be it."""
    price_of_part: ClassVar[float] = 0.0
    """The same for each part of the data beyond the second, which has unknowns of its own."""
    harmonic: ClassVar[int] = 0
    """Order of the flux that it causes, and that is none of the machine beside it."""

    @property
    def family(self) -> str:
        """Its cause, or itself."""
        return self.cause or self.name

    def possible(self, _: Recorded) -> bool:
        """Tell whether recordings can show it."""
        return True

    def plausible(self, value: FloatArray, _turn: float, _period: float) -> bool:
        """Tell whether values (K,) are physically possible, with the angle per sample, rad, and the period, s."""
        return not self.positive or bool(value[0] >= 0)

    def expected(self, _: Fitted) -> float:
        """Return how much of it a drive may have though the fit lacks it, in the unit of its first column."""
        return 0.0

    def shifts(self, _: Ends) -> list[ComplexArray]:
        """Return the currents (N, 2) that it adds to that of the map, per unit."""
        return []

    def waves(self, _: Ends) -> list[FloatArray]:
        """Return the errors of the angle (N, 2) per unit."""
        return []

    def magnetizing(self, at: Linearized, _: FloatArray) -> FloatArray:
        """Return the current (N, 1) that stands for the change of a magnet by values (K,) of it, A."""
        return np.zeros((len(at.windows), 1))

    def shifted(self, at: Ends, value: FloatArray) -> ComplexArray:
        """Return the current (N, 2) that values (K,) of it add to that of the map, A."""
        return np.asarray(sum(shift * x for shift, x in zip(self.shifts(at), value, strict=False)), np.complex128)

    def turned(self, at: Ends, value: FloatArray) -> FloatArray:
        """Return the error (N, 2) of the angle that values (K,) of it cause, rad."""
        return np.asarray(sum(wave * x for wave, x in zip(self.waves(at), value, strict=False)), np.float64)

    def columns(self, at: Linearized) -> list[ComplexArray]:
        """Return its columns (N,), Vs per unit; none where the data have none of it."""
        by_current = [between(at.turn * at.through(shift)) for shift in self.shifts(at)]
        return by_current + [between(at.tilt * wave) for wave in self.waves(at)]

    def beyond(self, at: Linearized, _: FloatArray) -> ComplexArray:
        """Return what values (K,) of it change (N,) beyond its columns, and beyond moved currents and angles, Vs."""
        return np.zeros(len(at.windows), np.complex128)

    def refused(self, _value: FloatArray, _half: float, _reach: float) -> Message | None:
        """Return why values (K,) of it are more than a fit follows, which none is by default.

        Given are half of the longest recording, s, and by how much more the voltages may be late, s.
        """
        return None

    @abstractmethod
    def report(self, found: Reported) -> Iterator[Calibration]:
        """Yield its values with their standard errors."""
