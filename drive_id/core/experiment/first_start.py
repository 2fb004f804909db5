"""What the first start of a drive tells: offsets of the currents, sense and angle of the rotor, acceleration.

The rotor of a free shaft follows a current vector that turns slowly in the stator frame; friction holds it back by as
much forwards as backwards. Valid while the magnets, not the saliency, hold the rotor: ``I < psi_PM / |L_q - L_d|``;
beyond, the angle depends on the current, so that two currents disagree.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drive_id.core.frames import ComplexArray, space_vector
from drive_id.errors import ExperimentError
from drive_id.types import FloatArray, Samples

_STEP = 0.01
"""Interval of the mean vectors that are evaluated, s: short against a turn of the vector, long against the noise."""
_IDLE = 0.2  # share of the largest current below which a vector counts as none
_BEFORE = 40  # mean vectors before the first current, for its offset
_SMOOTH = 25
"""Mean vectors over which its speed is taken: the rotor oscillates about the vector, and takes the currents with it."""
_EVEN = 0.4
"""Deviation from the usual speed of the vector that is tolerated: the inverter's voltage error makes it uneven."""
_LEAST_MOTION = 0.5  # motion of the rotor, relative to that of the vector, below which it does not follow
_LARGEST_RATIO_ERROR = 0.05  # deviation of the ratio of the angles from a whole number that is tolerated
_AGREEMENT = math.radians(2.0)
"""Distance between the offsets at two currents that is tolerated beyond what their scatter explains."""
_LARGEST_LOAD_ANGLE = math.radians(35.0)  # by which friction may hold the rotor back
_MOST_PAIRS = 50  # pole pairs
_SHAKES = 2  # periods of a shake in a window
_HIGHEST = 2.5
"""Highest harmonic of i_q whose torque counts; halves count as well, between which the sweep of i_d leads."""
_COHERENT = 0.7  # least cosine of the angle between torque and acceleration


class NoSwingError(ExperimentError):
    """A shaft does not swing with the torque; more current may help against friction and the inverter's drop."""


@dataclass(frozen=True)
class FirstStart:
    """Result of a first start."""

    current_offset: tuple[float, float, float]  # of the phase currents, A; to be subtracted
    direction: int  # -1 if the measured angle falls where the vector turns in the order of the phases
    turns_per_angle: int  # electrical turns per turn of the measured angle: 1, or the pole pairs if it is the shaft's
    angle_offset: float
    """Measured electrical angle, after direction and turns, minus that of the magnet axis, in [-pi, pi), rad."""
    angle_sigma: float  # its standard error, rad
    load_angle: float  # by which friction holds the rotor back, rad


@dataclass(frozen=True, eq=False)
class _Turn:
    """One electrical turn of the vector: its amplitude (A), sense, and angle of the rotor minus that of the vector."""

    amplitude: float
    sense: int
    difference: float


def first_start(samples: Samples) -> FirstStart:
    """Evaluate the recording of trajectory ``first_start``; raises ExperimentError when it does not tell the angle."""
    offset = _current_offset(samples)
    width = max(1, round(_STEP / samples.sample_period))
    count = len(samples.stamp) // width
    vector = space_vector(samples.i_abc - np.array(offset))[: count * width].reshape(count, width).mean(axis=1)
    angle = np.unwrap(samples.angle)[width // 2 : count * width : width][:count]
    largest = float(np.abs(vector).max())
    runs = list(_runs(vector, largest))
    if not runs:
        raise ExperimentError("No current vector that turns evenly is in the recording: record trajectory first_start.")
    # slopes, not ends: a heavy rotor swings about the vector by half a radian
    ratios = [float(np.polyfit(_phase(vector[run]), angle[run], 1)[0]) for run in runs]
    ratio = float(np.median(ratios))
    if abs(ratio) * _MOST_PAIRS < _LEAST_MOTION:
        raise ExperimentError(
            "The rotor does not follow the current vector: it is locked, or friction exceeds the torque of "
            f"{largest:.3g} A; raise first_start_current."
        )
    pairs = round(1 / abs(ratio))
    spread = float(np.ptp(ratios)) / abs(ratio)
    if pairs < 1 or abs(1 / abs(ratio) - pairs) > _LARGEST_RATIO_ERROR * pairs or spread > 4 * _LARGEST_RATIO_ERROR:
        raise ExperimentError(
            f"The angle turns {ratio:.3f} times as far as the current vector (from {min(ratios):.3f} to "
            f"{max(ratios):.3f}), which is no whole number of pole pairs: the rotor slips, or pole_pairs of the drive "
            "is wrong."
        )
    direction = 1 if ratio > 0 else -1
    electrical = direction * pairs * angle
    turns = [turn for run in runs for turn in _turns(vector[run], electrical[run])]
    return _judged(offset, direction, pairs, turns)


def _judged(offset: tuple[float, float, float], direction: int, pairs: int, turns: list[_Turn]) -> FirstStart:
    """Combine forwards and backwards at each amplitude, and compare the amplitudes."""
    largest = max(turn.amplitude for turn in turns)
    levels: dict[float, list[_Turn]] = {}
    for turn in turns:
        levels.setdefault(round(turn.amplitude / largest, 1), []).append(turn)
    found = []
    for _, own in sorted(levels.items()):
        ways = [np.array([turn.difference for turn in own if turn.sense == sense]) for sense in (1, -1)]
        if min(len(way) for way in ways) < 2:
            continue
        reference = ways[0][0]
        ways = [reference + _wrapped(way - reference) for way in ways]
        means = [float(way.mean()) for way in ways]
        error = 0.5 * math.hypot(*(float(way.std(ddof=1)) / math.sqrt(len(way)) for way in ways))
        found.append((0.5 * (means[0] + means[1]), error, 0.5 * abs(means[0] - means[1])))
    if len(found) < 2:
        raise ExperimentError(
            "The recording does not hold two turns each way at two currents: record trajectory first_start to its end."
        )
    (first, error_1, _), (second, error_2, load) = found[0], found[-1]
    apart = float(_wrapped(np.array(second - first)))
    if max(item[2] for item in found) > _LARGEST_LOAD_ANGLE:
        raise ExperimentError(
            f"Friction, or saliency, turns the rotor {math.degrees(max(item[2] for item in found)):.0f} degrees away "
            "from the current vector: change first_start_current, upwards against friction, downwards against saliency."
        )
    if abs(apart) > _AGREEMENT + 3 * math.hypot(error_1, error_2):
        raise ExperimentError(
            f"At two currents the angle's offset differs by {math.degrees(abs(apart)):.1f} degrees: saliency holds the "
            "rotor, not the magnets (the current must be below psi_PM / |L_q - L_d|); reduce first_start_current, or "
            "find angle_offset by the voltages of the machine driven with open terminals."
        )
    offset_angle = float(_wrapped(np.array(first + 0.5 * apart)))
    sigma = max(0.5 * math.hypot(error_1, error_2), 0.5 * abs(apart))
    return FirstStart(offset, direction, pairs, offset_angle, sigma, load)


def _current_offset(samples: Samples) -> tuple[float, float, float]:
    """Return the mean phase currents before the first current, A: a drive that regulates zero hides its offsets."""
    width = max(1, round(_STEP / samples.sample_period))
    count = len(samples.stamp) // width
    means = samples.i_abc[: count * width].reshape(count, width, 3).mean(axis=1)
    size = np.abs(means - np.median(means[:_BEFORE], axis=0)).max(axis=1)
    begin = int(np.argmax(size > _IDLE * size.max()))
    if begin < _BEFORE:
        raise ExperimentError("The recording begins with a current: start it before the trajectory.")
    a, b, c = np.median(means[:_BEFORE], axis=0)
    return float(a), float(b), float(c)


def _phase(vector: ComplexArray) -> FloatArray:
    return np.unwrap(np.angle(vector))


def _runs(vector: ComplexArray, largest: float) -> Iterator[slice]:
    """Yield the stretches in which the vector turns evenly."""
    speed = np.gradient(_phase(np.where(np.abs(vector) > _IDLE * largest, vector, largest)))
    smooth = np.convolve(speed, np.full(_SMOOTH, 1 / _SMOOTH), "same")
    usual = float(np.median(np.abs(smooth[np.abs(smooth) > 0.5 * np.percentile(np.abs(smooth), 80)])))
    even = (np.abs(np.abs(smooth) - usual) < _EVEN * usual) & (np.abs(vector) > _IDLE * largest)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], even.astype(np.int8), [0]))))
    for begin, end in edges.reshape(-1, 2):
        if (end - begin) * usual > 4 * math.pi:
            yield slice(begin, end)


def _turns(vector: ComplexArray, electrical: FloatArray) -> Iterator[_Turn]:
    """Yield the whole turns of an even run."""
    phase = _phase(vector)
    sense = 1 if phase[-1] > phase[0] else -1
    turned = np.abs(phase - phase[0]) / (2 * math.pi)
    for number in range(int(turned[-1])):
        inside = (turned >= number) & (turned < number + 1)
        difference = electrical[inside] - phase[inside]
        yield _Turn(float(np.abs(vector[inside]).mean()), sense, float(difference.mean()))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.mod(angle + math.pi, 2 * math.pi) - math.pi


def shaft_acceleration(samples: Samples, frequency: float, angle_offset: float = 0.0) -> tuple[float, float]:
    """Return the electrical acceleration per amplitude of i_q of a shake, T p / (J i_q), rad/s^2/A.

    First the largest one, of all harmonics of the swing: where i_d sweeps, reluctance torque swings at about twice the
    frequency of i_q. Then that at the frequency of i_q alone.

    Parameters
    ----------
    samples : Samples
        Of trajectory ``free_shaft``.
    frequency : float
        Of i_q, Hz.
    angle_offset : float
        Of a first start, rad: to see that i_q accelerates the shaft forwards.

    Raises
    ------
    NoSwingError
        When the shaft does not swing with the torque.
    ExperimentError
        When it swings against the torque.
    """
    width = max(1, round(_SHAKES / frequency / samples.sample_period))
    count = len(samples.stamp) // width
    phase: FloatArray = 2 * np.pi * frequency * samples.sample_period * np.arange(width, dtype=np.float64)
    orders = np.arange(1, 1 + _SHAKES * _HIGHEST) / _SHAKES
    waves = np.exp(1j * np.outer(phase, orders))
    basis = np.column_stack((waves.real, waves.imag, np.ones(width), np.linspace(-1, 1, width)))
    i_q = (space_vector(samples.i_abc) * np.exp(-1j * (samples.angle - angle_offset))).imag
    windows = np.stack((i_q, np.unwrap(samples.angle)), axis=-1)[: count * width].reshape(count, width, 2)
    both = np.linalg.lstsq(basis, np.moveaxis(windows, 0, 1).reshape(width, -1), rcond=None)[0].reshape(-1, count, 2)
    own = int(np.argmin(np.abs(orders - 1)))
    current, swing = (both[own] - 1j * both[own + len(orders)]).T
    full = np.abs(current) > 0.9 * np.abs(current).max()
    amid = full & np.roll(full, 1) & np.roll(full, -1)  # the slope of the current's rise and fall is no harmonic of it
    full = amid if amid.any() else full
    alpha = -swing[full] / current[full]
    coherent = float(np.median(alpha.real / np.abs(alpha)))
    if coherent < -_COHERENT:
        raise ExperimentError("The shaft swings against its torque: the angle's offset is wrong by half a turn.")
    if coherent < _COHERENT:
        raise NoSwingError("The shaft does not swing with the torque: it is locked, loose, or the offset is wrong.")
    rates = np.tile((2 * np.pi * frequency * orders) ** 2, 2)[:, None]
    acceleration = basis[:, : 2 * len(orders)] @ (rates * both[: 2 * len(orders), :, 1])
    largest = float((np.abs(acceleration).max(axis=0) / np.abs(current))[full].max())
    return largest, float((2 * np.pi * frequency) ** 2 * np.abs(alpha).max())
